#pragma once

#include <span>

namespace clampd::statistics {

/// The middle one of values, which it reorders; of an even number the upper of the two in the middle. 0 of
/// none.
double median(std::span<double> values);

}  // namespace clampd::statistics
