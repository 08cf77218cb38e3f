#include "rt/control_core.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "rt/toy_station.hpp"

namespace clampd::rt::test {
namespace {

constexpr std::uint64_t kStopWithin_ms = 5;

/// How to bring one cause about, and how to take it away again.
struct Injection {
  FaultCause cause;
  void (*inject)(ToyStation&);
  void (*heal)(ToyStation&);
  std::uint64_t ticks_to_see = 1;  ///< from the injection to the tick that can know
};

void nothing(ToyStation&) {}
void good_reading(ToyStation& s) {
  s.port.reading = {};
}
void good_link(ToyStation& s) {
  s.port.counts.link = LinkState::Up;
}
void good_sequence(ToyStation&) {
  ToySequence::reset();
}

const Injection kInjections[] = {
    {FaultCause::FeedbackStale, [](ToyStation& s) { s.port.silent = true; },
     [](ToyStation& s) { s.port.silent = false; }, 3},
    {FaultCause::FeedbackCorrupt, [](ToyStation& s) { ++s.port.counts.crc_errors; }, nothing},
    {FaultCause::FeedbackFrozen, [](ToyStation& s) { s.port.counts.counter_errors += 2; }, nothing},
    {FaultCause::FeedbackFrozen, [](ToyStation& s) { s.port.frozen_clock = true; },
     [](ToyStation& s) { s.port.frozen_clock = false; }},
    {FaultCause::FeedbackImplausible, [](ToyStation& s) { ++s.port.counts.implausible; }, nothing},
    {FaultCause::FeedbackImplausible,
     [](ToyStation& s) { s.port.reading.force_N = std::numeric_limits<double>::quiet_NaN(); }, good_reading},
    {FaultCause::BusOff, [](ToyStation& s) { ++s.port.counts.bus_off_events; }, nothing},
    {FaultCause::BusOff, [](ToyStation& s) { s.port.counts.link = LinkState::BusOff; }, good_link},
    {FaultCause::LinkDown, [](ToyStation& s) { s.port.counts.link = LinkState::Down; }, good_link},
    {FaultCause::LinkDown, [](ToyStation& s) { s.port.counts.link = LinkState::Gone; }, good_link},
    // The second failure makes it a fault, after that tick's only send: the one after asks for zero.
    {FaultCause::SendFailed, [](ToyStation& s) { s.port.send_fails = true; },
     [](ToyStation& s) { s.port.send_fails = false; }, 3},
    {FaultCause::OverForce,
     [](ToyStation& s) {
       s.port.reading.force_N = 34e3;
       s.port.reading.velocity_rad_s = 20.0;
     },
     good_reading},
    {FaultCause::OverSpeed, [](ToyStation& s) { s.port.reading.velocity_rad_s = 360.0; }, good_reading},
    {FaultCause::OverTorque, [](ToyStation& s) { s.port.reading.torque_Nm = 3.15; }, good_reading},
    {FaultCause::BrakeFault, [](ToyStation& s) { s.port.reading.watchdog_tripped = true; }, good_reading},
    {FaultCause::BrakeFault, [](ToyStation& s) { s.port.reading.brake_fault = true; }, good_reading},
    {FaultCause::EmergencyStop, [](ToyStation& s) { s.core.requests().emergency_stop = true; },
     [](ToyStation& s) { s.core.requests().emergency_stop = false; }},
};

const Injection kRunningInjections[] = {
    {FaultCause::BrakeFault, [](ToyStation& s) { s.port.drive_works = false; },
     [](ToyStation& s) { s.port.drive_works = true; }},
    {FaultCause::NonFinite,
     [](ToyStation&) { ToySequence::torque_Nm = std::numeric_limits<double>::infinity(); }, good_sequence},
    {FaultCause::NonFinite,
     [](ToyStation&) { ToySequence::torque_Nm = std::numeric_limits<double>::quiet_NaN(); }, good_sequence},
    {FaultCause::SequenceTimeout, [](ToyStation&) { ToySequence::fault = FaultCause::SequenceTimeout; },
     good_sequence},
    {FaultCause::OperatorStop, [](ToyStation& s) { s.stop(); }, nothing},
    {FaultCause::SampleLost, [](ToyStation& s) { ++s.port.sample_index; }, nothing},
    {FaultCause::MissedTicks, [](ToyStation& s) { s.tick(3); }, nothing, 0},
};

std::string describe(const Injection& injection) {
  return std::string(to_string(injection.cause));
}

void expect_stop_and_recovery(const Injection& injection, StationState state) {
  SCOPED_TRACE(describe(injection) + " in " + std::string(to_string(state)));
  ToyStation station;
  ASSERT_TRUE(station.reach(state));
  const std::uint64_t finished = station.core.status().checks_finished;
  const bool had_check = state != StationState::Idle;
  injection.inject(station);

  std::uint64_t ticks = 0;
  while (station.fault() == FaultCause::None && ticks < 50) {
    station.tick();
    ++ticks;
  }
  if (!station.drive_is_off()) {
    station.tick();
    ++ticks;
  }
  EXPECT_EQ(station.fault(), injection.cause);
  EXPECT_TRUE(station.drive_is_off());
  EXPECT_LE(ticks, injection.ticks_to_see);
  EXPECT_LE(ticks, kStopWithin_ms);
  EXPECT_EQ(station.core.status().checks_finished, finished + (had_check ? 1 : 0));
  EXPECT_EQ(ToySequence::abandoned, had_check ? 1 : 0);

  // Nothing moves until the operator clears, also if the cause goes and a check is asked for.
  const std::uint64_t driven = station.port.driven_sends;
  injection.heal(station);
  station.start();
  station.ticks(200);
  EXPECT_EQ(station.state(), StationState::Fault);
  EXPECT_EQ(station.core.requests().plan.load(), nullptr) << "refused";
  EXPECT_TRUE(station.core.status().clearable);
  station.core.requests().clear = true;
  station.ticks(100);
  EXPECT_EQ(station.state(), StationState::Idle);
  EXPECT_EQ(station.port.driven_sends, driven);
  EXPECT_EQ(ToySequence::steps_after_end, 0);

  // And without a restart the next check runs to its end.
  const std::uint64_t before_next = station.core.status().checks_finished;
  station.start();
  station.ticks(400);
  EXPECT_EQ(station.core.status().checks_finished, before_next + 1);
  EXPECT_EQ(station.state(), StationState::Idle);
  EXPECT_GT(station.port.driven_sends, driven);
}

TEST(ControlCore, RunsAreEnoughForTheCheckThatTheyWereEnoughForAndForNoOther) {
  ToySequence::reset();
  ToyStation station;
  station.ticks(10);
  station.start();
  station.ticks(20);
  EXPECT_EQ(ToySequence::concluded, 0);
  station.core.requests().enough_runs_in = station.core.status().checks_finished + 1;
  station.ticks(10);
  EXPECT_EQ(ToySequence::concluded, 10);
  station.ticks(400);
  ASSERT_EQ(station.core.status().checks_finished, 1u);
  ToySequence::reset();
  station.start();
  station.ticks(50);
  EXPECT_EQ(ToySequence::concluded, 0) << "what was said of the last check says nothing of this one";
}

TEST(ControlCore, ATrajectoryIsChosenForOneCheckAndForNoOther) {
  ToySequence::reset();
  ToyStation station;
  station.ticks(10);
  station.start();
  station.ticks(20);
  EXPECT_EQ(ToySequence::followed, -1);
  const std::uint64_t check = station.core.status().checks_finished + 1;
  station.core.requests().next_trajectory = check * RequestBoard::kTrajectories + 2;
  station.ticks(2);
  EXPECT_EQ(ToySequence::followed, 2);
  station.ticks(400);
  ASSERT_EQ(station.core.status().checks_finished, 1u);
  ToySequence::reset();
  station.start();
  station.ticks(50);
  EXPECT_EQ(ToySequence::followed, -1) << "what was said of the last check says nothing of this one";
}

TEST(ControlCore, EveryCauseStopsTheDriveAndIsRecoveredFrom) {
  for (const Injection& injection : kInjections) {
    expect_stop_and_recovery(injection, StationState::Idle);
    expect_stop_and_recovery(injection, StationState::Armed);
    expect_stop_and_recovery(injection, StationState::Running);
    expect_stop_and_recovery(injection, StationState::Releasing);
  }
  for (const Injection& injection : kRunningInjections) {
    expect_stop_and_recovery(injection, StationState::Running);
  }
}

TEST(ControlCore, InInitAndFaultNothingEverDrives) {
  for (const StationState state : {StationState::Init, StationState::Fault}) {
    for (const Injection& injection : kInjections) {
      SCOPED_TRACE(describe(injection));
      ToyStation station;
      ASSERT_TRUE(station.reach(state));
      injection.inject(station);
      for (int i = 0; i < 2500; ++i) {
        station.tick();
        ASSERT_TRUE(station.drive_is_off());
      }
    }
  }
}

TEST(ControlCore, ACheckGoesThroughItsStates) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Idle));
  station.start();
  std::vector<StationState> states;
  for (int i = 0; i < 300; ++i) {
    station.tick();
    if (states.empty() || states.back() != station.state()) states.push_back(station.state());
    if (station.state() == StationState::Armed) {
      ASSERT_EQ(station.port.attempted.torque_Nm, 0.0);
      ASSERT_TRUE(station.port.attempted.enable);
    }
  }
  EXPECT_EQ(states, (std::vector{StationState::Armed, StationState::Running, StationState::Releasing,
                                 StationState::Idle}));
  EXPECT_EQ(station.core.status().checks_finished, 1U);
  EXPECT_TRUE(station.drive_is_off());
  EXPECT_EQ(station.core.status().phase, CheckPhase::None);
  // 10 ticks ARMED and 220 driven, the first of each counted by the tick that enters it.
  EXPECT_EQ(station.core.lateness().snapshot().count, station.core.status().check_ticks);
  EXPECT_GE(station.core.status().check_ticks, 230U);
  EXPECT_DOUBLE_EQ(station.core.lateness().snapshot().max_us, 5.0);
}

TEST(ControlCore, SendsExactlyOnceATickInEveryState) {
  ToyStation station;
  station.tick();
  station.start();  // waits in INIT
  ASSERT_EQ(station.port.sends, 1U);
  for (std::uint64_t i = 2; i <= 600; ++i) {
    if (i == 150) station.stop();
    if (i == 300) station.port.silent = true;
    station.port.samples_per_tick = i % 4;
    station.tick();
    ASSERT_EQ(station.port.sends, i);
  }
}

TEST(ControlCore, LogsEverySampleWithItsCommand) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Running));
  Sample sample;
  while (station.core.ring().pop(sample)) {
  }
  ToySequence::torque_Nm = 0.7;
  station.port.reading.force_N = 12.0;
  station.port.samples_per_tick = 2;
  station.tick();
  ASSERT_TRUE(station.core.ring().pop(sample));
  EXPECT_EQ(sample.torque_command_Nm, ToySequence::kTorque_Nm) << "the command before still acted";
  const auto first_index = sample.sample_index;
  const auto first_row = sample.trajectory_index;
  ASSERT_TRUE(station.core.ring().pop(sample));
  EXPECT_EQ(sample.sample_index, first_index + 1);
  EXPECT_EQ(sample.trajectory_index, first_row + 1);
  EXPECT_EQ(sample.torque_command_Nm, 0.7);
  EXPECT_EQ(sample.host_time_ns, station.now_ns);
  EXPECT_EQ(sample.force_N, 12.0);
  EXPECT_EQ(sample.force_reference_N, 10.0 * sample.trajectory_index);
  EXPECT_EQ(sample.repeat, 3);
  EXPECT_EQ(sample.state, StationState::Running);
  EXPECT_EQ(sample.phase, CheckPhase::Trajectory);
  EXPECT_EQ(sample.lateness_ns, 5'000);
  EXPECT_FALSE(station.core.ring().pop(sample));
}

TEST(ControlCore, HoldsTheCommandOverEmptyTicksWithinTheStaleLimit) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Running));
  station.port.silent = true;
  station.tick();
  EXPECT_EQ(station.port.attempted.torque_Nm, ToySequence::kTorque_Nm);
  station.tick();
  EXPECT_EQ(station.port.attempted.torque_Nm, ToySequence::kTorque_Nm);
  station.tick();
  EXPECT_TRUE(station.drive_is_off());
}

TEST(ControlCore, LimitsWhatTheSequenceAsksFor) {
  ToyStation station;
  station.plan.torque_limit_Nm = 2.0;
  ASSERT_TRUE(station.reach(StationState::Running));
  ToySequence::torque_Nm = -50.0;
  station.tick();
  EXPECT_EQ(station.port.attempted.torque_Nm, -2.0);
  station.plan.torque_limit_Nm = 1e9;
  station.tick();
  EXPECT_EQ(station.port.attempted.torque_Nm, -SupervisorSettings{}.torque_limit_Nm);
  station.plan.torque_limit_Nm = std::numeric_limits<double>::quiet_NaN();
  station.tick();
  EXPECT_EQ(station.port.attempted.torque_Nm, -SupervisorSettings{}.torque_limit_Nm);
  station.plan.torque_limit_Nm = -1.0;
  station.tick();
  EXPECT_EQ(station.port.attempted.torque_Nm, 0.0);
}

TEST(ControlCore, ABrakeThatIsToldItsSpeedIsStoppedByTheDriveNotBySpeedZero) {
  const SupervisorSettings settings;
  const auto started = [](ToyStation& station, StationState state) {
    ToySequence::torque_Nm = 0.0;
    ToySequence::velocity_rad_s = 50.0;
    station.plan.commanded = CommandedQuantity::Velocity;
    return station.reach(state);
  };
  ToyStation station;
  ASSERT_TRUE(started(station, StationState::Armed));
  EXPECT_TRUE(station.port.last.enable) << "live, and at rest";
  EXPECT_EQ(station.port.last.commanded, CommandedQuantity::Velocity);
  EXPECT_EQ(station.port.last.velocity_rad_s, 0.0);
  station.ticks(50);
  EXPECT_EQ(station.port.last.velocity_rad_s, 50.0);
  EXPECT_EQ(station.port.last.torque_Nm, 0.0);
  ToySequence::velocity_rad_s = -1e6;
  station.tick();
  EXPECT_EQ(station.port.last.velocity_rad_s, -settings.speed_limit_rad_s);
  station.core.requests().emergency_stop = true;
  station.tick();
  EXPECT_EQ(station.fault(), FaultCause::EmergencyStop);
  EXPECT_TRUE(station.drive_is_off());

  ToyStation other;
  ASSERT_TRUE(started(other, StationState::Running));
  ToySequence::velocity_rad_s = std::numeric_limits<double>::quiet_NaN();
  other.tick();
  EXPECT_EQ(other.fault(), FaultCause::NonFinite);
  EXPECT_TRUE(other.drive_is_off());
}

TEST(ControlCore, CountsSkippedPeriodsForTheCheckAndForGood) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Idle));
  station.tick(7);
  ASSERT_TRUE(station.reach(StationState::Running));
  station.tick(2);
  EXPECT_EQ(station.state(), StationState::Running);
  EXPECT_EQ(station.core.status().skipped, 9U);
  EXPECT_EQ(station.core.status().check_skipped, 2U);
  EXPECT_DOUBLE_EQ(station.core.lateness().snapshot().max_us, 2005.0);
}

TEST(ControlCore, AFullRingDropsCountsAndTheCheckGoesOn) {
  ToyStation station({}, 16);
  ASSERT_TRUE(station.reach(StationState::Running));
  station.ticks(100);
  EXPECT_EQ(station.state(), StationState::Running);
  const std::uint64_t ticks = station.core.status().ticks;
  EXPECT_EQ(station.core.status().ring_drops, ticks - 16);
  EXPECT_GE(station.core.status().check_ring_drops, 100U);
  Sample sample;
  ASSERT_TRUE(station.core.ring().pop(sample));
  EXPECT_EQ(sample.sample_index, 1001) << "the oldest are kept";
}

TEST(ControlCore, StopWithdrawsAPlanThatWaits) {
  ToyStation station;
  station.tick();
  station.start();
  station.stop();
  station.ticks(200);
  EXPECT_EQ(station.state(), StationState::Idle);
  EXPECT_EQ(station.port.driven_sends, 0U);
  EXPECT_EQ(station.core.status().checks_finished, 1U);
}

TEST(ControlCore, AStopVoidsEveryStartThatWasAskedForBeforeIt) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Idle));
  const StartTicket before = station.core.ticket();
  EXPECT_EQ(station.core.refusal(before), StartRefusal::None);
  const std::uint64_t stop = station.stop();
  EXPECT_EQ(station.core.refusal(before), StartRefusal::Stopped) << "at once";
  EXPECT_LT(station.core.status().stops, stop);
  station.tick();
  EXPECT_EQ(station.core.status().stops, stop) << "confirmed by the next tick";
  station.core.requests().start(station.plan, before);
  station.ticks(400);
  EXPECT_EQ(station.port.driven_sends, 0U);
  EXPECT_EQ(station.core.status().checks_finished, 1U);
  EXPECT_EQ(station.core.status().end_refusal, StartRefusal::Stopped);
  EXPECT_EQ(station.state(), StationState::Idle) << "a refusal is no fault";
}

TEST(ControlCore, AStartThatHasSeenTheStopIsTakenAfterIt) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Idle));
  station.stop();
  station.start();  // both before the next tick
  station.ticks(30);
  EXPECT_EQ(station.state(), StationState::Running);
}

TEST(ControlCore, AStartThatWaitedTooLongIsVoid) {
  for (const int waited_ms : {299, 302}) {
    ToyStation station;
    ASSERT_TRUE(station.reach(StationState::Idle));
    const StartTicket ticket = station.core.ticket();
    station.ticks(waited_ms);
    station.core.requests().start(station.plan, ticket);
    station.ticks(30);
    EXPECT_EQ(station.state() == StationState::Running, waited_ms < 300);
    EXPECT_EQ(station.core.status().end_refusal,
              waited_ms < 300 ? StartRefusal::None : StartRefusal::TooLate);
  }
}

TEST(ControlCore, AStartFromBeforeAFaultOrItsClearIsVoid) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Idle));
  const StartTicket healthy = station.core.ticket();
  station.core.requests().emergency_stop = true;
  station.tick();
  station.core.requests().emergency_stop = false;
  const StartTicket in_fault = station.core.ticket();
  station.ticks(60);
  station.core.requests().clear = true;
  station.ticks(30);
  ASSERT_EQ(station.state(), StationState::Idle);
  for (const StartTicket& ticket : {healthy, in_fault}) {
    station.core.requests().start(station.plan, ticket);
    station.ticks(30);
    EXPECT_EQ(station.core.status().end_refusal, StartRefusal::Fault);
  }
  EXPECT_EQ(station.port.driven_sends, 0U);
}

TEST(ControlCore, APressIsVoidOnceAStopOrAFaultCameAfterIt) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Idle));
  const std::int64_t pressed_ns = station.now_ns;
  station.ticks(10);
  ASSERT_TRUE(station.core.ticket_of(pressed_ns));
  EXPECT_EQ(station.core.ticket_of(pressed_ns)->asked_ns, pressed_ns);
  station.stop();
  EXPECT_FALSE(station.core.ticket_of(pressed_ns));
  station.ticks(10);
  const std::int64_t again_ns = station.now_ns;
  station.ticks(10);
  ASSERT_TRUE(station.core.ticket_of(again_ns));
  station.core.requests().emergency_stop = true;
  station.tick();
  EXPECT_FALSE(station.core.ticket_of(again_ns));
}

TEST(ControlCore, TheCauseThatEndedACheckOutlivesItsClear) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Releasing));
  station.stop();
  station.tick();
  station.core.requests().clear = true;
  station.tick();
  ASSERT_EQ(station.fault(), FaultCause::None) << "cleared within 2 ms";
  EXPECT_EQ(station.core.status().checks_finished, 1U);
  EXPECT_EQ(station.core.status().end_fault, FaultCause::OperatorStop);
  EXPECT_EQ(station.core.status().end_state, StationState::Releasing);
  station.ticks(100);
  station.start();
  station.ticks(400);
  EXPECT_EQ(station.core.status().checks_finished, 2U);
  EXPECT_EQ(station.core.status().end_fault, FaultCause::None) << "of the next check, which reached its end";
}

TEST(ControlCore, TheDeadlineEndsACheckByItsOwnCause) {
  ToyStation station;
  station.plan.deadline_s = 0.1;
  ASSERT_TRUE(station.reach(StationState::Running));
  station.ticks(120);
  EXPECT_EQ(station.fault(), FaultCause::DeadlinePassed);
  EXPECT_EQ(station.core.status().end_fault, FaultCause::DeadlinePassed);
  EXPECT_TRUE(station.drive_is_off());
}

TEST(ControlCore, APlanFromBeforeTheClearDoesNotStartAfterIt) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Fault));
  station.ticks(100);
  station.start();
  station.core.requests().clear = true;
  station.ticks(300);
  EXPECT_EQ(station.state(), StationState::Idle);
  EXPECT_EQ(station.port.driven_sends, 0U);
}

TEST(ControlCore, ShutdownSwitchesTheDriveOffAndEndsTheCheck) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Running));
  station.core.shutdown(station.now_ns);
  EXPECT_TRUE(station.drive_is_off());
  EXPECT_EQ(station.state(), StationState::Fault);
  EXPECT_EQ(station.fault(), FaultCause::StationEnded);
  EXPECT_EQ(station.core.status().checks_finished, 1U);
}

TEST(ControlCore, FlightRecorderHoldsTheLastSamplesBeforeTheFault) {
  ToyStation station;
  ASSERT_TRUE(station.reach(StationState::Idle));
  EXPECT_TRUE(station.core.flight_recorder().last_capture().empty());
  station.ticks(600);
  ASSERT_TRUE(station.reach(StationState::Running));
  const std::int64_t last_good = station.port.sample_index;
  ++station.port.counts.crc_errors;
  station.tick();
  station.ticks(300);  // what comes after the fault does not push it out
  const std::vector<Sample> samples = station.core.flight_recorder().last_capture();
  ASSERT_EQ(samples.size(), FlightRecorder::kCapacity);
  EXPECT_EQ(samples.back().sample_index, last_good + 1);
  EXPECT_EQ(samples.back().fault, FaultCause::FeedbackCorrupt);
  EXPECT_EQ(samples[samples.size() - 2].fault, FaultCause::None);
  EXPECT_EQ(samples[samples.size() - 2].state, StationState::Running);
  for (std::size_t i = 1; i < samples.size(); ++i) {
    ASSERT_EQ(samples[i].sample_index, samples[i - 1].sample_index + 1);
  }
}

TEST(ControlCore, PublishesTheWholeOfThePortsHealth) {
  ToyStation station;
  station.port.counts = {LinkState::ErrorPassive, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};
  station.port.silent = true;
  station.tick();
  const PortHealth health = station.core.health();
  EXPECT_EQ(health.link, LinkState::ErrorPassive);
  const std::array all{health.frames_received,   health.frames_sent,    health.send_failures,
                       health.crc_errors,        health.counter_errors, health.lost_samples,
                       health.implausible,       health.error_frames,   health.bus_off_events,
                       health.receive_overflows, health.bus_bits};
  for (std::size_t i = 0; i < all.size(); ++i) EXPECT_EQ(all[i], i + 1);
}

// For ThreadSanitizer: a worker drains, a session starts, stops and clears, a publisher reads everything.
TEST(ControlCore, OtherThreadsMayUseItsBoardsAtAnyTime) {
  ToyStation station({}, 64);
  std::atomic<bool> end{false};
  std::atomic<std::int64_t> drained{0};
  std::atomic<std::uint64_t> asked{0};
  std::thread worker([&] {
    Sample sample;
    std::int64_t last = 0;
    while (!end) {
      while (station.core.ring().pop(sample)) {
        EXPECT_GT(sample.sample_index, last);
        last = sample.sample_index;
        ++drained;
      }
      std::this_thread::yield();
    }
  });
  std::thread session([&] {
    RequestBoard& requests = station.core.requests();
    const StatusBoard& status = station.core.status();
    while (!end) {
      const StationState state = status.state;
      if (state == StationState::Idle && requests.plan == nullptr) {
        station.start();
        ++asked;
      } else if (state == StationState::Releasing) {
        requests.stop(0);
      } else if (status.clearable) {
        requests.clear = true;
      }
      std::this_thread::yield();
    }
  });
  std::thread publisher([&] {
    std::size_t captured = 0;
    while (!end) {
      captured = std::max(captured, station.core.flight_recorder().last_capture().size());
      EXPECT_EQ(station.core.health().link, LinkState::Up);
      EXPECT_LE(station.core.lateness().snapshot().max_us, 5.0);
      std::this_thread::yield();
    }
    EXPECT_LE(captured, FlightRecorder::kCapacity);
  });
  // As many ticks as it takes until every thread had its turn; on a busy machine one may start late.
  for (int i = 0; i < 5'000 || drained == 0 || station.core.status().checks_finished < 5; ++i) {
    station.tick();
    if (i % 16 == 0) std::this_thread::yield();
  }
  end = true;
  worker.join();
  session.join();
  publisher.join();
  EXPECT_LE(station.core.status().checks_finished, asked);
}

}  // namespace
}  // namespace clampd::rt::test
