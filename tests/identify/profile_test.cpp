#include "clampd/identify/profile.hpp"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd {
namespace {

std::vector<clampd::Run> strong_runs(std::size_t count, const NoiseLevels& noise, unsigned seed) {
  std::mt19937_64 generator(seed);
  std::vector<clampd::Run> runs;
  for (std::size_t r = 0; r < count; ++r)
    runs.push_back(
        support::run_reference_brake({}, BrakeState::Zero(), support::strong_torque(), noise, generator).run);
  return runs;
}

/// Rising on both sides of the estimate, as it must where every fit of the others is at its minimum; what a
/// converged fit leaves open (less than a tenth) apart.
void expect_one_valley(const Profile& profile, double estimate) {
  for (std::size_t i = 0; i + 1 < profile.points.size(); ++i) {
    const ProfilePoint& left = profile.points[i];
    const ProfilePoint& right = profile.points[i + 1];
    EXPECT_LT(left.value, right.value);
    if (right.value <= estimate) {
      EXPECT_GT(left.deviance, right.deviance - 0.1) << left.value;
    } else {
      EXPECT_GT(right.deviance, left.deviance - 0.1) << right.value;
    }
  }
}

TEST(Profile, CountsTheTorquesNoiseAsTheStandardDeviationDoes) {
  // The worst torque reading: without its noise the intervals of the output error method were a fifth as
  // wide.
  const std::vector<clampd::Run> runs = strong_runs(6, {{30.0, 0.3}, 0.0142}, 31);
  for (const Method method : {Method::OutputError, Method::PredictionError}) {
    const Estimate estimate = identify_brake(method, runs, {});
    ASSERT_TRUE(estimate.converged()) << estimate.message;
    for (const Parameter parameter : {TC, Ts0, mus}) {
      const Profile profile = profile_likelihood(parameter, estimate.method, runs, {}, estimate);
      ASSERT_TRUE(profile.converged) << profile.message;
      const auto index = static_cast<Eigen::Index>(parameter);
      const double value = estimate.parameters.theta[index];
      const double sd = std::sqrt(estimate.covariance_normalised(index, index)) *
                        std::abs(kParameterTable[parameter].nominal);
      expect_one_valley(profile, value);
      EXPECT_LT(profile.lower, value);
      EXPECT_GT(profile.upper, value);
      // As wide as ± 1.96 sd but for its asymmetry, which these well excited runs show little of.
      EXPECT_NEAR((profile.upper - profile.lower) / (2.0 * 1.96 * sd), 1.0, 0.25)
          << to_string(method) << ' ' << kParameterTable[parameter].name;
    }
  }
}

TEST(Profile, SaysWhereTheDataDoNotBoundAParameter) {
  // So noisy that a static friction next to zero would do as well; the stiffness is bounded all the same.
  const std::vector<clampd::Run> runs = strong_runs(1, {{400.0, 8.0}, 0.0}, 34);
  const Estimate estimate = identify_brake(Method::OutputError, runs, {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  const Profile vague = profile_likelihood(Ts0, estimate.method, runs, {}, estimate);
  EXPECT_TRUE(std::isinf(vague.lower)) << vague.lower;
  const Profile bounded = profile_likelihood(k2, estimate.method, runs, {}, estimate);
  EXPECT_TRUE(std::isfinite(bounded.lower) && std::isfinite(bounded.upper));
}

TEST(Profile, FollowsARobustFitAndWhatIsHeld) {
  std::vector<clampd::Run> runs = strong_runs(2, {{30.0, 0.3}, 0.002}, 33);
  for (std::size_t k = 20; k < runs[0].size(); k += 40) runs[0].force_N[k] += 3000.0;
  EstimatorOptions options;
  options.loss = Loss::Robust;
  options.held[ws] = true;
  for (const Method method : {Method::OutputError, Method::PredictionError}) {
    const Estimate estimate = identify_brake(method, runs, options);
    ASSERT_TRUE(estimate.converged()) << estimate.message;
    const Profile profile = profile_likelihood(k2, estimate.method, runs, options, estimate);
    EXPECT_TRUE(profile.converged) << profile.message;
    EXPECT_LT(profile.lower, estimate.parameters.theta[k2]);
    EXPECT_GT(profile.upper, estimate.parameters.theta[k2]);
    expect_one_valley(profile, estimate.parameters.theta[k2]);
  }
}

}  // namespace
}  // namespace clampd
