#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include <pthread.h>

#include "clampd/base/clock.hpp"
#include "clampd/base/result.hpp"
#include "rt/cyclic_loop.hpp"

namespace clampd::rt {

struct CyclicThreadSettings {
  int priority = 80;        ///< SCHED_FIFO 1..99; 0 runs as SCHED_OTHER, for development only
  int cpu = -1;             ///< the core to run on, -1 for any
  bool lock_memory = true;  ///< mlockall for the whole process, so that no page fault ever meets the loop
  std::int64_t period_ns = kPeriod_ns;

  Result<void> validate() const;
};

/// Runs a tick once a period on a thread of its own, on an absolute grid of CLOCK_MONOTONIC.
class CyclicThread {
 public:
  CyclicThread() = default;
  ~CyclicThread() { stop(); }
  CyclicThread(const CyclicThread&) = delete;
  CyclicThread& operator=(const CyclicThread&) = delete;

  /// Starts the loop. `work` has tick(now_ns, lateness_ns, skipped_periods) noexcept and shutdown(now_ns)
  /// noexcept and must outlive it. Errors (no right to SCHED_FIFO or to lock memory, no such core) name what
  /// to change.
  template <class Work>
  Result<void> start(const CyclicThreadSettings& settings, Work& work) {
    static_assert(noexcept(work.tick(0, 0, 0))&& noexcept(work.shutdown(0)));
    return start(settings, Target{&work,
                                  [](void* object, std::int64_t now_ns, std::int64_t lateness_ns,
                                     std::uint64_t skipped_periods) noexcept {
                                    static_cast<Work*>(object)->tick(now_ns, lateness_ns, skipped_periods);
                                  },
                                  [](void* object, std::int64_t now_ns) noexcept {
                                    static_cast<Work*>(object)->shutdown(now_ns);
                                  }});
  }

  /// Ends the loop after its present tick; its last act is work.shutdown(). Returns when the thread has
  /// ended.
  void stop() noexcept;

  bool running() const noexcept { return running_; }
  const LoopStatistics& statistics() const noexcept { return *statistics_; }

 private:
  struct Target {
    void* object;
    void (*tick_function)(void*, std::int64_t, std::int64_t, std::uint64_t) noexcept;
    void (*shutdown_function)(void*, std::int64_t) noexcept;

    void tick(std::int64_t now_ns, std::int64_t lateness_ns, std::uint64_t skipped_periods) const noexcept {
      tick_function(object, now_ns, lateness_ns, skipped_periods);
    }
    void shutdown(std::int64_t now_ns) const noexcept { shutdown_function(object, now_ns); }
  };

  Result<void> start(const CyclicThreadSettings& settings, const Target& target);
  static void* enter(void* self) noexcept;

  Target target_{};
  std::int64_t period_ns_ = kPeriod_ns;
  std::unique_ptr<LoopStatistics> statistics_ = std::make_unique<LoopStatistics>();
  std::atomic<bool> stop_{false};
  pthread_t thread_{};
  bool running_ = false;
  int dma_latency_file_ = -1;
};

}  // namespace clampd::rt
