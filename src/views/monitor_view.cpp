#include "clampd/views/monitor_view.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>

namespace clampd {
namespace {

using attribution::ChangeDetector;
using attribution::LineMonitor;
using attribution::MonitorCount;
using attribution::ParameterMonitor;
using attribution::StationMonitor;
using nlohmann::ordered_json;

std::string day_text(double seconds) {
  return fmt::format("{:%Y-%m-%d}", fmt::gmtime(static_cast<std::time_t>(seconds)));
}

/// A station is watched in a parameter as soon as its readings allow a residual.
bool is_watched(const StationMonitor& station) {
  return station.detector.state().readings >= 3;
}

std::string sentence(const std::string& station, const ParameterMonitor& parameter,
                     const attribution::Alarm& alarm, double threshold) {
  return fmt::format(
      "ALARM {0}/{1}: station {0}: {1} changed by {2:+.3g} ± {3:.2g} {4} about {5}; raised by the checks of "
      "{6}, "
      "evidence {7:.3g} of {8:.3g}\n",
      station, parameter.name, alarm.change.size, 1.96 * alarm.change.sd, parameter.unit,
      day_text(alarm.change.time_s), day_text(alarm.raised_s - attribution::kDay_s), alarm.evidence,
      threshold);
}

}  // namespace

std::string format_monitor(const LineMonitor& line, const MonitorCount& count) {
  std::string text = fmt::format("{} checks counted", count.counted);
  for (const auto& [number, what] :
       {std::pair(count.before, "of days that were counted before"),
        std::pair(count.late, "came too late: their day was counted without them"),
        std::pair(count.waiting, "of the last day wait until a later day has checks"),
        std::pair(count.repeated, "of brakes that were checked before"),
        std::pair(count.alone, "of batches that no other station checked that day")})
    if (number > 0) text += fmt::format(", {} {}", number, what);
  text += line.last_day < 0 ? "\n"
                            : fmt::format("; up to {}\n",
                                          day_text(static_cast<double>(line.last_day) * attribution::kDay_s));
  std::size_t alarms = 0, watched = 0;
  for (const ParameterMonitor& parameter : line.parameters)
    for (std::size_t s = 0; s < parameter.stations.size(); ++s) {
      const StationMonitor& station = parameter.stations[s];
      if (station.alarm) {
        text += sentence(line.stations[s], parameter, *station.alarm, line.threshold());
        ++alarms;
      } else if (is_watched(station)) {
        ++watched;
      }
    }
  const std::size_t all = line.stations.size() * line.parameters.size();
  text +=
      fmt::format("{} of {} pairs of a station and a parameter are quiet, {} in alarm, {} not yet watched.\n",
                  watched, all, alarms, all - watched - alarms);
  text += fmt::format("Without any change, at most {:g} alarms a year are raised on average.\n",
                      line.false_alarms_per_year);
  if (alarms > 0 && line.stations.size() == 2)
    text += "Of two stations the checks do not tell which one changed.\n";
  if (alarms > 0)
    text += "When a cause was mended: clampctl line monitor --state FILE --acknowledge STATION/PARAMETER\n";
  return text;
}

ordered_json monitor_json(const LineMonitor& line, const MonitorCount& count) {
  ordered_json result{
      {"schema", "clampd.line_monitor/1"},
      {"false_alarms_per_year", line.false_alarms_per_year},
      {"part_number", line.part_number},
      {"last_day", line.last_day < 0
                       ? ordered_json()
                       : ordered_json(day_text(static_cast<double>(line.last_day) * attribution::kDay_s))},
      {"checks",
       {{"counted", count.counted},
        {"before", count.before},
        {"late", count.late},
        {"waiting", count.waiting},
        {"repeated", count.repeated},
        {"alone", count.alone}}},
      {"threshold", line.threshold()},
      {"monitored", ordered_json::array()}};
  for (const ParameterMonitor& parameter : line.parameters)
    for (std::size_t s = 0; s < parameter.stations.size(); ++s) {
      const StationMonitor& station = parameter.stations[s];
      ordered_json entry{{"station", line.stations[s]},
                         {"parameter", parameter.name},
                         {"unit", parameter.unit},
                         {"state", station.alarm         ? "alarm"
                                   : is_watched(station) ? "quiet"
                                                         : "learning"},
                         {"readings", station.detector.state().readings},
                         {"evidence", station.alarm ? station.alarm->evidence : station.detector.evidence()}};
      if (station.alarm) {
        entry["raised"] = day_text(station.alarm->raised_s - attribution::kDay_s);
        entry["changed"] = day_text(station.alarm->change.time_s);
        entry["size"] = station.alarm->change.size;
        entry["sd"] = station.alarm->change.sd;
      }
      result["monitored"].push_back(std::move(entry));
    }
  return result;
}

}  // namespace clampd
