#include "clampd/control/control_law.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <gtest/gtest.h>

namespace clampd {
namespace {

/// A row that the nominal brake passes while it closes, with feedback.
ReferenceRow closing_row() {
  const StiffnessCurve nominal = NominalDrive{}.stiffness();
  return {.force_N = nominal.force_N(20.0),
          .position_rad = 20.0,
          .velocity_rad_s = 100.0,
          .torque_Nm = 0.9,
          .stiffness_N_rad = nominal.slope_N_rad(20.0),
          .gain_position = 0.5,
          .gain_velocity = 0.03};
}

/// Of pads that are a fifth stiffer than the nominal ones.
StiffnessCurve stiffer_pads(const NominalDrive& drive) {
  StiffnessCurve stiffness = drive.stiffness();
  stiffness.cubic_N_rad3 *= 1.2;
  stiffness.quadratic_N_rad2 *= 1.2;
  return stiffness;
}

TEST(ControlLaw, TheNominalBrakeOnItsReferenceGetsTheFeedForward) {
  const NominalDrive drive;
  const ReferenceRow row = closing_row();
  ReferenceRow next = row;
  next.velocity_rad_s += 2.0;
  const MotionState on_it{.position_rad = row.position_rad, .velocity_rad_s = row.velocity_rad_s};
  EXPECT_NEAR(tracking_torque_Nm(row, next, drive, on_it, drive.stiffness()), row.torque_Nm, 1e-12);
}

TEST(ControlLaw, FeedbackAndFrictionExcessAddUp) {
  const NominalDrive drive;
  const ReferenceRow row = closing_row();
  MotionState motion{.position_rad = row.position_rad - 0.1, .velocity_rad_s = row.velocity_rad_s - 4.0};
  EXPECT_NEAR(tracking_torque_Nm(row, row, drive, motion, drive.stiffness()), 0.9 + 0.05 + 0.12, 1e-12);
  motion.friction_excess_Nm = 0.2;
  EXPECT_NEAR(tracking_torque_Nm(row, row, drive, motion, drive.stiffness()), 0.9 + 0.05 + 0.12 + 0.2, 1e-12);
  // Friction acts against the motion; at rest a feed-forward would chatter.
  motion = {.position_rad = row.position_rad, .velocity_rad_s = -100.0, .friction_excess_Nm = 0.2};
  ReferenceRow opening = row;
  opening.velocity_rad_s = -100.0;
  EXPECT_NEAR(tracking_torque_Nm(opening, opening, drive, motion, drive.stiffness()), 0.9 - 0.2, 1e-12);
  opening.velocity_rad_s = motion.velocity_rad_s = 0.0;
  EXPECT_NEAR(tracking_torque_Nm(opening, opening, drive, motion, drive.stiffness()), 0.9, 1e-12);
}

TEST(ControlLaw, StifferPadsHaveTheForceEarlierAndAreMovedSlower) {
  const NominalDrive drive;
  const StiffnessCurve stiffer = stiffer_pads(drive);
  const ReferenceRow row = closing_row();
  const double position_rad =
      stiffer.position_for(row.force_N, row.position_rad, drive.quadratic_N_rad2, 6.0);
  ASSERT_LT(position_rad, row.position_rad);
  // dF/dt of the reference at the stiffer pads' slope.
  const double velocity_rad_s = row.stiffness_N_rad * row.velocity_rad_s / stiffer.slope_N_rad(position_rad);
  ASSERT_LT(velocity_rad_s, row.velocity_rad_s);
  const MotionState on_it{.position_rad = position_rad, .velocity_rad_s = velocity_rad_s};
  const double viscous_Nm = drive.viscous_Nm_s_rad * (velocity_rad_s - row.velocity_rad_s);
  EXPECT_NEAR(tracking_torque_Nm(row, row, drive, on_it, stiffer), row.torque_Nm + viscous_Nm, 1e-12);
}

TEST(ControlLaw, AStopEndsWhereTheTangentAndTheTorqueSay) {
  const NominalDrive drive;
  // 290 rad/s for the millisecond until the command acts, then 3 N m on 2.91e-4 kg m^2.
  const double travel_rad = 290.0 * 1e-3 + 290.0 * 290.0 * 2.91e-4 / (2.0 * 3.0);
  EXPECT_NEAR(stop_force_N(290.0, 25e3, 1100.0, 3.0, drive), 25e3 + 1100.0 * travel_rad, 1e-6);
  EXPECT_EQ(stop_force_N(-290.0, 25e3, 1100.0, 3.0, drive), 25e3) << "it opens";
}

TEST(ControlLaw, LimitsComeLastAndAlwaysGiveAFiniteTorque) {
  const NominalDrive drive;
  const ControlLimits limits;
  const double nan = std::numeric_limits<double>::quiet_NaN(),
               infinity = std::numeric_limits<double>::infinity();
  EXPECT_EQ(limited_torque_Nm(nan, limits, drive, 0.0, 0.0, 0.0), 0.0);
  EXPECT_EQ(limited_torque_Nm(infinity, limits, drive, 0.0, 0.0, 0.0), 0.0);
  EXPECT_EQ(limited_torque_Nm(7.0, limits, drive, 0.0, 0.0, 0.0), 3.0);
  EXPECT_EQ(limited_torque_Nm(-7.0, limits, drive, 0.0, 0.0, 0.0), -3.0);
  EXPECT_LE(limited_torque_Nm(1.0, limits, drive, 0.0, 29.5e3, 1000.0), 0.0)
      << "no further at the force limit";

  constexpr double kFast_rad_s = 290.0;
  EXPECT_EQ(limited_torque_Nm(2.0, limits, drive, kFast_rad_s, 0.0, 0.0), 0.0)
      << "no faster at the speed limit";
  EXPECT_EQ(limited_torque_Nm(-2.0, limits, drive, kFast_rad_s, 0.0, 0.0), -2.0) << "but slower";
  // From 290 rad/s at full braking torque it takes some 4.4 rad to stop; at 1100 N/rad that is beyond the
  // limit.
  EXPECT_EQ(limited_torque_Nm(0.0, limits, drive, kFast_rad_s, 25e3, 1100.0), -3.0);
}

TEST(SpeedLaw, TheNominalBrakeOnItsReferenceGetsTheSpeedOfTheNextRow) {
  const NominalDrive drive;
  const ReferenceRow row = closing_row();
  ReferenceRow next = row;
  next.velocity_rad_s += 2.0;
  MotionState motion{.position_rad = row.position_rad, .velocity_rad_s = row.velocity_rad_s};
  EXPECT_NEAR(tracking_velocity_rad_s(row, next, drive, motion, drive.stiffness()), next.velocity_rad_s,
              1e-9);
  motion.position_rad -= 0.1;
  const double pushed_rad_s = tracking_velocity_rad_s(row, next, drive, motion, drive.stiffness());
  EXPECT_GT(pushed_rad_s, next.velocity_rad_s + 1.0) << "what lies behind is caught up with";
}

TEST(SpeedLaw, StifferPadsAreMovedSlowerByTheSameShareAsByTorque) {
  const NominalDrive drive;
  const StiffnessCurve stiffer = stiffer_pads(drive);
  const ReferenceRow row = closing_row();
  const double position_rad =
      stiffer.position_for(row.force_N, row.position_rad, drive.quadratic_N_rad2, 6.0);
  const double velocity_rad_s = row.stiffness_N_rad * row.velocity_rad_s / stiffer.slope_N_rad(position_rad);
  ASSERT_LT(velocity_rad_s, row.velocity_rad_s);
  EXPECT_NEAR(tracking_velocity_rad_s(row, row, drive, {.position_rad = position_rad}, stiffer),
              velocity_rad_s, 1e-9);
}

// Of a drive that follows exactly, one sample late; of every period that a brake's frames may have.
TEST(SpeedLaw, AMoveEndsAtItsTargetWithoutOvershootAndNeverBeyondItsSpeed) {
  for (const auto& [target_rad, period_s] :
       {std::pair{40.0, 1e-3}, {-7.0, 1e-3}, {40.0, 2e-3}, {40.0, 5e-3}, {-7.0, 5e-3}}) {
    SCOPED_TRACE(period_s);
    const NominalDrive drive{.period_s = period_s};
    MotionState motion;
    double command_rad_s = 0.0, fastest_rad_s = 0.0, furthest = 0.0;
    for (int k = 0; k * period_s < 1.0; ++k) {
      motion.velocity_rad_s = command_rad_s;
      motion.position_rad += period_s * motion.velocity_rad_s;
      command_rad_s = ramped_velocity_rad_s(move_velocity_rad_s(target_rad, 220.0, drive, motion),
                                            command_rad_s, 4000.0, drive);
      fastest_rad_s = std::max(fastest_rad_s, std::abs(command_rad_s));
      furthest = std::max(furthest, motion.position_rad / target_rad);
    }
    EXPECT_NEAR(motion.position_rad, target_rad, 0.01);
    EXPECT_NEAR(command_rad_s, 0.0, 1.0);
    EXPECT_LE(fastest_rad_s, 220.0);
    EXPECT_GT(fastest_rad_s, 100.0);
    EXPECT_LT(furthest, 1.02);
  }
}

TEST(SpeedLaw, FasterGoesByARampAndSlowerAtOnce) {
  EXPECT_EQ(ramped_velocity_rad_s(220.0, 100.0, 4000.0, {}), 104.0);
  EXPECT_EQ(ramped_velocity_rad_s(-220.0, -100.0, 4000.0, {}), -104.0);
  EXPECT_EQ(ramped_velocity_rad_s(50.0, 100.0, 4000.0, {}), 50.0);
  EXPECT_EQ(ramped_velocity_rad_s(0.0, -100.0, 4000.0, {}), 0.0);
  EXPECT_EQ(ramped_velocity_rad_s(220.0, 100.0, 4000.0, {.period_s = 5e-3}), 120.0);
  EXPECT_EQ(ramped_velocity_rad_s(-220.0, 100.0, 4000.0, {}), -4.0)
      << "through zero, and from there by the ramp";
}

TEST(SpeedLaw, LimitsComeLastAndAlwaysGiveAFiniteSpeed) {
  const NominalDrive drive;
  const ControlLimits limits;
  const double nan = std::numeric_limits<double>::quiet_NaN(),
               infinity = std::numeric_limits<double>::infinity();
  EXPECT_EQ(limited_velocity_rad_s(nan, limits, drive, 0.0, 0.0), 0.0);
  EXPECT_EQ(limited_velocity_rad_s(infinity, limits, drive, 0.0, 0.0), 0.0);
  EXPECT_EQ(limited_velocity_rad_s(400.0, limits, drive, 0.0, 0.0), limits.velocity_rad_s);
  EXPECT_EQ(limited_velocity_rad_s(-400.0, limits, drive, 0.0, 0.0), -limits.velocity_rad_s);
  EXPECT_EQ(limited_velocity_rad_s(50.0, limits, drive, 29.5e3, 1000.0), 0.0)
      << "no further at the force limit";
  EXPECT_EQ(limited_velocity_rad_s(50.0, limits, drive, 29.5e3, 0.0), 0.0) << "wherever contact may be";
  EXPECT_EQ(limited_velocity_rad_s(-50.0, limits, drive, 29.5e3, 1000.0), -50.0) << "but open";
  const double stops_rad_s = limited_velocity_rad_s(285.0, limits, drive, 25e3, 1100.0);
  EXPECT_LT(stops_rad_s, 285.0);
  EXPECT_NEAR(stop_force_N(stops_rad_s, 25e3, 1100.0, limits.torque_Nm, drive), limits.force_N, 1e-6)
      << "the speed from which the stop ends there";
}

}  // namespace
}  // namespace clampd
