#pragma once

#include <sys/types.h>

#include <atomic>
#include <cstdint>
#include <memory>

#include "clampd/base/result.hpp"
#include "clampd/ports/interlocks.hpp"
#include "drivers/gpio/lines.hpp"

namespace clampd::gpio {

enum class RelayState : std::uint8_t { Off, On, Lost };

/// What station and guard share: memory that survives neither but is read by both.
struct GuardedMemory {
  explicit GuardedMemory(std::int64_t lost_after_ns) noexcept : board(lost_after_ns) {}

  InterlockBoard board;
  std::atomic<std::int64_t> guard_beat_ns{0};
  std::atomic<RelayState> relay{RelayState::Off};
  std::atomic<int> relay_error{0};  ///< errno of the last loss
};

struct UnmapGuardedMemory {
  void operator()(GuardedMemory* memory) const noexcept;
};
using SharedMemory = std::unique_ptr<GuardedMemory, UnmapGuardedMemory>;
/// Anonymous memory that a process forked later shares.
Result<SharedMemory> share_memory(std::int64_t lost_after_ns);

/// Holds the enable relay in a process of its own, so that it also drops when the station's process is killed
/// or stopped as a whole: no thread of it could do that. It looks at the loop's beat every 2 ms.
class RelayGuard {
 public:
  struct Settings {
    LineSettings line;
    std::int64_t watchdog_ns = 0;  ///< the relay drops when the tick counter stood still for this long
    int priority = 0;  ///< of SCHED_FIFO, above the loop's: a loop that spins must not keep it out
  };

  /// Forks: before any thread, file or socket of the station. Errors: those of Line::open_output(), no right
  /// to the priority. `memory` must outlive this.
  static Result<std::unique_ptr<RelayGuard>> start(const Settings& settings, GuardedMemory& memory);
  /// The relay drops, the guard ends.
  ~RelayGuard();
  RelayGuard(const RelayGuard&) = delete;
  RelayGuard& operator=(const RelayGuard&) = delete;

  /// The guard's process is no more; its line may still have the level that it had.
  bool ended() noexcept;

 private:
  RelayGuard(pid_t process, int lifeline) noexcept : process_(process), lifeline_(lifeline) {}

  pid_t process_;
  bool ended_ = false;
  int lifeline_;  ///< its end tells the guard that the station is gone
};

}  // namespace clampd::gpio
