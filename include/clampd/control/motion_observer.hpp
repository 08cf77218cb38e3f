#pragma once

#include "clampd/base/realtime.hpp"
#include "clampd/control/nominal_drive.hpp"

namespace clampd {

/// How the motor moves, and what the friction of this brake differs by.
struct MotionState {
  double position_rad = 0.0;
  double velocity_rad_s = 0.0;
  double friction_excess_Nm = 0.0;  ///< what friction, as a magnitude, is beyond that of the nominal brake
};

/// Where the motor will be when the next command begins to act.
///
/// A Kalman filter for encoder position, velocity and one unknown: by how much the dry friction exceeds the
/// nominal one. It runs one sample ahead of the readings, which takes the sample of delay out of the control
/// loop. Between samples it integrates the nominal drive with friction as a projection at velocity level, so
/// that it knows rest from creeping; at rest it learns nothing about friction and cannot wind up.
class MotionObserver {
 public:
  /// Starts over from what is known: a reading of the encoder, at rest unless said.
  CLAMPD_REALTIME void reset(const MotionState& known) noexcept;
  /// A reading of the sample that was predicted last.
  CLAMPD_REALTIME void correct(double position_rad, double velocity_rad_s) noexcept;
  /// From the sample just corrected to the next one: `torque_Nm` and `force_N` act meanwhile. Again for each
  /// sample that is missing.
  CLAMPD_REALTIME void predict(const NominalDrive& drive, double torque_Nm, double force_N) noexcept;

  CLAMPD_REALTIME double position_rad() const noexcept { return state_.position_rad; }
  CLAMPD_REALTIME double velocity_rad_s() const noexcept { return state_.velocity_rad_s; }
  CLAMPD_REALTIME const MotionState& state() const noexcept { return state_; }

 private:
  /// Of position (p), velocity (v) and friction excess (f): the upper triangle of the symmetric matrix.
  struct Covariance {
    double pp = 0.0, pv = 0.0, pf = 0.0, vv = 0.0, vf = 0.0, ff = 0.0;
  };

  MotionState state_;
  Covariance covariance_;
};

}  // namespace clampd
