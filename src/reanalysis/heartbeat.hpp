#pragma once

#include <atomic>
#include <chrono>
#include <thread>

#include "src/reanalysis/queue.hpp"

namespace clampd::reanalysis {

/// Renews the lease of a claim while it exists, from a thread and by a connection of its own. While the
/// server does not answer it tries again at each beat; whether the lease outlived that, the server knows.
class Heartbeat {
 public:
  Heartbeat(const publish::PostgresqlSettings& settings, Claim claim, std::chrono::seconds lease)
      : queue_(settings), claim_(std::move(claim)), lease_(lease), thread_([this] { beat(); }) {}
  ~Heartbeat() {
    wake_.stop();
    thread_.join();
  }
  Heartbeat(const Heartbeat&) = delete;
  Heartbeat& operator=(const Heartbeat&) = delete;

  /// The claim is somebody else's by now, or cancelled.
  bool lost() const { return lost_; }

 private:
  void beat() {
    bool open = false;
    while (!lost_) {
      wake_.wait(std::chrono::milliseconds(lease_) / 3);
      if (wake_.stopped()) return;
      if (!open) open = queue_.open(wake_).has_value();
      if (!open) continue;
      const Result<Written> renewed = queue_.renew(claim_, lease_);
      if (!renewed) open = false;
      if (renewed && *renewed == Written::Lost) lost_ = true;
    }
  }

  Queue queue_;
  const Claim claim_;
  const std::chrono::seconds lease_;
  publish::WakeEvent wake_;
  std::atomic<bool> lost_{false};
  std::thread thread_;  ///< last: it uses all of the above
};

}  // namespace clampd::reanalysis
