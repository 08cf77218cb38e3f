#pragma once

#include "clampd/base/realtime.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/control/stiffness_curve.hpp"

namespace clampd {

/// The stiffness curve of the very brake on the bench, learned while it moves: F = s2 k2 u^2 + s1 k1 u^3 with
/// u = encoder - contact - delay * velocity, by an extended Kalman filter for (s2, s1, contact, delay). It
/// turns a force into the position where this brake has it, so that tracking a force becomes tracking an
/// encoder position: precise, free of the load cell's noise, and bounded. The delay is that of the force
/// reading behind the encoder's: without it, a slow load cell would be taken for soft pads, and the brake
/// squeezed by thousands of newtons too much.
class StiffnessEstimate {
 public:
  /// Contact was just found: `force_N` (tared, smoothed) at the encoder reading `position_rad`.
  CLAMPD_REALTIME void start(const NominalDrive& drive, double position_rad, double force_N) noexcept;
  /// A pair of readings of the same instant.
  CLAMPD_REALTIME void learn(double position_rad, double force_N, double velocity_rad_s) noexcept;

  CLAMPD_REALTIME double contact_rad() const noexcept { return contact_rad_; }
  CLAMPD_REALTIME StiffnessCurve curve() const noexcept {
    return {cubic_ * cubic_nominal_, quadratic_ * quadratic_nominal_};
  }

 private:
  double cubic_nominal_ = 0.0;
  double quadratic_nominal_ = 1.0;
  double cubic_ = 1.0;      ///< s1
  double quadratic_ = 1.0;  ///< s2
  double contact_rad_ = 0.0;
  double delay_s_ = 0.0;
  double found_rad_ = 0.0;        ///< contact as start() found it
  double covariance_[4][4] = {};  ///< of (s2, s1, contact, delay)
};

}  // namespace clampd
