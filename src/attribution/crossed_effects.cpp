#include "clampd/attribution/crossed_effects.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <tuple>
#include <utility>

#include <ceres/first_order_function.h>
#include <ceres/gradient_problem.h>
#include <ceres/gradient_problem_solver.h>

#include "clampd/statistics/symmetric.hpp"

namespace clampd::attribution {
namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();
/// A smaller deviation, as a share of the readings' spread, is none.
constexpr double kSmallest = 1e-5;
/// For the derivatives that are taken by differences, of the logarithm of a deviation.
constexpr double kStep = 1e-3;

constexpr std::array<double Deviations::*, 7> kMembers{
    &Deviations::repeat,  &Deviations::brake,  &Deviations::batch, &Deviations::station,
    &Deviations::fixture, &Deviations::period, &Deviations::wander};
constexpr std::size_t kEliminated = 3;  ///< the first ones: repeat, brake, batch

double square(double x) {
  return x * x;
}

/// The sum of the logarithms of many positive numbers, with few logarithms.
class SumOfLogs {
 public:
  void add(double x) {
    product_ *= x;
    if (product_ < 1e-200 || product_ > 1e200) flush();
  }
  double value() {
    flush();
    return sum_;
  }

 private:
  void flush() {
    sum_ += std::log(product_);
    product_ = 1.0;
  }
  double product_ = 1.0;
  double sum_ = 0.0;
};

/// A vector over the cells of which few are not zero.
class FewCells {
 public:
  explicit FewCells(int cells) : values_(static_cast<std::size_t>(cells), 0.0) {}
  void add(std::int32_t cell, double value) {
    double& there = values_[static_cast<std::size_t>(cell)];
    if (there == 0.0) touched_.push_back(cell);
    there += value;
  }
  double operator[](std::int32_t cell) const { return values_[static_cast<std::size_t>(cell)]; }
  const std::vector<std::int32_t>& touched() const { return touched_; }
  void clear() {
    for (const std::int32_t cell : touched_) values_[static_cast<std::size_t>(cell)] = 0.0;
    touched_.clear();
  }

 private:
  std::vector<double> values_;
  std::vector<std::int32_t> touched_;
};

/// A batch as the cells see it, with its brakes eliminated.
struct BatchSums {
  std::int32_t number = -1;
  double weight = 0.0;
  double reading = 0.0;
  std::vector<std::pair<std::int32_t, double>> cells;
};

}  // namespace

/// The checks as the cells see them, with brakes and batches eliminated: of a model y = cells + eliminated +
/// noise, with the eliminated and the noise of covariance V, and A the incidence of the cells.
struct CrossedEffects::Reduced {
  explicit Reduced(int cells)
      : information(Eigen::MatrixXd::Zero(cells, cells)),
        right(Eigen::VectorXd::Zero(cells)),
        batch(cells),
        brake(cells) {}

  Eigen::MatrixXd information;   ///< A^T V^-1 A
  Eigen::VectorXd right;         ///< A^T V^-1 y
  double squares = 0.0;          ///< y^T V^-1 y
  double log_determinant = 0.0;  ///< ln det V
  std::vector<BatchSums> batches;

  SumOfLogs logs;
  FewCells batch, brake;  ///< of the one at work
  double batch_weight = 0.0, batch_reading = 0.0;
};

/// Henderson's equations for what is not eliminated.
struct CrossedEffects::Solution {
  Eigen::MatrixXd design;    ///< cells × unknowns: mean, changes, stations, fixtures, periods, cells
  Eigen::MatrixXd weighted;  ///< A^T V^-1 A design
  std::array<std::pair<Eigen::Index, Eigen::Index>, kMembers.size()>
      group{};  ///< first unknown and how many, of each deviation
  statistics::CholeskyFactor factor;
  Eigen::VectorXd half;  ///< L^-1 right
  Eigen::VectorXd unknowns;
  double deviance = kNone;
};

CrossedEffects::CrossedEffects(const Layout& layout, const std::vector<double>& readings,
                               const std::vector<double>& deviations)
    : layout_(layout) {
  const auto count = static_cast<double>(readings.size());
  shift_ = std::accumulate(readings.begin(), readings.end(), 0.0) / count;
  double squares = 0.0;
  for (const double reading : readings) squares += square(reading - shift_);
  if (squares > 0.0) scale_ = std::sqrt(squares / count);
  number_cells();
  sort_checks(readings, deviations);
  find_components();
}

void CrossedEffects::number_cells() {
  std::map<std::tuple<std::int32_t, std::int32_t, std::int32_t>, std::int32_t> numbers;
  const std::size_t checks = layout_.station.size();
  for (std::size_t i = 0; i < checks; ++i)
    numbers.emplace(std::tuple(layout_.station[i], layout_.fixture[i], layout_.period[i]), 0);
  for (auto& [cell, number] : numbers) {
    number = static_cast<std::int32_t>(cell_station_.size());
    cell_station_.push_back(std::get<0>(cell));
    cell_fixture_.push_back(std::get<1>(cell));
    cell_period_.push_back(std::get<2>(cell));
  }
  cell_of_check_.resize(checks);
  for (std::size_t i = 0; i < checks; ++i)
    cell_of_check_[i] = numbers.at({layout_.station[i], layout_.fixture[i], layout_.period[i]});
}

void CrossedEffects::sort_checks(const std::vector<double>& readings, const std::vector<double>& deviations) {
  // A brake belongs to the batch that its first check says.
  std::vector<std::int32_t> batch_of(static_cast<std::size_t>(layout_.brakes), -2);
  for (std::size_t i = 0; i < readings.size(); ++i) {
    std::int32_t& batch = batch_of[static_cast<std::size_t>(layout_.brake[i])];
    if (batch == -2) batch = layout_.batch[i];
  }
  std::vector<std::size_t> order(readings.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto key = [&](std::size_t i) {
    return std::pair(batch_of[static_cast<std::size_t>(layout_.brake[i])], layout_.brake[i]);
  };
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
  for (const std::size_t i : order) {
    const bool same_brake =
        !reading_.empty() && layout_.brake[i] == layout_.brake[order[reading_.size() - 1]];
    if (!same_brake) {
      const std::int32_t batch = key(i).first;
      if (batch_.empty() || batch_.back().number != batch)
        batch_.push_back({brake_.size(), brake_.size(), batch});
      brake_.push_back({reading_.size(), reading_.size()});
      ++batch_.back().last_brake;
    } else {
      ++repeated_;
    }
    reading_.push_back((readings[i] - shift_) / scale_);
    variance_.push_back(square(deviations[i] / scale_));
    cell_.push_back(cell_of_check_[i]);
    brake_.back().end = reading_.size();
  }
}

void CrossedEffects::find_components() {
  std::size_t known_batches = 0, brakes_in_them = 0;
  for (const Batch& batch : batch_)
    if (batch.number >= 0) {
      ++known_batches;
      brakes_in_them += batch.last_brake - batch.first_brake;
    }
  components_.repeat = repeated_ >= 5;
  components_.batch = known_batches >= 3 && brakes_in_them > known_batches;
  components_.station = layout_.stations >= 2;
  components_.fixture = layout_.fixtures > layout_.stations;
  components_.period = layout_.periods >= 3 && layout_.stations >= 2;
  components_.wander = layout_.periods >= 3;
}

void CrossedEffects::add_repeated_brake(std::size_t number, const Deviations& deviations,
                                        Reduced& reduced) const {
  const Brake& brake = brake_[number];
  const double repeat = square(deviations.repeat);
  double weight = 0.0, reading = 0.0, squares = 0.0;
  for (std::size_t i = brake.begin; i < brake.end; ++i) {
    const double w = 1.0 / (repeat + variance_[i]);
    reduced.logs.add(repeat + variance_[i]);
    weight += w;
    reading += w * reading_[i];
    squares += w * square(reading_[i]);
    reduced.brake.add(cell_[i], w);
    reduced.information(cell_[i], cell_[i]) += w;
    reduced.right[cell_[i]] += w * reading_[i];
  }
  const double c = square(deviations.brake) / (1.0 + square(deviations.brake) * weight);
  reduced.logs.add(1.0 + square(deviations.brake) * weight);
  reduced.squares += squares - c * square(reading);
  const double left = 1.0 - c * weight;
  reduced.batch_weight += left * weight;
  reduced.batch_reading += left * reading;
  for (const std::int32_t a : reduced.brake.touched()) {
    const double g = reduced.brake[a];
    reduced.right[a] -= c * g * reading;
    reduced.batch.add(a, left * g);
    for (const std::int32_t b : reduced.brake.touched())
      reduced.information(a, b) -= c * g * reduced.brake[b];
  }
  reduced.brake.clear();
}

CrossedEffects::Reduced CrossedEffects::reduce(const Deviations& deviations, bool keep_batches) const {
  Reduced reduced(cells());
  const double single = square(deviations.repeat) + square(deviations.brake);
  for (const Batch& batch : batch_) {
    reduced.batch_weight = reduced.batch_reading = 0.0;
    for (std::size_t b = batch.first_brake; b < batch.last_brake; ++b) {
      const Brake& brake = brake_[b];
      if (brake.end - brake.begin > 1) {
        add_repeated_brake(b, deviations, reduced);
        continue;
      }
      const std::size_t i = brake.begin;
      const double w = 1.0 / (single + variance_[i]);
      const double wy = w * reading_[i];
      reduced.logs.add(single + variance_[i]);
      reduced.information(cell_[i], cell_[i]) += w;
      reduced.right[cell_[i]] += wy;
      reduced.squares += wy * reading_[i];
      reduced.batch_weight += w;
      reduced.batch_reading += wy;
      reduced.batch.add(cell_[i], w);
    }
    if (components_.batch && batch.number >= 0) {
      const double variance = square(deviations.batch);
      const double d = variance / (1.0 + variance * reduced.batch_weight);
      reduced.logs.add(1.0 + variance * reduced.batch_weight);
      reduced.squares -= d * square(reduced.batch_reading);
      for (const std::int32_t a : reduced.batch.touched()) {
        const double scaled = d * reduced.batch[a];
        reduced.right[a] -= scaled * reduced.batch_reading;
        for (const std::int32_t b : reduced.batch.touched())
          reduced.information(a, b) -= scaled * reduced.batch[b];
      }
      if (keep_batches) {
        BatchSums& sums = reduced.batches.emplace_back();
        sums.number = batch.number;
        sums.weight = reduced.batch_weight;
        sums.reading = reduced.batch_reading;
        for (const std::int32_t a : reduced.batch.touched()) sums.cells.emplace_back(a, reduced.batch[a]);
      }
    }
    reduced.batch.clear();
  }
  reduced.log_determinant = reduced.logs.value();
  return reduced;
}

CrossedEffects::Solution CrossedEffects::solve(const Reduced& reduced, const Deviations& deviations) const {
  const std::array<int, kMembers.size()> sizes{0,
                                               0,
                                               0,
                                               components_.station ? layout_.stations : 0,
                                               components_.fixture ? layout_.fixtures : 0,
                                               components_.period ? layout_.periods : 0,
                                               components_.wander ? cells() : 0};
  Eigen::Index unknowns = 1 + static_cast<Eigen::Index>(changes_.size());
  std::array<std::pair<Eigen::Index, Eigen::Index>, kMembers.size()> group{};
  for (std::size_t g = kEliminated; g < kMembers.size(); ++g) {
    group[g] = {unknowns, sizes[g]};
    unknowns += sizes[g];
  }
  Eigen::MatrixXd design = Eigen::MatrixXd::Zero(cells(), unknowns);
  design.col(0).setOnes();
  for (std::size_t c = 0; c < changes_.size(); ++c)
    design.col(static_cast<Eigen::Index>(1 + c)) = changes_[c].shape;
  for (int cell = 0; cell < cells(); ++cell) {
    if (components_.station) design(cell, group[3].first + station_of(cell)) = 1.0;
    if (components_.fixture) design(cell, group[4].first + fixture_of(cell)) = 1.0;
    if (components_.period) design(cell, group[5].first + period_of(cell)) = 1.0;
    if (components_.wander) design(cell, group[6].first + cell) = 1.0;
  }
  // The columns of the cells themselves need no product.
  const Eigen::Index products = components_.wander ? group[6].first : unknowns;
  Eigen::MatrixXd weighted(cells(), unknowns);
  weighted.leftCols(products).noalias() = reduced.information * design.leftCols(products);
  if (components_.wander) weighted.rightCols(cells()) = reduced.information;
  Eigen::MatrixXd equations(unknowns, unknowns);
  equations.topRows(products).noalias() = design.leftCols(products).transpose() * weighted;
  if (components_.wander) equations.bottomRows(cells()) = weighted;
  double logs = 0.0;
  for (std::size_t g = kEliminated; g < kMembers.size(); ++g) {
    if (group[g].second == 0) continue;
    const double variance = square(deviations.*kMembers[g]);
    equations.diagonal().segment(group[g].first, group[g].second).array() += 1.0 / variance;
    logs += static_cast<double>(group[g].second) * std::log(variance);
  }
  Solution solution{
      std::move(design), std::move(weighted), group, statistics::CholeskyFactor(equations), {}, {}};
  if (!solution.factor.is_positive()) return solution;
  const Eigen::VectorXd right = solution.design.transpose() * reduced.right;
  solution.half = solution.factor.solve_lower(right);
  solution.unknowns = solution.factor.solve_upper(solution.half);
  solution.deviance = reduced.log_determinant + logs + solution.factor.log_determinant() + reduced.squares -
                      solution.half.squaredNorm();
  return solution;
}

namespace {

Deviations scaled(const Deviations& deviations, double factor) {
  Deviations result;
  for (double Deviations::*const member : kMembers)
    result.*member = std::max(deviations.*member * factor, kSmallest);
  return result;
}

}  // namespace

double CrossedEffects::deviance(const Deviations& deviations) const {
  const Deviations standard = scaled(deviations, 1.0 / scale_);
  return solve(reduce(standard, false), standard).deviance;
}

double CrossedEffects::deviance(const Deviations& deviations, std::vector<double>& slopes) const {
  const Deviations standard = scaled(deviations, 1.0 / scale_);
  const Solution solution = solve(reduce(standard, false), standard);
  slopes.assign(kMembers.size(), 0.0);
  if (!std::isfinite(solution.deviance)) return kNone;
  // d/d ln s of the deviance for a group of n random effects u of deviation s is 2 (n - (tr C + u^T u) /
  // s^2), C their part of the inverse of Henderson's equations (Harville 1977).
  const Eigen::Index size = solution.unknowns.size();
  const Eigen::VectorXd inverse =
      solution.factor.solve_lower(Eigen::MatrixXd::Identity(size, size)).colwise().squaredNorm();
  for (std::size_t g = kEliminated; g < kMembers.size(); ++g) {
    const auto [first, count] = solution.group[g];
    if (count == 0 || standard.*kMembers[g] <= kSmallest) continue;
    const double sum =
        inverse.segment(first, count).sum() + solution.unknowns.segment(first, count).squaredNorm();
    slopes[g] = 2.0 * (static_cast<double>(count) - sum / square(standard.*kMembers[g]));
  }
  const std::array<bool, kEliminated> there{components_.repeat, true, components_.batch};
  for (std::size_t g = 0; g < kEliminated; ++g) {
    if (!there[g] || standard.*kMembers[g] <= kSmallest) continue;
    std::array<double, 2> beside{};
    for (const int side : {0, 1}) {
      Deviations moved = standard;
      moved.*kMembers[g] *= std::exp(side == 0 ? -kStep : kStep);
      beside[static_cast<std::size_t>(side)] = solve(reduce(moved, false), moved).deviance;
    }
    slopes[g] = (beside[1] - beside[0]) / (2.0 * kStep);
  }
  return solution.deviance;
}

namespace {

/// The deviance over the logarithms of the deviations that the data can have, each times the root of the
/// number of effects behind it: then all directions are about equally steep.
class Likelihood : public ceres::FirstOrderFunction {
 public:
  Likelihood(const CrossedEffects& model, std::vector<std::size_t> members, std::vector<double> steepness,
             double scale)
      : model_(model), members_(std::move(members)), steepness_(std::move(steepness)), scale_(scale) {}

  Deviations at(const double* unknowns) const {
    Deviations deviations;
    for (std::size_t i = 0; i < members_.size(); ++i)
      deviations.*kMembers[members_[i]] =
          scale_ * std::exp(std::clamp(unknowns[i] / steepness_[i], -12.0, 6.0));
    return deviations;
  }

  bool Evaluate(const double* unknowns, double* cost, double* gradient) const override {
    const Deviations deviations = at(unknowns);
    std::vector<double> slopes;
    *cost = gradient == nullptr ? model_.deviance(deviations) : model_.deviance(deviations, slopes);
    if (gradient != nullptr)
      for (std::size_t i = 0; i < members_.size(); ++i) gradient[i] = slopes[members_[i]] / steepness_[i];
    return std::isfinite(*cost);
  }
  int NumParameters() const override { return static_cast<int>(members_.size()); }

 private:
  const CrossedEffects& model_;
  std::vector<std::size_t> members_;
  std::vector<double> steepness_;
  double scale_;
};

}  // namespace

bool CrossedEffects::fit() {
  const auto count = [](auto number) { return static_cast<double>(number); };
  struct Member {
    bool there;
    double effects;
    double start;  ///< as a share of the spread
  };
  const std::array<Member, kMembers.size()> all{{{components_.repeat, count(repeated_), 0.2},
                                                 {true, count(brake_.size()), 0.7},
                                                 {components_.batch, count(batch_.size()), 0.3},
                                                 {components_.station, count(layout_.stations), 0.3},
                                                 {components_.fixture, count(layout_.fixtures), 0.1},
                                                 {components_.period, count(layout_.periods), 0.1},
                                                 {components_.wander, count(cells()), 0.1}}};
  std::vector<std::size_t> members;
  std::vector<double> steepness, unknowns;
  for (std::size_t g = 0; g < all.size(); ++g) {
    if (!all[g].there) continue;
    members.push_back(g);
    steepness.push_back(std::sqrt(4.0 * std::max(1.0, all[g].effects)));
    const double known = deviations_.*kMembers[g] / scale_;
    unknowns.push_back(steepness.back() * std::log(known > 1e-3 ? known : all[g].start));
  }
  auto* likelihood = new Likelihood(*this, members, steepness, scale_);
  const ceres::GradientProblem problem(likelihood);  // which owns it
  ceres::GradientProblemSolver::Options options;
  options.line_search_direction_type = ceres::BFGS;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = 100;
  options.function_tolerance = 1e-12;
  options.gradient_tolerance = 1e-2;  // of a standard error of a deviation
  options.parameter_tolerance = 1e-6;
  ceres::GradientProblemSolver::Summary summary;
  ceres::Solve(options, problem, unknowns.data(), &summary);
  deviations_ = likelihood->at(unknowns.data());
  return summary.termination_type == ceres::CONVERGENCE;
}

Deviations CrossedEffects::fit_without(std::initializer_list<bool Components::*> components) {
  const Components all = components_;
  const Deviations before = deviations_;
  for (bool Components::*const component : components) components_.*component = false;
  fit();
  components_ = all;
  // A member that was not fitted has stayed at zero.
  return std::exchange(deviations_, before);
}

std::vector<Evidence> CrossedEffects::evidence(const std::vector<Change>& candidates) const {
  std::vector<Evidence> found(candidates.size());
  const Deviations standard = scaled(deviations_, 1.0 / scale_);
  const Reduced reduced = reduce(standard, false);
  const Solution solution = solve(reduced, standard);
  if (!std::isfinite(solution.deviance) || candidates.empty()) return found;
  Eigen::MatrixXd shapes(cells(), static_cast<Eigen::Index>(candidates.size()));
  for (std::size_t i = 0; i < candidates.size(); ++i)
    shapes.col(static_cast<Eigen::Index>(i)) = candidates[i].shape;
  const Eigen::MatrixXd seen = reduced.information * shapes;
  const Eigen::MatrixXd half = solution.factor.solve_lower(solution.design.transpose() * seen);
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    const auto c = static_cast<Eigen::Index>(i);
    const double information = shapes.col(c).dot(seen.col(c)) - half.col(c).squaredNorm();
    const double score = shapes.col(c).dot(reduced.right) - half.col(c).dot(solution.half);
    // What is left of a shape that the others already span is rounding.
    if (information <= 1e-9 * shapes.col(c).dot(seen.col(c))) continue;
    found[i] = {scale_ * score / information, scale_ / std::sqrt(information)};
  }
  return found;
}

Levels CrossedEffects::levels() const {
  Levels levels;
  const Deviations standard = scaled(deviations_, 1.0 / scale_);
  const Reduced reduced = reduce(standard, true);
  const Solution solution = solve(reduced, standard);
  if (!std::isfinite(solution.deviance)) return levels;
  const Eigen::Index size = solution.unknowns.size();
  const Eigen::MatrixXd lower = solution.factor.solve_lower(Eigen::MatrixXd::Identity(size, size));
  if (components_.station) {
    const auto [first, count] = solution.group[3];
    // Against the mean of the stations.
    const Eigen::VectorXd predicted = solution.unknowns.segment(first, count);
    Eigen::MatrixXd halves = lower.middleCols(first, count);
    halves.colwise() -= halves.rowwise().mean().eval();
    levels.station = scale_ * (predicted.array() - predicted.mean());
    levels.station_variance = square(scale_) * halves.colwise().squaredNorm().transpose();
  }
  levels.batch = Eigen::VectorXd::Zero(layout_.batches);
  levels.batch_variance = Eigen::VectorXd::Constant(layout_.batches, square(scale_ * standard.batch));
  const Eigen::VectorXd cells_predicted = solution.design * solution.unknowns;
  for (const BatchSums& batch : reduced.batches) {
    const double share = square(standard.batch) / (1.0 + square(standard.batch) * batch.weight);
    double left = batch.reading;
    Eigen::VectorXd weights = Eigen::VectorXd::Zero(size);
    for (const auto& [cell, weight] : batch.cells) {
      left -= weight * cells_predicted[cell];
      weights += weight * solution.design.row(cell).transpose();
    }
    levels.batch[batch.number] = scale_ * share * left;
    levels.batch_variance[batch.number] =
        square(scale_) * (share + square(share) * solution.factor.solve_lower(weights).squaredNorm());
  }
  return levels;
}

double CrossedEffects::mean() const {
  const Deviations standard = scaled(deviations_, 1.0 / scale_);
  const Solution solution = solve(reduce(standard, false), standard);
  return std::isfinite(solution.deviance) ? shift_ + scale_ * solution.unknowns[0] : shift_;
}

}  // namespace clampd::attribution
