// What an iteration does with the runs takes nothing from the heap.

#include <gtest/gtest.h>

#include "src/identify/joint_fit.hpp"
#include "support/allocation_trap.hpp"
#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd::identify {
namespace {

enum class Cost { OutputErrors, Innovations };

struct Case {
  std::size_t runs;
  Cost cost;
  Loss loss = Loss::Squared;
};

class NoAllocation : public ::testing::TestWithParam<Case> {
 protected:
  NoAllocation() {
    std::mt19937_64 generator(31);
    const auto torque = support::strong_torque();
    const NoiseLevels noise{{30.0, 0.3}, 0.0142};
    for (std::size_t r = 0; r < GetParam().runs; ++r)
      runs_.push_back(
          support::run_reference_brake({}, BrakeState::Zero(), torque, noise, generator, 1e-4).run);
    options_.loss = GetParam().loss;
    fit_.emplace(runs_, options_);
    start_ = fit_->start_from(nominal_parameters());
    begin();
  }

  /// The cost that this case is about, gains at the start.
  void begin() {
    const Variances variances = variances_of({{30.0, 0.3}, 0.0142});
    fit_->use_output_errors(variances);
    if (GetParam().cost == Cost::Innovations) {
      ASSERT_TRUE(fit_->use_innovations(start_, variances));
    }
  }

  std::vector<clampd::Run> runs_;
  EstimatorOptions options_;
  std::optional<JointFit> fit_;
  Eigen::VectorXd start_;
};

TEST_P(NoAllocation, InAnEvaluationAtANewPoint) {
  ASSERT_TRUE(fit_->evaluate(start_));
  Eigen::VectorXd beside = start_;
  Eigen::VectorXd residuals(fit_->NumResiduals());
  Eigen::MatrixXd jacobian(fit_->NumResiduals(), fit_->NumParameters());
  Eigen::VectorXd step(fit_->NumParameters());
  fit_->update_weights();
  bool possible = true;
  double sum = 0.0;
  std::size_t allocations = 0;
  {
    const support::AllocationTrap trap;
    for (int i = 0; i < 4; ++i) {
      beside[1] += 1e-3;
      possible = possible && fit_->evaluate(beside) && (*fit_)(beside.data(), residuals.data(), nullptr) &&
                 (*fit_)(beside.data(), residuals.data(), jacobian.data());
      sum += fit_->sum_of_squares() + fit_->expected_decrease() + fit_->update_weights();
      fit_->gauss_newton_step(step);
    }
    allocations = trap.allocations();
  }
  EXPECT_TRUE(possible);
  EXPECT_GT(sum, 0.0);
  EXPECT_EQ(allocations, 0u);
}

INSTANTIATE_TEST_SUITE_P(, NoAllocation,
                         ::testing::Values(Case{1, Cost::OutputErrors}, Case{20, Cost::OutputErrors},
                                           Case{1, Cost::Innovations}, Case{20, Cost::Innovations},
                                           Case{1, Cost::OutputErrors, Loss::Robust},
                                           Case{20, Cost::Innovations, Loss::Robust}),
                         [](const auto& test) {
                           return std::to_string(test.param.runs) +
                                  (test.param.cost == Cost::OutputErrors ? "OutputErrors" : "Innovations") +
                                  (test.param.loss == Loss::Robust ? "Robust" : "");
                         });

}  // namespace
}  // namespace clampd::identify
