// The switches of the panel as the tick meets them: in every state, in virtual time.

#include "clampd/ports/interlocks.hpp"

#include <atomic>
#include <string>
#include <thread>

#include <gtest/gtest.h>

#include "rt/toy_station.hpp"
#include "support/allocation_trap.hpp"

namespace clampd::rt::test {
namespace {

constexpr std::int64_t kLostAfter_ns = 5 * kNanosecondsPerMillisecond;
constexpr StationState kEveryState[] = {StationState::Init,    StationState::Idle,      StationState::Armed,
                                        StationState::Running, StationState::Releasing, StationState::Fault};

/// A toy station with a panel whose reader publishes before every tick, unless it fell silent.
struct PanelStation {
  InterlockBoard board{kLostAfter_ns};
  ToyStation station{{}, 4096, &board};
  Interlocks interlocks;
  bool silent = false;

  void tick() {
    if (!silent) board.publish(interlocks, station.now_ns + kPeriod_ns);
    station.tick();
  }
  void ticks(int count) {
    for (int i = 0; i < count; ++i) tick();
  }
  bool reach(StationState target) {
    tick();
    if (target == StationState::Init) return station.state() == target;
    ticks(50);
    if (target == StationState::Idle) return station.state() == target;
    if (target == StationState::Fault) {
      station.core.requests().emergency_stop = true;
      tick();
      station.core.requests().emergency_stop = false;
      return station.state() == target;
    }
    station.start();
    for (int i = 0; i < 500 && station.state() != target; ++i) tick();
    tick();
    return station.state() == target;
  }
  /// Ticks until no command drives any more, from a switch that changed just after a tick.
  int ticks_to_zero_torque() {
    for (int ticks = 1; ticks <= 50; ++ticks) {
      tick();
      if (station.drive_is_off()) return ticks;
    }
    return 1000;
  }
};

TEST(Interlocks, TheEmergencyStopZeroesTheTorqueWithinTwoTicksInEveryState) {
  for (const StationState state : kEveryState) {
    SCOPED_TRACE(to_string(state));
    PanelStation bench;
    ASSERT_TRUE(bench.reach(state));
    if (state == StationState::Running) {
      ASSERT_NE(bench.station.port.attempted.torque_Nm, 0.0) << "driven, or this proves nothing";
    }
    const FaultCause before = bench.station.fault();
    bench.interlocks.emergency_stop = true;
    EXPECT_LE(bench.ticks_to_zero_torque(), 2);
    EXPECT_EQ(bench.station.state(), StationState::Fault);
    EXPECT_EQ(bench.station.fault(), before == FaultCause::None ? FaultCause::EmergencyStop : before);
    const std::uint64_t driven = bench.station.port.driven_sends;
    bench.station.core.requests().clear = true;
    bench.ticks(200);
    EXPECT_EQ(bench.station.state(), StationState::Fault) << "no clear while it is pressed";
    bench.interlocks.emergency_stop = false;
    bench.ticks(200);
    EXPECT_EQ(bench.station.state(), StationState::Fault) << "releasing it is not clearing it";
    bench.station.core.requests().clear = true;
    bench.ticks(200);
    EXPECT_EQ(bench.station.state(), StationState::Idle);
    EXPECT_EQ(bench.station.port.driven_sends, driven) << "nothing moves without a new check";
  }
  EXPECT_EQ(fault_rule(FaultCause::EmergencyStop).verdict, Verdict::Aborted);
}

TEST(Interlocks, ALineThatCannotBeReadIsAFaultInEveryStateThatMayDrive) {
  for (const StationState state :
       {StationState::Idle, StationState::Armed, StationState::Running, StationState::Releasing}) {
    SCOPED_TRACE(to_string(state));
    PanelStation bench;
    ASSERT_TRUE(bench.reach(state));
    bench.interlocks.lost = true;
    EXPECT_LE(bench.ticks_to_zero_torque(), 2);
    EXPECT_EQ(bench.station.fault(), FaultCause::InterlockLost);
  }
}

TEST(Interlocks, AReaderThatFallsSilentIsAFaultWithinAFewTicks) {
  for (const StationState state : {StationState::Armed, StationState::Running, StationState::Releasing}) {
    SCOPED_TRACE(to_string(state));
    PanelStation bench;
    ASSERT_TRUE(bench.reach(state));
    bench.silent = true;
    int ticks = 0;
    while (bench.station.fault() == FaultCause::None && ticks < 50) {
      bench.tick();
      ++ticks;
    }
    EXPECT_EQ(bench.station.fault(), FaultCause::InterlockLost);
    EXPECT_EQ(ticks, kLostAfter_ns / kPeriod_ns + 1);
    EXPECT_TRUE(bench.station.drive_is_off());
  }
}

TEST(Interlocks, AStationWhosePanelNeverReportsDoesNotBecomeReady) {
  PanelStation bench;
  bench.silent = true;
  bench.ticks(1000);
  EXPECT_EQ(bench.station.state(), StationState::Init);
  bench.ticks(1100);
  EXPECT_EQ(bench.station.fault(), FaultCause::InterlockLost);
}

TEST(Interlocks, AnOpenFixtureMattersInACheckOnly) {
  for (const StationState state : kEveryState) {
    SCOPED_TRACE(to_string(state));
    PanelStation bench;
    ASSERT_TRUE(bench.reach(state));
    const bool in_check =
        state == StationState::Armed || state == StationState::Running || state == StationState::Releasing;
    bench.interlocks.fixture_open = true;
    bench.tick();
    EXPECT_EQ(bench.station.fault() == FaultCause::FixtureOpen, in_check);
    EXPECT_EQ(bench.station.drive_is_off(), true);
    if (!in_check) continue;
    bench.station.core.requests().clear = true;
    bench.ticks(100);
    EXPECT_EQ(bench.station.state(), StationState::Idle) << "the part may come out while it is cleared";
  }
}

TEST(Interlocks, AHeldStartButtonKeepsTheStationFromBecomingReady) {
  PanelStation bench;
  bench.interlocks.start_button_stuck = true;
  bench.ticks(2200);
  EXPECT_EQ(bench.station.fault(), FaultCause::StartButtonStuck);
  bench.interlocks.start_button_stuck = false;
  bench.ticks(100);
  EXPECT_TRUE(bench.station.core.status().clearable);
}

TEST(Interlocks, TheLoopTellsItsTicksAndItsState) {
  PanelStation bench;
  ASSERT_TRUE(bench.reach(StationState::Running));
  const LoopBeat before = bench.board.last_beat();
  EXPECT_EQ(before.state, StationState::Running);
  bench.tick();
  EXPECT_EQ(bench.board.last_beat().ticks, before.ticks + 1);
  bench.station.core.shutdown(bench.station.now_ns);
  EXPECT_EQ(bench.board.last_beat().state, StationState::Fault) << "the relay must not outlive the loop";

  PanelStation idle;
  ASSERT_TRUE(idle.reach(StationState::Idle));
  idle.station.core.shutdown(idle.station.now_ns);
  EXPECT_EQ(idle.board.last_beat().state, StationState::Fault);
}

TEST(InterlockBoard, CarriesEveryFlagAndKnowsItsAge) {
  for (int flags = 0; flags < 16; ++flags) {
    const Interlocks written{(flags & 1) != 0, (flags & 2) != 0, (flags & 4) != 0, (flags & 8) != 0};
    InterlockBoard board(kLostAfter_ns);
    EXPECT_TRUE(board.read(0).lost) << "nobody published yet";
    constexpr std::int64_t kUptime_ns = 20LL * 365 * 86400 * kNanosecondsPerSecond;
    board.publish(written, kUptime_ns);
    const Interlocks read = board.read(kUptime_ns + kLostAfter_ns);
    EXPECT_EQ(read.emergency_stop, written.emergency_stop);
    EXPECT_EQ(read.fixture_open, written.fixture_open);
    EXPECT_EQ(read.start_button_stuck, written.start_button_stuck);
    EXPECT_EQ(read.lost, written.lost);
    EXPECT_FALSE(board.read(kUptime_ns - 10).lost && !written.lost)
        << "published just after the tick's clock";
    EXPECT_TRUE(board.read(kUptime_ns + kLostAfter_ns + 1).lost);
  }
}

TEST(Interlocks, TheTickDoesNotAllocateForThem) {
  PanelStation bench;
  std::size_t allocations = 0;
  std::uint64_t faults = 0;
  {
    support::AllocationTrap trap;
    bool in_fault = false;
    for (int i = 0; i < 12'000; ++i) {
      bench.interlocks.emergency_stop = i % 1000 > 950;
      bench.interlocks.fixture_open = i % 1300 > 1290;
      bench.interlocks.start_button_stuck = i % 1700 > 1690;
      bench.interlocks.lost = i % 1900 > 1890;
      bench.silent = i % 2300 > 2280;
      if (bench.station.state() == StationState::Idle) bench.station.start();
      if (bench.station.core.status().clearable) bench.station.core.requests().clear = true;
      bench.tick();
      faults += bench.station.state() == StationState::Fault && !in_fault;
      in_fault = bench.station.state() == StationState::Fault;
    }
    allocations = trap.allocations() + trap.releases();
  }
  EXPECT_EQ(allocations, 0U);
  EXPECT_GT(faults, 20U);
}

// For ThreadSanitizer: reader and guard of the panel beside the loop.
TEST(InterlockBoard, MayBeWrittenAndReadAtAnyTime) {
  InterlockBoard board(kLostAfter_ns);
  ToyStation station({}, 64, &board);
  std::atomic<bool> end{false};
  std::thread reader([&] {
    for (std::int64_t i = 1; !end; ++i) board.publish({i % 2 == 0, false, false, false}, i);
  });
  std::thread guard([&] {
    std::uint64_t last = 0;
    while (!end) {
      const LoopBeat beat = board.last_beat();
      EXPECT_GE(beat.ticks, last);
      last = beat.ticks;
    }
  });
  for (int i = 0; i < 5'000; ++i) station.tick();
  end = true;
  reader.join();
  guard.join();
  EXPECT_EQ(board.last_beat().ticks, 5'000U);
}

}  // namespace
}  // namespace clampd::rt::test
