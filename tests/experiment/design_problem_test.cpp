#include "src/experiment/design_problem.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "experiment/designs.hpp"

namespace clampd {
namespace {

std::vector<double> shares(const std::vector<double>& blocks_Nm, double limit_Nm) {
  std::vector<double> x = blocks_Nm;
  for (double& share : x) share *= 0.99 / limit_Nm;  // off the bounds, for differences
  return x;
}

DesignOptions options_for(Objective objective) {
  DesignOptions options;
  options.samples = 200;
  options.objective = objective;
  options.limits.end_velocity_rad_s = 5.0;
  options.limits.amplification_rad_s_Nm = 100.0;
  return options;
}

TEST(DesignProblem, InformationIsThatOfTheIdentification) {
  const DesignOptions options = options_for(Objective::D);
  DesignProblem problem(options, 0.0);
  const std::vector<double> x = shares(testing::kGoodBlocks_Nm, options.limits.torque_Nm);
  problem.evaluate(x);
  std::vector<double> blocks_Nm = x;
  for (double& torque : blocks_Nm) torque *= options.limits.torque_Nm;
  const std::vector<double> torque_Nm = expand_blocks(blocks_Nm, options.block_samples);
  SensitivitySimulation buffer(torque_Nm.size());
  const ParameterMatrix expected = initial_state_known(joint_information(
      options.brake, options.initial, Excitation{.torque_Nm = torque_Nm}, options.noise, buffer));
  EXPECT_LT((problem.information() - expected).norm(), 1e-9 * expected.norm());
}

TEST(DesignProblem, GradientsAreTheDerivatives) {
  for (const Objective objective : {Objective::D, Objective::A}) {
    const DesignOptions options = options_for(objective);
    DesignProblem problem(options, 1e-3);
    const std::vector<double> x = shares(testing::kGoodBlocks_Nm, options.limits.torque_Nm);
    problem.differentiate(x);
    const Eigen::VectorXd gradient = problem.objective_gradient();
    const Eigen::MatrixXd constraint_gradient = problem.constraint_gradient();
    ASSERT_EQ(problem.constraints(), 22U);
    const double step = 1e-6;
    for (std::size_t block = 0; block < x.size(); ++block) {
      std::vector<double> moved = x;
      moved[block] = x[block] + step;
      problem.evaluate(moved);
      const double above = problem.objective();
      const Eigen::VectorXd constraint_above = problem.constraint_values();
      moved[block] = x[block] - step;
      problem.evaluate(moved);
      const auto column = static_cast<Eigen::Index>(block);
      EXPECT_NEAR((above - problem.objective()) / (2.0 * step), gradient[column],
                  1e-4 * (1.0 + gradient.norm()))
          << to_string(objective) << ", block " << block;
      const Eigen::VectorXd slope = (constraint_above - problem.constraint_values()) / (2.0 * step);
      EXPECT_LT((slope - constraint_gradient.col(column)).norm(),
                1e-4 * (1.0 + constraint_gradient.col(column).norm()))
          << to_string(objective) << ", block " << block;
    }
  }
}

TEST(DesignProblem, GradientsGoThroughStickAndReversal) {
  // Ends at rest under load after a reversal; creeps towards it.
  DesignOptions options;
  DesignProblem problem(options, 0.0);
  const std::vector<double> x = shares({0.305, 2.993, 1.424, 0.315, 0.441, 0.534, 0.802, -2.748, 0.824, 1.492,
                                        1.563, -0.472, -0.202, -0.103, 0.011},
                                       options.limits.torque_Nm);
  problem.differentiate(x);
  const Eigen::VectorXd gradient = problem.objective_gradient();
  for (std::size_t block = 0; block < x.size(); ++block) {
    const double step = 1e-7;
    std::vector<double> moved = x;
    moved[block] = x[block] + step;
    problem.evaluate(moved);
    const double above = problem.objective();
    moved[block] = x[block] - step;
    problem.evaluate(moved);
    EXPECT_NEAR((above - problem.objective()) / (2.0 * step), gradient[static_cast<Eigen::Index>(block)],
                1e-4 * gradient.norm())
        << "block " << block;
  }
}

TEST(DesignProblem, TellsWhatIsSteady) {
  const DesignOptions options;
  DesignProblem problem(options, 0.0);
  const auto steady = [&](std::vector<double> blocks_Nm) {
    for (double& torque : blocks_Nm) torque /= options.limits.torque_Nm;
    return problem.is_steady(blocks_Nm);
  };
  EXPECT_TRUE(
      steady({0.392, 3.000, 1.370, 0.298, 0.437, 0.577, 0.771, -2.942, 1.145, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0}));
  EXPECT_FALSE(steady(testing::kCreepingBlocks_Nm));
}

TEST(DesignProblem, RandomTailsKeepTheLimitsAndTheBeginning) {
  const DesignOptions options = options_for(Objective::D);
  DesignProblem problem(options, 0.0);
  std::mt19937_64 random(7);
  int kept = 0;
  constexpr int kTails = 200;
  for (int i = 0; i < kTails; ++i) {
    std::vector<double> x = shares(testing::kGoodBlocks_Nm, options.limits.torque_Nm);
    const std::vector<double> before = x;
    problem.random_tail(random, 3, x);
    EXPECT_TRUE(std::equal(x.begin(), x.begin() + 3, before.begin()));
    for (const double share : x) ASSERT_LE(std::abs(share), 1.0);
    problem.evaluate(x);
    // The speed at the end is not part of what a tail looks after.
    kept += problem.constraint_values().head(20).maxCoeff() <= 1e-9;
  }
  EXPECT_GT(kept, kTails * 9 / 10);
}

}  // namespace
}  // namespace clampd
