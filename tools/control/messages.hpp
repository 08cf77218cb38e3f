#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "clampd/base/result.hpp"
#include "clampd/station/session.hpp"

namespace clampd {

NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(CheckRequest, serial, repeats, operator_name, part_number,
                                                batch)

}  // namespace clampd

namespace clampd::control {

// What goes over the control API (HTTP on the loopback interface, JSON bodies):
//   GET  /v1/status          StationStatus
//   POST /v1/checks          CheckRequest -> {"check": number}; 409 while the station is not IDLE
//   POST /v1/next            CheckRequest that the panel's start button starts
//   GET  /v1/checks/current  CheckProgress; ?colour=1 for a table with ANSI colours
//   POST /v1/stop            operator stop
//   POST /v1/clear           clears a fault whose cause is gone; 409 with the reason if it is not
//   GET  /v1/results         query: serial, part_number, batch, operator, verdict, since, until, limit
//   GET  /v1/results/{id}    clampd.check/1
//   GET  /v1/results/{id}/runs/{number}  readings of one run, number from 0
//   GET  /v1/statistics      clampd.statistics/1; query: limit, of the newest checks
//   GET  /v1/reference       what every run should follow: period_s, force_N, velocity_rad_s, torque_Nm
//   GET  /v1/live            the run under way or the last one; query: run, row to go on from there
//   GET  /v1/session         {"token_needed", "may_command"}: what whoever asks may do
//   GET  /                   the screen, for a browser
// Whatever moves or stops the brake needs "Authorization: Bearer TOKEN"; the daemon writes the token into the
// file named in its configuration when it starts, unless one of an earlier start is there. The screen gets it
// from the fragment of the address that `clampctl screen` prints, and keeps it in its tab's session storage:
// other than a cookie, that is not sent by itself, so that no other page can use it, nor to other ports of
// this host. Every request must name this host (an IP address, localhost or the host's name), so that a page
// of another site cannot reach the station through a name that it makes point here; pages of other origins
// are refused, and so are bodies other than JSON, in chunks, or larger than 64 KiB, and requests that take
// longer than 2 s.

/// A line of the operator's panel.
struct PanelLine {
  std::string line;   ///< "gpiochip0 line 4 (emergency stop)"
  std::string role;   ///< "emergency stop"
  std::string state;  ///< closed, open, on, off or lost
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(PanelLine, line, role, state)

/// Where the station publishes its checks.
struct PublishingChannel {
  std::string channel;  ///< mqtt or postgresql
  std::string where;    ///< its host and port
  bool connected = false;
  std::size_t pending = 0;    ///< checks that wait; they are safe in the station's database
  double oldest_age_s = 0.0;  ///< how long the oldest of them waits
  std::string error;          ///< what is wrong and what to do; empty: nothing
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(PublishingChannel, channel, where, connected, pending,
                                                oldest_age_s, error)

/// What the station is doing now.
struct StationStatus {
  std::string station;
  std::string version;
  std::string state;        ///< INIT, IDLE, ...
  std::string fault;        ///< "none" or the cause's name
  std::string fault_text;   ///< what it means and what to do
  std::string fault_state;  ///< the state that it came in; empty: no fault
  bool clearable = false;
  std::string phase;
  std::uint32_t repeat = 0;
  std::uint32_t repeats = 0;
  std::string serial;  ///< of the check in progress or the last one
  std::string last_verdict;
  std::uint64_t check = 0;  ///< its number since the daemon started; 0: there was none
  bool judging = false;     ///< the brake is done, the verdict is being made
  std::uint64_t ticks = 0;
  std::uint64_t skipped = 0;
  double lateness_avg_us = 0.0;
  double lateness_max_us = 0.0;
  double force_N = 0.0;
  double velocity_rad_s = 0.0;
  double torque_Nm = 0.0;
  std::string interface;
  std::string link;
  double bus_load = 0.0;
  bool simulated = false;
  bool realtime = false;
  std::string next_serial;       ///< what the start button checks; empty: none is known
  std::string notice;            ///< why the start button did nothing, last time
  std::vector<PanelLine> panel;  ///< empty: the station has none
  std::string master;            ///< what the master brake asks for; empty: nothing
  std::string storage;           ///< why the last result is not on record; empty: it is
  std::string clock;             ///< that it was set since the last check began; empty: it was not
  std::vector<PublishingChannel> publishing;  ///< empty: nothing is published
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(StationStatus, station, version, state, fault, fault_text,
                                                fault_state, clearable, phase, repeat, repeats, serial,
                                                last_verdict, ticks, skipped, lateness_avg_us,
                                                lateness_max_us, force_N, velocity_rad_s, torque_Nm,
                                                interface, link, bus_load, simulated, realtime, next_serial,
                                                notice, panel, master, storage, clock, check, judging,
                                                publishing)

/// Where a check stands; `record` is the finished clampd.check/1 document, null until then, and `table` the
/// same as a technician reads it.
struct CheckProgress {
  std::uint64_t check = 0;
  bool finished = false;
  std::string phase;
  std::uint32_t repeat = 0;
  std::uint32_t repeats = 0;
  nlohmann::ordered_json record;
  std::string table;
};

/// The station's half of the conversation, from a program that talks to the daemon.
class Client {
 public:
  Client(std::string address, int port, std::string token_file);

  Result<StationStatus> status() const;
  Result<std::uint64_t> start(const CheckRequest& request) const;
  Result<void> next(const CheckRequest& request) const;
  Result<CheckProgress> progress(bool colour) const;
  Result<void> stop() const;
  Result<void> clear() const;

 private:
  Result<nlohmann::ordered_json> exchange(const std::string& method, const std::string& path,
                                          const nlohmann::ordered_json& body) const;

  std::string address_;
  int port_;
  std::string token_file_;
};

}  // namespace clampd::control
