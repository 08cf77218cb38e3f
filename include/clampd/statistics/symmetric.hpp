#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>

/// Linear algebra of symmetric matrices that are positive definite or nearly so: information and covariance. Each
/// function is compiled once, here: Eigen's factorisations are by far what takes longest to compile.
namespace clampd::statistics {

using ConstMatrix = Eigen::Ref<const Eigen::MatrixXd>;
using ConstVector = Eigen::Ref<const Eigen::VectorXd>;

/// P^T L D L^T P of a symmetric matrix.
class SymmetricFactor {
 public:
  SymmetricFactor() = default;
  explicit SymmetricFactor(const ConstMatrix& matrix);

  /// What times the matrix gives `right`: as many rows as the matrix has. A direction with a vanishing pivot gets zero.
  Eigen::VectorXd solve(const ConstVector& right) const;
  Eigen::MatrixXd solve_columns(const ConstMatrix& right) const;
  Eigen::MatrixXd inverse() const;
  /// D. All above zero if the matrix is positive definite.
  Eigen::VectorXd pivots() const { return factor_.vectorD(); }
  double smallest_pivot() const;  ///< infinity of an empty matrix, NaN where the factorisation failed
  /// ln det, with pivots below `smallest` counted as `smallest`.
  double log_determinant(double smallest) const;
  bool is_positive() const { return factor_.info() == Eigen::Success && factor_.isPositive(); }

 private:
  Eigen::LDLT<Eigen::MatrixXd> factor_;
};

/// Square roots of the diagonal; 1e-150 where that is not above zero.
Eigen::VectorXd deviations_of_diagonal(const ConstMatrix& matrix);

/// The matrix with row and column i divided by scale(i): of unit diagonal, if `scale` are the roots of its diagonal.
Eigen::MatrixXd scaled_by(const ConstMatrix& matrix, const ConstVector& scale);

/// A symmetric matrix scaled to unit diagonal, so that rounding does not depend on the unknowns' units, and `ridge` added to
/// that diagonal, so that directions that the data do not show stay where they are.
class ScaledFactor {
 public:
  ScaledFactor() = default;
  explicit ScaledFactor(const ConstMatrix& matrix, double ridge = 0.0);

  Eigen::VectorXd solve(const ConstVector& right) const;
  Eigen::MatrixXd solve_columns(const ConstMatrix& right) const;
  Eigen::MatrixXd inverse() const;
  double smallest_pivot() const { return factor_.smallest_pivot(); }  ///< of the scaled matrix
  const Eigen::VectorXd& scale() const { return scale_; }
  const SymmetricFactor& scaled() const { return factor_; }

 private:
  Eigen::VectorXd scale_;
  SymmetricFactor factor_;
};

/// Lower triangular L with L L^T = matrix.
class CholeskyFactor {
 public:
  explicit CholeskyFactor(const ConstMatrix& matrix) : factor_(matrix) {}
  bool is_positive() const { return factor_.info() == Eigen::Success; }
  Eigen::MatrixXd solve_lower(const ConstMatrix& right) const;  ///< L^-1 right
  Eigen::MatrixXd solve_upper(const ConstMatrix& right) const;  ///< L^-T right
  double log_determinant() const;                               ///< of the matrix

 private:
  Eigen::LLT<Eigen::MatrixXd> factor_;
};

/// Eigenvalues, the smallest first, and a unit eigenvector a column. `ok` is false if the iteration failed.
struct Spectrum {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
  bool ok = false;
};
Spectrum spectrum_of(const ConstMatrix& symmetric);

/// What is left of `target` when the columns have explained of it, by least squares, what they can.
Eigen::VectorXd left_of(const ConstMatrix& columns, const ConstVector& target);

/// Orthonormal columns that span what the given ones do: rows × columns, at least as many rows as columns.
Eigen::MatrixXd orthonormal_basis(const ConstMatrix& columns);

}  // namespace clampd::statistics
