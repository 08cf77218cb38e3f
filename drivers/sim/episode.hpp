#pragma once

#include <limits>

namespace clampd::sim {

/// While a simulated brake misbehaves. Its times count from the brake's start, or, with `from_force_N`, from the
/// first sample in which the pads really press harder than that: whenever the brake is clamped, it finds it so.
struct Episode {
  double at_s = 0.0;
  double duration_s = std::numeric_limits<double>::infinity();
  double from_force_N = 0.0;                               ///< 0: from the brake's start
  double met_s = std::numeric_limits<double>::infinity();  ///< when that force was first exceeded

  /// Takes each sample's true force, on the brake's clock.
  void observe(double time_s, double force_N) noexcept {
    if (force_N > from_force_N && met_s > time_s) met_s = time_s;
  }

  bool active(double time_s) const noexcept {
    const double begin_s = at_s + (from_force_N > 0.0 ? met_s : 0.0);
    return time_s >= begin_s && time_s < begin_s + duration_s;
  }

  bool valid() const noexcept {
    return at_s >= 0.0 && duration_s > 0.0 && from_force_N >= 0.0 &&
           from_force_N < std::numeric_limits<double>::infinity();
  }
};

}  // namespace clampd::sim
