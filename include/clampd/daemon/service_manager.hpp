#pragma once

#include <cstdint>
#include <string>

#include "clampd/base/result.hpp"

namespace clampd::daemon {

/// When to tell the service manager's watchdog that the station lives: only while the loop's ticks move on.
class WatchdogFeed {
 public:
  /// `timeout_ns`: after so long without food the manager restarts the station; 0: nobody watches.
  explicit WatchdogFeed(std::int64_t timeout_ns) noexcept : period_ns_(timeout_ns / 4) {}

  /// True four times per timeout, and only if `ticks` is another than when it was true before.
  bool due(std::uint64_t ticks, std::int64_t now_ns) noexcept;

 private:
  std::int64_t period_ns_;
  std::uint64_t fed_ticks_ = 0;
  std::int64_t fed_ns_ = 0;
};

/// What systemd is told of the station, and what it hands over; without systemd nothing happens. For one
/// ordinary thread: what it is asked for every few milliseconds is as alive as that thread.
class ServiceManager {
 public:
  ServiceManager();

  /// The listening socket of clampd.socket, for ControlServer::start(); -1: there is none. Errors: it is
  /// several, no listening TCP socket, or on another address or port than the configuration's, where clients
  /// would not look for it.
  static Result<int> inherited_socket(const std::string& address, int port);

  /// The station is ready once the loop ticks; from then on it is watched. `headline` is what `systemctl
  /// status` shows.
  void round(std::uint64_t ticks, const std::string& headline, std::int64_t now_ns);

  /// The loop ends on purpose: only the manager's stop time-out counts now.
  void stopping();

 private:
  WatchdogFeed feed_;
  bool ready_ = false;
  bool stopping_ = false;
  std::string headline_;
};

/// True if standard error goes to systemd's journal.
bool logs_to_journal();

}  // namespace clampd::daemon
