#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace clampd::rt {

enum class ReadinessStatus : std::uint8_t { Ok, Warn, Fail };
std::string_view to_string(ReadinessStatus status) noexcept;  ///< "ok", "warn", "fail"

/// One fact about this machine's fitness for a 1 kHz loop.
struct ReadinessFact {
  std::string name;  ///< e.g. "kernel preemption"
  ReadinessStatus status = ReadinessStatus::Ok;
  std::string found;   ///< what is the case
  std::string advice;  ///< what to change; empty if nothing
};

struct ReadinessOptions {
  int priority = 80;                ///< SCHED_FIFO priority the station will ask for
  int cpu = -1;                     ///< the core it will run on, -1 for any
  std::int64_t jitter_test_ns = 0;  ///< how long to measure wake-up lateness; 0 leaves the measurement out
  std::string root;                 ///< put before /proc and /sys; for tests
};

/// Kernel, rights, scheduler, processor, timers and, if asked for, the measured lateness. Blocks for the
/// test's duration, changes nothing.
std::vector<ReadinessFact> examine_readiness(const ReadinessOptions& options);

}  // namespace clampd::rt
