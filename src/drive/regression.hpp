#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

namespace clampd::drive {

/// Least squares whose uncertainty comes from the scatter among blocks of rows: right whatever the noise
/// looks like within a block.
struct Regression {
  Eigen::VectorXd coefficients;
  Eigen::VectorXd residuals;
  Eigen::MatrixXd jackknife;  ///< covariance, from leaving out one block after the other
  Eigen::MatrixXd clustered;  ///< covariance, from the blocks' scores; for many small blocks
  double residual_square = 0.0;
  std::vector<double> heldout_square;  ///< of each block, by the fit to the others
  std::vector<double> in_square;       ///< of each block, by the fit to all
  /// Per block: false if the others alone hardly know some coefficient, so that they cannot judge this block.
  std::vector<bool> judged;
  int blocks = 0;

  /// Hotelling's test that the last `count` coefficients are zero; returns -ln p.
  double significance_of_last(int count) const;
};

/// `block`: 0, 1, ... of each row. Columns must not be collinear.
Regression regress(const Eigen::MatrixXd& columns, const Eigen::VectorXd& target, std::span<const int> block);

/// Share of the column's square that the others do not reproduce.
double share_of_its_own(const Eigen::MatrixXd& others, const Eigen::VectorXd& column);

/// Samples worth of independent ones: size over the variance inflation by autocorrelation.
double effective_size(const Eigen::VectorXd& residuals);

}  // namespace clampd::drive
