#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "src/drive/noise.hpp"
#include "src/drive/rows.hpp"

namespace clampd::drive {

/// A least-squares fit of some columns of a Design to one of its columns.
struct Fit {
  std::vector<int> columns;
  int target = 0;
  Eigen::VectorXd coefficients;
  double square = 0.0;  ///< whitened sum of squares that is left
  bool ok = false;      ///< false: the columns are collinear
};

/// Whitened columns of all rows, and the products of two of them, block of rows by block. Every fit, every
/// block left out and every comparison then costs no more than a few small matrices, on the same rows with
/// the same likelihood. Products are kept once they were asked for, so that not even a const Design may be
/// used by two threads.
class Design {
 public:
  Design(const DriveData& data, const RowNoise& noise);

  /// The function's column, computed once; returns its number.
  int column(const BasisFunction& function);
  /// A column of its own, one value a row; returns its number.
  int add(const Eigen::VectorXd& raw);
  /// The torque as DriveRows::torque_at(), less the known torques. What a fit to it leaves is scaled so that
  /// it is a share of the reading's variation.
  int target(const Actuation& actuation);
  /// Subtracts `known` from the torque; before any target is asked for.
  void set_known(Eigen::VectorXd known) { known_ = std::move(known); }

  Fit fit(std::vector<int> columns, int target) const;
  /// Whitened squares that fits to the other folds leave, block by block; NaN where the other folds hardly
  /// know some coefficient.
  std::vector<double> left_out(const Fit& fit) const;
  /// Of the fit to all, block by block.
  std::vector<double> fitted_squares(const Fit& fit) const;
  /// Of each block that takes part in no fit.
  std::vector<double> held_out(const Fit& fit) const;
  /// -ln p of Hotelling's test that the last `count` coefficients are zero, by the scatter among blocks.
  double significance_of_last(const Fit& fit, int count) const;
  /// By leaving out one block after the other.
  Eigen::MatrixXd covariance(const Fit& fit) const;
  /// How much more the blocks' scores scatter than the noise model says, on average over the columns.
  double overdispersion(const Fit& fit) const;
  /// Logarithm of the determinant of the columns' products over the noise's variance, each with the prior
  /// that its torque is about as large as all of it.
  double log_occam(const std::vector<int>& columns, int target, double variance) const;

  /// Not whitened, all rows; of a fit that is not ok all of the target.
  Eigen::VectorXd residuals(const Fit& fit) const;
  double scale_of(const Fit& fit) const {
    const auto found = scales_.find(fit.target);
    return found == scales_.end() ? 1.0 : found->second;
  }
  Eigen::VectorXd whitened_residuals(const Fit& fit) const;
  const Eigen::VectorXd& raw(int column) const { return raw_[static_cast<std::size_t>(column)]; }
  const Eigen::VectorXd& whitened(int column) const { return whitened_[static_cast<std::size_t>(column)]; }
  double root_mean_square(int column) const;  ///< not whitened, fitted rows

  const DriveData& data() const { return data_; }
  const RowNoise& noise() const { return noise_; }
  Eigen::Index rows() const { return count_; }
  double fitted_rows() const { return fitted_rows_; }
  int blocks() const { return static_cast<int>(blocks_.size()); }
  int fitted_blocks() const { return fitted_blocks_; }
  /// First row and number of rows; held-out blocks come last.
  std::pair<Eigen::Index, Eigen::Index> block(int number) const {
    return blocks_[static_cast<std::size_t>(number)];
  }
  int fold_of(int block) const { return block % kFolds; }
  static constexpr int kFolds = 5;

  /// One value a sample, made a column's rows.
  Eigen::VectorXd rows_of(const BasisFunction& function) const;

 private:
  void divide_into_blocks();
  std::vector<double> squares(const Fit& fit, int from_block, int to_block) const;
  /// Of two whitened columns, one value a block, and at last their sum over the fitted blocks.
  const Eigen::VectorXd& products(int one, int other) const;
  void products_of(const Fit& fit, int block, Eigen::MatrixXd& gram, Eigen::VectorXd& right,
                   double& square) const;

  const DriveData& data_;
  RowNoise noise_;
  Whitener whitener_;
  Eigen::Index count_ = 0;
  double fitted_rows_ = 0.0;
  int fitted_blocks_ = 0;
  std::vector<std::pair<Eigen::Index, Eigen::Index>> blocks_;
  std::vector<Eigen::VectorXd> raw_, whitened_;
  /// Of two columns with each other, when first asked for: row by row of a lower triangle.
  mutable std::vector<std::vector<Eigen::VectorXd>> products_;
  Eigen::VectorXd known_;
  double scale_of_readings(const Actuation& actuation);

  std::vector<std::pair<BasisFunction, int>> functions_;
  std::map<Actuation, int> targets_;
  std::map<int, double> scales_;  ///< of targets that are no reading
};

}  // namespace clampd::drive
