#pragma once

#include <atomic>
#include <cstdint>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "rt/histogram.hpp"

namespace clampd::rt {

/// The grid of absolute deadlines, 1 ms unless said otherwise. A missed deadline keeps the grid: whole
/// periods are skipped and counted, the next deadline is the next grid point after the wake-up.
class TickGrid {
 public:
  struct Wake {
    std::int64_t lateness_ns;       ///< against the deadline that was slept for
    std::uint64_t skipped_periods;  ///< grid points after that deadline that have passed too
  };

  /// The first deadline is one period after `origin_ns`.
  explicit TickGrid(std::int64_t origin_ns, std::int64_t period_ns = kPeriod_ns) noexcept
      : period_ns_(period_ns), deadline_ns_(origin_ns + period_ns) {}

  CLAMPD_REALTIME std::int64_t deadline_ns() const noexcept { return deadline_ns_; }

  CLAMPD_REALTIME Wake woke(std::int64_t now_ns) noexcept {
    const std::int64_t lateness_ns = now_ns - deadline_ns_;
    const std::int64_t skipped = lateness_ns >= period_ns_ ? lateness_ns / period_ns_ : 0;
    deadline_ns_ += (skipped + 1) * period_ns_;
    return {lateness_ns, static_cast<std::uint64_t>(skipped)};
  }

 private:
  std::int64_t period_ns_;
  std::int64_t deadline_ns_;
};

/// Ticks `core` once in `commands` points of a grid, and lets it repeat its command in between. Grid points
/// that were passed while this thread was late count as the core's own when they are.
template <class Core>
class FinerGrid {
 public:
  FinerGrid(Core& core, int commands, std::int64_t cycle_ns) noexcept
      : core_(core), commands_(commands), cycle_ns_(cycle_ns) {}

  CLAMPD_REALTIME void tick(std::int64_t now_ns, std::int64_t lateness_ns,
                            std::uint64_t skipped_points) noexcept {
    const std::int64_t deadline = points_ + 1;  // that was slept for, counted from the core's last one
    points_ = deadline + static_cast<std::int64_t>(skipped_points);
    if (points_ < commands_) {
      core_.between(now_ns);
      return;
    }
    const std::int64_t late_ns = lateness_ns - (commands_ - deadline) * cycle_ns_;
    const auto missed = static_cast<std::uint64_t>(points_ / commands_ - 1);
    points_ %= commands_;
    core_.tick(now_ns, late_ns, missed);
  }
  CLAMPD_REALTIME void shutdown(std::int64_t now_ns) noexcept { core_.shutdown(now_ns); }

 private:
  Core& core_;
  std::int64_t commands_;
  std::int64_t cycle_ns_;
  std::int64_t points_ = 0;  ///< passed since the core's last one
};

/// How the loop has kept time since it started. Written by the loop, readable by all.
struct LoopStatistics {
  DurationHistogram lateness;             ///< wake-up after the deadline
  DurationHistogram run_time;             ///< of the work in each tick
  std::atomic<std::uint64_t> skipped{0};  ///< whole periods
};

/// Calls work.tick(now, lateness, skipped) on the grid until `stop`, then work.shutdown(now) once.
/// `Clock` offers now_ns() and wait_until(deadline_ns), which may return early or late.
template <class Clock, class Work>
CLAMPD_REALTIME void run_cyclic(Clock& clock, Work& work, const std::atomic<bool>& stop,
                                LoopStatistics& statistics, std::int64_t period_ns = kPeriod_ns) noexcept {
  TickGrid grid(clock.now_ns(), period_ns);
  while (!stop.load(std::memory_order_acquire)) {
    std::int64_t now_ns = clock.now_ns();
    while (now_ns < grid.deadline_ns()) {
      clock.wait_until(grid.deadline_ns());
      now_ns = clock.now_ns();
    }
    const TickGrid::Wake wake = grid.woke(now_ns);
    statistics.lateness.record(wake.lateness_ns);
    statistics.skipped.store(statistics.skipped.load(std::memory_order_relaxed) + wake.skipped_periods,
                             std::memory_order_relaxed);
    work.tick(now_ns, wake.lateness_ns, wake.skipped_periods);
    statistics.run_time.record(clock.now_ns() - now_ns);
  }
  work.shutdown(clock.now_ns());
}

}  // namespace clampd::rt
