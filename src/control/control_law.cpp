#include "clampd/control/control_law.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/clock.hpp"

namespace clampd {
namespace {

constexpr double kVelocityBandwidth_rad_s = 250.0;
constexpr double kPositionBandwidth_rad_s = 80.0;
constexpr double kBraking_rad_s2 = 4000.0;
constexpr double kSignWidth_rad_s = 3.0;  // below, a friction feed-forward would chatter
// Bounds of a brake's velocity over the nominal one's, where both have the same force.
constexpr double kLeastStretch = 0.6, kMaxStretch = 1.6;

/// The sign of a wanted velocity, with a ramp through zero.
double soft_sign(double velocity_rad_s) noexcept {
  return std::clamp(velocity_rad_s / kSignWidth_rad_s, -1.0, 1.0);
}

}  // namespace

double tracking_torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const NominalDrive& drive,
                          const MotionState& motion, const StiffnessCurve& stiffness) noexcept {
  const double position_rad = stiffness.position_for(row.force_N, row.position_rad, drive.quadratic_N_rad2);
  // The same force over time needs another velocity on another stiffness: v = F'(t) / (dF/dx).
  double stretch = 1.0;
  if (row.position_rad > 0.0)
    stretch = row.position_rad > 1.0
                  ? row.stiffness_N_rad / std::max(stiffness.slope_N_rad(position_rad), 1.0)
                  : position_rad / row.position_rad;
  stretch = std::clamp(stretch, kLeastStretch, kMaxStretch);
  const double velocity_rad_s = stretch * row.velocity_rad_s;
  const double acceleration_rad_s2 = (next.velocity_rad_s - row.velocity_rad_s) / kPeriod_s;

  const double feed_forward_Nm = row.torque_Nm +
                                 (stretch - 1.0) * (drive.inertia_kg_m2 * acceleration_rad_s2 +
                                                    drive.viscous_Nm_s_rad * row.velocity_rad_s) +
                                 motion.friction_excess_Nm * soft_sign(velocity_rad_s);
  return feed_forward_Nm + row.gain_position * (position_rad - motion.position_rad) +
         row.gain_velocity * (velocity_rad_s - motion.velocity_rad_s);
}

double tracking_torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const NominalDrive& drive,
                          const MotionObserver& predicted, const StiffnessEstimate& learned) noexcept {
  // The observer's position is the encoder's, a row's counts from contact.
  MotionState motion = predicted.state();
  motion.position_rad -= learned.contact_rad();
  return tracking_torque_Nm(row, next, drive, motion, learned.curve());
}

double velocity_torque_Nm(double velocity_rad_s, double acceleration_rad_s2, const NominalDrive& drive,
                          const MotionState& predicted, double force_N) noexcept {
  const double friction_Nm = std::max(
      0.0, drive.dry_friction_Nm(std::abs(predicted.velocity_rad_s), force_N) + predicted.friction_excess_Nm);
  return drive.ratio_m_rad * force_N + friction_Nm * soft_sign(velocity_rad_s) +
         drive.viscous_Nm_s_rad * velocity_rad_s +
         drive.inertia_kg_m2 *
             (acceleration_rad_s2 + kVelocityBandwidth_rad_s * (velocity_rad_s - predicted.velocity_rad_s));
}

double move_torque_Nm(double target_rad, double speed_limit_rad_s, const NominalDrive& drive,
                      const MotionState& predicted, double force_N) noexcept {
  const double error_rad = target_rad - predicted.position_rad;
  const double distance_rad = std::abs(error_rad);
  // Exponential near the target, a parabola of constant braking before, joined smoothly.
  constexpr double kJoin_rad = kBraking_rad_s2 / (kPositionBandwidth_rad_s * kPositionBandwidth_rad_s);
  double speed_rad_s = distance_rad < kJoin_rad
                           ? kPositionBandwidth_rad_s * distance_rad
                           : std::sqrt(2.0 * kBraking_rad_s2 * (distance_rad - 0.5 * kJoin_rad));
  double braking_rad_s2 = distance_rad < kJoin_rad ? kPositionBandwidth_rad_s * speed_rad_s : kBraking_rad_s2;
  if (speed_rad_s > speed_limit_rad_s) {
    speed_rad_s = speed_limit_rad_s;
    braking_rad_s2 = 0.0;
  }
  const double direction = std::copysign(1.0, error_rad);
  // Braking belongs to the move as planned; while the motor is still slower, it must not slow it further.
  if (direction * predicted.velocity_rad_s < 0.8 * speed_rad_s) braking_rad_s2 = 0.0;
  return velocity_torque_Nm(direction * speed_rad_s, -direction * braking_rad_s2, drive, predicted, force_N);
}

}  // namespace clampd
