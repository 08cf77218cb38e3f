#pragma once

#include <atomic>
#include <chrono>

namespace clampd::publish {

/// Wakes a thread that waits for it, or for a connection and for it (`descriptor` is readable once rung).
class WakeEvent {
 public:
  WakeEvent();
  ~WakeEvent();
  WakeEvent(const WakeEvent&) = delete;
  WakeEvent& operator=(const WakeEvent&) = delete;

  void ring() noexcept;
  /// Rings, and from now on every wait is over at once.
  void stop() noexcept;
  bool stopped() const noexcept { return stopped_; }

  int descriptor() const noexcept { return descriptor_; }
  /// Waits for a ring, or at most so long.
  void wait(std::chrono::milliseconds longest) noexcept;
  /// Forgets the rings so far.
  void silence() noexcept;

 private:
  int descriptor_;
  std::atomic<bool> stopped_{false};
};

/// The event of this process, which SIGTERM and SIGINT stop from the first call on; SIGPIPE is ignored then.
WakeEvent& stopped_by_signals();

}  // namespace clampd::publish
