#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "clampd/base/result.hpp"
#include "tools/cli/exit_code.hpp"

namespace clampd::cli {

/// Prints the error and gives kBadInput, for a command to return.
int refuse(const Error& error);

/// Whether a file could be written there: found out before minutes of work rather than after. An empty path
/// and "-" (standard output) can always be written.
Result<void> check_writable(const std::string& path);

/// The same, and that it takes the place of no run: `--json *.csv` names the first of them.
Result<void> check_document(const std::string& path);

/// An option that names a file to be written, and the name; empty where it was not given.
struct OutputOption {
  std::string_view option;
  std::string path;
};

/// Whether all files can be written: each once, over none that is read, however either is called, over no
/// other that is named like a run, and none but --json to standard output.
Result<void> check_outputs(std::span<const OutputOption> outputs, const std::vector<std::string>& read = {});

/// Writes the document where the user asked for it: nowhere for an empty path, to standard output for "-".
Result<void> write_json(const std::string& path, const nlohmann::ordered_json& document);

}  // namespace clampd::cli
