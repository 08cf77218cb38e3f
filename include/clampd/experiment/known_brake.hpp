#pragma once

#include <cmath>

#include "clampd/brake/dynamics.hpp"
#include "clampd/control/motion_observer.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/control/stiffness_curve.hpp"

namespace clampd {

/// What the station's loop learns of a brake's stiffness, all of it known.
inline StiffnessCurve known_stiffness(const PaperBrake& brake) {
  return {brake.stiffness().cubic_N_rad3, brake.stiffness().quadratic_N_rad2};
}

/// What the loop observes of a brake's motion, all of it known. The observer takes the viscous friction for
/// nominal: what is more counts as excess like the rest.
inline MotionState known_motion(const PaperBrake& brake, const BrakeState& state, const NominalDrive& drive) {
  const double force_N = brake.stiffness().force_N(state[0]);
  const double speed_rad_s = std::abs(state[1]);
  const double nominal_Nm =
      drive.dry_friction_Nm(speed_rad_s, force_N) + drive.viscous_Nm_s_rad * speed_rad_s;
  return {.position_rad = state[0],
          .velocity_rad_s = state[1],
          .friction_excess_Nm = brake.friction().sliding_Nm(force_N, speed_rad_s, 1.0) - nominal_Nm};
}

}  // namespace clampd
