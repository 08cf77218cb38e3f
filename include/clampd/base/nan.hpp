#pragma once

#include <limits>

namespace clampd {

/// What a number is before it is known, and where it cannot be.
inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

}  // namespace clampd
