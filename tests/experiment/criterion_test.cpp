#include "clampd/experiment/criterion.hpp"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace clampd {
namespace {

ParameterMatrix some_information(unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  Eigen::Matrix<double, 20, static_cast<int>(kParameterCount)> rows;
  for (double& value : rows.reshaped()) value = 30.0 * normal(random);
  return rows.transpose() * rows;
}

TEST(Criterion, OfADiagonalInformation) {
  ParameterMatrix information = ParameterMatrix::Zero();
  for (int i = 0; i < 7; ++i) information(i, i) = std::pow(10.0, i);
  const Criterion criterion = criterion_of(information);
  EXPECT_NEAR(criterion.logdet, -21.0 * std::log(10.0), 1e-9);
  EXPECT_NEAR(criterion.trace_inverse, 1.111111, 1e-9);
}

TEST(Criterion, SingularInformationIsInfinitelyBad) {
  ParameterMatrix information = some_information(1);
  information.row(3).setZero();
  information.col(3).setZero();
  EXPECT_TRUE(std::isinf(criterion_of(information).logdet));
  EXPECT_TRUE(std::isinf(criterion_of(information).trace_inverse));
  for (const Objective objective : {Objective::D, Objective::A}) {
    EXPECT_TRUE(std::isinf(evaluate(objective, information).value));
    EXPECT_TRUE(evaluate(objective, information).slope.isZero());
  }
}

TEST(Criterion, SlopeIsTheDerivative) {
  const ParameterMatrix information = some_information(2);
  ParameterMatrix direction = some_information(3) - some_information(4);
  direction *= information.norm() / direction.norm();
  for (const Objective objective : {Objective::D, Objective::A}) {
    const double step = 1e-6;
    const double above = evaluate(objective, information + step * direction).value;
    const double below = evaluate(objective, information - step * direction).value;
    const double slope = (evaluate(objective, information).slope * direction).trace();
    EXPECT_NEAR((above - below) / (2.0 * step), slope, 1e-6 * std::abs(slope));
  }
}

TEST(Criterion, NamesOfObjectives) {
  EXPECT_EQ(parse_objective("d"), Objective::D);
  EXPECT_EQ(parse_objective("a"), Objective::A);
  EXPECT_FALSE(parse_objective("robust"));
  EXPECT_FALSE(parse_objective(""));
}

}  // namespace
}  // namespace clampd
