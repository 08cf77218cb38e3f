#pragma once

#include <string>
#include <string_view>

#include "clampd/base/result.hpp"

namespace clampd {

/// As a zlib stream (RFC 1950).
std::string compressed(std::string_view text);

/// The same back. Errors: it is no whole zlib stream, or its text is larger than any run.
Result<std::string> decompressed(std::string_view stream);

}  // namespace clampd
