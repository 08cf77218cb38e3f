#include "src/attribution/score_model.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "clampd/statistics/median.hpp"

namespace clampd::attribution {
namespace {

using Suspect = PopulationFinding::Suspect;

constexpr double kMedianToDeviation = 1.4826;
// Deviations in any direction; a check farther off counts as if it were there.
constexpr double kFarthest = 4.0;
// Of a direction's information, beside another: with less it is the same one.
constexpr double kLeastLeft = 1e-3;
constexpr double kRidge = 1e-6;

template <class Matrix>
double entry(const Matrix& matrix, int row, int column) {
  return static_cast<double>(matrix(row, column));
}

}  // namespace

std::vector<int> common_checks(const CheckGroup& a, const CheckGroup& b) {
  std::vector<int> both;
  std::set_intersection(a.checks.begin(), a.checks.end(), b.checks.begin(), b.checks.end(),
                        std::back_inserter(both));
  return both;
}

ScoreModel::ScoreModel(const PopulationTable& table) : table_(table) {
  group_by_station();
  move_far_checks_nearer();
  const auto directions = static_cast<Eigen::Index>(table.directions.size());
  for (Station& station : stations_) {
    station.information.setZero(directions, directions);
    station.score.setZero(directions);
    for (const int i : station.checks) {
      station.information += table.information[static_cast<std::size_t>(i)].cast<double>();
      station.score += score_.row(i).transpose();
    }
  }
}

void ScoreModel::group_by_station() {
  const auto checks = static_cast<std::size_t>(table_.score.rows());
  station_of_.assign(checks, -1);
  for (std::size_t g = 0; g < table_.groups.size(); ++g) {
    if (table_.groups[g].kind != CheckGroup::Kind::Station) continue;
    for (const int i : table_.groups[g].checks)
      station_of_[static_cast<std::size_t>(i)] = static_cast<int>(stations_.size());
    stations_.push_back({static_cast<int>(g), table_.groups[g].checks, {}, {}, {}});
  }
  Station rest;
  for (std::size_t i = 0; i < checks; ++i)
    if (station_of_[i] < 0) {
      station_of_[i] = static_cast<int>(stations_.size());
      rest.checks.push_back(static_cast<int>(i));
    }
  if (!rest.checks.empty()) stations_.push_back(std::move(rest));
}

/// A check that lies far from its station's median in one direction is moved nearer in all of them alike, so
/// that it says the same with less weight.
void ScoreModel::move_far_checks_nearer() {
  const Eigen::Index checks = table_.score.rows(), directions = table_.score.cols();
  Eigen::MatrixXd root(checks, directions);
  for (Eigen::Index i = 0; i < checks; ++i)
    root.row(i) = table_.information[static_cast<std::size_t>(i)]
                      .diagonal()
                      .cast<double>()
                      .cwiseMax(0.0)
                      .cwiseSqrt()
                      .transpose();
  const Eigen::MatrixXd z =
      (root.array() > 0.0).select(table_.score.array() / root.array().max(1e-150), 0.0).matrix();
  Eigen::MatrixXd middle(static_cast<Eigen::Index>(stations_.size()), directions);
  Eigen::VectorXd farthest = Eigen::VectorXd::Zero(checks);
  for (Eigen::Index j = 0; j < directions; ++j) {
    std::vector<double> away(static_cast<std::size_t>(checks));
    for (std::size_t s = 0; s < stations_.size(); ++s) {
      std::vector<double> values;
      for (const int i : stations_[s].checks) values.push_back(z(i, j));
      const double median = middle(static_cast<Eigen::Index>(s), j) = statistics::median(values);
      for (const int i : stations_[s].checks) away[static_cast<std::size_t>(i)] = std::abs(z(i, j) - median);
    }
    const double deviation = kMedianToDeviation * statistics::median(away);
    if (!(deviation > 0.0)) continue;
    for (Eigen::Index i = 0; i < checks; ++i)
      farthest[i] = std::max(farthest[i], away[static_cast<std::size_t>(i)] / deviation);
  }
  Eigen::MatrixXd nearer(checks, directions);
  for (Eigen::Index i = 0; i < checks; ++i) {
    const auto there = middle.row(station_of_[static_cast<std::size_t>(i)]);
    nearer.row(i) = there + std::min(1.0, kFarthest / std::max(farthest[i], 1e-150)) * (z.row(i) - there);
  }
  score_ = nearer.cwiseProduct(root);
  for (Eigen::Index j = 0; j < directions; ++j) {
    std::vector<double> roots(root.col(j).begin(), root.col(j).end());
    of_one_check_.push_back(statistics::median(roots));
  }
  standardised_ = nearer;
  for (const Station& station : stations_) {
    const Eigen::RowVectorXd mean = nearer(station.checks, Eigen::all).colwise().mean();
    for (const int i : station.checks) standardised_.row(i) -= mean;
  }
}

void ScoreModel::clear() {
  for (Station& station : stations_) station.levels.clear();
  elsewhere_.clear();
}

void ScoreModel::let_stations_differ(int direction) {
  for (Station& station : stations_)
    if (std::find(station.levels.begin(), station.levels.end(), direction) == station.levels.end())
      station.levels.push_back(direction);
}

void ScoreModel::add(const Suspect& suspect) {
  const auto station = std::find_if(stations_.begin(), stations_.end(),
                                    [&](const Station& each) { return each.group == suspect.group; });
  if (station == stations_.end())
    elsewhere_.push_back(suspect);
  else if (std::find(station->levels.begin(), station->levels.end(), suspect.direction) ==
           station->levels.end())
    station->levels.push_back(suspect.direction);
}

ScoreModel::Column ScoreModel::column(const Fit& fit, const Suspect& suspect) const {
  Column column{suspect, 0.0, 0.0, std::vector<Eigen::VectorXd>(stations_.size())};
  for (const int i : table_.groups[static_cast<std::size_t>(suspect.group)].checks) {
    const auto station = static_cast<std::size_t>(station_of_[static_cast<std::size_t>(i)]);
    const std::vector<int>& levels = fit.stations[station].levels;
    const Eigen::MatrixXf& information = table_.information[static_cast<std::size_t>(i)];
    Eigen::VectorXd& across = column.across[station];
    if (across.size() == 0) across.setZero(static_cast<Eigen::Index>(levels.size()));
    for (std::size_t l = 0; l < levels.size(); ++l)
      across[static_cast<Eigen::Index>(l)] += entry(information, levels[l], suspect.direction);
    column.information += entry(information, suspect.direction, suspect.direction);
    column.score += score_(i, suspect.direction);
  }
  return column;
}

/// Information that two columns share when the levels follow.
double ScoreModel::shared(const Fit& fit, const Column& a, const Column& b) const {
  double sum = 0.0;
  if (a.suspect == b.suspect) {
    sum = a.information;
  } else {
    const auto& groups = table_.groups;
    for (const int i : common_checks(groups[static_cast<std::size_t>(a.suspect.group)],
                                     groups[static_cast<std::size_t>(b.suspect.group)]))
      sum += entry(table_.information[static_cast<std::size_t>(i)], a.suspect.direction, b.suspect.direction);
  }
  for (std::size_t s = 0; s < stations_.size(); ++s)
    if (a.across[s].size() > 0 && b.across[s].size() > 0)
      sum -= a.across[s].dot(fit.stations[s].information.solve(b.across[s]));
  return sum;
}

/// A column's score when the levels follow.
double ScoreModel::own_score(const Fit& fit, const Column& column) const {
  double score = column.score;
  for (std::size_t s = 0; s < stations_.size(); ++s)
    if (column.across[s].size() > 0)
      score -= column.across[s].dot(fit.stations[s].information.solve(fit.stations[s].score));
  return score;
}

ScoreModel::Fit ScoreModel::fit(int direction) const {
  Fit fit;
  fit.direction = direction;
  for (const Station& station : stations_) {
    Fit::AtStation& at = fit.stations.emplace_back();
    at.levels = station.levels;
    const auto found = std::find(at.levels.begin(), at.levels.end(), direction);
    at.at = found - at.levels.begin();
    if (found == at.levels.end()) at.levels.push_back(direction);
    at.score = station.score(at.levels);
    at.information = statistics::ScaledFactor(station.information(at.levels, at.levels), kRidge);
  }
  std::vector<Column> columns;
  for (const Suspect& suspect : elsewhere_) columns.push_back(column(fit, suspect));
  for (Column& column : columns)
    if (shared(fit, column, column) > kLeastLeft * column.information)
      fit.elsewhere.push_back(std::move(column));
  const auto count = static_cast<Eigen::Index>(fit.elsewhere.size());
  Eigen::MatrixXd information(count, count);
  Eigen::VectorXd score(count);
  for (Eigen::Index a = 0; a < count; ++a) {
    const Column& column = fit.elsewhere[static_cast<std::size_t>(a)];
    score[a] = own_score(fit, column);
    for (Eigen::Index b = 0; b <= a; ++b)
      information(a, b) = information(b, a) = shared(fit, column, fit.elsewhere[static_cast<std::size_t>(b)]);
  }
  if (count > 0) {
    fit.information_elsewhere = statistics::ScaledFactor(information, kRidge);
    fit.strengths_elsewhere = fit.information_elsewhere.solve(score);
  }
  fit_levels(fit);
  estimate_overdispersion(fit);
  return fit;
}

void ScoreModel::fit_levels(Fit& fit) const {
  const auto count = static_cast<Eigen::Index>(fit.elsewhere.size());
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(table_.directions.size())),
                  with = sum;
  for (std::size_t s = 0; s < stations_.size(); ++s) {
    Fit::AtStation& at = fit.stations[s];
    const auto levels = static_cast<Eigen::Index>(at.levels.size());
    Eigen::VectorXd score = at.score;
    for (Eigen::Index k = 0; k < count; ++k)
      if (const auto& across = fit.elsewhere[static_cast<std::size_t>(k)].across[s]; across.size() > 0)
        score -= fit.strengths_elsewhere[k] * across;
    at.strengths = at.information.solve(score);
    const Eigen::VectorXd unit = at.information.solve(Eigen::VectorXd::Unit(levels, at.at));
    at.weights = unit / unit[at.at];
    const double all = entry(stations_[s].information, fit.direction, fit.direction);
    if (!(all > 0.0) || !(1.0 > kLeastLeft * all * unit[at.at])) continue;
    at.strength.size = at.strengths[at.at];
    at.strength.variance = unit[at.at];
    at.moved_by_elsewhere.setZero(count);
    for (Eigen::Index k = 0; k < count; ++k)
      if (const auto& across = fit.elsewhere[static_cast<std::size_t>(k)].across[s]; across.size() > 0)
        at.moved_by_elsewhere[k] = across.dot(unit);
    for (Eigen::Index l = 0; l < levels; ++l) {
      sum[at.levels[static_cast<std::size_t>(l)]] += at.strengths[l];
      with[at.levels[static_cast<std::size_t>(l)]] += 1.0;
    }
  }
  // What all stations have alike moves them alike.
  for (std::size_t s = 0; s < stations_.size(); ++s) {
    Fit::AtStation& at = fit.stations[s];
    if (!at.strength.is_known()) continue;
    double explained = 0.0;
    for (std::size_t l = 0; l < at.levels.size(); ++l) {
      const int level = at.levels[l];
      if (level == fit.direction) continue;
      const double mean = with[level] > 1.5 ? sum[level] / with[level] : 0.0;
      const double own = at.strengths[static_cast<Eigen::Index>(l)] - mean;
      explained += entry(stations_[s].information, fit.direction, level) * own;
      at.strength.largest_beside = std::max(at.strength.largest_beside, std::abs(own) * of_one_check(level));
    }
    at.strength.moved = explained * at.strength.variance;
  }
}

/// By the scores that are left, in so far as the levels of other directions do not follow them.
void ScoreModel::estimate_overdispersion(Fit& fit) const {
  std::vector<std::vector<char>> has;  // by column and check
  for (const Column& column : fit.elsewhere) {
    has.emplace_back(static_cast<std::size_t>(score_.rows()), 0);
    for (const int i : table_.groups[static_cast<std::size_t>(column.suspect.group)].checks)
      has.back()[static_cast<std::size_t>(i)] = 1;
  }
  double of_each = 0.0, squares = 0.0, variances = 0.0, checks = 0.0, levels = 0.0;
  for (std::size_t s = 0; s < stations_.size(); ++s) {
    const Fit::AtStation& at = fit.stations[s];
    if (!at.strength.is_known()) continue;
    levels += 1.0;
    for (const int i : stations_[s].checks) {
      const Eigen::MatrixXf& information = table_.information[static_cast<std::size_t>(i)];
      const Eigen::MatrixXd own = information(at.levels, at.levels).cast<double>();
      const double variance = at.weights.dot(own * at.weights);
      if (!(variance > 0.0)) continue;
      Eigen::VectorXd left = score_(i, at.levels).transpose() - own * at.strengths;
      for (std::size_t k = 0; k < fit.elsewhere.size(); ++k)
        if (has[k][static_cast<std::size_t>(i)] != 0)
          left -= fit.strengths_elsewhere[static_cast<Eigen::Index>(k)] *
                  information(at.levels, fit.elsewhere[k].suspect.direction).cast<double>();
      const double score = at.weights.dot(left);
      of_each += score * score / variance;
      squares += score * score;
      variances += variance;
      checks += 1.0;
    }
  }
  fit.degrees = std::max(1.0, checks - levels);
  // Checks that tell more may be off by more.
  if (variances > 0.0) fit.overdispersion = std::max(of_each, squares / variances * checks) / fit.degrees;
}

double ScoreModel::common_variance(const Fit& fit, const Eigen::VectorXd& weights) const {
  if (fit.elsewhere.empty()) return 0.0;
  Eigen::VectorXd moved = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(fit.elsewhere.size()));
  for (std::size_t s = 0; s < fit.stations.size(); ++s)
    if (fit.stations[s].strength.is_known())
      moved += weights[static_cast<Eigen::Index>(s)] * fit.stations[s].moved_by_elsewhere;
  return fit.overdispersion * moved.dot(fit.information_elsewhere.solve(moved));
}

Strength ScoreModel::of_group(const Fit& fit, int group) const {
  const Column column = this->column(fit, {fit.direction, group});
  double information = shared(fit, column, column);
  double score = own_score(fit, column);
  Strength strength;
  double explained = 0.0;
  for (std::size_t k = 0; k < fit.elsewhere.size(); ++k)
    if (const Suspect& other = fit.elsewhere[k].suspect; other.group == group)
      strength.largest_beside =
          std::max(strength.largest_beside, std::abs(fit.strengths_elsewhere[static_cast<Eigen::Index>(k)]) *
                                                of_one_check(other.direction));
  if (!fit.elsewhere.empty()) {
    Eigen::VectorXd across(static_cast<Eigen::Index>(fit.elsewhere.size()));
    for (Eigen::Index k = 0; k < across.size(); ++k)
      across[k] = shared(fit, column, fit.elsewhere[static_cast<std::size_t>(k)]);
    information -= across.dot(fit.information_elsewhere.solve(across));
    explained = across.dot(fit.strengths_elsewhere);
    score -= explained;
  }
  if (!(information > kLeastLeft * column.information)) return strength;
  strength.size = score / information;
  strength.variance = 1.0 / information;
  strength.moved = explained / information;
  return strength;
}

}  // namespace clampd::attribution
