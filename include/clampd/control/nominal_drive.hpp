#pragma once

#include <algorithm>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/control/stiffness_curve.hpp"

namespace clampd {

/// Friction torque without its viscous part over the speed, at one force: (4) of the paper with the sign in
/// place of tanh.
struct DryFriction {
  double coulomb_Nm = 0.0;
  double beyond_coulomb_Nm = 0.0;  ///< at rest
  double stribeck_s2_rad2 = 0.0;   ///< one over the square of the Stribeck speed

  /// As a magnitude; the sign of the speed does not matter. Of one speed, or of a vector of them.
  template <class Number>
  CLAMPD_REALTIME Number torque_Nm(Number speed_rad_s) const noexcept {
    return coulomb_Nm + beyond_coulomb_Nm / (1.0 + speed_rad_s * speed_rad_s * stribeck_s2_rad2);
  }
};

/// What the control law needs to know of the product's nominal brake, and of how it is told what to do, as
/// plain numbers: this room knows no brake model.
struct NominalDrive {
  double inertia_kg_m2 = 2.91e-4;
  double ratio_m_rad = 2.63e-5;
  double cubic_N_rad3 = -3.54e-1;    ///< k1
  double quadratic_N_rad2 = 3.52e1;  ///< k2
  double coulomb_Nm = 7.67e-2;
  double static_Nm = 4.68e-2;
  double viscous_Nm_s_rad = 4.46e-4;
  double load_friction_Nm_N = 3.55e-5;
  double stribeck_rad_s = 2.89e1;
  double period_s = kPeriod_s;  ///< from sample to sample, and for which a command acts

  CLAMPD_REALTIME StiffnessCurve stiffness() const noexcept { return {cubic_N_rad3, quadratic_N_rad2}; }

  /// (5) of the paper, and what (4) makes of it.
  CLAMPD_REALTIME DryFriction dry_friction(double force_N) const noexcept {
    const double holding_Nm = static_Nm + load_friction_Nm_N * std::max(0.0, force_N);
    return {coulomb_Nm, holding_Nm - coulomb_Nm, 1.0 / (stribeck_rad_s * stribeck_rad_s)};
  }

  /// Friction torque without its viscous part, as a magnitude.
  CLAMPD_REALTIME double dry_friction_Nm(double speed_rad_s, double force_N) const noexcept {
    return dry_friction(force_N).torque_Nm(speed_rad_s);
  }
};

}  // namespace clampd
