#include "clampd/control/control_law.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/clock.hpp"

namespace clampd {
namespace {

// Of what is slower, no more than a share of a turn in a period: what is decided now acts from the next
// sample on.
constexpr double kVelocityBandwidth_rad_s = 250.0, kVelocityShare = 0.8;
constexpr double kPositionBandwidth_rad_s = 80.0, kPositionShare = 0.25;
constexpr double kBraking_rad_s2 = 4000.0;
constexpr double kSignWidth_rad_s = 3.0;  // below, a friction feed-forward would chatter
// How far from where the nominal brake has a force. That a force reads too little, a slow loop finds later,
// and the brake comes to rest later: it goes less far.
constexpr double kReach_rad = 6.0, kSlowReach_rad = 3.0;
// Bounds of a brake's velocity over the nominal one's, where both have the same force.
constexpr double kLeastStretch = 0.6, kMaxStretch = 1.6;

double velocity_bandwidth_rad_s(const NominalDrive& drive) noexcept {
  return std::min(kVelocityBandwidth_rad_s, kVelocityShare / drive.period_s);
}

double position_bandwidth_rad_s(const NominalDrive& drive) noexcept {
  return std::min(kPositionBandwidth_rad_s, kPositionShare / drive.period_s);
}

/// The sign of a wanted velocity, with a ramp through zero.
double soft_sign(double velocity_rad_s) noexcept {
  return std::clamp(velocity_rad_s / kSignWidth_rad_s, -1.0, 1.0);
}

/// A row of the reference as this very brake has to go through it.
struct StretchedRow {
  double position_rad = 0.0;  ///< where it has the row's force
  double stretch = 1.0;       ///< of its velocity over the row's
};

StretchedRow stretched(const ReferenceRow& row, const NominalDrive& drive,
                       const StiffnessCurve& stiffness) noexcept {
  const double reach_rad = drive.period_s > kPeriod_s ? kSlowReach_rad : kReach_rad;
  const double position_rad =
      stiffness.position_for(row.force_N, row.position_rad, drive.quadratic_N_rad2, reach_rad);
  // The same force over time needs another velocity on another stiffness: v = F'(t) / (dF/dx).
  double stretch = 1.0;
  if (row.position_rad > 0.0)
    stretch = row.position_rad > 1.0
                  ? row.stiffness_N_rad / std::max(stiffness.slope_N_rad(position_rad), 1.0)
                  : position_rad / row.position_rad;
  return {position_rad, std::clamp(stretch, kLeastStretch, kMaxStretch)};
}

/// The observer's position is the encoder's, a row's counts from contact.
MotionState from_contact(const MotionObserver& predicted, const StiffnessEstimate& learned) noexcept {
  MotionState motion = predicted.state();
  motion.position_rad -= learned.contact_rad();
  return motion;
}

/// Where a move is along the square root that ends at its target.
struct Braking {
  double speed_rad_s = 0.0;
  double braking_rad_s2 = 0.0;
};

Braking braking_to(double distance_rad, double speed_limit_rad_s, const NominalDrive& drive) noexcept {
  // Exponential near the target, a parabola of constant braking before, joined smoothly.
  const double bandwidth_rad_s = position_bandwidth_rad_s(drive);
  const double join_rad = kBraking_rad_s2 / (bandwidth_rad_s * bandwidth_rad_s);
  const double speed_rad_s = distance_rad < join_rad
                                 ? bandwidth_rad_s * distance_rad
                                 : std::sqrt(2.0 * kBraking_rad_s2 * (distance_rad - 0.5 * join_rad));
  if (speed_rad_s > speed_limit_rad_s) return {speed_limit_rad_s, 0.0};
  return {speed_rad_s, distance_rad < join_rad ? bandwidth_rad_s * speed_rad_s : kBraking_rad_s2};
}

}  // namespace

double tracking_torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const NominalDrive& drive,
                          const MotionState& motion, const StiffnessCurve& stiffness) noexcept {
  const auto [position_rad, stretch] = stretched(row, drive, stiffness);
  const double velocity_rad_s = stretch * row.velocity_rad_s;
  const double acceleration_rad_s2 = (next.velocity_rad_s - row.velocity_rad_s) / drive.period_s;

  const double feed_forward_Nm = row.torque_Nm +
                                 (stretch - 1.0) * (drive.inertia_kg_m2 * acceleration_rad_s2 +
                                                    drive.viscous_Nm_s_rad * row.velocity_rad_s) +
                                 motion.friction_excess_Nm * soft_sign(velocity_rad_s);
  return feed_forward_Nm + row.gain_position * (position_rad - motion.position_rad) +
         row.gain_velocity * (velocity_rad_s - motion.velocity_rad_s);
}

double tracking_torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const NominalDrive& drive,
                          const MotionObserver& predicted, const StiffnessEstimate& learned) noexcept {
  return tracking_torque_Nm(row, next, drive, from_contact(predicted, learned), learned.curve());
}

double tracking_velocity_rad_s(const ReferenceRow& row, const ReferenceRow& next, const NominalDrive& drive,
                               const MotionState& motion, const StiffnessCurve& stiffness) noexcept {
  const auto [position_rad, stretch] = stretched(row, drive, stiffness);
  return stretch * next.velocity_rad_s +
         position_bandwidth_rad_s(drive) * (position_rad - motion.position_rad);
}

double tracking_velocity_rad_s(const ReferenceRow& row, const ReferenceRow& next, const NominalDrive& drive,
                               const MotionObserver& predicted, const StiffnessEstimate& learned) noexcept {
  return tracking_velocity_rad_s(row, next, drive, from_contact(predicted, learned), learned.curve());
}

double velocity_torque_Nm(double velocity_rad_s, double acceleration_rad_s2, const NominalDrive& drive,
                          const MotionState& predicted, double force_N) noexcept {
  const double friction_Nm = std::max(
      0.0, drive.dry_friction_Nm(std::abs(predicted.velocity_rad_s), force_N) + predicted.friction_excess_Nm);
  return drive.ratio_m_rad * force_N + friction_Nm * soft_sign(velocity_rad_s) +
         drive.viscous_Nm_s_rad * velocity_rad_s +
         drive.inertia_kg_m2 * (acceleration_rad_s2 + velocity_bandwidth_rad_s(drive) *
                                                          (velocity_rad_s - predicted.velocity_rad_s));
}

double move_torque_Nm(double target_rad, double speed_limit_rad_s, const NominalDrive& drive,
                      const MotionState& predicted, double force_N) noexcept {
  const double error_rad = target_rad - predicted.position_rad;
  auto [speed_rad_s, braking_rad_s2] = braking_to(std::abs(error_rad), speed_limit_rad_s, drive);
  const double direction = std::copysign(1.0, error_rad);
  // Braking belongs to the move as planned; while the motor is still slower, it must not slow it further.
  if (direction * predicted.velocity_rad_s < 0.8 * speed_rad_s) braking_rad_s2 = 0.0;
  return velocity_torque_Nm(direction * speed_rad_s, -direction * braking_rad_s2, drive, predicted, force_N);
}

double move_velocity_rad_s(double target_rad, double speed_limit_rad_s, const NominalDrive& drive,
                           const MotionState& predicted) noexcept {
  const double error_rad = target_rad - predicted.position_rad;
  return std::copysign(braking_to(std::abs(error_rad), speed_limit_rad_s, drive).speed_rad_s, error_rad);
}

}  // namespace clampd
