#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include "clampd/base/result.hpp"
#include "tools/cli/exit_code.hpp"

namespace clampd::cli {

/// Prints the error and gives kBadInput, for a command to return.
int refuse(const Error& error);

/// Whether a file could be written there: found out before minutes of work rather than after. An empty path
/// and "-" (standard output) can always be written.
Result<void> check_writable(const std::string& path);

/// The same for what is no run; nor does it take the place of one: `--json *.csv` names the first of them.
Result<void> check_document(const std::string& path);

/// Writes the document where the user asked for it: nowhere for an empty path, to standard output for "-".
Result<void> write_json(const std::string& path, const nlohmann::ordered_json& document);

}  // namespace clampd::cli
