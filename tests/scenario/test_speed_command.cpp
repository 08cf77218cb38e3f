// Whole checks of a brake that is told its speed, in virtual time; the true brake is what counts.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <random>

#include <gtest/gtest.h>

#include "tests/bench/embedded_check.hpp"
#include "tests/scenario/reading_campaign.hpp"
#include "tests/scenario/scenario.hpp"
#include "tests/support/allocation_trap.hpp"

namespace clampd::scenario {
namespace {

constexpr auto kVelocity = CommandedQuantity::Velocity;

SimulatedCheck check_by_speed(const sim::PlantConfiguration& plant, std::uint16_t repeats) {
  return simulate_check(plant, shipped_reference(), BrakeParameters{},
                        {.repeats = repeats, .timeout_s = 60.0, .commanded = kVelocity});
}

/// One whole check by hand.
struct SpeedCheck {
  explicit SpeedCheck(const sim::PlantConfiguration& plant) : brake(plant) {
    plan.reference = shipped_reference();
    plan.repeats = 1;
    plan.commanded = kVelocity;
    sequence.start(&plan);
  }
  rt::SequenceOutput exchange() {
    feedback = brake.sample();
    const rt::SequenceOutput output = sequence.step(feedback);
    brake.command({output.torque_Nm, true, output.velocity_rad_s, kVelocity});
    return output;
  }

  rt::CheckPlan plan;
  rt::CheckSequence sequence;
  sim::SimulatedBrake brake;
  BrakeFeedback feedback;
};

TEST(SpeedCommand, AWholeCheckPassesAndFindsTheTruth) {
  const sim::PlantConfiguration plant = bench::plant(1);
  const CheckRecord record = bench::check(plant, 6, nullptr, {kVelocity});
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  EXPECT_EQ(record.runs.size(), 6U);
  EXPECT_EQ(record.timing.lost_samples, 0U);
  for (std::size_t k = 0; k < record.parameters.size(); ++k) {
    const ParameterRecord& parameter = record.parameters[k];
    EXPECT_LT(std::abs(parameter.value - plant.brake.theta[static_cast<Eigen::Index>(k)]), 4.0 * parameter.sd)
        << parameter.name;
  }
}

TEST(SpeedCommand, TracksTheForceWithAnyLoopThatIsFastEnough) {
  for (const double bandwidth_rad_s : {250.0, 400.0, 900.0}) {
    sim::PlantConfiguration plant = noisy_plant();
    plant.speed_bandwidth_rad_s = bandwidth_rad_s;
    const SimulatedCheck check = check_by_speed(plant, 3);
    EXPECT_EQ(check.fault, FaultCause::None) << to_string(check.phase);
    EXPECT_EQ(check.runs.size(), 3U);
    EXPECT_LT(tracking_error(check, shipped_reference()).rms_N, 100.0) << bandwidth_rad_s;
    EXPECT_LT(check.speed_max_rad_s, 285.0);
  }
}

TEST(SpeedCommand, OtherStiffnessesAndFrictionsAreTrackedWithinTheLimits) {
  std::mt19937_64 random(5);
  for (int i = 0; i < 40; ++i) {
    const SimulatedCheck check = check_by_speed(table_ii_brake(random), 2);
    EXPECT_EQ(check.fault, FaultCause::None) << i << ": " << to_string(check.phase);
    EXPECT_LT(tracking_error(check, shipped_reference()).rms_N, 200.0) << i;
    EXPECT_LT(check.force_max_N, 29e3) << i;
    EXPECT_LT(check.speed_max_rad_s, 300.0) << i;
  }
}

TEST(SpeedCommand, StartsFromWhereverTheBrakeIsFoundAndHardlyPressesOnItsEndStop) {
  for (const double clearance_rad : {26.0, 6.0, 0.0, -20.0, -32.5}) {
    SCOPED_TRACE(clearance_rad);
    sim::PlantConfiguration plant = noisy_plant();
    plant.clearance_rad = clearance_rad;
    SpeedCheck check(plant);
    rt::SequenceOutput output;
    int pressing = 0;
    std::optional<double> tare_rad;
    for (int k = 0; k < 20'000 && !check.sequence.done() && output.fault == FaultCause::None; ++k) {
      output = check.exchange();
      const sim::Truth& truth = check.brake.truth();
      pressing += truth.position_rad < -25.99 && truth.torque_Nm < -1.0 ? 1 : 0;
      if (output.phase == CheckPhase::Tare) {
        EXPECT_NEAR(truth.position_rad, tare_rad.value_or(truth.position_rad), 0.1)
            << "it rests, but for what its loop makes of the sensor's noise";
        tare_rad = tare_rad.value_or(truth.position_rad);
        EXPECT_EQ(truth.force_N, 0.0);
      }
    }
    EXPECT_EQ(output.fault, FaultCause::None) << to_string(output.phase);
    EXPECT_TRUE(check.sequence.done());
    EXPECT_LE(pressing, 15) << "samples with more than the 1 N m that opening by torque may have";
  }
}

/// A tenth of a radian before its target, where it is told a speed too slow for anybody to miss it.
TEST(SpeedCommand, ABrakeThatMeetsItsEndStopAtTheEndDoesNotPressOnItForLong) {
  sim::PlantConfiguration plant = shipped_plant();
  plant.clearance_rad = 2.0;
  plant.open_stop_rad = 5.9;
  SpeedCheck check(plant);
  rt::SequenceOutput output;
  int pressing = 0;
  for (int k = 0; k < 20'000 && !check.sequence.done() && output.fault == FaultCause::None; ++k) {
    output = check.exchange();
    pressing += check.brake.truth().torque_Nm < -1.0 && check.brake.truth().position_rad < -5.89 ? 1 : 0;
  }
  EXPECT_EQ(output.fault, FaultCause::SpeedNotFollowed);
  EXPECT_EQ(output.phase, CheckPhase::Release);
  EXPECT_LE(pressing, 30);
}

TEST(SpeedCommand, OpensABrakeThatStaysClampedAndNeverClosesIt) {
  for (const double clearance_rad : {-32.5, -20.0, -5.0, 0.0, 26.0}) {
    SCOPED_TRACE(clearance_rad);
    sim::PlantConfiguration plant = noisy_plant();
    plant.clearance_rad = clearance_rad;
    SpeedCheck check(plant);
    check.plan.open_only = true;
    rt::SequenceOutput output = check.exchange();
    const double force_before_N = check.brake.truth().force_N;
    for (int k = 0; k < 20'000 && !check.sequence.done() && output.fault == FaultCause::None; ++k) {
      output = check.exchange();
      EXPECT_LE(check.brake.truth().force_N, force_before_N + 50.0);
    }
    EXPECT_EQ(output.fault, FaultCause::None) << to_string(output.phase);
    EXPECT_TRUE(check.sequence.done());
    EXPECT_EQ(check.brake.truth().force_N, 0.0);
  }
}

TEST(SpeedCommand, AWholeCheckTakesNothingFromTheHeap) {
  SpeedCheck check(shipped_plant());
  const support::AllocationTrap trap;
  for (int k = 0; k < 10'000 && !check.sequence.done(); ++k) check.exchange();
  EXPECT_EQ(trap.allocations(), 0U);
  EXPECT_EQ(trap.releases(), 0U);
  EXPECT_TRUE(check.sequence.done());
}

TEST(SpeedCommand, AnEmergencyStopWithinARunEndsTheTorqueNotOnlyTheMotion) {
  bench::Bench bench(bench::plant(1), WorkerMode::Synchronous, nullptr, bench::prepared({kVelocity}));
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.begin(4));
  const rt::StatusBoard& status = bench.core.status();
  while (status.force_N.load() < 10e3) bench.advance();
  ASSERT_EQ(status.state.load(), StationState::Running);
  bench.core.requests().emergency_stop = true;
  for (int k = 0; k < 3; ++k) bench.advance();  // taken, latched by the brake, read
  EXPECT_EQ(status.fault.load(), FaultCause::EmergencyStop);
  const double noise_Nm = 6.0 * bench::plant(1).sensors.torque_noise_Nm;
  for (int k = 0; k < 100; ++k) {
    EXPECT_LT(std::abs(status.torque_Nm.load()), noise_Nm) << k;
    bench.advance();
  }
  EXPECT_EQ(bench.finish().verdict, Verdict::Aborted);
}

TEST(SpeedCommand, ABrakeThatDoesNotTakeItUpIsNamed) {
  sim::PlantConfiguration deaf = shipped_plant();
  deaf.speed_bandwidth_rad_s = 0.0;
  const CheckOutcome outcome = drive_check(deaf, shipped_reference(), 1, {kVelocity});
  EXPECT_EQ(outcome.fault, FaultCause::SpeedNotFollowed);
  EXPECT_LT(outcome.fault_s, 0.2) << "it is ready after some 50 ms";

  sim::PlantConfiguration weak = shipped_plant();
  weak.torque_limit_Nm = 0.5;
  const CheckOutcome too_weak = drive_check(weak, shipped_reference(), 1, {kVelocity});
  EXPECT_EQ(too_weak.fault, FaultCause::SpeedNotFollowed) << to_string(too_weak.phase);
}

/// Its loop has no other encoder: it pushes with all of its torque towards a speed that it never sees.
TEST(SpeedCommand, AFrozenEncoderNeverRunsAway) {
  const rt::SupervisorSettings limits;
  const double duration_s = drive_check(shipped_plant(), shipped_reference(), 1, {kVelocity}).duration_s;
  for (int i = 0; i < 120; ++i) {
    sim::PlantConfiguration plant = shipped_plant();
    plant.seed = static_cast<std::uint64_t>(i);
    plant.speed_loop_is_spoiled = i % 2 == 0;
    plant.spoiled = {{sim::Reading::Encoder, sim::Spoil::Frozen, 0.0, duration_s * i / 120.0}};
    const CheckOutcome outcome = drive_check(plant, shipped_reference(), 1, {kVelocity});
    const bool at_rest_for_good = plant.spoiled.front().when.at_s > duration_s - 0.05;
    EXPECT_TRUE(outcome.fault != FaultCause::None || at_rest_for_good) << i;
    EXPECT_LT(outcome.speed_max_rad_s, limits.speed_limit_rad_s) << i;
    EXPECT_LT(outcome.force_max_N, limits.force_limit_N) << i;
    EXPECT_LE(outcome.torque_after_fault_s, 0.0021) << i;
  }
}

TEST(SpeedCommand, AForceThatReadsTooLittleNeverClampsTooHard) {
  const rt::SupervisorSettings limits;
  std::mt19937_64 random(32);
  std::uniform_real_distribution<double> scale(0.0, 0.7), instant_s(0.0, 3.4);
  for (int i = 0; i < 300; ++i) {
    sim::PlantConfiguration plant = i % 3 == 0 ? shipped_plant() : table_ii_brake(random);
    plant.seed = random();
    const double amount = i % 2 == 0 ? 0.5 : scale(random);
    plant.spoiled = {{sim::Reading::Force, sim::Spoil::Scaled, amount, instant_s(random)}};
    const CheckOutcome outcome = drive_check(plant, shipped_reference(), 3, {kVelocity});
    EXPECT_LT(outcome.force_max_N, limits.force_ceiling_N)
        << "times " << amount << " from " << plant.spoiled.front().when.at_s << " s on";
    EXPECT_LT(outcome.speed_max_rad_s, limits.speed_limit_rad_s);
  }
}

TEST(SpeedCommand, NoReadingThatLiesHarmsAndMostAreNamed) {
  const SpoilCampaign campaign = run_spoil_campaign(420, 22, 0, {kVelocity});
  const SpoilTally& all = campaign.all;
  EXPECT_EQ(all.unsafe, 0);
  EXPECT_GE(all.named, 0.85 * all.faults) << "without the torque's command, readings are told less surely";
  EXPECT_LE(all.undetected, 0.05 * all.checks);
  EXPECT_LT(all.force_max_N, rt::SupervisorSettings{}.force_ceiling_N);
  EXPECT_LE(all.torque_after_fault_s, 0.0021);
}

TEST(SpeedCommand, HealthyBrakesOfAllSortsRaiseNoFault) {
  for (const std::string& fault : run_healthy_campaign(300, 23, {kVelocity}).faults) ADD_FAILURE() << fault;
}

}  // namespace
}  // namespace clampd::scenario
