#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "clampd/base/result.hpp"
#include "clampd/station/session.hpp"

namespace clampd::http {
struct Call;
}

namespace clampd::api {

// What goes over the control API, HTTP with JSON bodies: docs/api.md says it route by route.

/// A check request as the API takes it; what is empty or 0 is left out, so that the station's own holds.
nlohmann::ordered_json check_request_json(const CheckRequest& request);

/// Reads one strictly: an unknown key, a value of another type or out of range is an error that names it;
/// what is left out stays empty or 0. Blanks around texts are taken off, since a scanner or a keyboard adds
/// them.
Result<CheckRequest> parse_check_request(const std::string& body);

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
  std::uint32_t repeats = 0;  ///< planned, or allowed at most
  bool repeats_auto = false;  ///< the latter: fewer, if fewer decide every limit
  std::string serial;         ///< of the check in progress or the last one
  std::string part_number;    ///< of that check; empty: none is configured
  std::vector<std::string> part_numbers;  ///< that have a recipe; empty: the station has no recipes
  std::string last_verdict;
  std::uint64_t check = 0;      ///< its number since the daemon started; 0: there was none
  std::string id;               ///< of its record, unique; empty: there was none
  bool judging = false;         ///< the brake is done, the verdict is being made
  double cause_searched = 0.0;  ///< share of the search for a misfit's cause that is done; 0: none has begun
  std::uint64_t ticks = 0;
  std::uint64_t skipped = 0;
  double lateness_avg_us = 0.0;
  double lateness_max_us = 0.0;
  double force_N = 0.0;
  double velocity_rad_s = 0.0;
  double torque_Nm = 0.0;
  bool clamped = false;     ///< force stands on the brake though nothing drives it: `clampctl open`
  double clamped_N = 0.0;   ///< that force
  std::string open_id;      ///< the opening in progress or the last one; empty: there was none
  bool opening = false;     ///< it is in progress
  std::string open_result;  ///< what came of it: OPEN, ERROR, TIMEOUT or ABORTED; empty until then
  std::string open_reason;
  std::uint64_t stops = 0;        ///< operator stops since the daemon started
  std::uint64_t stops_taken = 0;  ///< those of them that have taken effect
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
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(
    StationStatus, station, version, state, fault, fault_text, fault_state, clearable, phase, repeat, repeats,
    serial, last_verdict, ticks, skipped, lateness_avg_us, lateness_max_us, force_N, velocity_rad_s,
    torque_Nm, interface, link, bus_load, simulated, realtime, next_serial, notice, panel, master, storage,
    clock, check, judging, publishing, cause_searched, id, clamped, clamped_N, open_id, opening, open_result,
    open_reason, stops, stops_taken, repeats_auto, part_number, part_numbers)

/// Where a check stands; `record` is the finished clampd.check/1 document, null until then, and `table` the
/// same as a technician reads it.
struct CheckProgress {
  std::uint64_t check = 0;
  std::string id;  ///< of the record
  bool finished = false;
  std::string phase;
  std::uint32_t repeat = 0;
  std::uint32_t repeats = 0;  ///< planned, or allowed at most
  bool repeats_auto = false;  ///< the latter: fewer, if fewer decide every limit
  nlohmann::ordered_json record;
  std::string table;
};

/// A check that was started. Its number begins at 1 with each start of the daemon, its id never comes again.
struct StartedCheck {
  std::uint64_t check = 0;
  std::string id;
};
nlohmann::ordered_json progress_json(const CheckProgress& progress);

/// The station's half of the conversation, from a program that talks to the daemon.
class Client {
 public:
  Client(std::string address, int port, std::string token_file);

  /// Errors after that time without an answer.
  Result<StationStatus> status(std::chrono::milliseconds within = std::chrono::seconds(5)) const;
  /// `stops_seen`: of a status that was read before; the start is refused if another stop came since.
  Result<StartedCheck> start(const CheckRequest& request,
                             std::optional<std::uint64_t> stops_seen = std::nullopt) const;
  /// Opens a brake that stays clamped: the opening's id, which the status follows.
  Result<std::string> open() const;
  Result<void> next(const CheckRequest& request) const;
  Result<CheckProgress> progress(bool colour) const;
  Result<void> stop() const;
  Result<void> clear() const;

 private:
  Result<std::string> token() const;
  Result<nlohmann::ordered_json> get(const std::string& path) const;
  Result<nlohmann::ordered_json> post(const std::string& path, const nlohmann::ordered_json& body) const;
  Result<nlohmann::ordered_json> exchange(http::Call call) const;

  std::string address_;
  int port_;
  std::string token_file_;
};

}  // namespace clampd::api
