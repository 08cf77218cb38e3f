#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"
#include "rt/check_sequence.hpp"
#include "tests/scenario/scenario.hpp"
#include "tests/support/allocation_trap.hpp"

namespace clampd {
namespace {

using rt::CheckSequence;
using rt::SequenceOutput;

/// Drives the sequence by hand, so that a test can meddle with what passes between it and the brake.
class CheckSequenceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    plan_.reference = scenario::shipped_reference();
    plan_.repeats = 2;
    sequence_.start(&plan_);
  }

  /// One sample to the sequence and its answer to the brake.
  SequenceOutput exchange(sim::SimulatedBrake& brake) {
    feedback_ = brake.sample();
    const SequenceOutput output = sequence_.step(feedback_);
    brake.command({output.torque_Nm, true});
    return output;
  }

  /// Until the end or a fault, at most 60 s of bench time. Returns the last output.
  SequenceOutput run(
      sim::SimulatedBrake& brake,
      const std::function<void(const SequenceOutput&)>& look = [](const SequenceOutput&) {}) {
    SequenceOutput output;
    for (int k = 0; k < 60000 && !sequence_.done() && output.fault == FaultCause::None; ++k) {
      output = exchange(brake);
      look(output);
    }
    return output;
  }

  rt::CheckPlan plan_;
  CheckSequence sequence_;
  BrakeFeedback feedback_;
};

TEST_F(CheckSequenceTest, ConcludedWithinARunItEndsThatRunAndReleases) {
  plan_.repeats = 9;
  sim::SimulatedBrake brake(scenario::shipped_plant());
  std::int32_t last_row = -1;
  std::uint16_t last_repeat = 0;
  const SequenceOutput end = run(brake, [&](const SequenceOutput& output) {
    if (output.repeat == 2 && output.trajectory_index == 100) sequence_.conclude();
    if (output.trajectory_index >= 0) last_row = output.trajectory_index, last_repeat = output.repeat;
  });
  EXPECT_EQ(end.fault, FaultCause::None);
  EXPECT_TRUE(sequence_.done());
  EXPECT_EQ(last_repeat, 2) << "no further run";
  EXPECT_EQ(last_row, static_cast<std::int32_t>(plan_.reference.rows.size()) - 1) << "but that one whole";
  EXPECT_LT(brake.truth().force_N, 50.0) << "and open";
}

TEST_F(CheckSequenceTest, ConcludedBetweenRunsItReleasesAtOnce) {
  for (const CheckPhase when : {CheckPhase::Return, CheckPhase::Settle}) {
    plan_.repeats = 9;
    sequence_.start(&plan_);
    sim::SimulatedBrake brake(scenario::shipped_plant());
    int runs = 0;
    CheckPhase before = CheckPhase::None;
    CheckPhase after_conclusion = CheckPhase::None;
    bool concluded = false;
    const SequenceOutput end = run(brake, [&](const SequenceOutput& output) {
      runs += before != CheckPhase::Trajectory && output.phase == CheckPhase::Trajectory;
      if (concluded && after_conclusion == CheckPhase::None && output.phase != when)
        after_conclusion = output.phase;
      if (runs == 2 && output.phase == when && !concluded) {
        sequence_.conclude();
        concluded = true;
      }
      before = output.phase;
    });
    EXPECT_EQ(end.fault, FaultCause::None);
    EXPECT_EQ(runs, 2);
    EXPECT_EQ(after_conclusion, CheckPhase::Release);
    EXPECT_EQ(end.repeat, 1) << "the last run that there was";
  }
}

TEST_F(CheckSequenceTest, ConcludedBeforeItsFirstRunItStillDrivesOne) {
  plan_.repeats = 9;
  sequence_.conclude();
  sim::SimulatedBrake brake(scenario::shipped_plant());
  int rows = 0;
  run(brake, [&](const SequenceOutput& output) { rows += output.trajectory_index >= 0; });
  EXPECT_EQ(rows, static_cast<int>(plan_.reference.rows.size()));
}

TEST_F(CheckSequenceTest, FollowsAnotherTrajectoryFromTheNextRunOn) {
  plan_.repeats = 4;
  plan_.further = {build_reference(read_run(scenario::config("trajectory-sliding.csv")).value().run, {}).value(),
                   build_reference(read_run(scenario::config("trajectory-breakaway.csv")).value().run, {}).value()};
  sequence_.start(&plan_);
  sequence_.follow(2);  // not the first run, which shows the stiffness
  sim::SimulatedBrake brake(scenario::shipped_plant());
  std::vector<int> followed;
  double squares_N2 = 0.0;
  const SequenceOutput end = run(brake, [&](const SequenceOutput& output) {
    if (output.trajectory_index < 0) return;
    if (output.trajectory_index == 0) followed.push_back(output.trajectory);
    ASSERT_EQ(output.trajectory, followed.back()) << "never within a run";
    const Reference& reference =
        output.trajectory == 0 ? plan_.reference : plan_.further[output.trajectory - 1u];
    ASSERT_EQ(output.force_reference_N, reference.rows[static_cast<std::size_t>(output.trajectory_index)].force_N);
    squares_N2 += std::pow(brake.truth().force_N - output.force_reference_N, 2);
    if (output.repeat == 1) sequence_.follow(1);
    if (output.repeat == 2) sequence_.follow(7);
  });
  EXPECT_EQ(end.fault, FaultCause::None) << "a gentle run says nothing of the stiffness";
  EXPECT_TRUE(sequence_.done());
  EXPECT_EQ(followed, (std::vector<int>{0, 2, 1, 0})) << "one that there is not counts as the plan's own";
  EXPECT_LT(std::sqrt(squares_N2 / (4.0 * static_cast<double>(plan_.reference.rows.size()))), 300.0);
}

TEST_F(CheckSequenceTest, RunsAreWholeConsecutiveAndStartWithTheFirstRowsTorque) {
  sim::PlantConfiguration plant = scenario::shipped_plant();
  plant.sensors = {};  // so that the readings are the truth
  sim::SimulatedBrake brake(plant);
  std::vector<std::int32_t> rows[2];
  std::int64_t last_index = -1;
  double commanded_Nm = 0.0;
  run(brake, [&](const SequenceOutput& output) {
    EXPECT_EQ(output.phase == CheckPhase::Trajectory, output.trajectory_index >= 0);
    EXPECT_EQ(feedback_.torque_Nm, commanded_Nm) << "a command acts from the next sample on";
    commanded_Nm = output.torque_Nm;
    if (output.trajectory_index >= 0) {
      auto& mine = rows[output.repeat];
      if (!mine.empty()) {
        EXPECT_EQ(feedback_.sample_index, last_index + 1);
      } else {
        EXPECT_NEAR(feedback_.torque_Nm, plan_.reference.rows[0].torque_Nm, 0.3);
        EXPECT_EQ(feedback_.velocity_rad_s, 0.0);
      }
      mine.push_back(output.trajectory_index);
      EXPECT_EQ(output.force_reference_N,
                plan_.reference.rows[static_cast<std::size_t>(output.trajectory_index)].force_N);
      last_index = feedback_.sample_index;
    }
  });
  EXPECT_TRUE(sequence_.done());
  for (const auto& mine : rows) {
    ASSERT_EQ(mine.size(), plan_.reference.rows.size());
    for (std::size_t k = 0; k < mine.size(); ++k) EXPECT_EQ(mine[k], static_cast<std::int32_t>(k));
  }
}

TEST_F(CheckSequenceTest, PhasesComeInOrderAndTheBrakeEndsOpen) {
  const sim::PlantConfiguration plant = scenario::shipped_plant();
  sim::SimulatedBrake brake(plant);
  std::vector<CheckPhase> phases;
  int tare_samples = 0;
  run(brake, [&](const SequenceOutput& output) {
    if (phases.empty() || phases.back() != output.phase) phases.push_back(output.phase);
    if (output.phase == CheckPhase::Tare) {
      ++tare_samples;
      EXPECT_EQ(brake.truth().velocity_rad_s, 0.0);
      EXPECT_EQ(brake.truth().torque_Nm, 0.0);
      EXPECT_EQ(brake.truth().force_N, 0.0);
    }
    if (output.phase == CheckPhase::Settle) {
      EXPECT_LT(brake.truth().force_N, 10.0);
      EXPECT_LT(std::abs(brake.truth().velocity_rad_s), 2.0);
    }
  });
  using enum CheckPhase;
  EXPECT_EQ(phases, (std::vector{Return, Tare, Approach, Return, Settle, Trajectory, Return, Settle,
                                 Trajectory, Release, Done}));
  EXPECT_EQ(tare_samples, std::lround(plan_.tare_s / kPeriod_s));
  EXPECT_NEAR(brake.truth().position_rad, -plan_.clearance_rad, 0.3);
}

TEST_F(CheckSequenceTest, OpensABrakeThatStaysClampedAndNoMore) {
  plan_.open_only = true;
  for (const double clearance_rad : {-32.5, -20.0, -5.0, 0.0, 6.0, 26.0}) {
    SCOPED_TRACE(clearance_rad);
    sim::PlantConfiguration plant = scenario::noisy_plant();
    plant.clearance_rad = clearance_rad;
    sim::SimulatedBrake brake(plant);
    sequence_.start(&plan_);
    double force_max_N = 0.0;
    double force_before_N = -1.0;  // known from the first sample on
    const SequenceOutput last = run(brake, [&](const SequenceOutput& output) {
      if (force_before_N < 0.0) force_before_N = brake.truth().force_N;
      EXPECT_TRUE(output.phase == CheckPhase::Release || output.phase == CheckPhase::Done);
      EXPECT_EQ(output.trajectory_index, -1);
      force_max_N = std::max(force_max_N, brake.truth().force_N);
    });
    EXPECT_EQ(last.fault, FaultCause::None);
    EXPECT_TRUE(sequence_.done());
    EXPECT_EQ(brake.truth().force_N, 0.0);
    EXPECT_LE(force_max_N, force_before_N + 50.0) << "it never closes";
    EXPECT_LE(std::abs(brake.truth().velocity_rad_s), 2.0);
    if (clearance_rad < -1.0) {
      EXPECT_LT(brake.truth().position_rad, -0.5 * plan_.clearance_rad) << "the clearance is open";
    }
  }
}

TEST_F(CheckSequenceTest, StartsFromWhereverTheBrakeIsFound) {
  // Open at the end stop, open, just touching, clamped at 12 kN, clamped at 25 kN.
  for (const double clearance_rad : {26.0, 6.0, 0.0, -20.0, -32.5}) {
    SCOPED_TRACE(clearance_rad);
    sim::PlantConfiguration plant = scenario::noisy_plant();
    plant.clearance_rad = clearance_rad;
    const SimulatedCheck check = simulate_check(plant, plan_.reference, BrakeParameters{}, {.repeats = 1});
    EXPECT_EQ(check.fault, FaultCause::None) << to_string(check.phase);
    ASSERT_EQ(check.runs.size(), 1u);
    EXPECT_LT(std::abs(check.runs[0].truth.front().position_rad), 0.4);
    EXPECT_LT(scenario::tracking_error(check, plan_.reference).rms_N, 75.0);
  }
}

TEST_F(CheckSequenceTest, AnotherCheckStartsWhereTheLastOneEnded) {
  sim::SimulatedBrake brake(scenario::shipped_plant());
  for (int check = 0; check < 4; ++check) {
    sequence_.start(&plan_);
    EXPECT_FALSE(sequence_.done());
    const SequenceOutput last = run(brake);
    EXPECT_EQ(last.fault, FaultCause::None);
    EXPECT_EQ(last.phase, CheckPhase::Done);
    EXPECT_NEAR(brake.truth().position_rad, -plan_.clearance_rad, 0.3);
  }
}

TEST_F(CheckSequenceTest, MissingAndDoubledSamplesMoveNothingButTheirRows) {
  sim::SimulatedBrake brake(scenario::shipped_plant());
  std::int64_t first = -1;
  double sum = 0.0;
  int rows = 0, k = 0;
  SequenceOutput output;
  for (; k < 60000 && !sequence_.done(); ++k) {
    const BrakeFeedback feedback = brake.sample();
    if (k % 37 == 5) continue;  // neither the sample nor an answer to it passes
    output = sequence_.step(feedback);
    if (k % 23 == 7) {
      const SequenceOutput again = sequence_.step(feedback);
      ASSERT_EQ(again.torque_Nm, output.torque_Nm);
      ASSERT_EQ(again.trajectory_index, output.trajectory_index);
      ASSERT_EQ(again.phase, output.phase);
    }
    brake.command({output.torque_Nm, true});
    ASSERT_EQ(output.fault, FaultCause::None);
    if (output.trajectory_index < 0) {
      first = -1;
      continue;
    }
    if (first < 0) first = feedback.sample_index - output.trajectory_index;
    ASSERT_EQ(output.trajectory_index, feedback.sample_index - first) << "rows go by the brake's clock";
    const double error_N = brake.truth().force_N - output.force_reference_N;
    sum += error_N * error_N;
    ++rows;
  }
  EXPECT_TRUE(sequence_.done());
  EXPECT_GT(rows, 550);
  EXPECT_LT(std::sqrt(sum / rows), 75.0);
}

TEST_F(CheckSequenceTest, WithoutPadsItTimesOutAtZeroTorque) {
  sim::PlantConfiguration plant = scenario::shipped_plant();
  plant.brake.theta[k1] = 0.0;
  plant.brake.theta[k2] = 0.1;
  plant.closed_stop_rad = 50.0;
  sim::SimulatedBrake brake(plant);
  const SequenceOutput last = run(brake);
  EXPECT_EQ(last.fault, FaultCause::SequenceTimeout);
  EXPECT_EQ(last.phase, CheckPhase::Approach);
  EXPECT_EQ(last.torque_Nm, 0.0);
}

TEST_F(CheckSequenceTest, ABrakeThatDoesNotMoveTimesOut) {
  BrakeFeedback feedback;
  feedback.force_N = 20e3;
  SequenceOutput output;
  for (int k = 0; k < 10000 && output.fault == FaultCause::None; ++k) {
    feedback.sample_index = k;
    output = sequence_.step(feedback);
    EXPECT_LE(std::abs(output.torque_Nm), 1.0) << "opening is gentle";
  }
  EXPECT_EQ(output.fault, FaultCause::SequenceTimeout);
  EXPECT_EQ(output.torque_Nm, 0.0);
}

TEST_F(CheckSequenceTest, RefusesImpossibleSamplesWithZeroTorque) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (double BrakeFeedback::*member : {&BrakeFeedback::force_N, &BrakeFeedback::velocity_rad_s,
                                        &BrakeFeedback::torque_Nm, &BrakeFeedback::position_rad}) {
    sequence_.start(&plan_);
    sim::SimulatedBrake brake(scenario::shipped_plant());
    for (int k = 0; k < 100; ++k) exchange(brake);
    BrakeFeedback feedback = brake.sample();
    feedback.*member = nan;
    const SequenceOutput output = sequence_.step(feedback);
    EXPECT_EQ(output.fault, FaultCause::FeedbackImplausible);
    EXPECT_EQ(output.torque_Nm, 0.0);
  }
  sequence_.start(&plan_);
  sim::SimulatedBrake brake(scenario::shipped_plant());
  for (int k = 0; k < 100; ++k) exchange(brake);
  BrakeFeedback feedback = brake.sample();
  feedback.sample_index = 50;
  const SequenceOutput output = sequence_.step(feedback);
  EXPECT_EQ(output.fault, FaultCause::FeedbackFrozen);
  EXPECT_EQ(output.torque_Nm, 0.0);
}

TEST_F(CheckSequenceTest, AbandonedItStaysQuiet) {
  sim::SimulatedBrake brake(scenario::shipped_plant());
  for (int k = 0; k < 500; ++k) exchange(brake);
  sequence_.abandon();
  EXPECT_TRUE(sequence_.done());
  EXPECT_EQ(sequence_.step(brake.sample()).torque_Nm, 0.0);
}

TEST_F(CheckSequenceTest, AWholeCheckTakesNothingFromTheHeap) {
  sim::SimulatedBrake brake(scenario::shipped_plant());
  const support::AllocationTrap trap;
  for (int k = 0; k < 10000 && !sequence_.done(); ++k) exchange(brake);
  EXPECT_EQ(trap.allocations(), 0u);
  EXPECT_EQ(trap.releases(), 0u);
  EXPECT_TRUE(sequence_.done());
}

}  // namespace
}  // namespace clampd
