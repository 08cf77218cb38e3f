#pragma once

#include <vector>

#include "clampd/brake/dynamics.hpp"
#include "clampd/brake/parameters.hpp"
#include "clampd/record/reference.hpp"

namespace clampd {

/// What a brake does that tracks a reference.
struct TrackedRun {
  bool bounded = false;
  std::vector<double> torque_Nm;    ///< commanded, within the limit
  double torque_max_Nm = 0.0;       ///< asked for, before the limit
  double force_max_N = 0.0;         ///< at the samples
  double stop_force_max_N = 0.0;    ///< that a stop with all torque from any sample on would end at
  double velocity_max_rad_s = 0.0;  ///< of the speed
  double tracking_rms_N = 0.0;      ///< force minus the reference's
};

/// The loop of ARCHITECTURE.md, "Clamp-force tracking", with everything known that it observes and learns:
/// position and velocity, the brake's own stiffness, what its friction exceeds the nominal one by.
class ClosedLoop {
 public:
  ClosedLoop(const BrakeParameters& nominal, double torque_limit_Nm);

  /// `brake`, from contact and at rest, along the reference into `out`.
  void track(const Reference& reference, const BrakeParameters& brake, TrackedRun& out) const;

  /// What the loop asks for in one row, not limited.
  double torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const PaperBrake& brake,
                   const BrakeState& state) const;

 private:
  BrakeParameters nominal_;
  PaperBrake nominal_brake_;
  double torque_limit_Nm_;
};

}  // namespace clampd
