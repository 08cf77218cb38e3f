#include "clampd/control/stiffness_curve.hpp"

#include <algorithm>
#include <cmath>

namespace clampd {
namespace {

/// The slope of a cubic with k1 < 0 peaks at the inflection, x = -k2 / (3 k1), and is zero at twice that: up
/// to this many inflections it is still steep.
constexpr double kSteep = 1.6;
constexpr double kLeastSlope_N_rad = 1.0;
constexpr int kNewtonSteps = 6;

}  // namespace

double StiffnessCurve::position_for(double force_N, double nominal_position_rad,
                                    double nominal_quadratic_N_rad2, double reach_rad) const noexcept {
  if (nominal_position_rad <= 0.0 || force_N <= 0.0) return nominal_position_rad;
  double highest = nominal_position_rad + reach_rad;
  if (cubic_N_rad3 < 0.0) highest = std::min(highest, kSteep * quadratic_N_rad2 / (-3.0 * cubic_N_rad3));
  const double lowest = std::max(0.5 * nominal_position_rad, nominal_position_rad - reach_rad);
  highest = std::max(highest, lowest);
  // If only k2 differed, the force would be where the square of the position is as much smaller or larger.
  double x = std::clamp(nominal_position_rad * std::sqrt(nominal_quadratic_N_rad2 / quadratic_N_rad2), lowest,
                        highest);
  for (int step = 0; step < kNewtonSteps; ++step) {
    const double slope = std::max(slope_N_rad(x), kLeastSlope_N_rad), before = x;
    x = std::clamp(x + (force_N - this->force_N(x)) / slope, lowest, highest);
    if (x == before) break;  // all that follow would find the same
  }
  return x;
}

}  // namespace clampd
