#include "clampd/statistics/symmetric.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace clampd::statistics {
namespace {

/// Of units that differ by eight orders of magnitude, as a brake's parameters do.
Eigen::MatrixXd badly_scaled() {
  Eigen::MatrixXd matrix(3, 3);
  matrix << 4.0, 2e-4, 1e4,  //
      2e-4, 9e-8, 0.3,       //
      1e4, 0.3, 1e8;
  return matrix;
}

TEST(SymmetricMatrix, IsSolvedAndInverted) {
  const Eigen::MatrixXd matrix = badly_scaled();
  const Eigen::Vector3d solution(1.0, -2e4, 3e-4);
  const Eigen::VectorXd right = matrix * solution;
  const ScaledFactor scaled(matrix);
  EXPECT_LT((SymmetricFactor(matrix).solve(right) - solution).cwiseQuotient(solution).norm(), 1e-9);
  EXPECT_LT((scaled.solve(right) - solution).cwiseQuotient(solution).norm(), 1e-12);
  EXPECT_LT((scaled.inverse() * matrix - Eigen::Matrix3d::Identity()).norm(), 1e-6);
  EXPECT_TRUE(SymmetricFactor(matrix).is_positive());
  EXPECT_NEAR(SymmetricFactor(matrix).log_determinant(0.0), std::log(matrix.determinant()), 1e-9);
}

TEST(SymmetricMatrix, OfADirectionThatNothingShowsTheRidgeLeavesTheUnknownWhereItIs) {
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(2, 2);
  matrix(0, 0) = 4.0;
  const Eigen::VectorXd step = ScaledFactor(matrix, 1e-10).solve(Eigen::Vector2d(8.0, 0.0));
  EXPECT_NEAR(step[0], 2.0, 1e-8);
  EXPECT_EQ(step[1], 0.0);
  EXPECT_FALSE(SymmetricFactor(-matrix).is_positive());
}

TEST(SymmetricMatrix, SaysWhatIsNotDefinite) {
  Eigen::MatrixXd indefinite(2, 2);
  indefinite << 1.0, 2.0, 2.0, 1.0;
  EXPECT_LT(SymmetricFactor(indefinite).smallest_pivot(), 0.0);
  EXPECT_FALSE(CholeskyFactor(indefinite).is_positive());
  EXPECT_EQ(SymmetricFactor(Eigen::MatrixXd(0, 0)).smallest_pivot(), std::numeric_limits<double>::infinity());
}

TEST(SymmetricMatrix, WhitensWhatHasThisCovariance) {
  const Eigen::MatrixXd matrix = badly_scaled();
  const CholeskyFactor factor(matrix);
  const Eigen::MatrixXd half = factor.solve_lower(matrix);
  EXPECT_LT((factor.solve_lower(half.transpose()) - Eigen::Matrix3d::Identity()).norm(), 1e-7);
  EXPECT_LT((factor.solve_upper(half) - Eigen::Matrix3d::Identity()).norm(), 1e-7);
}

TEST(SymmetricMatrix, IsTakenApartIntoItsDirections) {
  Eigen::MatrixXd matrix(2, 2);
  matrix << 2.0, 1.0, 1.0, 2.0;
  const Spectrum spectrum = spectrum_of(matrix);
  ASSERT_TRUE(spectrum.ok);
  EXPECT_NEAR(spectrum.values[0], 1.0, 1e-14);
  EXPECT_NEAR(spectrum.values[1], 3.0, 1e-14);
  EXPECT_NEAR(std::abs(spectrum.vectors(0, 1)), std::sqrt(0.5), 1e-14);
}

TEST(LeastSquares, LeavesWhatTheColumnsCannotExplainAlsoWhenTheyRepeatEachOther) {
  Eigen::MatrixXd columns(4, 3);
  columns << 1, 1, 2,  //
      1, 2, 4,         //
      1, 3, 6,         //
      1, 4, 8;
  const Eigen::Vector4d target(1.0, 2.0, 3.0, 8.0);
  const Eigen::VectorXd left = left_of(columns, target);
  EXPECT_LT((columns.transpose() * left).norm(), 1e-12);
  EXPECT_NEAR(left.squaredNorm(), 4.8, 1e-12);  // squares about the mean, 29, less 24.2 of the slope 2.2
  const Eigen::MatrixXd basis = orthonormal_basis(columns.leftCols(2));
  EXPECT_LT((basis.transpose() * basis - Eigen::Matrix2d::Identity()).norm(), 1e-14);
  EXPECT_LT((left_of(columns, target) - (target - basis * (basis.transpose() * target))).norm(), 1e-12);
}

}  // namespace
}  // namespace clampd::statistics
