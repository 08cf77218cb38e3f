#include "src/drive/design.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::drive {
namespace {

constexpr int kLeastBlocks = 24, kMostBlocks = 60;
/// A column is collinear if the others leave no more than this share of its square.
constexpr double kLeastOfItsOwn = 1e-7;
/// A fold cannot be judged where the others know some coefficient so much less well.
constexpr double kLostInformation = 30.0;

struct Solution {
  Eigen::VectorXd coefficients;
  Eigen::MatrixXd inverse;
  bool ok = false;
};

/// Scaled to unit diagonal, so that units do not matter.
Solution solved(const Eigen::MatrixXd& gram, const Eigen::VectorXd& right) {
  Solution solution;
  if (gram.rows() == 0) return {Eigen::VectorXd(0), gram, true};
  if (!(gram.diagonal().minCoeff() > 0.0) || !gram.allFinite()) return solution;
  const statistics::ScaledFactor factor(gram);
  if (!(factor.smallest_pivot() > kLeastOfItsOwn)) return solution;
  solution.coefficients = factor.solve(right);
  solution.inverse = factor.inverse();
  solution.ok = solution.coefficients.allFinite() && solution.inverse.allFinite();
  return solution;
}

/// What coefficients leave of a block, by its products.
double square_left(const Eigen::VectorXd& coefficients, const Eigen::MatrixXd& gram,
                   const Eigen::VectorXd& right, double square) {
  return std::max(0.0, square - 2.0 * coefficients.dot(right) + coefficients.dot(gram * coefficients));
}

}  // namespace

Design::Design(const DriveData& data, const RowNoise& noise)
    : data_(data), noise_(noise), whitener_(data, noise) {
  for (const DriveRows& run : data.runs) count_ += static_cast<Eigen::Index>(run.size());
  divide_into_blocks();
  known_ = Eigen::VectorXd::Zero(count_);
}

void Design::divide_into_blocks() {
  for (const DriveRows& run : data_.runs)
    if (!run.heldout) fitted_rows_ += static_cast<double>(run.size());
  const double memory_rows = noise_.memory_share > 0.05 && data_.cut_off_Hz > 0.0
                                 ? noise_.memory_s * data_.cut_off_Hz / kRowsPerCutOff
                                 : 1.0;
  const double blocks = std::clamp(fitted_rows_ / std::max(4.0, 4.0 * memory_rows),
                                   static_cast<double>(kLeastBlocks), static_cast<double>(kMostBlocks));
  const double wanted = std::max(1.0, fitted_rows_ / blocks);
  std::vector<std::pair<Eigen::Index, Eigen::Index>> heldout;
  Eigen::Index first = 0;
  for (const DriveRows& run : data_.runs) {
    const auto size = static_cast<Eigen::Index>(run.size());
    const auto parts = std::max<Eigen::Index>(1, std::llround(static_cast<double>(size) / wanted));
    for (Eigen::Index p = 0; p < parts; ++p) {
      const Eigen::Index from = first + size * p / parts, to = first + size * (p + 1) / parts;
      if (to > from) (run.heldout ? heldout : blocks_).emplace_back(from, to - from);
    }
    first += size;
  }
  fitted_blocks_ = static_cast<int>(blocks_.size());
  blocks_.insert(blocks_.end(), heldout.begin(), heldout.end());
}

Eigen::VectorXd Design::rows_of(const BasisFunction& function) const {
  using Factor = BasisFunction::Factor;
  Eigen::VectorXd result(count_);
  Eigen::Index first = 0;
  const bool periodic = function.factor == Factor::Sine || function.factor == Factor::Cosine;
  using Carrier = BasisFunction::Carrier;
  for (const DriveRows& run : data_.runs) {
    if (function.factor == Factor::One &&
        (function.carrier == Carrier::Acceleration || function.carrier == Carrier::Velocity)) {
      result.segment(first, static_cast<Eigen::Index>(run.size())) =
          function.carrier == Carrier::Velocity ? run.velocity : run.acceleration;
      first += static_cast<Eigen::Index>(run.size());
      continue;
    }
    const DriveMotion& motion = run.motion;
    std::vector<double> samples(motion.time_s.size()), columns, lacking;
    if (function.factor == Factor::Reversal) lacking = motion.lacking_friction(function.first);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      if (lacking.empty())
        samples[i] = value_of(function, motion.state(i, run.run, columns));
      else
        samples[i] =
            lacking[i] * (function.carrier == Carrier::Velocity ? std::abs(motion.velocity[i]) : 1.0);
      // What turns by more than four fifths of half a period from one reading to the next is an alias of
      // something else.
      if (periodic && function.first * std::abs(motion.velocity[i]) * data_.sample_s > 0.8 * M_PI)
        samples[i] = 0.0;
    }
    const auto size = static_cast<Eigen::Index>(run.size());
    result.segment(first, size) = run.filtered(samples);
    first += size;
  }
  return result;
}

int Design::column(const BasisFunction& function) {
  for (const auto& [known, number] : functions_)
    if (known == function) return number;
  const int number = add(rows_of(function));
  functions_.emplace_back(function, number);
  return number;
}

int Design::target(const Actuation& actuation) {
  const auto found = targets_.find(actuation);
  if (found != targets_.end()) return found->second;
  Eigen::VectorXd torque(count_);
  Eigen::Index first = 0;
  for (const DriveRows& run : data_.runs) {
    torque.segment(first, static_cast<Eigen::Index>(run.size())) = run.torque_at(actuation);
    first += static_cast<Eigen::Index>(run.size());
  }
  const int number = add(torque - known_);
  targets_[actuation] = number;
  if (actuation.saturation.loss > 0.0 || actuation.settling_s > 0.0)
    scales_[number] = scale_of_readings(actuation);
  return number;
}

/// What changes the readings changes their noise, too: else whatever makes the torque small would explain it.
/// A law of the reading: the density of the readings has the product of its slopes as a factor (change of
/// variables). A time constant: what it takes off the variation.
double Design::scale_of_readings(const Actuation& actuation) {
  double log_slope = 0.0;
  Actuation linear = actuation;
  linear.saturation = {};
  for (const DriveRows& run : data_.runs)
    for (const double reading : run.torque_at(linear))
      log_slope += std::log(actuation.saturation.slope(reading));
  const double scale = std::exp(-log_slope / static_cast<double>(count_));
  if (!(actuation.settling_s > 0.0)) return scale;
  const auto variation = [&](const Actuation& of) {
    const Eigen::VectorXd& torque = raw(target(of));
    return (torque.array() - torque.mean()).matrix().norm();
  };
  const double settled = variation(linear);
  return settled > 0.0 ? scale * variation({}) / settled : scale;
}

int Design::add(const Eigen::VectorXd& raw) {
  raw_.push_back(raw);
  whitened_.push_back(whitener_(raw));
  products_.emplace_back(raw_.size());
  return static_cast<int>(raw_.size()) - 1;
}

const Eigen::VectorXd& Design::products(int one, int other) const {
  const auto larger = static_cast<std::size_t>(std::max(one, other)),
             smaller = static_cast<std::size_t>(std::min(one, other));
  Eigen::VectorXd& known = products_[larger][smaller];
  if (known.size() > 0) return known;
  known = Eigen::VectorXd::Zero(blocks() + 1);
  for (int b = 0; b < blocks(); ++b) {
    const auto [from, length] = block(b);
    known[b] = whitened_[larger].segment(from, length).dot(whitened_[smaller].segment(from, length));
    if (b < fitted_blocks_) known[blocks()] += known[b];
  }
  return known;
}

void Design::products_of(const Fit& fit, int block, Eigen::MatrixXd& gram, Eigen::VectorXd& right,
                         double& square) const {
  const auto all = [&](int one, int other) { return products(one, other)[block < 0 ? blocks() : block]; };
  const auto count = static_cast<Eigen::Index>(fit.columns.size());
  gram.resize(count, count);
  right.resize(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const int column = fit.columns[static_cast<std::size_t>(i)];
    right[i] = all(column, fit.target);
    for (Eigen::Index j = 0; j < count; ++j)
      gram(i, j) = all(column, fit.columns[static_cast<std::size_t>(j)]);
  }
  square = all(fit.target, fit.target);
}

Fit Design::fit(std::vector<int> columns, int target) const {
  Fit fit{std::move(columns), target, {}, 0.0, false};
  Eigen::MatrixXd gram;
  Eigen::VectorXd right;
  double square = 0.0;
  products_of(fit, -1, gram, right, square);
  const Solution solution = solved(gram, right);
  fit.ok = solution.ok;
  if (!fit.ok) return fit;
  fit.coefficients = solution.coefficients;
  fit.square = std::max(square - right.dot(fit.coefficients), 1e-12 * square) * std::pow(scale_of(fit), 2);
  return fit;
}

std::vector<double> Design::left_out(const Fit& fit) const {
  Eigen::MatrixXd gram, block_gram;
  Eigen::VectorXd right, block_right;
  double square = 0.0, block_square = 0.0;
  products_of(fit, -1, gram, right, square);
  const Solution all = solved(gram, right);
  if (!all.ok) return {};
  std::vector<double> result(static_cast<std::size_t>(fitted_blocks_), 0.0);
  for (int fold = 0; fold < kFolds; ++fold) {
    Eigen::MatrixXd rest = gram;
    Eigen::VectorXd rest_right = right;
    for (int b = fold; b < fitted_blocks_; b += kFolds) {
      products_of(fit, b, block_gram, block_right, block_square);
      rest -= block_gram;
      rest_right -= block_right;
    }
    const Solution others = solved(rest, rest_right);
    bool known = others.ok;
    for (Eigen::Index j = 0; known && j < rest.rows(); ++j)
      known = others.inverse(j, j) < kLostInformation * all.inverse(j, j);
    for (int b = fold; !known && b < fitted_blocks_; b += kFolds)
      result[static_cast<std::size_t>(b)] = std::numeric_limits<double>::quiet_NaN();
    for (int b = fold; known && b < fitted_blocks_; b += kFolds) {
      products_of(fit, b, block_gram, block_right, block_square);
      result[static_cast<std::size_t>(b)] =
          square_left(others.coefficients, block_gram, block_right, block_square) *
          std::pow(scale_of(fit), 2);
    }
  }
  return result;
}

std::vector<double> Design::squares(const Fit& fit, int from_block, int to_block) const {
  std::vector<double> result;
  Eigen::MatrixXd gram;
  Eigen::VectorXd right;
  double square = 0.0;
  for (int b = from_block; b < to_block; ++b) {
    products_of(fit, b, gram, right, square);
    result.push_back(square_left(fit.coefficients, gram, right, square) * std::pow(scale_of(fit), 2));
  }
  return result;
}

std::vector<double> Design::fitted_squares(const Fit& fit) const {
  return squares(fit, 0, fitted_blocks_);
}

std::vector<double> Design::held_out(const Fit& fit) const {
  return squares(fit, fitted_blocks_, blocks());
}

Eigen::MatrixXd Design::covariance(const Fit& fit) const {
  Eigen::MatrixXd gram, block_gram;
  Eigen::VectorXd right, block_right;
  double square = 0.0, block_square = 0.0;
  products_of(fit, -1, gram, right, square);
  const auto count = gram.rows();
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(count, count);
  int usable = 0;
  for (int b = 0; b < fitted_blocks_; ++b) {
    products_of(fit, b, block_gram, block_right, block_square);
    const Solution others = solved(gram - block_gram, right - block_right);
    if (!others.ok) continue;
    const Eigen::VectorXd step = others.coefficients - fit.coefficients;
    result += step * step.transpose();
    ++usable;
  }
  if (usable < 3) return Eigen::MatrixXd::Constant(count, count, std::numeric_limits<double>::quiet_NaN());
  return result * (usable - 1.0) / usable;
}

double Design::significance_of_last(const Fit& fit, int count) const {
  if (!fit.ok || fitted_blocks_ <= count + 1) return 0.0;
  const Eigen::MatrixXd all = covariance(fit);
  const Eigen::VectorXd tail = fit.coefficients.tail(count);
  const Eigen::MatrixXd part = all.bottomRightCorner(count, count);
  if (!part.allFinite() || !(part.diagonal().minCoeff() > 0.0)) return 0.0;
  const statistics::ScaledFactor factor(part);
  if (!(factor.smallest_pivot() > 1e-12)) return 0.0;
  const double square = tail.dot(factor.solve(tail));
  if (!std::isfinite(square) || square <= 0.0) return 0.0;
  const double statistic = square * (fitted_blocks_ - count) / (count * (fitted_blocks_ - 1.0));
  return -std::log(std::max(1e-300, statistics::fisher_f_p_value(statistic, count, fitted_blocks_ - count)));
}

double Design::overdispersion(const Fit& fit) const {
  if (!fit.ok) return 1.0;
  Eigen::MatrixXd gram, block_gram;
  Eigen::VectorXd right, block_right;
  double square = 0.0, block_square = 0.0;
  products_of(fit, -1, gram, right, square);
  const auto count = gram.rows();
  if (count == 0) return 1.0;
  const double variance = fit.square / std::max(1.0, fitted_rows_ - static_cast<double>(count));
  Eigen::VectorXd scores = Eigen::VectorXd::Zero(count);
  for (int b = 0; b < fitted_blocks_; ++b) {
    products_of(fit, b, block_gram, block_right, block_square);
    scores += std::pow(scale_of(fit), 2) * (block_right - block_gram * fit.coefficients).cwiseAbs2();
  }
  const Eigen::VectorXd ratios = scores.cwiseQuotient(variance * gram.diagonal());
  return std::max(1.0, ratios.mean() * fitted_blocks_ / std::max(1.0, fitted_blocks_ - 1.0));
}

double Design::log_occam(const std::vector<int>& columns, int target, double variance) const {
  const auto count = static_cast<Eigen::Index>(columns.size());
  Eigen::MatrixXd matrix(count, count);
  const double torque = root_mean_square(target);
  for (Eigen::Index i = 0; i < count; ++i) {
    const int a = columns[static_cast<std::size_t>(i)];
    const double prior_a = torque / std::max(1e-300, root_mean_square(a));
    for (Eigen::Index j = 0; j < count; ++j) {
      const int b = columns[static_cast<std::size_t>(j)];
      matrix(i, j) =
          prior_a * torque / std::max(1e-300, root_mean_square(b)) * products(a, b)[blocks()] / variance;
    }
    matrix(i, i) += 1.0;
  }
  if (!matrix.allFinite()) return std::numeric_limits<double>::infinity();
  return 0.5 * statistics::SymmetricFactor(matrix).log_determinant(1e-12);
}

double Design::root_mean_square(int column) const {
  const Eigen::VectorXd& values = raw(column);
  double square = 0.0;
  for (int b = 0; b < fitted_blocks_; ++b)
    square += values.segment(block(b).first, block(b).second).squaredNorm();
  return std::sqrt(square / std::max(1.0, fitted_rows_));
}

namespace {

/// Of the target, with `column` giving each column as it is or whitened.
Eigen::VectorXd left_by(const Fit& fit, const auto& column) {
  Eigen::VectorXd result = column(fit.target);
  for (Eigen::Index i = 0; i < fit.coefficients.size(); ++i)
    result -= fit.coefficients[i] * column(fit.columns[static_cast<std::size_t>(i)]);
  return result;
}

}  // namespace

Eigen::VectorXd Design::residuals(const Fit& fit) const {
  return scale_of(fit) * left_by(fit, [this](int column) -> decltype(auto) { return raw(column); });
}

Eigen::VectorXd Design::whitened_residuals(const Fit& fit) const {
  return scale_of(fit) * left_by(fit, [this](int column) -> decltype(auto) { return whitened(column); });
}

}  // namespace clampd::drive
