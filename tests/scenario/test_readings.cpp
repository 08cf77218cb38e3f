// One reading lies in each of these checks, in frames that are right; the true brake is what counts.

#include <algorithm>
#include <iostream>
#include <random>

#include <gtest/gtest.h>

#include "tests/scenario/reading_campaign.hpp"
#include "tests/scenario/scenario.hpp"

namespace clampd::scenario {
namespace {

TEST(SpoiledReadings, NoneHarmsAndTheWrongOneIsNamed) {
  const SpoilCampaign campaign = run_spoil_campaign(420, 21, 1);
  print(std::cout, campaign);
  for (const std::string& remark : campaign.remarks) std::cout << "  " << remark << '\n';
  const SpoilTally& all = campaign.all;
  EXPECT_EQ(all.unsafe, 0);
  EXPECT_GE(all.named, 0.95 * all.faults);
  EXPECT_LE(all.undetected, 0.02 * all.checks);
  EXPECT_EQ(all.wrong, 0) << "a verdict that rests on a wrong parameter";
  EXPECT_GT(all.faults, 0.8 * all.checks) << "or there was nothing to see";
  EXPECT_LE(all.torque_after_fault_s, 0.0021) << "zero torque two samples after the one that shows it";
}

TEST(SpoiledReadings, AFrozenEncoderNeverRunsAway) {
  const Reference reference = shipped_reference();
  const rt::SupervisorSettings limits;
  const double duration_s = drive_check(shipped_plant(), reference, 1).duration_s;
  for (int i = 0; i < 60; ++i) {
    sim::PlantConfiguration plant = shipped_plant();
    plant.seed = static_cast<std::uint64_t>(i);
    plant.spoiled = {{sim::Reading::Encoder, sim::Spoil::Frozen, 0.0, duration_s * i / 60.0}};
    const CheckOutcome outcome = drive_check(plant, reference, 1);
    EXPECT_NE(outcome.fault, FaultCause::None) << i;
    EXPECT_LT(outcome.speed_max_rad_s, 1.2 * limits.speed_limit_rad_s) << i;
    EXPECT_LT(outcome.force_max_N, 1.1 * limits.force_limit_N) << i;
  }
}

/// The controller clamps until the force reads enough. What reads too little is told by how far the pads give
/// way, before the first run or within it.
void expect_no_hard_clamping(int checks, const Told& told = {}) {
  const Reference reference = shipped_reference(told.period_s);
  const rt::SupervisorSettings limits;
  std::mt19937_64 random(31);
  std::uniform_real_distribution<double> scale(0.0, 0.7), instant_s(0.0, 3.3);
  double hardest_N = 0.0;
  for (int i = 0; i < checks; ++i) {
    sim::PlantConfiguration plant = i % 3 == 0 ? shipped_plant() : table_ii_brake(random);
    plant.seed = random();
    plant.spoiled = {{sim::Reading::Force, sim::Spoil::Scaled, scale(random), instant_s(random)}};
    const CheckOutcome outcome = drive_check(plant, reference, 3, told);
    EXPECT_LT(outcome.force_max_N, 1.1 * limits.force_limit_N)
        << "times " << plant.spoiled.front().amount << " from " << plant.spoiled.front().when.at_s << " s on";
    EXPECT_LT(outcome.speed_max_rad_s, 1.2 * limits.speed_limit_rad_s);
    hardest_N = std::max(hardest_N, outcome.force_max_N);
  }
  std::cout << "at most " << hardest_N << " N\n";
}

/// Position and velocity agree, so that the pads alone tell: no brake is that stiff.
TEST(SpoiledReadings, AnEncoderThatTellsOfHalfTheMotionClampsNothing) {
  for (const double period_s : {1e-3, 2e-3, 5e-3}) {
    sim::PlantConfiguration plant = shipped_plant();
    plant.spoiled = {{sim::Reading::Encoder, sim::Spoil::Scaled, 0.5, 0.09}};
    const CheckOutcome outcome = drive_check(plant, shipped_reference(period_s), 1, {.period_s = period_s});
    EXPECT_NE(outcome.fault, FaultCause::None) << period_s;
    EXPECT_LT(outcome.force_max_N, 5e3) << period_s;
  }
}

/// A brake whose frames come every so many milliseconds: the same lies have longer to do harm.
class SlowBrake : public ::testing::TestWithParam<int> {
 protected:
  const Told told_{.period_s = 1e-3 * GetParam()};
  const Reference reference_ = shipped_reference(told_.period_s);
  const rt::SupervisorSettings limits_;
};

TEST_P(SlowBrake, NoFrozenReadingRunsAway) {
  const double duration_s = drive_check(shipped_plant(), reference_, 1, told_).duration_s;
  double fastest_rad_s = 0.0, hardest_N = 0.0;
  for (const sim::Reading reading :
       {sim::Reading::Encoder, sim::Reading::Position, sim::Reading::Velocity, sim::Reading::Force})
    for (int i = 0; i < 240; ++i) {
      sim::PlantConfiguration plant = shipped_plant();
      plant.seed = static_cast<std::uint64_t>(i);
      plant.spoiled = {{reading, sim::Spoil::Frozen, 0.0, duration_s * i / 240.0}};
      const CheckOutcome outcome = drive_check(plant, reference_, 1, told_);
      EXPECT_LT(outcome.speed_max_rad_s, 1.2 * limits_.speed_limit_rad_s) << to_string(reading) << " " << i;
      EXPECT_LT(outcome.force_max_N, 1.1 * limits_.force_limit_N) << to_string(reading) << " " << i;
      EXPECT_LE(outcome.torque_after_fault_s, 2.1 * told_.period_s);
      fastest_rad_s = std::max(fastest_rad_s, outcome.speed_max_rad_s);
      hardest_N = std::max(hardest_N, outcome.force_max_N);
    }
  std::cout << "at most " << fastest_rad_s << " rad/s and " << hardest_N << " N\n";
}

TEST_P(SlowBrake, AForceThatReadsTooLittleNeverClampsTooHard) {
  expect_no_hard_clamping(600, told_);
}

TEST_P(SlowBrake, HealthyOnesRaiseNoFault) {
  for (const std::string& fault : run_healthy_campaign(240, 7, told_).faults) ADD_FAILURE() << fault;
}

INSTANTIATE_TEST_SUITE_P(Periods, SlowBrake, ::testing::Values(2, 5),
                         [](const auto& tested) { return std::to_string(tested.param) + "ms"; });

TEST(SpoiledReadings, AForceThatReadsTooLittleNeverClampsTooHard) {
  expect_no_hard_clamping(900);
}

/// The station wants more clearance than the brake has: it runs into its open end stop, and that is no lie.
TEST(SpoiledReadings, ABrakeThatIsHeldByItsOpenEndStopHasTrueReadings) {
  const Reference reference = shipped_reference();
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    sim::PlantConfiguration plant = shipped_plant();
    plant.seed = seed;
    plant.clearance_rad = 3.0;
    plant.open_stop_rad = 5.0;
    EXPECT_EQ(drive_check(plant, reference, 1).fault, FaultCause::SequenceTimeout) << seed;
  }
}

/// A brake that is found wide open comes to rest just where its end stop is: whatever it does there is no
/// lie.
TEST(SpoiledReadings, ABrakeThatComesToRestAtItsOpenEndStopHasTrueReadings) {
  const Reference reference = shipped_reference();
  for (int i = 0; i <= 60; ++i) {
    sim::PlantConfiguration plant = shipped_plant();
    plant.clearance_rad = 21.8 + 0.02 * i;
    EXPECT_EQ(drive_check(plant, reference, 1).fault, FaultCause::None)
        << "found " << plant.clearance_rad << " rad from the pads";
  }
}

/// Two spikes beside each other look like pads, until the force is gone again. A contact that was found there
/// would contradict every force that follows.
TEST(SpoiledReadings, SpikesBesideEachOtherAreNoContact) {
  const Reference reference = shipped_reference();
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    sim::PlantConfiguration plant = shipped_plant();
    plant.seed = seed;
    plant.effects.outliers = 0.02;
    EXPECT_EQ(drive_check(plant, reference, 1).fault, FaultCause::None) << "seed " << seed;
  }
}

TEST(SpoiledReadings, HealthyBrakesOfAllSortsRaiseNoFault) {
  const HealthyCampaign campaign = run_healthy_campaign(400, 7);
  for (const std::string& fault : campaign.faults) ADD_FAILURE() << fault;
}

}  // namespace
}  // namespace clampd::scenario
