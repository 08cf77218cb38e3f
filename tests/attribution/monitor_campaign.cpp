#include "attribution/monitor_campaign.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "clampd/attribution/line_monitor.hpp"

namespace clampd::attribution {
namespace {

constexpr int kBaseline = 50;   ///< readings that EWMA and CUSUM take their mean and spread from
constexpr int kChangeAt = 120;  ///< day of the change where delays are measured

class Simulation {
 public:
  Simulation(const MonitoredLine& line, std::uint64_t seed) : line_(line), random_(seed) {
    for (int s = 0; s < line.stations; ++s) {
      level_.push_back(line.station * normal_(random_));
      rate_.push_back(line.checks_a_day * std::exp(1.1 * (uniform_(random_) - 0.5)));
    }
    // What a station's daily reading spreads by, about.
    usual_ = std::sqrt(line.wander * line.wander + 1.0 / line.checks_a_day);
  }

  /// The checks of the day, and one of the next so that the day is over.
  LineTable day(int day) {
    LineTable table;
    for (int s = 0; s < line_.stations; ++s) table.stations.push_back("S" + std::to_string(s));
    table.parameters.push_back({"k2", "N/rad^2", {}, {}});
    const double time = line_.time * normal_(random_);
    // Four days a batch, at stations of its own: each kind of batch goes to every second, third, ... of them.
    const int kinds = std::max(1, line_.stations / line_.stations_of_a_batch);
    if (day % 4 == 0) {
      batch_.clear();
      for (int b = 0; b < kinds; ++b) batch_.push_back(line_.batch * normal_(random_));
      kind_.assign(static_cast<std::size_t>(line_.stations), 0);
      for (int s = 0; s < line_.stations; ++s) kind_[static_cast<std::size_t>(s)] = s % kinds;
      std::shuffle(kind_.begin(), kind_.end(), random_);
    }
    for (int b = 0; b < kinds; ++b)
      table.batches.push_back("B" + std::to_string(day / 4) + "-" + std::to_string(b));
    for (int s = 0; s < line_.stations; ++s) add_station(table, day, s, time);
    add(table, day + 1, 0, 0, "next", 0.0);
    table.layout.stations = line_.stations;
    return table;
  }

 private:
  void add_station(LineTable& table, int day, int s, double time) {
    const auto number = static_cast<std::size_t>(s);
    const double today = rate_[number] * std::exp(1.1 * (uniform_(random_) - 0.5));
    const int checks = std::poisson_distribution<int>(today)(random_);
    const double wander = line_.wander * normal_(random_);
    double change = 0.0;
    if (s == 0 && line_.changed_at >= 0 && day >= line_.changed_at)
      change = usual_ * (line_.step + line_.drift * (day - line_.changed_at + 1));
    for (int i = 0; i < checks; ++i) {
      const bool master = uniform_(random_) < line_.master_share;
      const auto kind = static_cast<std::size_t>(kind_[number]);
      add(table, day, s, static_cast<int>(kind), master ? "master" : "R" + std::to_string(++brakes_),
          time + wander + level_[number] + change + batch_[kind] + (master ? 2.0 : noise()));
    }
  }

  void add(LineTable& table, int day, int station, int batch, const std::string& brake, double value) {
    table.layout.brake.push_back(static_cast<std::int32_t>(table.brakes.size()));
    table.brakes.push_back(brake);
    table.layout.station.push_back(station);
    table.layout.batch.push_back(batch);
    table.started_s.push_back(day * kDay_s + static_cast<double>(table.brakes.size()));
    table.parameters[0].values.push_back(value);
    table.parameters[0].deviations.push_back(0.0);
  }

  double noise() {
    return line_.noise == Noise::Normal ? normal_(random_) : student_(random_) * std::sqrt(3.0 / 5.0);
  }

  MonitoredLine line_;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> uniform_;
  std::student_t_distribution<double> student_{5.0};
  std::vector<double> level_, rate_, batch_;
  std::vector<int> kind_;
  double usual_ = 1.0;
  long brakes_ = 0;
};

/// A station's daily readings and the monitor's evidence after each.
struct Sequence {
  std::vector<int> day;
  std::vector<double> reading, evidence;
};

std::vector<Sequence> sequences(const MonitoredLine& line, std::uint64_t seed) {
  Simulation simulation(line, seed);
  LineMonitor state;
  state.false_alarms_per_year = 1e-300;  // no alarm interrupts what is measured
  std::vector<Sequence> result(static_cast<std::size_t>(line.stations));
  std::vector<ChangeDetector::State> before(result.size());
  for (int day = 0; day < line.days; ++day) {
    if (!monitor(state, simulation.day(day))) return {};
    for (std::size_t s = 0; s < result.size(); ++s) {
      const ChangeDetector& detector = state.parameters[0].stations[s].detector;
      const ChangeDetector::State& now = detector.state();
      if (now.readings == before[s].readings) continue;
      result[s].day.push_back(day);
      result[s].reading.push_back((now.information * now.mean - before[s].information * before[s].mean) /
                                  (now.information - before[s].information));
      result[s].evidence.push_back(detector.evidence());
      before[s] = now;
      before[s].starts.clear();
    }
  }
  return result;
}

/// The statistic of a chart of each reading after the baseline, which starts anew at `limit`.
std::vector<std::size_t> chart_alarms(const Sequence& sequence, bool cusum, double limit) {
  constexpr double kWeight = 0.1, kReference = 0.5;
  std::vector<std::size_t> alarms;
  if (sequence.reading.size() <= kBaseline) return alarms;
  double mean = 0.0, squares = 0.0;
  for (int i = 0; i < kBaseline; ++i) mean += sequence.reading[static_cast<std::size_t>(i)] / kBaseline;
  for (int i = 0; i < kBaseline; ++i)
    squares += std::pow(sequence.reading[static_cast<std::size_t>(i)] - mean, 2) / (kBaseline - 1);
  double up = 0.0, down = 0.0;
  for (std::size_t i = kBaseline; i < sequence.reading.size(); ++i) {
    const double z = (sequence.reading[i] - mean) / std::sqrt(squares);
    if (cusum) {
      up = std::max(0.0, up + z - kReference);
      down = std::max(0.0, down - z - kReference);
    } else {
      up += kWeight * (z - up);
      down = -up;
    }
    if (std::max(up, down) < limit) continue;
    alarms.push_back(i);
    up = down = 0.0;
  }
  return alarms;
}

double calibrated(const std::vector<Sequence>& quiet, bool cusum, double average_run_length) {
  double low = 0.0, high = 50.0;
  for (int step = 0; step < 30; ++step) {
    const double limit = 0.5 * (low + high);
    double alarms = 0.0, readings = 0.0;
    for (const Sequence& sequence : quiet) {
      alarms += static_cast<double>(chart_alarms(sequence, cusum, limit).size());
      readings += std::max(0.0, static_cast<double>(sequence.reading.size()) - kBaseline);
    }
    (alarms * average_run_length > readings ? low : high) = limit;
  }
  return high;
}

void note(Delay& delay, std::size_t method, int day, int days) {
  if (day >= 0 && day < kChangeAt) {
    ++delay.early[method];
    return;
  }
  delay.found[method] += day >= 0 ? 1 : 0;
  delay.mean[method] += (day >= 0 ? day : days) - kChangeAt + 1;
}

}  // namespace

FalseAlarms count_false_alarms(const MonitoredLine& line, std::uint64_t seed, double false_alarms_per_year) {
  Simulation simulation(line, seed);
  LineMonitor state;
  state.false_alarms_per_year = false_alarms_per_year;
  FalseAlarms result;
  for (int day = 0; day < line.days; ++day) {
    if (!monitor(state, simulation.day(day))) return {};
    for (std::size_t s = 0; s < state.stations.size(); ++s)
      if (state.parameters[0].stations[s].alarm) {
        ++result.alarms;
        if (!acknowledge(state, state.stations[s], "k2")) return {};
      }
  }
  result.station_days = static_cast<double>(line.days) * line.stations;
  result.promised = line.days / 365.25 * false_alarms_per_year;
  return result;
}

Delay measure_delay(const MonitoredLine& changed, std::uint64_t seed, int lines, double average_run_length) {
  MonitoredLine line = changed;
  std::vector<Sequence> quiet;
  line.changed_at = -1;
  for (int i = 0; i < lines; ++i)
    for (Sequence& sequence : sequences(line, seed + 100000 + static_cast<std::uint64_t>(i)))
      quiet.push_back(std::move(sequence));
  const std::array<double, 2> limits{calibrated(quiet, false, average_run_length),
                                     calibrated(quiet, true, average_run_length)};
  line.changed_at = kChangeAt;
  Delay delay;
  delay.lines = lines;
  for (int i = 0; i < lines; ++i) {
    const Sequence sequence = sequences(line, seed + static_cast<std::uint64_t>(i)).at(0);
    const auto alarm = std::find_if(sequence.evidence.begin(), sequence.evidence.end(),
                                    [&](double evidence) { return evidence >= average_run_length; });
    note(delay, 0,
         alarm == sequence.evidence.end()
             ? -1
             : sequence.day[static_cast<std::size_t>(alarm - sequence.evidence.begin())],
         line.days);
    for (std::size_t chart = 0; chart < 2; ++chart) {
      const std::vector<std::size_t> alarms = chart_alarms(sequence, chart == 1, limits[chart]);
      note(delay, chart + 1, alarms.empty() ? -1 : sequence.day[alarms.front()], line.days);
    }
  }
  for (std::size_t m = 0; m < delay.mean.size(); ++m) delay.mean[m] /= std::max(1, lines - delay.early[m]);
  return delay;
}

}  // namespace clampd::attribution
