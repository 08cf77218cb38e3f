#pragma once

#include <algorithm>

#include "clampd/base/realtime.hpp"
#include "clampd/control/stiffness_curve.hpp"

namespace clampd {

/// What the control law needs to know of the product's nominal brake, as plain numbers: this room knows no
/// brake model. Friction is (4) and (5) of the paper with the sign in place of tanh.
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

  CLAMPD_REALTIME StiffnessCurve stiffness() const noexcept { return {cubic_N_rad3, quadratic_N_rad2}; }

  /// Friction torque without its viscous part, as a magnitude.
  CLAMPD_REALTIME double dry_friction_Nm(double speed_rad_s, double force_N) const noexcept {
    const double ratio = speed_rad_s / stribeck_rad_s;
    const double holding_Nm = static_Nm + load_friction_Nm_N * std::max(0.0, force_N);
    return coulomb_Nm + (holding_Nm - coulomb_Nm) / (1.0 + ratio * ratio);
  }
};

}  // namespace clampd
