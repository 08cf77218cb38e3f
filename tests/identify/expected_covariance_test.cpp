#include "clampd/identify/expected_covariance.hpp"

#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/identify/method.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd {
namespace {

constexpr NoiseLevels kNoise{{60.0, 1.0}, 0.0142};

std::vector<double> blocks(std::initializer_list<double> torques_Nm) {
  std::vector<double> torque;
  for (const double value : torques_Nm) torque.insert(torque.end(), 20, value);
  return torque;
}

/// One that clamps hard, and one that closes slowly.
const std::vector<std::vector<double>>& motions() {
  static const std::vector<std::vector<double>> both{
      blocks({0.06, 2.5, 1.0, 0.7, 0.2, 0.36, 0.27, -0.27, 0.12, 0.14, 0.5, 1.27, -0.33, -0.48, 0.17}),
      blocks({0.78, 0.03, 0.17, 0.09, 0.14, 0.11, 0.15, 0.18, 0.17, 0.18, 0.52, -0.91, -0.05, -0.11, -0.1})};
  return both;
}

/// Four runs of the first motion and two of the second.
std::vector<Run> mixed_runs(std::uint64_t seed) {
  std::mt19937_64 generator(seed);
  std::vector<Run> runs;
  for (const std::size_t motion : {0, 0, 0, 0, 1, 1})
    runs.push_back(
        support::run_reference_brake({}, BrakeState::Zero(), motions()[motion], kNoise, generator, 1e-4).run);
  return runs;
}

class ExpectedCovariance : public ::testing::TestWithParam<Method> {
 protected:
  static ParameterMatrix expected(double of_first, double of_second) {
    std::vector<ExpectedContribution> contributions;
    for (const std::vector<double>& torque : motions())
      contributions.push_back(expected_contribution(GetParam(), {}, BrakeState::Zero(),
                                                    Excitation{.torque_Nm = torque}, kNoise));
    return expected_covariance(contributions, std::vector{of_first, of_second});
  }
};

TEST_P(ExpectedCovariance, IsThatOfAnEstimateFromSuchRuns) {
  EstimatorOptions options;
  options.noise_force_N = kNoise.sensors.force_N;
  options.noise_velocity_rad_s = kNoise.sensors.velocity_rad_s;
  options.noise_torque_Nm = kNoise.torque_Nm;
  // Of single runs it depends on where they happen to stick; so the mean of some.
  ParameterVector ratio = ParameterVector::Zero();
  constexpr int kEstimates = 12;
  for (std::uint64_t seed = 1; seed <= kEstimates; ++seed) {
    const Estimate estimate = identify_brake(GetParam(), mixed_runs(seed), options);
    ASSERT_TRUE(estimate.converged()) << estimate.message;
    ASSERT_EQ(estimate.method, GetParam());
    ratio += estimate.covariance_normalised.diagonal().cwiseQuotient(expected(4, 2).diagonal()).cwiseSqrt() /
             kEstimates;
  }
  EXPECT_GT(ratio.minCoeff(), 0.8) << ratio.transpose();
  // It is linear in the noise, which output errors of a slow motion, and its static friction, are not.
  EXPECT_LT(ratio.maxCoeff(), GetParam() == Method::OutputError ? 1.5 : 1.25) << ratio.transpose();
}

TEST_P(ExpectedCovariance, FallsWithTheNumberOfRunsAndWithASlowOneForTheFriction) {
  EXPECT_TRUE(expected(8, 0).isApprox(0.5 * expected(4, 0), 1e-9));
  EXPECT_LT(expected(4, 4)(TC, TC), 0.3 * expected(8, 0)(TC, TC));
  EXPECT_GT(expected(4, 4)(k2, k2), expected(8, 0)(k2, k2)) << "it does not clamp hard";
  EXPECT_TRUE(expected(0, 0).array().isNaN().all()) << "no run, no covariance";
}

/// Runs of different motions that differ by their noise alone: whether they agree is judged by what each tells.
TEST_P(ExpectedCovariance, RunsOfDifferentMotionsAgree) {
  int unlikely = 0;
  double squares = 0.0;
  constexpr int kEstimates = 40;
  for (std::uint64_t seed = 1; seed <= kEstimates; ++seed) {
    const Estimate estimate = identify_brake(GetParam(), mixed_runs(100 + seed), {});
    ASSERT_TRUE(estimate.converged()) << estimate.message;
    unlikely += estimate.runs_agree_p < 0.05;
    squares += support::normalised_error(estimate.parameters, {})
                   .cwiseQuotient(estimate.covariance_normalised.diagonal().cwiseSqrt())
                   .squaredNorm();
  }
  EXPECT_LE(unlikely, 8) << "two are expected";
  EXPECT_NEAR(squares / (kEstimates * kParameterCount), 1.0, 0.35) << "and the uncertainty is what it says";
}

INSTANTIATE_TEST_SUITE_P(Methods, ExpectedCovariance,
                         ::testing::Values(Method::OutputError, Method::PredictionError),
                         [](const auto& method) { return std::string(to_string(method.param)); });

}  // namespace
}  // namespace clampd
