#include "src/experiment/closed_loop.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/brake/simulation.hpp"
#include "clampd/control/control_law.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/experiment/robust_design.hpp"
#include "clampd/record/run.hpp"

namespace clampd {
namespace {

Run known_trajectory() {
  return response_to({kKnownRobustBlocks_Nm.begin(), kKnownRobustBlocks_Nm.end()}, kKnownRobustBlockSamples,
                     {});
}

Reference shipped_reference() {
  const std::string path = std::string(CLAMPD_SOURCE_DIR) + "/configs/trajectory.csv";
  return build_reference(read_run(path).value().run, {}).value();
}

/// Friction as a magnitude by (4) and (5), eps to infinity.
double friction_Nm(const BrakeParameters& brake, double force_N, double speed_rad_s) {
  const ParameterVector& p = brake.theta;
  const double holding_Nm = p[Ts0] + p[mus] * force_N;
  return p[TC] + (holding_Nm - p[TC]) / (1.0 + std::pow(speed_rad_s / p[ws], 2)) + p[Tv] * speed_rad_s;
}

/// The corners of Table II, some brakes between and beyond, and the nominal one.
std::vector<BrakeParameters> brakes_of_table_II() {
  std::vector<BrakeParameters> brakes = draw_prior({}, 40, 5);
  for (unsigned corner = 0; corner < 1u << kParameterCount; ++corner) {
    BrakeParameters brake;
    for (std::size_t i = 0; i < kParameterCount; ++i)
      if ((corner >> i & 1u) != 0) brake.theta[static_cast<Eigen::Index>(i)] *= kTableII[i];
    brakes.push_back(brake);
  }
  return brakes;
}

// The loop's side is what CheckSequence does in a row of a run, with an observer and a stiffness that know
// the truth instead of having found it.
TEST(ClosedLoop, AsksForWhatTheStationsLoopAsksForThatKnowsTheTruth) {
  const Reference reference = shipped_reference();
  const NominalDrive drive = nominal_drive({});
  const ClosedLoop loop({}, 3.0);
  constexpr double kContact_rad = 11.25;  // of the encoder, which the design does not know
  const double beside_rad[] = {-1.5, -0.2, 0.0, 0.03, 0.8};
  const double beside_rad_s[] = {-60.0, -2.0, 0.0, 5.0, 40.0};
  std::size_t compared = 0;
  double largest_Nm = 0.0;
  for (const BrakeParameters& truth : brakes_of_table_II()) {
    const PaperBrake brake = paper_brake(truth);
    StiffnessEstimate learned;
    learned.start(nominal_drive(truth), kContact_rad, 0.0);
    for (std::size_t k = 0; k < reference.rows.size(); k += 7) {
      const ReferenceRow& row = reference.rows[k];
      const ReferenceRow& next = reference.rows[std::min(k + 1, reference.rows.size() - 1)];
      for (const double position_rad : beside_rad)
        for (const double velocity_rad_s : beside_rad_s) {
          const BrakeState state(row.position_rad + position_rad, row.velocity_rad_s + velocity_rad_s);
          const double speed_rad_s = std::abs(state[1]);
          const double force_N = brake.stiffness().force_N(state[0]);
          MotionObserver predicted;
          predicted.reset({.position_rad = kContact_rad + state[0],
                           .velocity_rad_s = state[1],
                           .friction_excess_Nm = friction_Nm(truth, force_N, speed_rad_s) -
                                                 friction_Nm({}, force_N, speed_rad_s)});
          const double expected_Nm = tracking_torque_Nm(row, next, drive, predicted, learned);
          ASSERT_NEAR(loop.torque_Nm(row, next, brake, state), expected_Nm, 1e-11) << "row " << k;
          largest_Nm = std::max(largest_Nm, std::abs(expected_Nm));
          ++compared;
        }
    }
  }
  EXPECT_GT(compared, 150'000U);
  EXPECT_GT(largest_Nm, 1.0) << "the states must have asked for something";
}

TEST(ClosedLoop, NominalBrakeFollowsExactly) {
  const clampd::Run run = known_trajectory();
  const Reference reference = build_reference(run, {}).value();
  TrackedRun tracked;
  ClosedLoop({}, 3.0).track(reference, {}, tracked);
  ASSERT_TRUE(tracked.bounded);
  ASSERT_EQ(tracked.torque_Nm.size(), run.size());
  for (std::size_t k = 0; k < run.size(); ++k) EXPECT_NEAR(tracked.torque_Nm[k], run.torque_Nm[k], 1e-6);
  EXPECT_LT(tracked.tracking_rms_N, 1e-3);
}

TEST(ClosedLoop, EveryBrakeOfThePriorFollowsWithinTheLimits) {
  const clampd::Run run = known_trajectory();
  const Reference reference = build_reference(run, {}).value();
  const ClosedLoop loop({}, 3.0);
  TrackedRun tracked;
  int followed = 0;
  for (const BrakeParameters& brake : draw_prior({}, 300, 11)) {
    loop.track(reference, brake, tracked);
    ASSERT_TRUE(tracked.bounded);
    EXPECT_LT(tracked.force_max_N, 30e3);
    EXPECT_LT(tracked.velocity_max_rad_s, 300.0);
    // The softest pads run out of stiffness at the top.
    EXPECT_LT(tracked.tracking_rms_N, 1000.0);
    followed += tracked.tracking_rms_N < 50.0 ? 1 : 0;
    for (const double torque_Nm : tracked.torque_Nm) ASSERT_LE(std::abs(torque_Nm), 3.0);
  }
  EXPECT_GT(followed, 270);
}

TEST(ClosedLoop, IsHeldBackAsOnTheStationAndSaysWhatItWouldHaveReached) {
  const Reference reference = build_reference(known_trajectory(), {}).value();
  const ClosedLoop loop({}, 3.0);
  TrackedRun tracked;
  Simulation done(reference.rows.size());
  int held_back = 0;
  for (const BrakeParameters& brake : draw_prior({}, 300, 11)) {
    loop.track(reference, brake, tracked);
    simulate(brake, BrakeState::Zero(), Excitation{.torque_Nm = tracked.torque_Nm}, done);
    double speed_rad_s = 0.0;
    for (const double velocity_rad_s : done.velocity_rad_s)
      speed_rad_s = std::max(speed_rad_s, std::abs(velocity_rad_s));
    EXPECT_LT(speed_rad_s, ControlLimits{}.velocity_rad_s);
    held_back += tracked.velocity_max_rad_s > ControlLimits{}.velocity_rad_s ? 1 : 0;
    const bool torque_fades = tracked.velocity_max_rad_s > 270.0;
    if (!torque_fades) {
      EXPECT_NEAR(speed_rad_s, tracked.velocity_max_rad_s, 1e-6);
    }
  }
  EXPECT_GT(held_back, 0);
}

}  // namespace
}  // namespace clampd
