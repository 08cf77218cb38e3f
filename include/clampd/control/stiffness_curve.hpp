#pragma once

#include "clampd/base/realtime.hpp"

namespace clampd {

/// Clamp force over the position from contact, F = k1 x^3 + k2 x^2, equation (3), as plain numbers: of the
/// nominal brake, as learned of the one on the bench, or the true one of a brake that a design simulates.
struct StiffnessCurve {
  double cubic_N_rad3 = 0.0;      ///< k1
  double quadratic_N_rad2 = 1.0;  ///< k2, positive

  /// At a position from contact; none in the clearance.
  CLAMPD_REALTIME double force_N(double position_rad) const noexcept {
    return position_rad <= 0.0 ? 0.0 : force_in_contact_N(position_rad);
  }

  /// The same where the pads touch, for one position or a vector of them.
  template <class Number>
  CLAMPD_REALTIME Number force_in_contact_N(Number position_rad) const noexcept {
    return (cubic_N_rad3 * position_rad + quadratic_N_rad2) * position_rad * position_rad;
  }

  /// dF/dx at a position from contact; none in the clearance.
  CLAMPD_REALTIME double slope_N_rad(double position_rad) const noexcept {
    if (position_rad <= 0.0) return 0.0;
    return (3.0 * cubic_N_rad3 * position_rad + 2.0 * quadratic_N_rad2) * position_rad;
  }

  /// The position from contact where this curve has `force_N`. The nominal brake has that force at
  /// `nominal_position_rad` and a quadratic coefficient of `nominal_quadratic_N_rad2`: the search starts from
  /// there, goes at most `reach_rad` away and stays where the curve is still steep, so that also a brake that
  /// cannot reach the force at all gets a sane position.
  CLAMPD_REALTIME double position_for(double force_N, double nominal_position_rad,
                                      double nominal_quadratic_N_rad2, double reach_rad) const noexcept;
};

}  // namespace clampd
