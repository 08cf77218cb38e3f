#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include <fmt/format.h>

namespace clampd::support {

/// How often something was hit, with Wilson's 95 % interval.
struct Rate {
  int hits = 0, of = 0;

  void add(bool hit) {
    hits += hit ? 1 : 0;
    ++of;
  }
  std::string text() const {
    if (of == 0) return "      -";
    constexpr double kZ = 1.96;
    const double n = of, p = hits / n, z2 = kZ * kZ / n;
    const double middle = (p + 0.5 * z2) / (1.0 + z2);
    const double half = kZ * std::sqrt(p * (1.0 - p) / n + 0.25 * z2 / n) / (1.0 + z2);
    return fmt::format("{:5.1f} % [{:4.1f}, {:5.1f}]  {}/{}", 100.0 * p, 100.0 * std::max(0.0, middle - half),
                       100.0 * std::min(1.0, middle + half), hits, of);
  }
};

}  // namespace clampd::support
