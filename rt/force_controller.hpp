#pragma once

#include "clampd/base/realtime.hpp"
#include "clampd/record/reference.hpp"
#include "rt/motion_observer.hpp"
#include "rt/nominal_drive.hpp"
#include "rt/stiffness_estimate.hpp"

namespace clampd::rt {

/// Hard limits that the control law keeps by itself, below those at which the supervisor stops everything.
struct ControlLimits {
  double torque_Nm = 3.0;
  double force_N = 29e3;
  double velocity_rad_s = 285.0;
};

/// Torque for the row `row` of a reference, from the state predicted for that very row: feed-forward
/// re-shaped for the brake's own stiffness, plus the row's state feedback. `next` is the row after it (or the
/// same at the end).
CLAMPD_REALTIME double tracking_torque_Nm(const ReferenceRow& row, const ReferenceRow& next,
                                          const NominalDrive& drive, const MotionObserver& predicted,
                                          const StiffnessEstimate& stiffness) noexcept;

/// Near time-optimal move to `target_rad` (encoder): full speed, braking along the square root that ends at
/// the target. `force_N` is the present clamp force.
CLAMPD_REALTIME double move_torque_Nm(double target_rad, double speed_limit_rad_s, const NominalDrive& drive,
                                      const MotionObserver& predicted, double force_N) noexcept;

/// Holds a velocity.
CLAMPD_REALTIME double velocity_torque_Nm(double velocity_rad_s, double acceleration_rad_s2,
                                          const NominalDrive& drive, const MotionObserver& predicted,
                                          double force_N) noexcept;

/// Limits last: no torque beyond the drive's, none that drives the brake beyond its speed, or into a force
/// from where it could no longer stop in time. Always finite; zero if the input is not.
CLAMPD_REALTIME double limited_torque_Nm(double torque_Nm, const ControlLimits& limits,
                                         const NominalDrive& drive, const MotionObserver& predicted,
                                         double force_N, double slope_N_rad) noexcept;

}  // namespace clampd::rt
