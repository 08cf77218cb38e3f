#include "clampd/attribution/attribution.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/parallel.hpp"
#include "clampd/statistics/distributions.hpp"

namespace clampd::attribution {
namespace {

/// More than so many findings in one parameter mean that the model of the line does not hold.
constexpr std::size_t kMostFindings = 20;

/// Minus twice the logarithm of a likelihood ratio that is no evidence against zero variance at 5 % (Self and
/// Liang 1987: half of chi-square's probability).
constexpr double kLikelihoodRise = 2.71;

/// A station's level is no question where the stations have a smaller share than this of the variance of a check: the
/// most likely variance is never quite zero.
constexpr double kNegligibleShare = 0.001;

struct Candidate {
  Finding::Kind kind;
  int station;
  int period;
};

/// Steps, drifts and levels of each station, over the cells.
class Candidates {
 public:
  Candidates(const CrossedEffects& model, const Layout& layout) {
    for (int station = 0; station < layout.stations; ++station) {
      if (model.components().wander) {
        for (int period = 1; period < layout.periods; ++period)
          add(model, {Finding::Kind::StationStep, station, period},
              [&](int at) { return at >= period ? 1.0 : 0.0; });
        add(model, {Finding::Kind::StationDrift, station, 0},
            [&](int at) { return static_cast<double>(at) / (layout.periods - 1); });
      }
      if (layout.stations >= 4)
        add(model, {Finding::Kind::StationApart, station, 0}, [](int) { return 1.0; });
    }
  }
  const std::vector<Candidate>& all() const { return all_; }
  const std::vector<Change>& changes() const { return changes_; }

 private:
  template <class Shape>
  void add(const CrossedEffects& model, Candidate candidate, const Shape& shape) {
    Change change;
    change.shape = Eigen::VectorXd::Zero(model.cells());
    double sum = 0.0;
    int count = 0;
    for (int cell = 0; cell < model.cells(); ++cell) {
      if (model.station_of(cell) != candidate.station) continue;
      change.shape[cell] = shape(model.period_of(cell));
      sum += change.shape[cell];
      ++count;
    }
    if (candidate.kind != Finding::Kind::StationApart) {
      // A change leaves the station's mean alone, which is its level's.
      if (sum == 0.0 || sum == count) return;
      for (int cell = 0; cell < model.cells(); ++cell)
        if (model.station_of(cell) == candidate.station) change.shape[cell] -= sum / count;
    }
    all_.push_back(candidate);
    changes_.push_back(std::move(change));
  }

  std::vector<Candidate> all_;
  std::vector<Change> changes_;
};

double two_sided(double z) {
  return 2.0 * statistics::normal_upper_tail(std::abs(z));
}

/// Of one of `count` effects of variance `spread` that differs by `size`, of variance `variance` (spread and
/// noise). Its own size went into the spread: it is taken out again (the externally studentised residual),
/// and Student's t has the degrees of freedom of what is left.
double two_sided_studentised(double size, double variance, double spread, int count) {
  const double degrees = count - 2.0;
  const double noise = std::max(0.0, variance - spread);
  const double without = std::max(0.0, (spread * (count - 1) - std::max(0.0, size * size - noise)) / degrees);
  if (degrees < 1.0 || !(noise + without > 0.0)) return 1.0;
  return statistics::fisher_f_p_value(size * size / (noise + without), 1.0, degrees);
}

Finding strongest(const CrossedEffects& model, const Candidates& candidates, int stations,
                  std::size_t& which) {
  const std::vector<Evidence> evidence = model.evidence(candidates.changes());
  Finding best;
  double best_z = 0.0;
  for (std::size_t i = 0; i < evidence.size(); ++i) {
    const Candidate& candidate = candidates.all()[i];
    const double z = evidence[i].z();
    const double spread = model.deviations().station * model.deviations().station;
    const double p =
        candidate.kind == Finding::Kind::StationApart
            ? two_sided_studentised(evidence[i].size, evidence[i].sd * evidence[i].sd, spread, stations)
            : two_sided(z);
    // Probabilities below the smallest number compare by their statistic.
    if (p > best.p || (p == best.p && std::abs(z) <= best_z)) continue;
    best = {candidate.kind, candidate.station, candidate.period, evidence[i].size, evidence[i].sd, p};
    best_z = std::abs(z);
    which = i;
  }
  return best;
}

void find_batches(const Levels& levels, const Deviations& deviations, double level,
                  std::vector<Finding>& findings) {
  const int count = static_cast<int>(levels.batch.size());
  for (int batch = 0; batch < count; ++batch) {
    // A prediction is the observed difference, drawn to zero by the share of the batches' variance that it
    // tells of.
    const double spread = deviations.batch * deviations.batch;
    const double told = 1.0 - levels.batch_variance[batch] / spread;
    if (!(told > 0.01)) continue;
    const double p = two_sided_studentised(levels.batch[batch] / told, spread / told, spread, count);
    if (p < level)
      findings.push_back({Finding::Kind::BatchApart, batch, 0, levels.batch[batch],
                          std::sqrt(levels.batch_variance[batch]), p});
  }
}

double mean_square(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value * value;
  return sum / static_cast<double>(values.size());
}

/// Zero where it is negligible.
double stations_variance(const Deviations& found) {
  const auto square = [](double deviation) { return deviation * deviation; };
  const double all = square(found.repeat) + square(found.brake) + square(found.batch) + square(found.station) +
                     square(found.fixture) + square(found.period) + square(found.wander);
  return square(found.station) < kNegligibleShare * all ? 0.0 : square(found.station);
}

/// Batches that went to one station only, most of them.
bool batches_stay(const Layout& layout) {
  std::vector<std::int32_t> station(static_cast<std::size_t>(layout.batches), -1);
  std::vector<bool> at_several(static_cast<std::size_t>(layout.batches), false);
  for (std::size_t i = 0; i < layout.batch.size(); ++i) {
    if (layout.batch[i] < 0) continue;
    const auto batch = static_cast<std::size_t>(layout.batch[i]);
    if (station[batch] >= 0 && station[batch] != layout.station[i]) at_several[batch] = true;
    station[batch] = layout.station[i];
  }
  return 2 * std::count(at_several.begin(), at_several.end(), true) < layout.batches;
}

/// Where a spread is seen that batches explain as well as stations, no level of a station is known, whatever
/// the most likely share of the two is.
void note_what_cannot_be_told(const Layout& layout, CrossedEffects& model, ParameterAttribution& result) {
  if (!model.components().station || !model.components().batch || !batches_stay(layout)) return;
  const double least = model.deviance(result.deviations);
  const auto rise_without = [&](std::initializer_list<bool Components::*> components) {
    const Deviations without = model.fit_without(components);
    return std::pair(model.deviance(without) - least, without);
  };
  const auto [without_both, neither] = rise_without({&Components::station, &Components::batch});
  const auto [without_stations, batches] = rise_without({&Components::station});
  const auto [without_batches, stations] = rise_without({&Components::batch});
  model.set_deviations(result.deviations);
  if (without_both < kLikelihoodRise || without_stations > kLikelihoodRise ||
      without_batches > kLikelihoodRise)
    return;
  result.confounded = true;
  result.deviations.station = stations.station;
  for (StationLevel& level : result.stations) level.reliability = 0.0;
}

ParameterAttribution attribute_parameter(const Layout& layout, const ParameterReadings& readings,
                                         double false_alarms) {
  ParameterAttribution result;
  result.name = readings.name;
  result.unit = readings.unit;
  result.identification = std::sqrt(mean_square(readings.deviations));
  CrossedEffects model(layout, readings.values, readings.deviations);
  result.components = model.components();
  result.converged = model.fit();
  const Candidates candidates(model, layout);
  const auto tests =
      static_cast<double>(candidates.all().size()) + (model.components().batch ? layout.batches : 0);
  const double level = false_alarms / std::max(1.0, tests);
  while (result.findings.size() < kMostFindings) {
    std::size_t which = 0;
    const Finding found = strongest(model, candidates, layout.stations, which);
    if (found.p >= level) break;
    result.findings.push_back(found);
    model.add_change(candidates.changes()[which]);
    result.converged = model.fit() && result.converged;
  }
  result.deviations = model.deviations();
  result.mean = model.mean();
  const Levels levels = model.levels();
  if (model.components().batch && levels.batch.size() > 0)
    find_batches(levels, result.deviations, level, result.findings);
  double spread = stations_variance(result.deviations);
  for (Eigen::Index s = 0; s < levels.station.size(); ++s)
    result.stations.push_back(
        {levels.station[s], std::sqrt(levels.station_variance[s]),
         spread > 0.0 ? std::clamp(1.0 - levels.station_variance[s] / spread, 0.0, 1.0) : 1.0});
  note_what_cannot_be_told(layout, model, result);
  const bool known =
      std::all_of(result.stations.begin(), result.stations.end(),
                  [](const StationLevel& station) { return station.reliability >= kReliable; });
  spread = stations_variance(result.deviations);
  // The difference of two stations is known to half of their spread.
  if (!known && spread > 0.0)
    result.brakes_needed = static_cast<int>(std::ceil(
        8.0 * (result.deviations.repeat * result.deviations.repeat + mean_square(readings.deviations)) /
        spread));
  return result;
}

}  // namespace

LineAttribution attribute(const LineTable& table, const AttributionOptions& options) {
  LineAttribution result;
  result.parameters.resize(table.parameters.size());
  const double each =
      options.false_alarms / static_cast<double>(std::max<std::size_t>(1, table.parameters.size()));
  for_each_index(table.parameters.size(), ThreadBudget(threads_or_all(options.threads)), [&](std::size_t i) {
    result.parameters[i] = attribute_parameter(table.layout, table.parameters[i], each);
  });
  result.separable.assign(static_cast<std::size_t>(table.layout.stations), true);
  for (const ParameterAttribution& parameter : result.parameters)
    for (std::size_t s = 0; s < parameter.stations.size(); ++s)
      if (parameter.stations[s].reliability < kReliable) result.separable[s] = false;
  return result;
}

}  // namespace clampd::attribution
