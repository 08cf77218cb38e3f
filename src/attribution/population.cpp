#include "clampd/attribution/population.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <span>
#include <utility>

#include "clampd/statistics/distributions.hpp"
#include "src/attribution/score_model.hpp"

namespace clampd::attribution {
namespace {

using Suspect = PopulationFinding::Suspect;

constexpr double kRivalNats = 3.0;               // a rival is at most so much less likely: one in twenty
constexpr double kSmallestProbability = 1e-290;  // below, Fisher's F has no other than its asymptote
constexpr double kChanceOfSpread = 0.1;
constexpr double kAlone = 5.0;  // deviations between the others
constexpr double kSameChecks = 0.8;
constexpr std::size_t kFewestToDiffer = 3;  // stations: of two, one differs from the other
// All checks share what the estimates are biased by (nonlinearity, rounding of time), a part of their own
// deviation; between groups most of it cancels. What is smaller for a typical check is not named, however
// many checks there are.
constexpr double kLeastOfLine = 0.5, kLeastOfGroup = 0.1;
// Scores are linear in what is small. Of what one strength is thought to move another by, so much may be
// wrong.
constexpr double kNonlinear = 0.05;
// In directions that it does not move in proportion, a large strength looks like so much of itself.
constexpr double kBesideLarge = 0.03;
constexpr double kLinear = 1.0;  // deviations of one check: what is smaller is small
constexpr std::array kKindsWithinStations{CheckGroup::Kind::Fixture, CheckGroup::Kind::Batch};
constexpr double kExchangeNats = 1e-6;  // more than rounding
constexpr int kMostExchanges = 20;
constexpr int kLine = 0, kNoGroup = -1, kStations = -2;  // in place of a group's number

/// Whether groups have most of their checks in common, so that nothing tells which of them has an effect.
bool are_nearly_same(const CheckGroup& a, const CheckGroup& b) {
  return static_cast<double>(common_checks(a, b).size()) >
         kSameChecks * static_cast<double>(std::max(a.checks.size(), b.checks.size()));
}

/// What a group has of a direction by its own checks.
struct Estimate {
  int group = 0;
  double size = 0.0, variance = 0.0;
  double largest_beside = 0.0;
  Eigen::Index station = 0;  ///< among the model's, of a station
};

Estimate estimate_of(const ScoreModel::Fit& fit, const Strength& strength, int group) {
  return {group, strength.size,
          fit.overdispersion * strength.variance + std::pow(kNonlinear * strength.moved, 2),
          strength.largest_beside};
}

/// A candidate beside what is selected already.
struct Trial {
  Suspect suspect;  ///< the group may be kStations: that they differ
  double size = 0.0, sd = std::numeric_limits<double>::infinity();
  double square = 0.0, directions = 1.0, degrees = 1.0;  ///< Fisher's F, times the first of its degrees
  double largest_beside = 0.0;  ///< of another strength that the same checks have, as one check shows it
  double surprise = 0.0;        ///< -ln of the probability of as much without a cause
};

/// Variance of a strength between groups, beyond what their checks explain.
struct Spread {
  double variance = 0.0;
  int groups = 0;
};

/// A mean of groups and its variance.
struct Mean {
  double size = 0.0, variance = std::numeric_limits<double>::infinity();
};

double largest_beside(std::span<const Estimate> estimates) {
  double largest = 0.0;
  for (const Estimate& each : estimates) largest = std::max(largest, each.largest_beside);
  return largest;
}

Mean mean_of(std::span<const Estimate> estimates, double between, int without = kNoGroup) {
  double weights = 0.0, sum = 0.0;
  for (const Estimate& each : estimates) {
    if (each.group == without) continue;
    const double weight = 1.0 / (each.variance + between);
    weights += weight;
    sum += weight * each.size;
  }
  return weights > 0.0 ? Mean{sum / weights, 1.0 / weights} : Mean{};
}

/// Adds the weights of that mean, times a factor, to those of the stations.
void add_weights_of_mean(std::span<const Estimate> estimates, double between, int without, double factor,
                         Eigen::VectorXd& weights) {
  const double of_mean = mean_of(estimates, between, without).variance;
  for (const Estimate& each : estimates)
    if (each.group != without) weights[each.station] += factor * of_mean / (each.variance + between);
}

/// Cochran's Q and the spread that it tells of (DerSimonian, Laird 1986).
struct Heterogeneity {
  double q = 0.0;
  Spread spread;
};

Heterogeneity heterogeneity_of(std::span<const Estimate> estimates, int without = kNoGroup) {
  Heterogeneity result;
  const double mean = mean_of(estimates, 0.0, without).size;
  double weights = 0.0, squares = 0.0;
  for (const Estimate& each : estimates) {
    if (each.group == without) continue;
    const double weight = 1.0 / each.variance;
    weights += weight;
    squares += weight * weight;
    result.q += weight * (each.size - mean) * (each.size - mean);
    ++result.spread.groups;
  }
  const double degrees = result.spread.groups - 1;
  if (degrees >= 1.0)
    result.spread.variance = std::max(0.0, (result.q - degrees) / (weights - squares / weights));
  return result;
}

/// What chance alone explains would cost a few groups most of what they can tell, and is no spread.
Spread spread_between(const Heterogeneity& found) {
  if (found.spread.groups < 2) return {};
  if (statistics::chi_squared_p_value(found.q, found.spread.groups - 1) > kChanceOfSpread)
    return {0.0, found.spread.groups};
  return found.spread;
}

/// The spread between the others that a group of this size has to stand out from: none if they differ by so
/// much less that it alone is another.
Spread spread_beside(double size, const Heterogeneity& others, double least_surprise) {
  const Spread spread = spread_between(others);
  if (spread.variance > 0.0 && size * size > kAlone * kAlone * spread.variance &&
      statistics::chi_squared_p_value(others.q, others.spread.groups - 1) > std::exp(-least_surprise))
    return {0.0, spread.groups};
  return spread;
}

double surprise_of(const Trial& trial) {
  const double p =
      statistics::fisher_f_p_value(trial.square / trial.directions, trial.directions, trial.degrees);
  return p > kSmallestProbability ? -std::log(p)
                                  : 0.5 * trial.degrees * std::log1p(trial.square / trial.degrees);
}

class Search {
 public:
  Search(const PopulationTable& table, const PopulationOptions& options)
      : table_(table), options_(options), model_(table) {
    for (std::size_t g = 0; g < table.groups.size(); ++g)
      if (is_large_enough(table.groups[g])) looked_at_.push_back(static_cast<int>(g));
  }

  PopulationResult run();

 private:
  bool is_large_enough(const CheckGroup& group) const;
  const CheckGroup& group(int number) const { return table_.groups[static_cast<std::size_t>(number)]; }
  bool is_looked_at(int group) const {
    return std::find(looked_at_.begin(), looked_at_.end(), group) != looked_at_.end();
  }
  bool is_selected(const Suspect& suspect) const {
    return std::find(selected_.begin(), selected_.end(), suspect) != selected_.end();
  }
  double of_one_check(const Trial& trial) const {
    return std::abs(trial.size) * model_.of_one_check(trial.suspect.direction);
  }
  std::vector<Estimate> stations_of(const ScoreModel::Fit& fit) const;
  Trial of_line(const ScoreModel::Fit& fit, std::span<const Estimate> stations,
                std::span<const std::vector<Estimate>> within) const;
  Trial of_station(const ScoreModel::Fit& fit, std::span<const Estimate> stations, const Estimate& own) const;
  Trial of_difference(const ScoreModel::Fit& fit, std::span<const Estimate> stations) const;
  void judge(Trial& trial) const;
  std::vector<Trial> trials_of(int direction) const;
  void put_into_model(const std::vector<Suspect>& selected);
  std::vector<Trial> trials_beside(const std::vector<Suspect>& selected);
  bool exchange_one(std::vector<Suspect>& selected);
  std::vector<Suspect> select();
  std::vector<Suspect> rivals(std::span<const Trial> before, std::span<const Trial> after,
                              const Trial& chosen) const;
  void conclude(const std::vector<Suspect>& selected, PopulationResult& result);
  void add_levels(PopulationResult& result) const;

  const PopulationTable& table_;
  const PopulationOptions& options_;
  ScoreModel model_;
  std::vector<int> looked_at_;
  std::vector<Suspect> selected_;
  double least_surprise_ = 0.0;  ///< of what is found
};

bool Search::is_large_enough(const CheckGroup& group) const {
  const auto size = static_cast<Eigen::Index>(group.checks.size());
  return size >= kFewestOfGroup &&
         (group.kind == CheckGroup::Kind::Line || model_.checks() - size >= kFewestOfGroup);
}

/// Of those that are known to have the direction there is none here: they are no measure of the others.
std::vector<Estimate> Search::stations_of(const ScoreModel::Fit& fit) const {
  std::vector<Estimate> estimates;
  for (std::size_t s = 0; s < fit.stations.size(); ++s) {
    const Strength& strength = fit.stations[s].strength;
    const int number = model_.group_of(s);
    if (!strength.is_known() || is_selected({fit.direction, number})) continue;
    estimates.push_back(estimate_of(fit, strength, number));
    estimates.back().station = static_cast<Eigen::Index>(s);
  }
  return estimates;
}

void Search::judge(Trial& trial) const {
  if (!std::isfinite(trial.sd) || !(trial.sd > 0.0)) return;
  const bool is_possible =
      trial.size > 0.0 || !table_.directions[static_cast<std::size_t>(trial.suspect.direction)].is_one_sided;
  const double least =
      (trial.suspect.group == kLine ? kLeastOfLine : kLeastOfGroup) + kBesideLarge * trial.largest_beside;
  if (is_possible && of_one_check(trial) > least) trial.surprise = surprise_of(trial);
}

/// A deviation of several parts is known by as many degrees of freedom as they are (Satterthwaite 1946).
class Variance {
 public:
  Variance(double variance, double degrees) { add(variance, degrees); }
  void add(double variance, double degrees) {
    variance_ += variance;
    of_variance_ += variance * variance / std::max(1.0, degrees);
  }
  void put_into(Trial& trial) const {
    if (!(variance_ > 0.0) || !std::isfinite(variance_)) return;
    trial.sd = std::sqrt(variance_);
    trial.square = trial.size * trial.size / variance_;
    trial.degrees = variance_ * variance_ / of_variance_;
  }

 private:
  double variance_ = 0.0, of_variance_ = 0.0;
};

/// The line has what its stations have on average. Groups of a kind differ a little in everything: what
/// differs between them is no matter of the line.
Trial Search::of_line(const ScoreModel::Fit& fit, std::span<const Estimate> stations,
                      std::span<const std::vector<Estimate>> within) const {
  Trial trial{{fit.direction, kLine}};
  const Mean plain = mean_of(stations, 0.0);
  if (!std::isfinite(plain.variance)) return trial;
  Variance variance(plain.variance, fit.degrees);
  const Spread between = spread_between(heterogeneity_of(stations));
  trial.size = mean_of(stations, between.variance).size;
  trial.largest_beside = largest_beside(stations);
  variance.add(between.variance / std::max(1, between.groups), between.groups - 1);
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(model_.stations()));
  add_weights_of_mean(stations, between.variance, kNoGroup, 1.0, weights);
  variance.add(model_.common_variance(fit, weights), fit.degrees);
  for (const std::vector<Estimate>& kind : within) {
    const Spread spread = spread_between(heterogeneity_of(kind));
    variance.add(spread.variance / std::max(1, spread.groups), spread.groups - 1);
  }
  variance.put_into(trial);
  return trial;
}

/// A station stands out if it differs from the mean of the others by more than they do.
Trial Search::of_station(const ScoreModel::Fit& fit, std::span<const Estimate> stations,
                         const Estimate& own) const {
  Trial trial{{fit.direction, own.group}};
  const Mean plain = mean_of(stations, 0.0, own.group);
  const Spread between =
      spread_beside(own.size - plain.size, heterogeneity_of(stations, own.group), least_surprise_);
  const Mean others = mean_of(stations, between.variance, own.group);
  trial.size = own.size - others.size;
  trial.largest_beside = own.largest_beside;
  Variance variance(own.variance + plain.variance, fit.degrees);
  variance.add(between.variance + (others.variance - plain.variance), between.groups - 1);
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(model_.stations()));
  weights[own.station] = 1.0;
  add_weights_of_mean(stations, between.variance, own.group, -1.0, weights);
  variance.add(model_.common_variance(fit, weights), fit.degrees);
  variance.put_into(trial);
  return trial;
}

Trial Search::of_difference(const ScoreModel::Fit& fit, std::span<const Estimate> stations) const {
  Trial trial{{fit.direction, kStations}};
  std::vector<Estimate> large;
  for (const Estimate& each : stations)
    if (is_looked_at(each.group)) large.push_back(each);
  if (large.size() < kFewestToDiffer) return trial;
  const Heterogeneity found = heterogeneity_of(large);
  trial.size = std::sqrt(found.spread.variance);
  trial.largest_beside = largest_beside(large);
  trial.sd = 1.0;  // none is needed
  trial.square = found.q;
  trial.directions = found.spread.groups - 1;
  trial.degrees = fit.degrees;
  return trial;
}

std::vector<Trial> Search::trials_of(int direction) const {
  const ScoreModel::Fit fit = model_.fit(direction);
  const std::vector<Estimate> stations = stations_of(fit);
  std::vector<Trial> trials;
  std::vector<std::vector<Estimate>> within;
  for (const CheckGroup::Kind kind : kKindsWithinStations) {
    std::vector<Estimate>& estimates = within.emplace_back();
    for (const int g : looked_at_) {
      if (group(g).kind != kind || is_selected({direction, g})) continue;
      const Strength strength = model_.of_group(fit, g);
      if (strength.is_known()) estimates.push_back(estimate_of(fit, strength, g));
    }
    for (const Estimate& own : estimates) {
      Trial& trial = trials.emplace_back(Trial{{direction, own.group}});
      trial.size = own.size;
      trial.largest_beside = own.largest_beside;
      Variance variance(own.variance, fit.degrees);
      const Spread between = spread_beside(own.size, heterogeneity_of(estimates, own.group), least_surprise_);
      variance.add(between.variance, between.groups - 1);
      variance.put_into(trial);
    }
  }
  if (!is_selected({direction, kLine})) trials.push_back(of_line(fit, stations, within));
  for (const Estimate& own : stations)
    if (is_looked_at(own.group) && stations.size() > 1) trials.push_back(of_station(fit, stations, own));
  if (!is_selected({direction, kStations})) trials.push_back(of_difference(fit, stations));
  for (Trial& trial : trials) judge(trial);
  return trials;
}

void Search::put_into_model(const std::vector<Suspect>& selected) {
  selected_ = selected;
  model_.clear();
  for (const Suspect& each : selected)
    each.group == kStations ? model_.let_stations_differ(each.direction) : model_.add(each);
}

/// Everything that is not selected, with these selected.
std::vector<Trial> Search::trials_beside(const std::vector<Suspect>& selected) {
  put_into_model(selected);
  std::vector<Trial> all;
  for (int j = 0; j < static_cast<int>(table_.directions.size()); ++j) {
    const std::vector<Trial> of_direction = trials_of(j);
    all.insert(all.end(), of_direction.begin(), of_direction.end());
  }
  return all;
}

const Trial* most_surprising(std::span<const Trial> trials,
                             const std::function<bool(const Suspect&)>& counts) {
  const Trial* best = nullptr;
  for (const Trial& trial : trials)
    if (counts(trial.suspect) && (best == nullptr || trial.surprise > best->surprise)) best = &trial;
  return best;
}

const Trial& trial_of(std::span<const Trial> trials, const Suspect& suspect) {
  static const Trial none;
  const auto found =
      std::find_if(trials.begin(), trials.end(), [&](const Trial& each) { return each.suspect == suspect; });
  return found == trials.end() ? none : *found;
}

/// What was named first was named beside less. The first of the selected that is not surprising any more is
/// left out, the first that another direction of the same group explains better gives way to it.
bool Search::exchange_one(std::vector<Suspect>& selected) {
  for (std::size_t k = 0; k < selected.size(); ++k) {
    std::vector<Suspect> others = selected;
    others.erase(others.begin() + static_cast<std::ptrdiff_t>(k));
    const std::vector<Trial> all = trials_beside(others);
    const double own = trial_of(all, selected[k]).surprise;
    const Trial* best =
        most_surprising(all, [&](const Suspect& each) { return each.group == selected[k].group; });
    if (best != nullptr && best->surprise > std::max(own + kExchangeNats, least_surprise_)) {
      selected[k] = best->suspect;
      return true;
    }
    if (own <= least_surprise_) {
      selected = others;
      return true;
    }
  }
  return false;
}

std::vector<Suspect> Search::select() {
  std::vector<Suspect> selected;
  while (static_cast<int>(selected.size()) < options_.most_findings) {
    const std::vector<Trial> all = trials_beside(selected);
    const Trial* best = most_surprising(all, [](const Suspect&) { return true; });
    if (best == nullptr || best->surprise <= least_surprise_) break;
    selected.push_back(best->suspect);
    const std::vector<Suspect> before = selected;
    for (int round = 0; round < kMostExchanges; ++round)
      if (!exchange_one(selected)) break;
    if (selected.size() < before.size()) break;  // what was added made something else needless: enough
  }
  return selected;
}

/// Those that were as likely as the chosen one, and of which nothing is left once it is there.
std::vector<Suspect> Search::rivals(std::span<const Trial> before, std::span<const Trial> after,
                                    const Trial& chosen) const {
  // Of an effect that a check shows by itself, the linear scores tell rivals apart no better than so.
  const double nats =
      kRivalNats + (of_one_check(chosen) > kLinear ? 2.0 * kNonlinear * chosen.surprise : 0.0);
  std::vector<const Trial*> likely;
  for (const Trial& each : before) {
    if (each.suspect == chosen.suspect || each.surprise < chosen.surprise - nats || each.surprise <= 0.0 ||
        (each.suspect.group == kStations) != (chosen.suspect.group == kStations))
      continue;
    const bool is_left = std::any_of(after.begin(), after.end(), [&](const Trial& later) {
      return later.suspect == each.suspect && later.surprise > least_surprise_;
    });
    if (!is_left) likely.push_back(&each);
  }
  std::sort(likely.begin(), likely.end(),
            [](const Trial* a, const Trial* b) { return a->surprise > b->surprise; });
  std::vector<Suspect> rivals;
  for (const Trial* each : likely) rivals.push_back(each->suspect);
  if (chosen.suspect.group == kStations) return rivals;
  for (const int g : looked_at_) {
    const Suspect same{chosen.suspect.direction, g};
    if (g != chosen.suspect.group && are_nearly_same(group(g), group(chosen.suspect.group)) &&
        std::find(rivals.begin(), rivals.end(), same) == rivals.end())
      rivals.push_back(same);
  }
  return rivals;
}

/// As many independent directions are worth as much: by the eigenvalues of their correlation (Galwey 2009).
double independent_directions(const Eigen::MatrixXd& standardised) {
  const statistics::Spectrum spectrum = statistics::spectrum_of(statistics::scaled_by(
      standardised.transpose() * standardised, standardised.colwise().norm().transpose().cwiseMax(1e-150)));
  const Eigen::ArrayXd values = spectrum.values.array().max(0.0);
  return values.sum() > 0.0 ? std::pow(values.sqrt().sum(), 2) / values.sum() : 0.0;
}

/// Of each difference, what the stations have of it beside all that was found.
void Search::add_levels(PopulationResult& result) const {
  for (StationDifference& difference : result.differences) {
    const ScoreModel::Fit fit = model_.fit(difference.direction);
    const std::vector<Estimate> stations = stations_of(fit);
    const double mean = mean_of(stations, heterogeneity_of(stations).spread.variance).size;
    for (const Estimate& each : stations)
      if (is_looked_at(each.group))
        difference.levels.push_back({each.group, each.size - mean, std::sqrt(each.variance)});
  }
}

/// Each of the selected as it stands beside the others.
void Search::conclude(const std::vector<Suspect>& selected, PopulationResult& result) {
  const std::vector<Trial> after = trials_beside(selected);
  std::vector<std::pair<Trial, std::vector<Suspect>>> found;
  for (std::size_t k = 0; k < selected.size(); ++k) {
    std::vector<Suspect> others = selected;
    others.erase(others.begin() + static_cast<std::ptrdiff_t>(k));
    const std::vector<Trial> before = trials_beside(others);
    const Trial& trial = trial_of(before, selected[k]);
    found.emplace_back(trial, rivals(before, after, trial));
  }
  std::stable_sort(found.begin(), found.end(),
                   [](const auto& a, const auto& b) { return a.first.surprise > b.first.surprise; });
  for (auto& [trial, rivals] : found) {
    const double p = std::exp(-trial.surprise), of_one_check = this->of_one_check(trial);
    if (trial.suspect.group == kStations) {
      StationDifference& difference = result.differences.emplace_back();
      difference.direction = trial.suspect.direction;
      difference.sd = trial.size;
      difference.p = p;
      difference.of_one_check = of_one_check;
      for (const Suspect& rival : rivals) difference.rivals.push_back(rival.direction);
    } else {
      result.findings.push_back({.suspect = trial.suspect,
                                 .size = trial.size,
                                 .sd = trial.sd,
                                 .t = trial.size / trial.sd,
                                 .p = p,
                                 .of_one_check = of_one_check,
                                 .rivals = std::move(rivals)});
    }
  }
  put_into_model(selected);
  add_levels(result);
}

PopulationResult Search::run() {
  PopulationResult result;
  result.groups_too_small = static_cast<int>(table_.groups.size() - looked_at_.size());
  result.overdispersion = (model_.standardised().colwise().squaredNorm().transpose() /
                           std::max<double>(1.0, static_cast<double>(model_.checks()) - 1.0))
                              .cwiseSqrt();
  const auto stations = std::count_if(looked_at_.begin(), looked_at_.end(),
                                      [&](int g) { return group(g).kind == CheckGroup::Kind::Station; });
  const auto questions = looked_at_.size() + (static_cast<std::size_t>(stations) >= kFewestToDiffer ? 1 : 0);
  result.tests = static_cast<double>(questions) * independent_directions(model_.standardised());
  if (!(result.tests > 0.0)) return result;
  least_surprise_ = -std::log(options_.false_alarms / result.tests);
  conclude(select(), result);
  return result;
}

}  // namespace

PopulationResult attribute_effects(const PopulationTable& table, const PopulationOptions& options) {
  if (table.groups.empty() || table.score.rows() == 0) return {};
  return Search(table, options).run();
}

}  // namespace clampd::attribution
