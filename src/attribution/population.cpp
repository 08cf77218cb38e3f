#include "clampd/attribution/population.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <optional>
#include <span>

#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/median.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::attribution {
namespace {

using Suspect = PopulationFinding::Suspect;

constexpr double kMedianToDeviation = 1.4826;
constexpr double kFarthest = 3.0;   // deviations; what lies farther from its group counts as if it lay there
constexpr double kRivalNats = 3.0;  // a rival is at most so much less likely: one in twenty
constexpr double kSmallestProbability = 1e-290;  // below, Student's t has no other than its asymptote
constexpr double kChanceOfSpread = 0.1;
constexpr double kSameChecks = 0.8;
constexpr double kLeastOwn = 1e-6;
constexpr double kLeastLeft =
    1e-3;  // of a direction's scatter, beside another: with less it is the same direction
// All checks share what the estimates are biased by (nonlinearity, rounding of time), a part of their own
// deviation; between groups most of it cancels. What is smaller for a typical check is not named, however
// many checks there are.
constexpr double kLeastOfLine = 0.5, kLeastOfGroup = 0.1;
constexpr std::array kKindsBesideTheLine{CheckGroup::Kind::Station, CheckGroup::Kind::Fixture,
                                         CheckGroup::Kind::Batch};
constexpr int kLine = 0, kNoGroup = -1;  // numbers of groups

/// Whether groups have most of their checks in common, so that nothing tells which of them has an effect.
bool are_nearly_same(const CheckGroup& a, const CheckGroup& b) {
  std::vector<int> common;
  std::set_intersection(a.checks.begin(), a.checks.end(), b.checks.begin(), b.checks.end(),
                        std::back_inserter(common));
  return static_cast<double>(common.size()) >
         kSameChecks * static_cast<double>(std::max(a.checks.size(), b.checks.size()));
}

/// A candidate beside what is selected already.
struct Trial {
  Suspect suspect;
  double size = 0.0, sd = std::numeric_limits<double>::infinity(), t = 0.0, degrees = 1.0;
  double surprise = 0.0;  ///< -ln of the probability of as much without a cause
};

/// The scores of a direction when the groups beside a candidate have taken of them what they can.
struct Rest {
  Eigen::MatrixXd columns;  ///< of those groups
  statistics::ScaledFactor factor;
  Eigen::VectorXd left;
};

struct Spread {
  double variance = 0.0;
  int groups = 0;
};

double surprise_of(const Trial& trial) {
  const double square = trial.t * trial.t;
  const double p = statistics::fisher_f_p_value(square, 1.0, trial.degrees);
  return p > kSmallestProbability ? -std::log(p) : 0.5 * trial.degrees * std::log1p(square / trial.degrees);
}

class Search {
 public:
  Search(const PopulationTable& table, const PopulationOptions& options) : table_(table), options_(options) {
    standardise();
    for (std::size_t g = 0; g < table.groups.size(); ++g)
      if (is_large_enough(table.groups[g])) looked_at_.push_back(static_cast<int>(g));
  }

  PopulationResult run();

 private:
  void standardise();
  bool is_large_enough(const CheckGroup& group) const;
  const CheckGroup& group(int number) const { return table_.groups[static_cast<std::size_t>(number)]; }
  bool has(int group) const;
  bool is_selected(const Suspect& suspect) const;
  std::vector<int> beside(int group) const;
  /// The scores of a direction as the candidates of a group see them: less what follows from the directions
  /// that the group has.
  Eigen::VectorXd response(int direction, int group) const;
  Rest rest_beside(int direction, int group) const;
  Trial trial(int direction, int group, const Rest& rest) const;
  Spread spread_between(CheckGroup::Kind kind, int without, std::span<const Trial> trials) const;
  void allow_for_spread(Trial& trial, std::span<const Trial> trials) const;
  double of_one_check(const Trial& trial) const;
  std::vector<Trial> trials() const;
  std::vector<Suspect> rivals(std::span<const Trial> before, std::span<const Trial> after,
                              const Trial& chosen, double level) const;

  const PopulationTable& table_;
  const PopulationOptions& options_;
  Eigen::MatrixXd z_;       ///< scores over the root of their information, far ones moved nearer
  Eigen::MatrixXd weight_;  ///< that root: what a strength of one moves z by
  Eigen::MatrixXd within_;  ///< z less its station's mean
  std::vector<int> looked_at_;
  std::vector<Suspect> selected_;
  std::vector<int> closed_;  ///< groups in which nothing more is looked for
};

bool Search::is_large_enough(const CheckGroup& group) const {
  const auto size = static_cast<Eigen::Index>(group.checks.size());
  return size >= kFewestOfGroup &&
         (group.kind == CheckGroup::Kind::Line || z_.rows() - size >= kFewestOfGroup);
}

void Search::standardise() {
  const Eigen::Index rows = table_.score.rows(), columns = table_.score.cols();
  weight_ = table_.information.cwiseMax(0.0).cwiseSqrt();
  z_ = (weight_.array() > 0.0).select(table_.score.array() / weight_.array(), 0.0).matrix();
  within_ = z_;
  std::vector<std::vector<int>> parts;
  for (const CheckGroup& each : table_.groups)
    if (each.kind == CheckGroup::Kind::Station) parts.push_back(each.checks);
  if (parts.empty()) {
    parts.emplace_back(static_cast<std::size_t>(rows));
    std::iota(parts.front().begin(), parts.front().end(), 0);
  }
  for (Eigen::Index j = 0; j < columns; ++j) {
    std::vector<double> away;
    std::vector<double> middles;
    for (const std::vector<int>& part : parts) {
      std::vector<double> values;
      for (const int i : part) values.push_back(z_(i, j));
      middles.push_back(statistics::median(values));
      for (const double value : values) away.push_back(std::abs(value - middles.back()));
    }
    const double farthest = kFarthest * kMedianToDeviation * statistics::median(away);
    for (std::size_t part = 0; part < parts.size(); ++part) {
      double mean = 0.0;
      for (const int i : parts[part]) {
        z_(i, j) = std::clamp(z_(i, j), middles[part] - farthest, middles[part] + farthest);
        mean += z_(i, j) / static_cast<double>(parts[part].size());
      }
      for (const int i : parts[part]) within_(i, j) = z_(i, j) - mean;
    }
  }
}

bool Search::is_selected(const Suspect& suspect) const {
  return std::find(selected_.begin(), selected_.end(), suspect) != selected_.end();
}

bool Search::has(int number) const {
  return std::any_of(selected_.begin(), selected_.end(),
                     [&](const Suspect& each) { return each.group == number; });
}

Eigen::VectorXd Search::response(int direction, int number) const {
  std::vector<int> known;
  for (const Suspect& each : selected_)
    if (each.group == number) known.push_back(each.direction);
  if (known.empty()) return z_.col(direction);
  const auto count = static_cast<Eigen::Index>(known.size());
  Eigen::MatrixXd within(z_.rows(), count), all(z_.rows(), count);
  for (Eigen::Index k = 0; k < count; ++k) {
    within.col(k) = within_.col(known[static_cast<std::size_t>(k)]);
    all.col(k) = z_.col(known[static_cast<std::size_t>(k)]);
  }
  // How two directions' scores go together from check to check is how one strength moves the other's score.
  const statistics::ScaledFactor factor(within.transpose() * within, 1e-9);
  const Eigen::VectorXd share = factor.solve(within.transpose() * within_.col(direction));
  if ((within_.col(direction) - within * share).squaredNorm() <
      kLeastLeft * within_.col(direction).squaredNorm())
    return Eigen::VectorXd::Zero(z_.rows());
  return z_.col(direction) - all * share;
}

/// Groups whose checks may have anything when one is looked at. Beside a batch each station has a level of
/// its own, so that what stations differ by hides nothing of the batches; beside any other group but the
/// line, the line.
std::vector<int> Search::beside(int number) const {
  std::vector<int> groups;
  const bool is_batch = number >= 0 && group(number).kind == CheckGroup::Kind::Batch;
  for (std::size_t g = 0; g < table_.groups.size() && is_batch; ++g)
    if (table_.groups[g].kind == CheckGroup::Kind::Station) groups.push_back(static_cast<int>(g));
  if (groups.empty() && number != kLine) groups.push_back(kLine);
  for (const Suspect& each : selected_)
    if (each.group != number && each.group != kLine &&
        std::find(groups.begin(), groups.end(), each.group) == groups.end())
      groups.push_back(each.group);
  return groups;
}

Rest Search::rest_beside(int direction, int number) const {
  const std::vector<int> beside = this->beside(number);
  Rest rest;
  rest.columns.setZero(z_.rows(), static_cast<Eigen::Index>(beside.size()));
  for (std::size_t k = 0; k < beside.size(); ++k)
    for (const int i : group(beside[k]).checks)
      rest.columns(i, static_cast<Eigen::Index>(k)) = weight_(i, direction);
  rest.left = response(direction, number);
  if (beside.empty()) return rest;
  rest.factor = statistics::ScaledFactor(rest.columns.transpose() * rest.columns, 1e-10);
  rest.left -= rest.columns * rest.factor.solve(rest.columns.transpose() * rest.left);
  return rest;
}

Trial Search::trial(int direction, int number, const Rest& rest) const {
  Trial trial{{direction, number}};
  double squares = 0.0, product = 0.0;
  Eigen::VectorXd across = Eigen::VectorXd::Zero(rest.columns.cols());
  for (const int i : group(number).checks) {
    const double weight = weight_(i, direction);
    squares += weight * weight;
    product += weight * rest.left[i];
    across += weight * rest.columns.row(i).transpose();
  }
  const double information = across.size() > 0 ? squares - across.dot(rest.factor.solve(across)) : squares;
  // Where the groups beside it are the same checks, nothing is its own.
  if (!(information > kLeastOwn * squares)) return trial;
  trial.size = product / information;
  trial.degrees = static_cast<double>(z_.rows() - rest.columns.cols() - 1);
  const double variance = (rest.left.squaredNorm() - trial.size * product) / trial.degrees;
  if (!(variance > 0.0) || trial.degrees < 1.0) return trial;
  trial.sd = std::sqrt(variance / information);
  trial.t = trial.size / trial.sd;
  return trial;
}

/// Variance of a strength between the groups of a kind beyond what their checks explain (DerSimonian, Laird
/// 1986), and from how many.
Spread Search::spread_between(CheckGroup::Kind kind, int without, std::span<const Trial> trials) const {
  double weights = 0.0, squares = 0.0, sum = 0.0, sum_of_squares = 0.0;
  int count = 0;
  for (const Trial& other : trials) {
    const int number = other.suspect.group;
    if (number == without || has(number) || group(number).kind != kind || !std::isfinite(other.sd)) continue;
    const double weight = 1.0 / (other.sd * other.sd);
    weights += weight;
    squares += weight * weight;
    sum += weight * other.size;
    sum_of_squares += weight * other.size * other.size;
    ++count;
  }
  if (count < 2) return {};
  // Cochran's Q. What chance alone explains would cost a few groups most of what they can tell.
  const double heterogeneity = sum_of_squares - sum * sum / weights;
  if (statistics::chi_squared_p_value(heterogeneity, count - 1) > kChanceOfSpread) return {0.0, count};
  return {std::max(0.0, (heterogeneity - (count - 1)) / (weights - squares / weights)), count};
}

/// Groups of a kind differ a little in everything: a group stands out only if it differs by more than the
/// others do, and the line has only what its groups have on average. The deviation is known by as many
/// degrees of freedom as its parts are (Satterthwaite 1946).
void Search::allow_for_spread(Trial& trial, std::span<const Trial> trials) const {
  if (!std::isfinite(trial.sd)) return;
  const int number = trial.suspect.group;
  std::vector<Spread> spreads;
  if (number == kLine) {
    for (const CheckGroup::Kind kind : kKindsBesideTheLine) {
      spreads.push_back(spread_between(kind, kNoGroup, trials));
      spreads.back().variance /= std::max(1, spreads.back().groups);
    }
  } else {
    spreads.push_back(spread_between(group(number).kind, number, trials));
  }
  double variance = trial.sd * trial.sd;
  double of_variance = variance * variance / trial.degrees;  // half of the estimated variance's own variance
  for (const Spread& spread : spreads) {
    variance += spread.variance;
    of_variance += spread.variance * spread.variance / std::max(1, spread.groups - 1);
  }
  trial.sd = std::sqrt(variance);
  trial.t = trial.size / trial.sd;
  trial.degrees = variance * variance / of_variance;
}

double Search::of_one_check(const Trial& trial) const {
  std::vector<double> weights;
  for (const int i : group(trial.suspect.group).checks)
    weights.push_back(weight_(i, trial.suspect.direction));
  return std::abs(trial.size) * statistics::median(weights);
}

std::vector<Trial> Search::trials() const {
  std::vector<Trial> list;
  for (int j = 0; j < static_cast<int>(table_.directions.size()); ++j) {
    std::vector<Trial> of_direction;
    const Rest of_station = rest_beside(j, kNoGroup);
    std::optional<Rest> of_batch;
    for (const int g : looked_at_) {
      if (is_selected({j, g}) || std::find(closed_.begin(), closed_.end(), g) != closed_.end()) continue;
      const bool is_batch = group(g).kind == CheckGroup::Kind::Batch;
      if (g == kLine || has(g)) {
        of_direction.push_back(trial(j, g, rest_beside(j, g)));
      } else {
        if (is_batch && !of_batch) of_batch = rest_beside(j, g);
        of_direction.push_back(trial(j, g, is_batch ? *of_batch : of_station));
      }
    }
    const std::vector<Trial> alone = of_direction;
    for (Trial& each : of_direction) {
      allow_for_spread(each, alone);
      const bool is_possible =
          each.size > 0.0 || !table_.directions[static_cast<std::size_t>(j)].is_one_sided;
      const double least = each.suspect.group == kLine ? kLeastOfLine : kLeastOfGroup;
      if (is_possible && std::isfinite(each.sd) && of_one_check(each) > least)
        each.surprise = surprise_of(each);
    }
    list.insert(list.end(), of_direction.begin(), of_direction.end());
  }
  return list;
}

/// Those that were as likely as the chosen one, and of which nothing is left once it is there.
std::vector<Suspect> Search::rivals(std::span<const Trial> before, std::span<const Trial> after,
                                    const Trial& chosen, double level) const {
  std::vector<const Trial*> likely;
  for (const Trial& each : before) {
    if (each.suspect == chosen.suspect || each.surprise < chosen.surprise - kRivalNats ||
        each.surprise <= 0.0)
      continue;
    const bool is_left = std::any_of(after.begin(), after.end(), [&](const Trial& later) {
      return later.suspect == each.suspect && later.surprise > -std::log(level);
    });
    if (!is_left) likely.push_back(&each);
  }
  std::sort(likely.begin(), likely.end(),
            [](const Trial* a, const Trial* b) { return a->surprise > b->surprise; });
  std::vector<Suspect> rivals;
  for (const Trial* each : likely) rivals.push_back(each->suspect);
  for (const int g : looked_at_) {
    const Suspect same{chosen.suspect.direction, g};
    if (g != chosen.suspect.group && are_nearly_same(group(g), group(chosen.suspect.group)) &&
        std::find(rivals.begin(), rivals.end(), same) == rivals.end())
      rivals.push_back(same);
  }
  return rivals;
}

/// As many independent directions are worth as much: by the eigenvalues of their correlation (Galwey 2009).
double independent_directions(const Eigen::MatrixXd& within) {
  const statistics::Spectrum spectrum = statistics::spectrum_of(statistics::scaled_by(
      within.transpose() * within, within.colwise().norm().transpose().cwiseMax(1e-150)));
  const Eigen::ArrayXd values = spectrum.values.array().max(0.0);
  return values.sum() > 0.0 ? std::pow(values.sqrt().sum(), 2) / values.sum() : 0.0;
}

PopulationResult Search::run() {
  PopulationResult result;
  result.groups_too_small = static_cast<int>(table_.groups.size() - looked_at_.size());
  result.overdispersion = (within_.colwise().squaredNorm().transpose() /
                           std::max<double>(1.0, static_cast<double>(z_.rows()) - 1.0))
                              .cwiseSqrt();
  result.tests = static_cast<double>(looked_at_.size()) * independent_directions(within_);
  if (!(result.tests > 0.0)) return result;
  const double level = options_.false_alarms / result.tests;
  std::vector<Trial> all = trials();
  while (static_cast<int>(selected_.size()) < options_.most_findings) {
    const auto best = std::max_element(
        all.begin(), all.end(), [](const Trial& a, const Trial& b) { return a.surprise < b.surprise; });
    if (best == all.end() || !(best->surprise > -std::log(level))) break;
    PopulationFinding finding;
    finding.suspect = best->suspect;
    finding.size = best->size;
    finding.sd = best->sd;
    finding.t = best->t;
    finding.p = std::exp(-best->surprise);
    finding.of_one_check = of_one_check(*best);
    selected_.push_back(best->suspect);
    if (finding.of_one_check > kShownByOneCheck) closed_.push_back(best->suspect.group);
    std::vector<Trial> after = trials();
    finding.rivals = rivals(all, after, *best, level);
    result.findings.push_back(std::move(finding));
    all = std::move(after);
  }
  return result;
}

}  // namespace

PopulationResult attribute_effects(const PopulationTable& table, const PopulationOptions& options) {
  if (table.groups.empty() || table.score.rows() == 0) return {};
  return Search(table, options).run();
}

}  // namespace clampd::attribution
