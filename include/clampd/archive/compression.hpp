#pragma once

#include <string>
#include <string_view>

#include "clampd/base/result.hpp"

namespace clampd {

/// As a zlib stream (RFC 1950), quickly: for what is written while somebody waits.
std::string compressed(std::string_view text);

/// As a Zstandard frame (RFC 8878), which takes longer and is a fifth smaller: for what is kept for years.
std::string compressed_smaller(std::string_view text);

/// The text of either. Errors: it is neither as a whole, or its text is larger than any run.
Result<std::string> decompressed(std::string_view stream);

}  // namespace clampd
