#pragma once

#include <algorithm>
#include <cmath>

#include "clampd/base/realtime.hpp"
#include "clampd/control/motion_observer.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/control/stiffness_curve.hpp"
#include "clampd/control/stiffness_estimate.hpp"
#include "clampd/record/reference.hpp"

namespace clampd {

/// Hard limits that the control law keeps by itself, below those at which the supervisor stops everything.
struct ControlLimits {
  double torque_Nm = 3.0;
  double force_N = 29e3;
  double velocity_rad_s = 285.0;
};

/// THE tracking law (ARCHITECTURE.md, "Clamp-force tracking"): torque for the row `row` of a reference, not
/// limited. Feed-forward re-shaped for the brake's own stiffness, plus the row's state feedback. `next` is
/// the row after it (or the same at the end); `motion`, its position from contact, is the state at that very
/// row. The design calls it with what is true of a simulated brake.
CLAMPD_REALTIME double tracking_torque_Nm(const ReferenceRow& row, const ReferenceRow& next,
                                          const NominalDrive& drive, const MotionState& motion,
                                          const StiffnessCurve& stiffness) noexcept;

/// The same as the loop calls it: with what it predicts for the row, and what it has learned so far.
CLAMPD_REALTIME double tracking_torque_Nm(const ReferenceRow& row, const ReferenceRow& next,
                                          const NominalDrive& drive, const MotionObserver& predicted,
                                          const StiffnessEstimate& learned) noexcept;

/// Near time-optimal move to `target_rad` (encoder): full speed, braking along the square root that ends at
/// the target. `force_N` is the present clamp force.
CLAMPD_REALTIME double move_torque_Nm(double target_rad, double speed_limit_rad_s, const NominalDrive& drive,
                                      const MotionState& predicted, double force_N) noexcept;

/// Holds a velocity.
CLAMPD_REALTIME double velocity_torque_Nm(double velocity_rad_s, double acceleration_rad_s2,
                                          const NominalDrive& drive, const MotionState& predicted,
                                          double force_N) noexcept;

// The same laws for a brake whose own loop makes the torque of a speed that it is told.

/// Of tracking_torque_Nm(): the speed with which the reference leaves `row`, stretched for the brake's own
/// stiffness, and what takes out the position's error. Not limited. `motion` is the state at that very row.
CLAMPD_REALTIME double tracking_velocity_rad_s(const ReferenceRow& row, const ReferenceRow& next,
                                               const NominalDrive& drive, const MotionState& motion,
                                               const StiffnessCurve& stiffness) noexcept;

/// The same as the loop calls it: with what it predicts for the row, and what it has learned so far.
CLAMPD_REALTIME double tracking_velocity_rad_s(const ReferenceRow& row, const ReferenceRow& next,
                                               const NominalDrive& drive, const MotionObserver& predicted,
                                               const StiffnessEstimate& learned) noexcept;

/// Of move_torque_Nm(): the speed along the same square root.
CLAMPD_REALTIME double move_velocity_rad_s(double target_rad, double speed_limit_rad_s,
                                           const NominalDrive& drive, const MotionState& predicted) noexcept;

/// `velocity_rad_s`, but no more than `acceleration_rad_s2` allows after `before_rad_s`, the command before:
/// the brake's own loop would answer a step with all of its torque. Slower is allowed at once.
CLAMPD_REALTIME inline double ramped_velocity_rad_s(double velocity_rad_s, double before_rad_s,
                                                    double acceleration_rad_s2,
                                                    const NominalDrive& drive) noexcept {
  const double step_rad_s = acceleration_rad_s2 * drive.period_s;
  return std::clamp(velocity_rad_s, std::min(before_rad_s, 0.0) - step_rad_s,
                    std::max(before_rad_s, 0.0) + step_rad_s);
}

/// The force in N that a stop would end at, if the next command brakes with all of `torque_limit_Nm`: along
/// the tangent of the stiffness, with no help by load and friction. The present force unless it closes.
CLAMPD_REALTIME inline double stop_force_N(double velocity_rad_s, double force_N, double slope_N_rad,
                                           double torque_limit_Nm, const NominalDrive& drive) noexcept {
  if (!(velocity_rad_s > 0.0)) return force_N;
  const double braking_rad_s2 = torque_limit_Nm / drive.inertia_kg_m2;
  const double stop_rad = velocity_rad_s * (drive.period_s + 0.5 * velocity_rad_s / braking_rad_s2);
  return force_N + slope_N_rad * stop_rad;
}

/// Limits last: no torque beyond the drive's, none that drives the brake beyond its speed, or into a force
/// from where it could no longer stop in time. Always finite; zero if the input is not.
CLAMPD_REALTIME inline double limited_torque_Nm(double torque_Nm, const ControlLimits& limits,
                                                const NominalDrive& drive, double velocity_rad_s,
                                                double force_N, double slope_N_rad) noexcept {
  // Over which the torque fades before the speed limit: all of it adds no more than that in a period.
  constexpr double kSpeedMargin_rad_s = 15.0;
  if (!std::isfinite(torque_Nm)) return 0.0;
  if (torque_Nm * velocity_rad_s > 0.0) {
    const double margin_rad_s =
        std::max(kSpeedMargin_rad_s, limits.torque_Nm * drive.period_s / drive.inertia_kg_m2);
    const double share =
        std::clamp((limits.velocity_rad_s - std::abs(velocity_rad_s)) / margin_rad_s, 0.0, 1.0);
    torque_Nm = std::clamp(torque_Nm, -share * limits.torque_Nm, share * limits.torque_Nm);
  }
  if (stop_force_N(velocity_rad_s, force_N, slope_N_rad, limits.torque_Nm, drive) > limits.force_N)
    torque_Nm = velocity_rad_s > 0.0 ? -limits.torque_Nm : std::min(torque_Nm, 0.0);
  return std::clamp(torque_Nm, -limits.torque_Nm, limits.torque_Nm);
}

/// Limits last: no speed beyond the limit, none that drives the brake into a force from where it could no
/// longer stop in time: along the square root that ends at the force limit. The torque is the brake's own
/// affair. Always finite; zero if the input is not.
CLAMPD_REALTIME inline double limited_velocity_rad_s(double velocity_rad_s, const ControlLimits& limits,
                                                     const NominalDrive& drive, double force_N,
                                                     double slope_N_rad) noexcept {
  if (!std::isfinite(velocity_rad_s)) return 0.0;
  double closing_rad_s = limits.velocity_rad_s;
  if (slope_N_rad > 0.0 || force_N >= limits.force_N) {
    // Of stop_force_N(): the speed from which the stop ends at the limit.
    const double braking_rad_s2 = limits.torque_Nm / drive.inertia_kg_m2;
    const double room_rad = std::max(0.0, limits.force_N - force_N) / std::max(slope_N_rad, 1.0);
    const double lost_rad_s = braking_rad_s2 * drive.period_s;  // until the next command acts
    const double stops_rad_s =
        std::sqrt(lost_rad_s * lost_rad_s + 2.0 * braking_rad_s2 * room_rad) - lost_rad_s;
    closing_rad_s = std::min(closing_rad_s, stops_rad_s);
  }
  return std::clamp(velocity_rad_s, -limits.velocity_rad_s, closing_rad_s);
}

}  // namespace clampd
