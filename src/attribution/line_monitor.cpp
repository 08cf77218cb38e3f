#include "clampd/attribution/line_monitor.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include <fmt/format.h>

#include "clampd/statistics/median.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::attribution {
namespace {

constexpr double kDaysInYear = 365.25;

/// A reading has the information of so many brakes at least.
constexpr double kLeastInformation = 5.0;

/// Others are compared with a station once it was compared itself on so many days: its level is known then.
constexpr int kDaysOfReference = 10;

/// A spread from day to day is estimated from so many readings of a station.
constexpr std::size_t kReadingsForSpread = 5;

/// Checks of one batch on one day.
using Group = std::vector<std::size_t>;

std::int64_t day_of(double seconds) {
  return static_cast<std::int64_t>(std::floor(seconds / kDay_s));
}

void grow(LineMonitor& line, const LineTable& table) {
  for (const std::string& name : table.stations)
    if (std::find(line.stations.begin(), line.stations.end(), name) == line.stations.end()) {
      line.stations.push_back(name);
      line.last_s.push_back(0.0);
    }
  const auto count = static_cast<Eigen::Index>(line.stations.size());
  for (ParameterMonitor& parameter : line.parameters) {
    const Eigen::Index old = parameter.comparisons.rows();
    for (Eigen::MatrixXd* matrix : {&parameter.comparisons, &parameter.differences}) {
      Eigen::MatrixXd larger = Eigen::MatrixXd::Zero(count, count);
      larger.topLeftCorner(old, old) = *matrix;
      *matrix = std::move(larger);
    }
    parameter.stations.resize(line.stations.size());
  }
}

Result<void> match(LineMonitor& line, const LineTable& table) {
  if (line.parameters.empty()) {
    line.part_number = table.part_number;
    for (const ParameterReadings& readings : table.parameters)
      line.parameters.push_back({readings.name, readings.unit, 0.0, 0.0, {}, {}, {}});
  }
  if (line.part_number != table.part_number)
    return failure(
        fmt::format("the checks are of part number '{}', those that were counted before of '{}': keep a "
                    "state file for each",
                    table.part_number, line.part_number));
  const auto there = [&](const ParameterReadings& readings) {
    return std::any_of(line.parameters.begin(), line.parameters.end(), [&](const ParameterMonitor& known) {
      return known.name == readings.name && known.unit == readings.unit;
    });
  };
  if (line.parameters.size() != table.parameters.size() ||
      !std::all_of(table.parameters.begin(), table.parameters.end(), there))
    return failure(
        "the checks have other parameters or units than those that were counted before: begin a new state "
        "file");
  return {};
}

/// What one day says of one parameter.
struct DayOfParameter {
  Eigen::MatrixXd comparisons, differences;
};

/// Adds each pair of stations in the group: within a batch and a day, what they have in common cancels.
void compare(const Group& group, const std::vector<std::size_t>& station, const std::vector<double>& values,
             ParameterMonitor& parameter, DayOfParameter& day) {
  struct Sums {
    double count = 0.0, mean = 0.0;
  };
  std::map<std::size_t, Sums> of_station;
  for (const std::size_t check : group) {
    Sums& sums = of_station[station[check]];
    const double difference = values[check] - sums.mean;
    sums.count += 1.0;
    sums.mean += difference / sums.count;
    parameter.within_squares += difference * (values[check] - sums.mean);
    if (sums.count > 1.0) parameter.within_degrees += 1.0;
  }
  double all = 0.0;
  for (const auto& [number, sums] : of_station)
    if (!parameter.stations[number].alarm) all += sums.count;
  for (const auto& [a, of_a] : of_station)
    for (const auto& [b, of_b] : of_station) {
      if (a == b || parameter.stations[a].alarm || parameter.stations[b].alarm) continue;
      const double weight = of_a.count * of_b.count / all;
      const auto row = static_cast<Eigen::Index>(a), column = static_cast<Eigen::Index>(b);
      day.comparisons(row, column) += weight;
      day.differences(row, column) += weight * (of_a.mean - of_b.mean);
    }
}

/// The spread from day to day in variances of a brake: the median of the stations' own estimates, so that a
/// station that changed does not hide itself.
double day_to_day(const ParameterMonitor& parameter) {
  if (!(parameter.within_squares > 0.0)) return 0.0;
  const double variance = parameter.within_squares / parameter.within_degrees;
  std::vector<double> of_station;
  for (const StationMonitor& station : parameter.stations) {
    const auto readings = static_cast<double>(station.detector.state().readings);
    if (station.detector.state().readings < kReadingsForSpread) continue;
    const double excess = station.squares / variance - (readings - 1.0);
    of_station.push_back(
        std::max(0.0, excess / (station.information - station.squared_information / station.information)));
  }
  return statistics::median(of_station);
}

void add_reading(StationMonitor& station, double time_s, double spread) {
  const double information = station.pending_information;
  const double reading = station.pending_sum / information;
  station.pending_information = station.pending_sum = 0.0;
  const double variance = spread + 1.0 / information;
  if (!(station.usual_variance > 0.0)) station.usual_variance = 1.0 / information;
  station.detector.add(time_s, reading, variance / (spread + station.usual_variance));
  const double difference = reading - station.mean, before = station.information;
  station.information += information;
  station.squared_information += information * information;
  station.mean += difference * information / station.information;
  station.squares += difference * difference * information * before / station.information;
}

/// The station with the strongest evidence alone: what it differs by is seen in all that were compared with
/// it, with the other sign. Their evidence begins anew, without it in their comparisons.
void raise_alarm(ParameterMonitor& parameter, double time_s, double threshold) {
  StationMonitor* strongest = nullptr;
  double most = threshold;
  for (StationMonitor& station : parameter.stations) {
    if (station.alarm) continue;
    const double evidence = station.detector.evidence();
    if (evidence < most) continue;
    most = evidence;
    strongest = &station;
  }
  if (strongest == nullptr) return;
  strongest->alarm = Alarm{time_s + kDay_s, strongest->detector.change(), most};
  for (StationMonitor& station : parameter.stations)
    if (!station.alarm) station.detector.drop_evidence();
}

/// Levels by least squares over all comparisons, as a correction of the old ones that leaves alone what no
/// comparison tells (their common level), weighted by what is known of each.
void update_levels(ParameterMonitor& parameter) {
  const Eigen::VectorXd known = parameter.comparisons.rowwise().sum();
  Eigen::VectorXd level(known.size()), scale(known.size());
  for (Eigen::Index s = 0; s < known.size(); ++s) {
    level[s] = parameter.stations[static_cast<std::size_t>(s)].level;
    scale[s] = known[s] > 0.0 ? 1.0 / std::sqrt(known[s]) : 0.0;
  }
  const Eigen::VectorXd rest =
      parameter.differences.rowwise().sum() - known.cwiseProduct(level) + parameter.comparisons * level;
  Eigen::MatrixXd scaled = -(scale.asDiagonal() * parameter.comparisons * scale.asDiagonal());
  scaled.diagonal() = known.cwiseProduct(scale).cwiseProduct(scale);
  const statistics::Spectrum spectrum = statistics::spectrum_of(scaled);
  if (!spectrum.ok) return;
  Eigen::VectorXd along = spectrum.vectors.transpose() * scale.cwiseProduct(rest);
  for (Eigen::Index i = 0; i < along.size(); ++i)
    along[i] = spectrum.values[i] > 1e-9 ? along[i] / spectrum.values[i] : 0.0;
  level += scale.cwiseProduct(spectrum.vectors * along);
  for (Eigen::Index s = 0; s < known.size(); ++s)
    parameter.stations[static_cast<std::size_t>(s)].level = level[s];
}

void close_day(ParameterMonitor& parameter, const DayOfParameter& day, double time_s, double threshold) {
  const double spread = day_to_day(parameter);
  std::vector<bool> known;
  for (const StationMonitor& station : parameter.stations) known.push_back(station.days >= kDaysOfReference);
  for (std::size_t s = 0; s < parameter.stations.size(); ++s) {
    StationMonitor& station = parameter.stations[s];
    const auto row = static_cast<Eigen::Index>(s);
    if (station.alarm || !(day.comparisons.row(row).sum() > 0.0)) continue;
    ++station.days;
    for (std::size_t other = 0; other < known.size(); ++other) {
      if (!known[other]) continue;
      const double weight = day.comparisons(row, static_cast<Eigen::Index>(other));
      station.pending_information += weight;
      station.pending_sum +=
          day.differences(row, static_cast<Eigen::Index>(other)) + weight * parameter.stations[other].level;
    }
    if (station.pending_information >= kLeastInformation) add_reading(station, time_s, spread);
  }
  raise_alarm(parameter, time_s, threshold);
  parameter.comparisons += day.comparisons;
  parameter.differences += day.differences;
  update_levels(parameter);
}

/// Takes the checks of one day that are of brakes not seen before, by batch.
std::map<std::int32_t, Group> groups_of(LineMonitor& line, const LineTable& table, std::int64_t day,
                                        const std::vector<std::size_t>& checks, MonitorCount& count) {
  std::map<std::int32_t, Group> groups;
  for (const std::size_t check : checks) {
    const std::string& brake = table.brakes[static_cast<std::size_t>(table.layout.brake[check])];
    const auto [at, fresh] = line.brakes_day.try_emplace(brake, day);
    at->second = day;
    if (fresh)
      groups[table.layout.batch[check]].push_back(check);
    else
      ++count.repeated;
  }
  return groups;
}

void forget_brakes(LineMonitor& line) {
  if (line.brakes_day.size() <= 2 * LineMonitor::kMostBrakes) return;
  std::vector<std::int64_t> days;
  for (const auto& [brake, day] : line.brakes_day) days.push_back(day);
  const auto limit = days.end() - static_cast<std::ptrdiff_t>(LineMonitor::kMostBrakes);
  std::nth_element(days.begin(), limit, days.end());
  std::erase_if(line.brakes_day, [oldest = *limit](const auto& entry) { return entry.second < oldest; });
}

void count_day(LineMonitor& line, const LineTable& table, const std::vector<std::size_t>& number,
               const std::vector<std::size_t>& station, std::int64_t day,
               const std::vector<std::size_t>& checks, MonitorCount& count) {
  const auto groups = groups_of(line, table, day, checks, count);
  for (const auto& [batch, group] : groups) {
    const bool alone = std::all_of(group.begin(), group.end(), [&](std::size_t check) {
      return station[check] == station[group.front()];
    });
    (alone ? count.alone : count.counted) += group.size();
  }
  const auto stations = static_cast<Eigen::Index>(line.stations.size());
  const double time_s = static_cast<double>(day) * kDay_s;
  for (std::size_t p = 0; p < line.parameters.size(); ++p) {
    DayOfParameter today{Eigen::MatrixXd::Zero(stations, stations),
                         Eigen::MatrixXd::Zero(stations, stations)};
    for (const auto& [batch, group] : groups)
      compare(group, station, table.parameters[number[p]].values, line.parameters[p], today);
    close_day(line.parameters[p], today, time_s, line.threshold());
  }
  for (const std::size_t check : checks)
    line.last_s[station[check]] = std::max(line.last_s[station[check]], table.started_s[check]);
  line.last_day = day;
  forget_brakes(line);
}

}  // namespace

double LineMonitor::threshold() const {
  return static_cast<double>(stations.size() * parameters.size()) * kDaysInYear / false_alarms_per_year;
}

Result<MonitorCount> monitor(LineMonitor& line, const LineTable& table) {
  if (const Result<void> matched = match(line, table); !matched) return tl::unexpected(matched.error());
  grow(line, table);
  std::vector<std::size_t> number;
  for (const ParameterMonitor& parameter : line.parameters)
    number.push_back(static_cast<std::size_t>(
        std::find_if(table.parameters.begin(), table.parameters.end(),
                     [&](const ParameterReadings& readings) { return readings.name == parameter.name; }) -
        table.parameters.begin()));
  MonitorCount count;
  std::vector<std::size_t> of_table, station;
  for (const std::string& name : table.stations)
    of_table.push_back(static_cast<std::size_t>(std::find(line.stations.begin(), line.stations.end(), name) -
                                                line.stations.begin()));
  for (const std::int32_t s : table.layout.station) station.push_back(of_table[static_cast<std::size_t>(s)]);
  std::vector<std::size_t> order(table.checks());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return table.started_s[a] < table.started_s[b]; });
  for (std::size_t begin = 0; begin < order.size();) {
    const std::int64_t day = day_of(table.started_s[order[begin]]);
    std::size_t end = begin;
    while (end < order.size() && day_of(table.started_s[order[end]]) == day) ++end;
    const std::vector<std::size_t> checks(order.begin() + static_cast<std::ptrdiff_t>(begin),
                                          order.begin() + static_cast<std::ptrdiff_t>(end));
    begin = end;
    if (day <= line.last_day) {
      for (const std::size_t check : checks)
        ++(table.started_s[check] > line.last_s[station[check]] ? count.late : count.before);
    } else if (end == order.size()) {
      count.waiting = checks.size();
    } else {
      count_day(line, table, number, station, day, checks, count);
    }
  }
  return count;
}

Result<void> acknowledge(LineMonitor& line, const std::string& station, const std::string& parameter) {
  const auto s = std::find(line.stations.begin(), line.stations.end(), station);
  const auto p = std::find_if(line.parameters.begin(), line.parameters.end(),
                              [&](const ParameterMonitor& known) { return known.name == parameter; });
  if (s == line.stations.end() || p == line.parameters.end())
    return failure(fmt::format(
        "{}/{}: there is no such {}; the state file has the stations {} and the parameters {}", station,
        parameter, s == line.stations.end() ? "station" : "parameter", fmt::join(line.stations, ", "), [&] {
          std::string names;
          for (const ParameterMonitor& known : line.parameters)
            names += (names.empty() ? "" : ", ") + known.name;
          return names;
        }()));
  const auto number = s - line.stations.begin();
  StationMonitor& monitored = p->stations[static_cast<std::size_t>(number)];
  if (!monitored.alarm)
    return failure(fmt::format("{}/{}: there is no alarm to acknowledge", station, parameter));
  const double level = monitored.level;
  monitored = {};
  monitored.level = level;
  for (Eigen::MatrixXd* matrix : {&p->comparisons, &p->differences}) {
    matrix->row(number).setZero();
    matrix->col(number).setZero();
  }
  return {};
}

}  // namespace clampd::attribution
