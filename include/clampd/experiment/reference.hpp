#pragma once

#include "clampd/base/clock.hpp"
#include "clampd/base/result.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/reference.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// What a trajectory may ask of the brake, and how tightly it shall be tracked.
struct ReferenceOptions {
  double period_s = kPeriod_s;  ///< of the loop, a multiple of 1 ms
  double force_limit_N = 30e3;
  double velocity_limit_rad_s = 300.0;
  double torque_limit_Nm = 3.0;
  /// A start further into the pads would not be at rest at zero force.
  double start_force_limit_N = 100.0;
  /// How far one row may be from where the nominal brake gets from the row before.
  double consistency_position_rad = 0.01;
  double consistency_velocity_rad_s = 0.5;
  double consistency_force_N = 50.0;
  /// Weights of the tracking: errors of this size cost as much as a torque of tracking_torque_Nm.
  double tracking_force_N = 50.0;
  double tracking_position_rad = 0.1;
  double tracking_velocity_rad_s = 15.0;
  double tracking_torque_Nm = 0.6;

  Result<void> validate() const;
};

/// Turns a trajectory of the nominal brake (rows 1 ms apart, all columns, position from contact)
/// into what the loop replays: its rows at the loop's period, with the stiffness there and the gains of a
/// linear-quadratic regulator along it.
///
/// The gains K(k) minimise the sum of (dF/force)^2 + (dx/position)^2 + (dv/velocity)^2 + (dT/torque)^2 over
/// the rows to come, for the brake linearised about each row and its torque held over the sample. They are
/// meant for the state at the very row whose torque they change: the loop predicts that state from the sample
/// before.
///
/// Errors name the first row that breaks a limit, or does not follow from the row before it on the nominal
/// brake: such a trajectory was designed for another brake; or whose torque changes within a period.
Result<Reference> build_reference(const Run& trajectory, const BrakeParameters& nominal,
                                  const ReferenceOptions& options = {});

/// What the control law needs to know of the nominal brake, and of the station's period.
NominalDrive nominal_drive(const BrakeParameters& nominal, double period_s = kPeriod_s);

}  // namespace clampd
