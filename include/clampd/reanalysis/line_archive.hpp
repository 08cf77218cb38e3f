#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/publish/wake_event.hpp"
#include "clampd/reanalysis/jobs.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd::reanalysis {

/// So many equal periods, of which the last one has begun and not ended.
struct LineSpan {
  int days = 0;
  double period_s = 0.0;
  int periods = 0;

  /// Start of the first period, seconds since 1970; periods begin at whole multiples of their length.
  double since_s(double now_s) const;
};
inline constexpr std::array kLineSpans{LineSpan{1, 3600.0, 24}, LineSpan{7, 6 * 3600.0, 28},
                                       LineSpan{30, 86'400.0, 30}, LineSpan{90, 3 * 86'400.0, 30},
                                       LineSpan{365, 7 * 86'400.0, 53}};

struct LineQuestion {
  LineSpan span = kLineSpans[2];
  std::optional<std::string> part_number = {};  ///< nothing: the one with the most checks in the span
  std::size_t most_checks = 20'000;             ///< the newest ones
  std::size_t most_stations = 100;              ///< those whose last check is the newest
};

/// The last check of a station, however long ago.
struct LastCheck {
  std::string station;
  double started_s = 0.0;  ///< seconds since 1970
  std::string serial;
  std::string part_number;
  Verdict verdict = Verdict::Error;
  std::string reason;
};

/// A check as it is counted.
struct ListedCheck {
  double started_s = 0.0;  ///< seconds since 1970
  std::string station;
  std::string part_number;
  Verdict verdict = Verdict::Error;
  bool simulated = false;
};

/// A check of the chosen part number that says something about its brake. All parameters are in the order
/// and the units of kParameterTable.
struct MeasuredCheck {
  double started_s = 0.0;  ///< seconds since 1970
  std::string station;
  std::string fixture;
  std::string serial;
  std::string batch;
  bool simulated = false;
  std::array<std::pair<double, double>, kParameterCount> readings;  ///< value and its standard deviation
  std::array<std::pair<double, double>, kParameterCount> limits;    ///< infinite: there is none
};

/// A task that a worker has taken and not ended.
struct HeldClaim {
  std::string worker;
  std::int64_t job = 0;
  std::string job_name;
  std::string check;
  std::string serial;
  double claimed_s = 0.0;  ///< seconds since 1970
  int attempts = 0;
  bool alive = false;  ///< its lease has not ended
};

/// What the archive says of the line, all at one moment but for the jobs.
struct LineRows {
  std::string where;   ///< the database
  double now_s = 0.0;  ///< by the server's clock, seconds since 1970
  LineSpan span;
  std::vector<LastCheck> stations;      ///< the newest first
  bool more_stations = false;           ///< there are others, which were not read
  std::vector<ListedCheck> checks;      ///< of the span, the newest first
  bool more_checks = false;             ///< the span has older ones, which were not read
  std::string part_number;              ///< the chosen one
  std::vector<MeasuredCheck> measured;  ///< the newest first
  bool more_measured = false;
  std::vector<HeldClaim> claims;  ///< the oldest first
  std::vector<JobStatus> jobs;    ///< the newest first, ten at most
};

/// Reads it over a connection of its own, which it closes again; needs the right to SELECT and writes
/// nothing. Errors: no connection, an older or newer schema, missing rights, no answer within ten seconds;
/// they say what to do. Gives up connecting when the wake stops.
Result<LineRows> read_line(const publish::PostgresqlSettings& settings, const LineQuestion& question,
                           const publish::WakeEvent& wake);

}  // namespace clampd::reanalysis
