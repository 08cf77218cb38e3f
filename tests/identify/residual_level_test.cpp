#include "clampd/identify/residual_level.hpp"

#include <cmath>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/identify/method.hpp"
#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd {
namespace {

using support::expect_no_nonsense;
using support::normalised_error;
using ::testing::HasSubstr;

const NoiseLevels kNoise{{30.0, 0.3}, 0.002};

clampd::Run strong_run(unsigned seed, const BrakeParameters& truth = {}, const NoiseLevels& noise = kNoise) {
  std::mt19937_64 generator(seed);
  return support::run_reference_brake(truth, BrakeState::Zero(), support::strong_torque(), noise, generator)
      .run;
}

TEST(ResidualLevel, TakesTheNoiseFromTheReadingsAlone) {
  const clampd::Run run = strong_run(1);
  const ResidualLevel level = residual_level({&run, 1}, {{60.0, 0.9}, 0.0});
  EXPECT_NEAR(level.force, 2.0, 0.5);  // the median of 300 differences is within a quarter
  EXPECT_NEAR(level.velocity, 3.0, 0.75);
  EXPECT_FALSE(level.far_above_noise);
  EXPECT_THAT(level.words, HasSubstr("the velocity by 0.9 rad/s rms"));
}

TEST(ResidualLevel, IsFarAboveTheNoiseOnlyWhereItIsMuchOfTheReadingToo) {
  const clampd::Run run = strong_run(2, {}, {{5.0, 0.05}, 0.0005});
  // Thirty times the noise of a good load cell, and one percent of what the force does: a misfit for a
  // diagnosis.
  EXPECT_FALSE(residual_level({&run, 1}, {{150.0, 0.05}, 0.0}).far_above_noise);
  const ResidualLevel lost = residual_level({&run, 1}, {{2000.0, 0.05}, 0.0});
  EXPECT_TRUE(lost.far_above_noise);
  EXPECT_THAT(lost.words, HasSubstr("the force by 2000 N rms"));
  EXPECT_TRUE(residual_level({&run, 1}, {{5.0, 30.0}, 0.0}).far_above_noise);
  EXPECT_FALSE(residual_level({&run, 1}, {{5.0, 0.05}, 0.3}).far_above_noise);
  EXPECT_THAT(residual_level({&run, 1}, {{5.0, 0.05}, 3.0}).words, HasSubstr("the torque itself"));
}

TEST(IdentifyBrake, HasNoResultForRunsOfSomethingElse) {
  clampd::Run run = strong_run(3);
  // Readings of an oscillation that no torque of this run explains.
  for (std::size_t k = 0; k < run.size(); ++k) {
    const double phase = 0.35 * static_cast<double>(k);
    run.velocity_rad_s[k] = 200.0 * std::sin(phase) + 0.3 * std::cos(977.0 * phase);
    run.force_N[k] = 12000.0 + 9000.0 * std::cos(1.7 * phase) + 30.0 * std::cos(811.0 * phase);
  }
  for (const Method method : {Method::OutputError, Method::PredictionError}) {
    const Estimate estimate = identify_brake(method, {&run, 1}, {});
    EXPECT_FALSE(estimate.converged()) << to_string(method) << estimate.message;
    expect_no_nonsense(estimate);
    EXPECT_EQ(estimate.termination, Termination::Unexplained)
        << to_string(method) << ": " << estimate.message;
    EXPECT_THAT(estimate.message, HasSubstr("no result"));
    EXPECT_TRUE(estimate.parameters.theta.array().isNaN().all());
    EXPECT_TRUE(estimate.covariance_normalised.array().isNaN().all());
  }
}

TEST(IdentifyBrake, LeavesAHealthyFitAsItIs) {
  for (unsigned seed = 10; seed < 14; ++seed) {
    const clampd::Run run = strong_run(seed, {}, {{30.0, 0.3}, 0.0});
    const Estimate estimate = identify_brake(Method::OutputError, {&run, 1}, {});
    ASSERT_TRUE(estimate.converged()) << estimate.message;
    EXPECT_EQ(estimate.method, Method::OutputError);
    EXPECT_THAT(estimate.message, ::testing::Not(HasSubstr("prediction")));
  }
}

TEST(IdentifyBrake, FindsWornBrakesFromTheNominalOne) {
  BrakeParameters worn;
  worn.theta =
      worn.theta.cwiseProduct((ParameterVector() << 0.8, 0.9, 1.66, 0.93, 2.2, 1.05, 0.43).finished());
  for (const Method method : {Method::OutputError, Method::PredictionError})
    for (unsigned seed = 20; seed < 26; ++seed) {
      const clampd::Run run = strong_run(seed, worn);
      const Estimate estimate = identify_brake(method, {&run, 1}, {});
      ASSERT_TRUE(estimate.converged()) << estimate.message;
      const ParameterVector error = normalised_error(estimate.parameters, worn);
      // Chi-square with seven degrees of freedom is above 40 once in a million.
      EXPECT_LT(error.dot(estimate.covariance_normalised.ldlt().solve(error)), 40.0) << seed;
    }
}

}  // namespace
}  // namespace clampd
