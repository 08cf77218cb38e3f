#pragma once

#include <vector>

#include "clampd/brake/dynamics.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/reference.hpp"

namespace clampd {

/// What a brake does that tracks a reference. Torque and tracking are those of the station, whose loop holds
/// back what would break its limits of force and speed. The extremes are those of the same loop without these
/// limits, so that no design counts on being held back.
struct TrackedRun {
  bool bounded = false;
  std::vector<double> torque_Nm;    ///< commanded, within the loop's limits
  double tracking_rms_N = 0.0;      ///< force minus the reference's
  double torque_max_Nm = 0.0;       ///< asked for, before any limit
  double force_max_N = 0.0;         ///< at the samples
  double stop_force_max_N = 0.0;    ///< that a stop with all torque from any sample on would end at
  double velocity_max_rad_s = 0.0;  ///< of the speed
};

/// A brake under the station's control law (`clampd/control/control_law.hpp`), with everything known that
/// the loop observes and learns: position and velocity, the brake's own stiffness, what its friction exceeds
/// the nominal one by.
class ClosedLoop {
 public:
  /// `drive`: what the loop knows; the references must have its period.
  ClosedLoop(const NominalDrive& drive, double torque_limit_Nm);

  /// `brake`, from contact and at rest, along the reference into `out`.
  void track(const Reference& reference, const BrakeParameters& brake, TrackedRun& out) const;

  /// What the law asks for in one row, not limited.
  double torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const PaperBrake& brake,
                   const BrakeState& state) const;

 private:
  /// `held_back`: by all of the loop's limits, or by the torque limit alone. Returns whether the others would
  /// have changed a torque.
  bool simulate(const Reference& reference, const PaperBrake& brake, bool held_back, TrackedRun& out) const;

  NominalDrive drive_;
  double torque_limit_Nm_;
};

}  // namespace clampd
