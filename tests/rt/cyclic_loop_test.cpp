#include "rt/cyclic_loop.hpp"

#include <vector>

#include <gtest/gtest.h>

#include "rt/cyclic_thread.hpp"

namespace clampd::rt {
namespace {

/// Sleeps exactly to the deadline plus what is planned for that wake-up.
struct VirtualClock {
  std::int64_t now = 7'000'300;  // off any round number: the grid starts where the loop starts
  std::vector<std::int64_t> late_by;
  std::size_t sleeps = 0;
  std::int64_t early_returns = 0;

  std::int64_t now_ns() noexcept { return now; }
  void wait_until(std::int64_t deadline_ns) noexcept {
    if (early_returns > 0) {
      --early_returns;
      now += 100;
      return;
    }
    now = deadline_ns + (sleeps < late_by.size() ? late_by[sleeps] : 0);
    ++sleeps;
  }
};

struct Call {
  std::int64_t now_ns;
  std::int64_t lateness_ns;
  std::uint64_t skipped;
};

struct Recorder {
  VirtualClock& clock;
  std::atomic<bool>& stop;
  std::size_t calls_wanted;
  std::vector<std::int64_t> work_ns;
  std::vector<Call> calls;
  int shutdowns = 0;

  void tick(std::int64_t now_ns, std::int64_t lateness_ns, std::uint64_t skipped) noexcept {
    if (calls.size() < work_ns.size()) clock.now += work_ns[calls.size()];
    calls.push_back({now_ns, lateness_ns, skipped});
    if (calls.size() == calls_wanted) stop = true;
  }
  void shutdown(std::int64_t) noexcept { ++shutdowns; }
};

constexpr std::int64_t kOrigin_ns = 7'000'300;

TEST(CyclicLoop, KeepsTheGridDespiteLateness) {
  VirtualClock clock;
  clock.late_by = {0, 20'000, 999'999, 5'000, 0};
  std::atomic<bool> stop{false};
  Recorder recorder{clock, stop, 5, {}, {}};
  LoopStatistics statistics;
  run_cyclic(clock, recorder, stop, statistics);
  ASSERT_EQ(recorder.calls.size(), 5U);
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(recorder.calls[i].now_ns - recorder.calls[i].lateness_ns,
              kOrigin_ns + static_cast<std::int64_t>(i + 1) * kPeriod_ns);
    EXPECT_EQ(recorder.calls[i].lateness_ns, clock.late_by[i]);
    EXPECT_EQ(recorder.calls[i].skipped, 0U);
  }
  EXPECT_EQ(statistics.lateness.snapshot().count, 5U);
  EXPECT_DOUBLE_EQ(statistics.lateness.snapshot().max_us, 999.999);
}

TEST(CyclicLoop, SkipsWholePeriodsAndComesBackToTheGrid) {
  VirtualClock clock;
  clock.late_by = {0, 3'400'000, 0, 1'000'000, 0};
  std::atomic<bool> stop{false};
  Recorder recorder{clock, stop, 5, {}, {}};
  LoopStatistics statistics;
  run_cyclic(clock, recorder, stop, statistics);
  EXPECT_EQ(recorder.calls[1].skipped, 3U);
  EXPECT_EQ(recorder.calls[1].lateness_ns, 3'400'000);
  EXPECT_EQ(recorder.calls[2].now_ns, kOrigin_ns + 6 * kPeriod_ns);
  EXPECT_EQ(recorder.calls[2].skipped, 0U);
  EXPECT_EQ(recorder.calls[3].skipped, 1U) << "exactly one period late: that grid point has passed";
  EXPECT_EQ(recorder.calls[4].now_ns, kOrigin_ns + 9 * kPeriod_ns);
  EXPECT_EQ(statistics.skipped.load(), 4U);
  // Every grid point is either a tick or a skipped period.
  EXPECT_EQ((recorder.calls[4].now_ns - kOrigin_ns) / kPeriod_ns, 5 + 4);
}

TEST(CyclicLoop, WorkThatOverrunsMakesTheNextTickLate) {
  VirtualClock clock;
  std::atomic<bool> stop{false};
  Recorder recorder{clock, stop, 3, {0, 2'300'000, 0}, {}};
  LoopStatistics statistics;
  run_cyclic(clock, recorder, stop, statistics);
  EXPECT_EQ(recorder.calls[2].skipped, 1U);
  EXPECT_EQ(recorder.calls[2].lateness_ns, 1'300'000);
  EXPECT_DOUBLE_EQ(statistics.run_time.snapshot().max_us, 2300.0);
}

TEST(CyclicLoop, AnInterruptedSleepDoesNotTickEarly) {
  VirtualClock clock;
  clock.early_returns = 3;
  std::atomic<bool> stop{false};
  Recorder recorder{clock, stop, 1, {}, {}};
  LoopStatistics statistics;
  run_cyclic(clock, recorder, stop, statistics);
  EXPECT_EQ(recorder.calls[0].now_ns, kOrigin_ns + kPeriod_ns);
}

TEST(CyclicLoop, ShutsDownOnceAfterTheLastTick) {
  VirtualClock clock;
  std::atomic<bool> stop{false};
  Recorder recorder{clock, stop, 4, {}, {}};
  LoopStatistics statistics;
  run_cyclic(clock, recorder, stop, statistics);
  EXPECT_EQ(recorder.shutdowns, 1);
  EXPECT_EQ(recorder.calls.size(), 4U);
}

/// A core whose brake wants a command four times in a period.
struct Repeater {
  Recorder recorder;
  std::vector<std::int64_t> between_ns;
  void tick(std::int64_t now_ns, std::int64_t lateness_ns, std::uint64_t skipped) noexcept {
    recorder.tick(now_ns, lateness_ns, skipped);
  }
  void between(std::int64_t now_ns) noexcept { between_ns.push_back(now_ns); }
  void shutdown(std::int64_t now_ns) noexcept { recorder.shutdown(now_ns); }
};

TEST(FinerGrid, TicksOncePerPeriodAndRepeatsInBetween) {
  constexpr std::int64_t kQuarter_ns = kPeriod_ns / 4;
  VirtualClock clock;
  // In the second period the third point is passed; in the third one the last one and the fourth period's
  // first two; then a stay of over two periods.
  clock.late_by = {0, 5, 0, 7, 0, kQuarter_ns + 9, 0, 0, 11, 3 * kQuarter_ns + 13, 0, 10 * kQuarter_ns + 1};
  std::atomic<bool> stop{false};
  Repeater core{{clock, stop, 5, {}, {}}, {}};
  FinerGrid<Repeater> grid(core, 4, kPeriod_ns / 4);
  LoopStatistics statistics;
  run_cyclic(clock, grid, stop, statistics, kQuarter_ns);
  const std::vector<Call>& calls = core.recorder.calls;
  ASSERT_EQ(calls.size(), 5U);
  const auto at = [&](std::size_t i) { return calls[i].now_ns - kOrigin_ns; };
  EXPECT_EQ(at(0), kPeriod_ns + 7);
  EXPECT_EQ(calls[0].lateness_ns, 7);
  EXPECT_EQ(at(1), 2 * kPeriod_ns);
  EXPECT_EQ(calls[1].lateness_ns, 0);
  EXPECT_EQ(at(2), 3 * kPeriod_ns + 2 * kQuarter_ns + 13);
  EXPECT_EQ(calls[2].lateness_ns, 2 * kQuarter_ns + 13);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(calls[i].skipped, 0U) << i;
  EXPECT_EQ(at(3), 6 * kPeriod_ns + 2 * kQuarter_ns + 1);
  EXPECT_EQ(calls[3].lateness_ns, 2 * kPeriod_ns + 2 * kQuarter_ns + 1);
  EXPECT_EQ(calls[3].skipped, 2U);
  EXPECT_EQ(at(4), 7 * kPeriod_ns);
  EXPECT_EQ(calls[4].lateness_ns, 0);
  EXPECT_EQ(calls[4].skipped, 0U);
  EXPECT_EQ(core.between_ns.size(), 3U + 2U + 2U + 1U + 1U);
  EXPECT_EQ(core.recorder.shutdowns, 1);
}

struct Counter {
  std::atomic<std::uint64_t> ticks{0};
  std::atomic<std::uint64_t> periods{0};
  std::atomic<int> shutdowns{0};
  void tick(std::int64_t, std::int64_t, std::uint64_t skipped) noexcept {
    periods += 1 + skipped;
    ++ticks;
  }
  void shutdown(std::int64_t) noexcept { ++shutdowns; }
};

TEST(CyclicThread, TicksOnTheRealClockAndStops) {
  Counter counter;
  CyclicThread thread;
  const CyclicThreadSettings settings{0, -1, false};
  ASSERT_TRUE(thread.start(settings, counter));
  EXPECT_TRUE(thread.running());
  EXPECT_FALSE(thread.start(settings, counter)) << "it runs already";
  while (counter.ticks < 20) std::this_thread::yield();
  thread.stop();
  EXPECT_FALSE(thread.running());
  EXPECT_EQ(counter.shutdowns, 1);
  EXPECT_EQ(thread.statistics().lateness.snapshot().count, counter.ticks);
  EXPECT_EQ(thread.statistics().skipped, counter.periods - counter.ticks);

  ASSERT_TRUE(thread.start(settings, counter)) << "and may start again";
  thread.stop();
  EXPECT_EQ(counter.shutdowns, 2);
}

TEST(CyclicThread, RefusesImpossibleSettingsInWords) {
  Counter counter;
  CyclicThread thread;
  const auto priority = thread.start({100, -1, false}, counter);
  ASSERT_FALSE(priority);
  EXPECT_NE(priority.error().message.find("priority 100"), std::string::npos);
  const auto core = thread.start({0, CPU_SETSIZE - 1, false}, counter);
  ASSERT_FALSE(core);
  EXPECT_NE(core.error().message.find("core"), std::string::npos);
  EXPECT_EQ(counter.ticks, 0U);
}

}  // namespace
}  // namespace clampd::rt
