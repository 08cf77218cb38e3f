#include "src/drive/regression.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/assert.hpp"
#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::drive {

Regression regress(const Eigen::MatrixXd& columns, const Eigen::VectorXd& target,
                   std::span<const int> block) {
  const Eigen::Index n = columns.rows();
  const Eigen::Index p = columns.cols();
  CLAMPD_ASSERT(static_cast<std::size_t>(n) == block.size() && target.size() == n);
  Regression result;
  result.blocks = block.empty() ? 0 : 1 + *std::max_element(block.begin(), block.end());
  const auto blocks = static_cast<std::size_t>(result.blocks);
  const Eigen::VectorXd scale = columns.colwise().norm().cwiseMax(1e-300);
  const Eigen::MatrixXd scaled = columns * scale.cwiseInverse().asDiagonal();

  std::vector<Eigen::MatrixXd> gram(blocks, Eigen::MatrixXd::Zero(p, p));
  std::vector<Eigen::VectorXd> score(blocks, Eigen::VectorXd::Zero(p));
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto b = static_cast<std::size_t>(block[static_cast<std::size_t>(i)]);
    gram[b].noalias() += scaled.row(i).transpose() * scaled.row(i);
  }
  Eigen::MatrixXd total = Eigen::MatrixXd::Zero(p, p);
  for (const Eigen::MatrixXd& each : gram) total += each;
  const Eigen::MatrixXd inverse = statistics::SymmetricFactor(total).inverse();
  const Eigen::VectorXd beta = inverse * (scaled.transpose() * target);
  result.residuals = target - scaled * beta;
  result.residual_square = result.residuals.squaredNorm();
  result.in_square.assign(blocks, 0.0);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto b = static_cast<std::size_t>(block[static_cast<std::size_t>(i)]);
    score[b] += scaled.row(i).transpose() * result.residuals[i];
    result.in_square[b] += result.residuals[i] * result.residuals[i];
  }

  Eigen::MatrixXd meat = Eigen::MatrixXd::Zero(p, p);
  Eigen::MatrixXd jackknife = Eigen::MatrixXd::Zero(p, p);
  int usable = 0;
  for (std::size_t b = 0; b < blocks; ++b) {
    meat.noalias() += score[b] * score[b].transpose();
    const Eigen::MatrixXd rest = total - gram[b];
    const statistics::SymmetricFactor factor(rest);
    const Eigen::MatrixXd rest_inverse = factor.inverse();
    constexpr double kLostInformation = 30.0;
    bool known = factor.is_positive() && rest_inverse.allFinite();
    for (Eigen::Index j = 0; known && j < p; ++j)
      known = rest_inverse(j, j) > 0.0 && rest_inverse(j, j) < kLostInformation * inverse(j, j);
    result.judged.push_back(known);
    if (!known) {
      result.heldout_square.push_back(0.0);
      continue;
    }
    // Leaving a block out moves the coefficients by -rest^-1 score.
    const Eigen::VectorXd step = rest_inverse * score[b];
    jackknife.noalias() += step * step.transpose();
    ++usable;
    result.heldout_square.push_back(
        std::max(0.0, result.in_square[b] + 2.0 * step.dot(score[b]) + step.dot(gram[b] * step)));
  }
  const double groups = static_cast<double>(std::max(usable, 2));
  const double all_groups = static_cast<double>(std::max<std::size_t>(blocks, 2));
  const auto unscale = scale.cwiseInverse().asDiagonal();
  result.coefficients = unscale * beta;
  result.jackknife = unscale * (jackknife * (groups - 1.0) / groups) * unscale;
  result.clustered = unscale * (inverse * meat * inverse * all_groups / (all_groups - 1.0)) * unscale;
  return result;
}

double Regression::significance_of_last(int count) const {
  if (blocks <= count + 1) return 0.0;
  const Eigen::VectorXd tail = coefficients.tail(count);
  const Eigen::MatrixXd covariance = jackknife.bottomRightCorner(count, count);
  const statistics::SymmetricFactor factor(covariance);
  if (!factor.is_positive()) return 0.0;
  const double square = tail.dot(factor.solve(tail));
  if (!std::isfinite(square) || square <= 0.0) return 0.0;
  const double statistic = square * (blocks - count) / (count * (blocks - 1.0));
  return -std::log(std::max(1e-300, statistics::fisher_f_p_value(statistic, count, blocks - count)));
}

double share_of_its_own(const Eigen::MatrixXd& others, const Eigen::VectorXd& column) {
  const double square = column.squaredNorm();
  if (!(square > 0.0)) return 0.0;
  if (others.cols() == 0) return 1.0;
  return statistics::left_of(others, column).squaredNorm() / square;
}

double effective_size(const Eigen::VectorXd& residuals) {
  const Eigen::Index n = residuals.size();
  const double square = residuals.squaredNorm();
  if (n < 8 || !(square > 0.0)) return static_cast<double>(n);
  double inflation = 1.0;
  for (Eigen::Index lag = 1; lag < n / 4; ++lag) {
    const double correlation = residuals.head(n - lag).dot(residuals.tail(n - lag)) / square;
    if (correlation < 2.0 / std::sqrt(static_cast<double>(n))) break;
    inflation += 2.0 * correlation;
  }
  return static_cast<double>(n) / inflation;
}

}  // namespace clampd::drive
