#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "clampd/views/monitor_view.hpp"

namespace clampd {
namespace {

using attribution::ChangeDetector;
using attribution::LineMonitor;
using attribution::ParameterMonitor;
using attribution::StationMonitor;
using nlohmann::ordered_json;

constexpr const char* kSchema = "clampd.line_monitor_state/1";

ordered_json matrix_json(const Eigen::MatrixXd& matrix) {
  ordered_json rows = ordered_json::array();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    ordered_json row = ordered_json::array();
    for (Eigen::Index k = 0; k < matrix.cols(); ++k) row.push_back(matrix(i, k));
    rows.push_back(std::move(row));
  }
  return rows;
}

Eigen::MatrixXd matrix_of(const ordered_json& rows, std::size_t size) {
  const auto n = static_cast<Eigen::Index>(size);
  Eigen::MatrixXd matrix(n, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index k = 0; k < n; ++k)
      matrix(i, k) = rows.at(static_cast<std::size_t>(i)).at(static_cast<std::size_t>(k)).get<double>();
  return matrix;
}

ordered_json detector_json(const ChangeDetector::State& state) {
  ordered_json starts = ordered_json::array();
  for (const ChangeDetector::Start& start : state.starts)
    starts.push_back({start.time_s, start.information, start.mean, start.score, start.weight});
  return {{"readings", state.readings}, {"information", state.information},
          {"mean", state.mean},         {"squares", state.squares},
          {"score", state.score},       {"weight", state.weight},
          {"starts", std::move(starts)}};
}

ChangeDetector::State detector_of(const ordered_json& json) {
  ChangeDetector::State state;
  state.readings = json.at("readings").get<std::size_t>();
  state.information = json.at("information").get<double>();
  state.mean = json.at("mean").get<double>();
  state.squares = json.at("squares").get<double>();
  state.score = json.at("score").get<double>();
  state.weight = json.at("weight").get<double>();
  for (const ordered_json& start : json.at("starts"))
    state.starts.push_back({start.at(0).get<double>(), start.at(1).get<double>(), start.at(2).get<double>(),
                            start.at(3).get<double>(), start.at(4).get<double>()});
  return state;
}

ordered_json station_json(const StationMonitor& station) {
  ordered_json alarm;
  if (station.alarm)
    alarm = {{"raised_s", station.alarm->raised_s},
             {"changed_s", station.alarm->change.time_s},
             {"size", station.alarm->change.size},
             {"sd", station.alarm->change.sd},
             {"evidence", station.alarm->evidence}};
  return {{"level", station.level},
          {"days", station.days},
          {"pending", {station.pending_information, station.pending_sum}},
          {"usual_variance", station.usual_variance},
          {"spread", {station.information, station.squared_information, station.mean, station.squares}},
          {"detector", detector_json(station.detector.state())},
          {"alarm", std::move(alarm)}};
}

StationMonitor station_of(const ordered_json& json) {
  StationMonitor station;
  station.level = json.at("level").get<double>();
  station.days = json.at("days").get<int>();
  station.pending_information = json.at("pending").at(0).get<double>();
  station.pending_sum = json.at("pending").at(1).get<double>();
  station.usual_variance = json.at("usual_variance").get<double>();
  station.information = json.at("spread").at(0).get<double>();
  station.squared_information = json.at("spread").at(1).get<double>();
  station.mean = json.at("spread").at(2).get<double>();
  station.squares = json.at("spread").at(3).get<double>();
  station.detector = ChangeDetector(detector_of(json.at("detector")));
  if (const ordered_json& alarm = json.at("alarm"); !alarm.is_null())
    station.alarm = attribution::Alarm{
        alarm.at("raised_s").get<double>(),
        {alarm.at("changed_s").get<double>(), alarm.at("size").get<double>(), alarm.at("sd").get<double>()},
        alarm.at("evidence").get<double>()};
  return station;
}

LineMonitor line_of(const ordered_json& json) {
  LineMonitor line;
  line.false_alarms_per_year = json.at("false_alarms_per_year").get<double>();
  line.part_number = json.at("part_number").get<std::string>();
  line.stations = json.at("stations").get<std::vector<std::string>>();
  line.last_s = json.at("last_s").get<std::vector<double>>();
  line.last_day = json.at("last_day").get<std::int64_t>();
  line.brakes_day = json.at("brakes_day").get<std::map<std::string, std::int64_t>>();
  for (const ordered_json& entry : json.at("parameters")) {
    ParameterMonitor parameter{entry.at("name").get<std::string>(),
                               entry.at("unit").get<std::string>(),
                               entry.at("within").at(0).get<double>(),
                               entry.at("within").at(1).get<double>(),
                               matrix_of(entry.at("comparisons"), line.stations.size()),
                               matrix_of(entry.at("differences"), line.stations.size()),
                               {}};
    for (const ordered_json& station : entry.at("stations"))
      parameter.stations.push_back(station_of(station));
    line.parameters.push_back(std::move(parameter));
  }
  return line;
}

/// What JSON of the right shape may still say and no monitor can have.
bool is_possible(const LineMonitor& line) {
  if (!(line.false_alarms_per_year > 0.0) || line.last_s.size() != line.stations.size()) return false;
  return std::all_of(line.parameters.begin(), line.parameters.end(), [&](const ParameterMonitor& parameter) {
    if (parameter.stations.size() != line.stations.size() || !(parameter.within_squares >= 0.0) ||
        (parameter.comparisons.array() < 0.0).any() ||
        parameter.comparisons != parameter.comparisons.transpose())
      return false;
    return std::all_of(
        parameter.stations.begin(), parameter.stations.end(), [](const StationMonitor& station) {
          const ChangeDetector::State& state = station.detector.state();
          const std::size_t starts =
              std::min(ChangeDetector::kMostStarts, std::max<std::size_t>(state.readings, 2) - 2);
          return station.days >= 0 && state.readings <= static_cast<std::size_t>(station.days) &&
                 station.pending_information >= 0.0 && station.usual_variance >= 0.0 &&
                 station.information >= 0.0 && station.squares >= 0.0 && state.squares >= 0.0 &&
                 (state.readings == 0 || state.information > 0.0) && state.starts.size() <= starts &&
                 std::all_of(state.starts.begin(), state.starts.end(),
                             [&](const ChangeDetector::Start& start) {
                               return start.information > 0.0 && start.information < state.information &&
                                      start.weight <= state.weight;
                             });
        });
  });
}

}  // namespace

ordered_json monitor_state_json(const LineMonitor& line) {
  ordered_json parameters = ordered_json::array();
  for (const ParameterMonitor& parameter : line.parameters) {
    ordered_json stations = ordered_json::array();
    for (const StationMonitor& station : parameter.stations) stations.push_back(station_json(station));
    parameters.push_back({{"name", parameter.name},
                          {"unit", parameter.unit},
                          {"within", {parameter.within_squares, parameter.within_degrees}},
                          {"comparisons", matrix_json(parameter.comparisons)},
                          {"differences", matrix_json(parameter.differences)},
                          {"stations", std::move(stations)}});
  }
  return {{"schema", kSchema},
          {"false_alarms_per_year", line.false_alarms_per_year},
          {"part_number", line.part_number},
          {"stations", line.stations},
          {"last_s", line.last_s},
          {"last_day", line.last_day},
          {"brakes_day", ordered_json(line.brakes_day)},
          {"parameters", std::move(parameters)}};
}

Result<LineMonitor> parse_monitor_state(const std::string& text, const std::string& file) {
  const auto damaged = [&](const std::string& why) {
    return failure(fmt::format(
        "{}: is damaged ({}): take the copy of a backup, or name a new state file to begin anew", file, why));
  };
  const ordered_json json = ordered_json::parse(text, nullptr, false);
  if (json.is_discarded() || !json.is_object()) return damaged("it is no JSON object");
  const auto schema = json.find("schema");
  if (schema == json.end() || *schema != kSchema)
    return failure(
        fmt::format("{}: is of the format {}, this version reads {}: name another state file, or use the "
                    "version that wrote it",
                    file, schema == json.end() ? "of something else" : schema->dump(), kSchema));
  try {
    LineMonitor line = line_of(json);
    if (!is_possible(line)) return damaged("it holds values that no monitor can have");
    // What is not written the same again has keys or values that would be lost.
    if (nlohmann::json(monitor_state_json(line)) != nlohmann::json(json))
      return damaged("it has unknown keys or values");
    return line;
  } catch (const nlohmann::json::exception& error) {
    return damaged(error.what());
  }
}

}  // namespace clampd
