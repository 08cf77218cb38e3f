#include "tools/cli/output.hpp"

#include <unistd.h>

#include <algorithm>
#include <filesystem>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/record/file.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::cli {

namespace fs = std::filesystem;

int refuse(const Error& error) {
  print_error(error.message);
  return kBadInput;
}

Result<void> check_writable(const std::string& path) {
  if (path.empty() || path == "-") return {};
  std::error_code failed;
  if (fs::is_directory(path, failed)) return failure(fmt::format("{} is a folder; name a file", path));
  const fs::path parent = fs::absolute(path, failed).parent_path();
  if (!fs::is_directory(parent, failed))
    return failure(fmt::format("cannot write {}: there is no folder {}", path, parent.string()));
  if (access(parent.c_str(), W_OK) != 0)
    return failure(fmt::format("cannot write {}: no permission in {}", path, parent.string()));
  return {};
}

Result<void> check_document(const std::string& path) {
  std::error_code failed;
  if (fs::path(path).extension() == ".csv" && fs::exists(path, failed))
    return failure(
        fmt::format("{} is there already and is named like a run, which would be lost; give the "
                    "result another name, and that before the runs",
                    path));
  return check_writable(path);
}

namespace {

/// Two names of one file: "runs/../a.csv" and "a.csv", or a link.
bool are_the_same(const std::string& a, const std::string& b) {
  std::error_code failed;
  return a == b || fs::equivalent(a, b, failed) ||
         fs::weakly_canonical(a, failed) == fs::weakly_canonical(b, failed);
}

}  // namespace

Result<void> check_outputs(std::span<const OutputOption> outputs, const std::vector<std::string>& read) {
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    const auto& [option, path] = outputs[i];
    if (path.empty()) continue;
    if (path == "-" && option != "--json") return failure(fmt::format("{} needs the name of a file", option));
    for (const OutputOption& other : outputs.first(i))
      if (!other.path.empty() && are_the_same(other.path, path))
        return failure(fmt::format("{} and {} name the same file", other.option, option));
    const auto taken =
        std::ranges::find_if(read, [&](const std::string& file) { return are_the_same(file, path); });
    if (taken != read.end())
      return failure(fmt::format("{} would overwrite {}, which is read; name another file", option, *taken));
    if (Result<void> writable = check_document(path); !writable) return writable;
  }
  return {};
}

Result<void> write_json(const std::string& path, const nlohmann::ordered_json& document) {
  if (path.empty()) return {};
  if (path == "-") {
    fmt::print("{}\n", document.dump(2));
    return {};
  }
  return write_file_atomically(path, document.dump(2) + "\n");
}

}  // namespace clampd::cli
