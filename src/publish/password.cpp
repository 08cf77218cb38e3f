#include "src/publish/password.hpp"

#include <sys/stat.h>

#include <fmt/format.h>

#include "clampd/record/file.hpp"

namespace clampd::publish {

Result<std::string> read_password(const std::string& file) {
  if (file.empty()) return std::string();
  struct stat status {};
  if (::stat(file.c_str(), &status) == 0 && (status.st_mode & S_IRWXO) != 0)
    return failure(
        fmt::format("{}: everybody on this machine may read the password: `chmod o-rwx {}`", file, file));
  return read_file(file).map(
      [](const std::string& text) { return text.substr(0, text.find_first_of("\r\n")); });
}

}  // namespace clampd::publish
