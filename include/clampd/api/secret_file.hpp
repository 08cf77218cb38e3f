#pragma once

#include <sys/types.h>

#include <string>
#include <string_view>

#include "clampd/base/result.hpp"

namespace clampd::api {

/// Writes a file that has these permissions from its first byte on. It is a new file that takes the place of
/// whatever stood there: permissions are not inherited, a symbolic link is replaced and not followed, and
/// whoever had the old one open learns nothing.
Result<void> write_secret_file(const std::string& path, std::string_view content, mode_t permissions);

}  // namespace clampd::api
