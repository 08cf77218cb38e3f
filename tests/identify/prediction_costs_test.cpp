#include <gtest/gtest.h>

#include "clampd/identify/kalman.hpp"
#include "support/excitation.hpp"
#include "support/reference_brake.hpp"

namespace clampd {
namespace {

TEST(PredictionCosts, InnovationsFindTheTorqueNoiseAndThePrintedFormulaTooMuchOfIt) {
  constexpr double kTorqueNoise_Nm = 0.0142;
  const auto torque = support::strong_torque();
  std::mt19937_64 generator(7);
  std::normal_distribution<double> normal;
  const std::vector<double> factors{0.25, 0.5, 0.7, 1.0, 1.4, 2.0, 4.0, 8.0};
  std::vector<PredictionCosts> sums(factors.size(), PredictionCosts{0.0, 0.0});
  for (int repeat = 0; repeat < 20; ++repeat) {
    std::vector<double> acting = torque;
    for (double& value : acting) value += kTorqueNoise_Nm * normal(generator);
    const auto trace = support::simulate_reference({}, 0.0, 0.0, acting, 2e-5);
    const clampd::Run run =
        support::noisy_run(torque, trace.force_N, trace.velocity_rad_s, 30.0, 0.3, generator);
    for (std::size_t i = 0; i < factors.size(); ++i) {
      const PredictionCosts costs =
          prediction_costs(run, {}, BrakeState::Zero(), {{30.0, 0.3}, factors[i] * kTorqueNoise_Nm});
      sums[i].innovations += costs.innovations;
      sums[i].as_printed += costs.as_printed;
    }
  }
  const auto best = [&](double PredictionCosts::*cost) {
    std::size_t least = 0;
    for (std::size_t i = 0; i < sums.size(); ++i)
      if (sums[i].*cost < sums[least].*cost) least = i;
    return factors[least];
  };
  EXPECT_EQ(best(&PredictionCosts::innovations), 1.0);
  EXPECT_GE(best(&PredictionCosts::as_printed), 2.0);
}

}  // namespace
}  // namespace clampd
