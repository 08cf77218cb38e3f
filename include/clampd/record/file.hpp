#pragma once

#include <string>
#include <string_view>

#include "clampd/base/result.hpp"

namespace clampd {

/// Whole content of a regular file of at most 256 MiB.
Result<std::string> read_file(const std::string& path);

/// Writes to a temporary file beside `path`, syncs and renames it: nothing half-written is ever left at
/// `path`.
Result<void> write_file_atomically(const std::string& path, std::string_view content);

}  // namespace clampd
