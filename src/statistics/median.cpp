#include "clampd/statistics/median.hpp"

#include <algorithm>

namespace clampd::statistics {

double median(std::span<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace clampd::statistics
