#include "rt/supervisor.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <tuple>

#include <gtest/gtest.h>

#include "rt/toy_station.hpp"

namespace clampd::rt {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// A supervisor in virtual time with a healthy brake that stands still.
struct Bench {
  explicit Bench(const SupervisorSettings& settings = {}, const Policy& policy = kPolicy)
      : supervisor(test::without_physics(settings), policy) {}

  /// One tick of `samples` samples; `inputs.now_ns` advances by the period.
  void tick(int samples = 1) {
    inputs.now_ns += kPeriod_ns;
    supervisor.begin_tick(inputs);
    for (int i = 0; i < samples; ++i) {
      ++feedback.sample_index;
      feedback.brake_time_ns += kPeriod_ns;
      const bool drives = supervisor.in_check();
      feedback.drive_enabled = drives && drive_works;
      supervisor.observe(feedback);
      supervisor.follow(phase, false, {});
    }
    supervisor.end_samples();
    supervisor.sent(true, {.torque_Nm = torque_sent_Nm, .velocity_rad_s = velocity_sent_rad_s});
    inputs.clear = false;
    inputs.operator_stop = false;
    inputs.skipped_periods = 0;
  }
  void ticks(int count, int samples = 1) {
    for (int i = 0; i < count; ++i) tick(samples);
  }
  void reach(StationState target) {
    if (target == StationState::Init) return tick();
    ticks(50);
    if (target == StationState::Idle) return;
    if (target == StationState::Fault) return supervisor.raise(FaultCause::EmergencyStop);
    ASSERT_TRUE(supervisor.arm());
    if (target == StationState::Armed) return;
    ticks(30);
    if (target == StationState::Running) return;
    phase = CheckPhase::Release;
    tick();
  }

  Supervisor supervisor;
  TickInputs inputs;
  BrakeFeedback feedback;
  CheckPhase phase = CheckPhase::Trajectory;
  double torque_sent_Nm = 0.0;
  double velocity_sent_rad_s = 0.0;
  bool drive_works = true;
};

TEST(Policy, IsIndexedByCauseAndSaysWhatToDo) {
  for (std::size_t i = 0; i < kPolicy.size(); ++i) {
    EXPECT_EQ(static_cast<std::size_t>(kPolicy[i].cause), i);
    ASSERT_FALSE(kPolicy[i].advice.empty()) << i;
    EXPECT_EQ(kPolicy[i].advice.back(), '.') << i;
    EXPECT_NE(to_string(kPolicy[i].cause), "?") << i;
  }
}

class StateAndCause : public ::testing::TestWithParam<std::tuple<int, int>> {};

TEST_P(StateAndCause, EndsWithoutDriving) {
  const auto state = static_cast<StationState>(std::get<0>(GetParam()));
  const auto cause = static_cast<FaultCause>(std::get<1>(GetParam()));
  Bench bench;
  bench.reach(state);
  ASSERT_EQ(bench.supervisor.state(), state);
  const FaultCause fault_before = bench.supervisor.fault();
  bench.supervisor.raise(cause);

  EXPECT_FALSE(bench.supervisor.in_check());
  const FaultScope scope = fault_rule(cause).scope;
  const bool latches = state == StationState::Init   ? scope == FaultScope::Always
                       : state == StationState::Idle ? scope != FaultScope::Check
                                                     : true;
  if (state == StationState::Fault) {
    EXPECT_EQ(bench.supervisor.fault(), fault_before) << "the first cause stays";
  } else if (latches) {
    EXPECT_EQ(bench.supervisor.state(), StationState::Fault);
    EXPECT_EQ(bench.supervisor.fault(), cause);
    EXPECT_EQ(bench.supervisor.fault_time_ns(), bench.inputs.now_ns);
    EXPECT_EQ(bench.supervisor.fault_state(), state);
  } else {
    EXPECT_EQ(bench.supervisor.state(), state);
    EXPECT_EQ(bench.supervisor.fault(), FaultCause::None);
  }
  EXPECT_FALSE(bench.supervisor.arm() && state != StationState::Idle);
}

INSTANTIATE_TEST_SUITE_P(All, StateAndCause,
                         ::testing::Combine(::testing::Range(0, 6),
                                            ::testing::Range(1, static_cast<int>(kFaultCauseCount))),
                         [](const auto& test) {
                           std::string name =
                               std::string(to_string(static_cast<StationState>(std::get<0>(test.param)))) +
                               "_" + std::string(to_string(static_cast<FaultCause>(std::get<1>(test.param))));
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

TEST(Supervisor, AToyPolicyChangesTheOutcomeWithoutNewMechanism) {
  Policy policy = kPolicy;
  policy[static_cast<std::size_t>(FaultCause::OverSpeed)].scope = FaultScope::Check;
  Bench bench({}, policy);
  bench.reach(StationState::Idle);
  bench.supervisor.raise(FaultCause::OverSpeed);
  EXPECT_EQ(bench.supervisor.state(), StationState::Idle);
}

TEST(Supervisor, BecomesIdleOnGoodFeedbackInARow) {
  Bench bench;
  bench.ticks(19);
  EXPECT_EQ(bench.supervisor.state(), StationState::Init);
  bench.feedback.watchdog_tripped = true;  // as after a silence of the station
  bench.tick();
  bench.feedback.watchdog_tripped = false;
  bench.ticks(19);
  EXPECT_EQ(bench.supervisor.state(), StationState::Init) << "the row was broken";
  bench.tick();
  EXPECT_EQ(bench.supervisor.state(), StationState::Idle);
}

TEST(Supervisor, ReportsASilentBrakeAfterTheStartUpTime) {
  Bench bench;
  bench.ticks(2000, 0);
  EXPECT_EQ(bench.supervisor.state(), StationState::Init);
  bench.ticks(3, 0);
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::FeedbackMissing);
}

TEST(Supervisor, ReportsWhatKeptItFromBecomingReady) {
  Bench bench;
  bench.inputs.health.link = LinkState::Down;
  bench.ticks(2003);
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::LinkDown);
}

TEST(Supervisor, ToleratesTwoEmptyTicksAndNotThree) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.ticks(2, 0);
  bench.tick(3);
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
  bench.ticks(3, 0);
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::FeedbackStale);
}

TEST(Supervisor, WakeUpJitterDoesNotMakeFeedbackStale) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.ticks(1, 0);
  bench.inputs.now_ns += 400'000;
  bench.ticks(1, 0);
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
}

TEST(Supervisor, OneCorruptFrameEndsACheck) {
  Bench bench;
  bench.reach(StationState::Running);
  ++bench.inputs.health.crc_errors;
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::FeedbackCorrupt);
}

TEST(Supervisor, ARepeatedFrameIsHealthyButNotTwoInAWindow) {
  Bench bench;
  bench.reach(StationState::Running);
  for (int i = 0; i < 5; ++i) {
    ++bench.inputs.health.counter_errors;
    bench.ticks(12);
  }
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
  ++bench.inputs.health.counter_errors;
  bench.ticks(5);
  ++bench.inputs.health.counter_errors;
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::FeedbackFrozen);
}

TEST(Supervisor, ABusOffThatRecoveredAtOnceIsSeen) {
  Bench bench;
  bench.reach(StationState::Running);
  ++bench.inputs.health.bus_off_events;
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::BusOff);
}

TEST(Supervisor, ErrorPassiveIsNoFault) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.inputs.health.link = LinkState::ErrorPassive;
  bench.ticks(50);
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
}

TEST(Supervisor, CountsThatStartOverAreNoEvents) {
  Bench bench;
  bench.inputs.health.crc_errors = 7;  // from before the station looked
  bench.reach(StationState::Idle);
  bench.inputs.health.crc_errors = 0;
  bench.ticks(5);
  EXPECT_EQ(bench.supervisor.state(), StationState::Idle);
}

TEST(Supervisor, ImplausibleReadings) {
  for (const double force_N : {kNan, 1e6, -1e6}) {
    Bench bench;
    bench.reach(StationState::Running);
    bench.feedback.force_N = force_N;
    bench.tick();
    EXPECT_EQ(bench.supervisor.fault(), FaultCause::FeedbackImplausible) << force_N;
  }
  Bench bench;
  bench.reach(StationState::Idle);
  bench.feedback.position_rad += 2.0;  // a jump that the velocity does not explain
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::FeedbackImplausible);
}

TEST(Supervisor, FastMotionIsNoJump) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.feedback.velocity_rad_s = 300.0;
  for (int i = 0; i < 300; ++i) {
    bench.feedback.position_rad += 0.3;
    bench.tick();
  }
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
}

TEST(Supervisor, ASampleClockThatStandsStillIsFrozen) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.feedback.brake_time_ns -= kPeriod_ns;
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::FeedbackFrozen);
}

TEST(Supervisor, LostSamplesMatterOnlyWithinARun) {
  Bench bench;
  bench.phase = CheckPhase::Settle;
  bench.reach(StationState::Running);
  const auto lose_one = [&bench] {
    ++bench.feedback.sample_index;
    bench.feedback.brake_time_ns += kPeriod_ns;
    bench.tick();
  };
  lose_one();
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
  bench.phase = CheckPhase::Trajectory;
  bench.tick();
  lose_one();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::SampleLost);
}

TEST(Supervisor, LimitsOfForceSpeedTorqueTravel) {
  const SupervisorSettings settings;
  const auto fault_of = [](auto change) {
    Bench bench;
    bench.reach(StationState::Running);
    bench.torque_sent_Nm = 1.0;
    bench.tick();
    for (int i = 0; i < 200 && bench.supervisor.state() == StationState::Running; ++i) {
      change(bench.feedback);
      bench.tick();
    }
    return bench.supervisor.fault();
  };
  EXPECT_EQ(fault_of([&](auto& f) { f.force_N = settings.force_limit_N + 1; }), FaultCause::OverForce);
  EXPECT_EQ(fault_of([&](auto& f) { f.velocity_rad_s = -settings.speed_limit_rad_s - 1; }),
            FaultCause::OverSpeed);
  EXPECT_EQ(fault_of([&](auto& f) { f.torque_Nm = -settings.torque_limit_Nm - 0.01; }),
            FaultCause::OverTorque);
  EXPECT_EQ(fault_of([](auto& f) { f.position_rad -= 0.9; }), FaultCause::OverTravel);
  EXPECT_EQ(fault_of([&](auto& f) { f.force_N = settings.force_limit_N - 1; }), FaultCause::None);
}

TEST(Supervisor, ABrakeClampedBeyondTheLimitMayBeOpened) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.torque_sent_Nm = 2.0;
  bench.tick();
  bench.feedback.force_N = 34e3;
  bench.tick();
  ASSERT_EQ(bench.supervisor.fault(), FaultCause::OverForce);
  bench.torque_sent_Nm = 0.0;
  bench.tick();
  bench.ticks(60);
  ASSERT_TRUE(bench.supervisor.clearable()) << "at rest and self-locked, nothing more can happen by itself";
  bench.inputs.clear = true;
  bench.ticks(40);
  ASSERT_EQ(bench.supervisor.state(), StationState::Idle);
  bench.supervisor.arm();
  bench.ticks(20);
  bench.torque_sent_Nm = -2.0;
  bench.feedback.velocity_rad_s = -50.0;
  bench.ticks(5);
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
  bench.feedback.velocity_rad_s = 0.0;
  bench.torque_sent_Nm = 0.1;
  bench.ticks(2);
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::OverForce);
}

TEST(Supervisor, ABrakeThatIsToldToCloseBeyondTheLimitIsStopped) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.feedback.force_N = 34e3;
  bench.velocity_sent_rad_s = -30.0;
  bench.ticks(5);
  EXPECT_EQ(bench.supervisor.state(), StationState::Running) << "it opens";
  bench.velocity_sent_rad_s = 5.0;
  bench.ticks(2);
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::OverForce);
}

TEST(Supervisor, MissedTicksCountOnlyInACheck) {
  Bench bench;
  bench.reach(StationState::Idle);
  bench.inputs.skipped_periods = 1000;
  bench.tick();
  EXPECT_EQ(bench.supervisor.state(), StationState::Idle);

  bench.supervisor.arm();
  bench.ticks(20);
  for (int i = 0; i < 5; ++i) {
    bench.inputs.skipped_periods = 1;
    bench.tick();
  }
  EXPECT_EQ(bench.supervisor.state(), StationState::Running) << "five of five tolerated";
  bench.inputs.skipped_periods = 1;
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::MissedTicks);
}

TEST(Supervisor, ThreeMissedTicksAtOnceAreTooMany) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.inputs.skipped_periods = 3;
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::MissedTicks);
}

TEST(Supervisor, RunsOnlyWithALiveDrive) {
  Bench bench;
  bench.drive_works = false;
  bench.reach(StationState::Armed);
  bench.ticks(500);
  EXPECT_EQ(bench.supervisor.state(), StationState::Armed);
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::BrakeFault);

  Bench running;
  running.reach(StationState::Running);
  running.drive_works = false;
  running.tick();
  EXPECT_EQ(running.supervisor.fault(), FaultCause::BrakeFault);

  SupervisorSettings settings;
  settings.drive_reports_live = false;
  Bench mute(settings);
  mute.drive_works = false;
  mute.reach(StationState::Running);
  EXPECT_EQ(mute.supervisor.state(), StationState::Running);
}

TEST(Supervisor, FaultStaysUntilTheCauseIsGoneAndTheOperatorClears) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.inputs.health.link = LinkState::BusOff;
  bench.tick();
  ASSERT_EQ(bench.supervisor.fault(), FaultCause::BusOff);
  bench.ticks(200);
  bench.inputs.clear = true;
  bench.tick();
  EXPECT_EQ(bench.supervisor.state(), StationState::Fault) << "the bus is still off";
  bench.inputs.health.link = LinkState::Up;
  bench.ticks(30);
  bench.inputs.clear = true;
  bench.tick();
  EXPECT_EQ(bench.supervisor.state(), StationState::Fault) << "not quiet for long enough";
  bench.ticks(500);
  EXPECT_EQ(bench.supervisor.state(), StationState::Fault) << "refused clears are not remembered";
  bench.inputs.clear = true;
  bench.tick();
  EXPECT_EQ(bench.supervisor.state(), StationState::Init);
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::None);
  bench.ticks(100);
  EXPECT_EQ(bench.supervisor.state(), StationState::Idle) << "and nothing moves without a new check";
}

TEST(Supervisor, AnotherStandingCauseAlsoPreventsTheClear) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.inputs.interlocks.emergency_stop = true;
  bench.tick();
  bench.inputs.interlocks.emergency_stop = false;
  bench.ticks(100, 0);
  EXPECT_FALSE(bench.supervisor.clearable()) << "the brake is silent";
  bench.ticks(100);
  EXPECT_TRUE(bench.supervisor.clearable());
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::EmergencyStop);
}

TEST(Supervisor, AnEventMayBeClearedAtOnce) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.inputs.operator_stop = true;
  bench.tick();
  ASSERT_EQ(bench.supervisor.fault(), FaultCause::OperatorStop);
  bench.inputs.clear = true;
  bench.tick();
  EXPECT_EQ(bench.supervisor.state(), StationState::Init);
}

TEST(Supervisor, BeyondTheCeilingNotEvenOpeningIsAllowed) {
  Bench bench;
  bench.reach(StationState::Running);
  bench.torque_sent_Nm = -2.0;
  bench.feedback.velocity_rad_s = -50.0;
  bench.feedback.force_N = SupervisorSettings{}.force_ceiling_N - 1.0;
  bench.ticks(5);
  EXPECT_EQ(bench.supervisor.state(), StationState::Running);
  bench.feedback.force_N = SupervisorSettings{}.force_ceiling_N + 1.0;
  bench.tick();
  EXPECT_EQ(bench.supervisor.fault(), FaultCause::OverForce);
}

TEST(GoodRow, StopsCountingLongBeforeItOverflows) {
  GoodRow row;
  for (int i = 0; i < GoodRow::kMax + 10; ++i) row.add();
  EXPECT_EQ(row.count(), GoodRow::kMax);
  row.restart();
  row.add();
  EXPECT_EQ(row.count(), 1);
}

TEST(Supervisor, SettingsThatCannotWorkAreNamed) {
  EXPECT_TRUE(SupervisorSettings{}.validate());
  SupervisorSettings settings;
  settings.force_limit_N = kNan;
  ASSERT_FALSE(settings.validate());
  EXPECT_NE(settings.validate().error().message.find("force_limit_N"), std::string::npos);
  settings = {};
  settings.plausible_torque_Nm = settings.torque_limit_Nm;
  EXPECT_FALSE(settings.validate());
  settings = {};
  settings.force_ceiling_N = settings.force_limit_N - 1.0;
  EXPECT_FALSE(settings.validate());
  settings = {};
  settings.good_samples_to_run = GoodRow::kMax + 1;
  EXPECT_FALSE(settings.validate());
  for (double ReadingTolerances::*tolerance :
       {&ReadingTolerances::torque_Nm, &ReadingTolerances::velocity_rad_s, &ReadingTolerances::position_rad,
        &ReadingTolerances::force_N}) {
    settings = {};
    settings.readings.*tolerance = 0.0;
    EXPECT_FALSE(settings.validate());
  }
}

}  // namespace
}  // namespace clampd::rt
