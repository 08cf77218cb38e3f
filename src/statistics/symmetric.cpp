#include "clampd/statistics/symmetric.hpp"

#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>
#include <Eigen/QR>

namespace clampd::statistics {

SymmetricFactor::SymmetricFactor(const ConstMatrix& matrix) : factor_(matrix) {}

Eigen::VectorXd SymmetricFactor::solve(const ConstVector& right) const {
  return factor_.solve(right);
}

Eigen::MatrixXd SymmetricFactor::solve_columns(const ConstMatrix& right) const {
  return factor_.solve(right);
}

Eigen::MatrixXd SymmetricFactor::inverse() const {
  return solve_columns(Eigen::MatrixXd::Identity(factor_.rows(), factor_.cols()));
}

double SymmetricFactor::smallest_pivot() const {
  if (factor_.rows() == 0) return std::numeric_limits<double>::infinity();
  if (factor_.info() != Eigen::Success) return std::numeric_limits<double>::quiet_NaN();
  return factor_.vectorD().minCoeff();
}

double SymmetricFactor::log_determinant(double smallest) const {
  const Eigen::VectorXd pivots = factor_.vectorD();
  double sum = 0.0;
  for (const double pivot : pivots) sum += std::log(pivot > smallest ? pivot : smallest);
  return sum;
}

Eigen::VectorXd deviations_of_diagonal(const ConstMatrix& matrix) {
  Eigen::VectorXd scale(matrix.rows());
  for (Eigen::Index i = 0; i < scale.size(); ++i)
    scale[i] = matrix(i, i) > 1e-300 ? std::sqrt(matrix(i, i)) : 1e-150;
  return scale;
}

Eigen::MatrixXd scaled_by(const ConstMatrix& matrix, const ConstVector& scale) {
  Eigen::MatrixXd scaled(matrix.rows(), matrix.cols());
  for (Eigen::Index j = 0; j < matrix.cols(); ++j)
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) scaled(i, j) = matrix(i, j) / (scale[i] * scale[j]);
  return scaled;
}

ScaledFactor::ScaledFactor(const ConstMatrix& matrix, double ridge) : scale_(deviations_of_diagonal(matrix)) {
  Eigen::MatrixXd scaled = scaled_by(matrix, scale_);
  for (Eigen::Index i = 0; i < scaled.rows(); ++i) scaled(i, i) += ridge;
  factor_ = SymmetricFactor(scaled);
}

Eigen::VectorXd ScaledFactor::solve(const ConstVector& right) const {
  Eigen::VectorXd scaled = right;
  for (Eigen::Index i = 0; i < scaled.size(); ++i) scaled[i] /= scale_[i];
  Eigen::VectorXd solution = factor_.solve(scaled);
  for (Eigen::Index i = 0; i < solution.size(); ++i) solution[i] /= scale_[i];
  return solution;
}

Eigen::MatrixXd ScaledFactor::solve_columns(const ConstMatrix& right) const {
  Eigen::MatrixXd columns(right.rows(), right.cols());
  for (Eigen::Index j = 0; j < right.cols(); ++j) columns.col(j) = solve(right.col(j));
  return columns;
}

Eigen::MatrixXd ScaledFactor::inverse() const {
  return scaled_by(factor_.inverse(), scale_);
}

Eigen::MatrixXd CholeskyFactor::solve_lower(const ConstMatrix& right) const {
  return factor_.matrixL().solve(right);
}

Eigen::MatrixXd CholeskyFactor::solve_upper(const ConstMatrix& right) const {
  return factor_.matrixU().solve(right);
}

double CholeskyFactor::log_determinant() const {
  return 2.0 * factor_.matrixLLT().diagonal().array().log().sum();
}

Spectrum spectrum_of(const ConstMatrix& symmetric) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(symmetric);
  return {solver.eigenvalues(), solver.eigenvectors(), solver.info() == Eigen::Success};
}

Eigen::VectorXd left_of(const ConstMatrix& columns, const ConstVector& target) {
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> factor(columns);
  const Eigen::VectorXd coefficients = factor.solve(target);
  return target - columns * coefficients;
}

Eigen::MatrixXd orthonormal_basis(const ConstMatrix& columns) {
  const Eigen::HouseholderQR<Eigen::MatrixXd> factor(columns);
  return factor.householderQ() * Eigen::MatrixXd::Identity(columns.rows(), columns.cols());
}

}  // namespace clampd::statistics
