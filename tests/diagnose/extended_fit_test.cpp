#include "clampd/identify/extended_fit.hpp"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "clampd/identify/prediction_error.hpp"
#include "support/blind/blind_set.hpp"

namespace clampd {
namespace {

std::vector<Run> runs_of(const char* effect, std::uint64_t seed, std::size_t count) {
  blind::Request request;
  request.kind = effect[0] == '\0' ? blind::Kind::None : blind::Kind::Single;
  request.effect = effect;
  request.seed = seed;
  Result<blind::BlindSet> set = blind::make_set(request);
  EXPECT_TRUE(set);
  set->runs.resize(count);
  return set->runs;
}

TEST(ExtendedFit, IsThePredictionErrorMethodWithoutEffects) {
  const std::vector<clampd::Run> runs = runs_of("", 11, 6);
  const ExtendedEstimate extended = fit_base(runs, BrakeParameters{});
  ASSERT_TRUE(extended.possible && extended.settled);
  const Estimate estimate = identify_prediction_error(runs, EstimatorOptions{});
  ASSERT_TRUE(estimate.converged());
  for (Eigen::Index i = 0; i < static_cast<Eigen::Index>(kParameterCount); ++i) {
    const double sd = std::sqrt(extended.covariance(i, i));
    EXPECT_NEAR(extended.parameters.base.theta[i], estimate.parameters.theta[i], 0.3 * sd) << i;
    EXPECT_NEAR(sd / (std::abs(nominal_parameters()[i]) * std::sqrt(estimate.covariance_normalised(i, i))),
                1.0, 0.1);
  }
  EXPECT_NEAR(extended.noise.sensors.force_N, estimate.noise_force_N, 0.02 * estimate.noise_force_N);
  EXPECT_NEAR(extended.noise.torque_Nm, estimate.noise_torque_Nm, 0.15 * estimate.noise_torque_Nm);
}

TEST(ExtendedFit, InnovationsAreWhiteAndOfTheirOwnSizeWhereTheModelIsTrue) {
  const std::vector<clampd::Run> runs = runs_of("", 12, 9);
  const ExtendedEstimate estimate = fit_base(runs, BrakeParameters{});
  ASSERT_TRUE(estimate.possible);
  double square = 0.0, lagged = 0.0, count = 0.0;
  for (const FilteredRun& run : filter_runs(fit_runs(runs), estimate))
    for (std::size_t k = 1; k < run.force.size(); ++k) {
      square += run.force[k] * run.force[k] + run.velocity[k] * run.velocity[k];
      lagged += run.force[k] * run.force[k - 1] + run.velocity[k] * run.velocity[k - 1];
      count += 2.0;
    }
  EXPECT_NEAR(square / count, 1.0, 4.0 * std::sqrt(2.0 / count));
  EXPECT_NEAR(lagged / count, 0.0, 4.0 / std::sqrt(count));
}

TEST(ExtendedFit, AStepForecastsWhatTheFitBrings) {
  const std::vector<clampd::Run> runs = runs_of("force-lag", 21, 9);
  const ExtendedEstimate base = fit_base(runs, BrakeParameters{});
  ASSERT_TRUE(base.possible);
  const ExtendedEstimate start = with_effect(base, {find_effect("force-lag"), {0.0}});
  const StepForecast seen = forecast(fit_runs(runs), start);
  ExtendedEstimate stepped = start;
  stepped.parameters.effects[0].values[0] = std::max(1e-6, seen.step[kParameterCount]);
  const ExtendedEstimate fitted = fit_extended(fit_runs(runs), stepped);
  ASSERT_TRUE(fitted.possible);
  const double gain = fitted.log_likelihood - base.log_likelihood;
  EXPECT_GT(gain, 10.0);
  EXPECT_NEAR((seen.after_step - seen.log_likelihood) / gain, 1.0, 0.3);
}

TEST(ExtendedFit, IsGivenUpWhereItWillNotGetToWhatIsWanted) {
  const std::vector<clampd::Run> runs = runs_of("", 31, 6);
  const std::vector<FitRun> fitted = fit_runs(runs);
  ExtendedEstimate start = fit_base(runs, BrakeParameters{});
  ASSERT_TRUE(start.possible);
  for (const auto parameter : {k1, TC, Tv, ws}) start.parameters.base.theta[parameter] *= 2.0;
  start.noise.torque_Nm *= 3.0;
  const ExtendedEstimate free = fit_extended(fitted, start);
  ASSERT_TRUE(free.settled);
  ExtendedFitOptions options;
  options.least_log_likelihood = free.log_likelihood - 1.0;
  const ExtendedEstimate reached = fit_extended(fitted, start, options);
  EXPECT_NEAR(reached.log_likelihood, free.log_likelihood, 0.5);
  options.least_log_likelihood = free.log_likelihood + 100.0;
  const ExtendedEstimate given_up = fit_extended(fitted, start, options);
  EXPECT_TRUE(given_up.possible);
  EXPECT_FALSE(given_up.settled);
  EXPECT_LT(given_up.iterations, reached.iterations);
}

/// Readings of force that come early ask for a lag below zero, and the brake's own parameters for the rest.
TEST(ExtendedFit, AParameterAtItsBoundDoesNotStopTheOthers) {
  std::vector<clampd::Run> runs = runs_of("", 31, 6);
  for (clampd::Run& run : runs) std::rotate(run.force_N.begin(), run.force_N.begin() + 1, run.force_N.end());
  const std::vector<FitRun> fitted = fit_runs(runs);
  const ExtendedEstimate base = fit_base(runs, BrakeParameters{});
  ASSERT_TRUE(base.possible);
  ExtendedEstimate start = with_effect(base, {find_effect("force-lag"), {0.0005}});
  start.parameters.base.theta[mus] *= 1.1;
  start.parameters.base.theta[ws] *= 0.7;
  const ExtendedEstimate extended = fit_extended(fitted, start);
  ASSERT_TRUE(extended.possible);
  EXPECT_EQ(extended.parameters.effects[0].values[0], 0.0);
  EXPECT_GT(extended.log_likelihood, base.log_likelihood - 0.5);
  EXPECT_TRUE(extended.covariance.allFinite());
  const StepForecast seen = forecast(fitted, extended);
  EXPECT_LT(seen.after_step - seen.log_likelihood, 0.5) << "nothing is promised beyond the bound";
}

/// What one linearisation of all effects that are there in name only tells of each.
void expect_the_same_together_as_alone(const std::vector<EffectValues>& effects) {
  const std::vector<clampd::Run> runs = runs_of("force-lag", 21, 5);
  const ExtendedEstimate base =
      with_effect(fit_base(runs, BrakeParameters{}), {find_effect("backlash"), {0.05}});
  ASSERT_TRUE(base.possible);
  const std::vector<FitRun> fitted = fit_runs(runs);
  const std::vector<StepForecast> together = forecast_each(fitted, base, effects);
  ASSERT_EQ(together.size(), effects.size());
  for (std::size_t e = 0; e < effects.size(); ++e) {
    const StepForecast alone = forecast(fitted, with_effect(base, effects[e]));
    const std::string_view name = info_of(*effects[e].effect).name;
    EXPECT_NEAR(together[e].log_likelihood, alone.log_likelihood, 1e-6) << name;
    EXPECT_NEAR(together[e].after_step, alone.after_step, 1e-5) << name;
    ASSERT_EQ(together[e].step.size(), alone.step.size()) << name;
    for (Eigen::Index i = 0; i < alone.step.size(); ++i) {
      if (!(alone.sd[i] < 1e6)) continue;  // a shape that neutral strengths do not show
      EXPECT_NEAR(together[e].step[i], alone.step[i], 1e-3 * alone.sd[i]) << name << " " << i;
      EXPECT_NEAR(together[e].sd[i], alone.sd[i], 1e-4 * alone.sd[i]) << name << " " << i;
    }
  }
}

TEST(ExtendedFit, ManyEffectsAtNeutralAreForeseenTogetherAsAlone) {
  expect_the_same_together_as_alone({{find_effect("force-lag"), {0.0}},
                                     {find_effect("torque-gain"), {0.0}},
                                     {find_effect("friction-asymmetry"), {0.0, 0.0, 1.0}},
                                     {find_effect("stiffness-hysteresis"), {0.0, 0.1, 1.0}},
                                     {find_effect("stiffness-hysteresis"), {0.0, 2.5, 1.0}},
                                     {find_effect("channel-skew"), {0.0, 0.0, 2.0}}});
}

/// Those of a hum count, a relaxing pad's are drawn from their prior.
TEST(ExtendedFit, EffectsWithFreeStatesAreForeseenTogetherAsAlone) {
  expect_the_same_together_as_alone({{find_effect("force-hum"), {50.0}},
                                     {find_effect("pad-relaxation"), {0.0, 0.15}},
                                     {find_effect("force-hum"), {120.0}}});
}

/// The largest factor by which standard deviations grow for how far the runs contradict each other.
double growth_over_runs(const std::vector<clampd::Run>& runs) {
  const ExtendedEstimate estimate = fit_base(runs, BrakeParameters{});
  EXPECT_TRUE(estimate.possible);
  const Eigen::MatrixXd covariance = covariance_over_runs(fit_runs(runs), estimate);
  const Eigen::ArrayXd ratio =
      (covariance.diagonal().array() / estimate.covariance.diagonal().array()).sqrt();
  EXPECT_GE(ratio.minCoeff(), 1.0 - 1e-12) << "never smaller";
  return ratio.maxCoeff();
}

TEST(ExtendedFit, RunsThatContradictEachOtherMakeTheParametersLessSure) {
  std::vector<clampd::Run> runs = runs_of("", 12, 15);
  EXPECT_LT(growth_over_runs(runs), 2.0);
  double gain = 1.005;  // of each run's force reading: no model knows of that
  for (clampd::Run& run : runs) {
    for (double& force : run.force_N) force *= gain;
    gain = 2.0 - gain;
  }
  EXPECT_GT(growth_over_runs(runs), 3.0);
  runs.resize(4);
  EXPECT_EQ(growth_over_runs(runs), 1.0) << "too few runs to tell";
}

TEST(ExtendedFit, IsTheSameOnAnyNumberOfThreads) {
  const std::vector<clampd::Run> runs = runs_of("force-lag", 21, 5);
  const ExtendedEstimate start =
      with_effect(fit_base(runs, BrakeParameters{}), {find_effect("force-lag"), {0.001}});
  ExtendedFitOptions options;
  const ExtendedEstimate alone = fit_extended(fit_runs(runs), start, options);
  options.threads = ThreadBudget(4);
  const ExtendedEstimate together = fit_extended(fit_runs(runs), start, options);
  ASSERT_TRUE(alone.possible && together.possible);
  EXPECT_EQ(together.log_likelihood, alone.log_likelihood);
  EXPECT_EQ(together.parameters.base.theta, alone.parameters.base.theta);
  EXPECT_EQ(together.parameters.effects[0].values, alone.parameters.effects[0].values);
  EXPECT_EQ(together.noise.torque_Nm, alone.noise.torque_Nm);
  EXPECT_EQ(together.covariance, alone.covariance);
}

TEST(ExtendedFit, ASignalIsFoundWhereItIsAndAsLargeAsItIs) {
  std::vector<clampd::Run> runs = runs_of("", 13, 9);
  for (clampd::Run& run : runs)
    for (double& force : run.force_N) force += 25.0;
  const ExtendedEstimate estimate = fit_base(runs, BrakeParameters{});
  ASSERT_TRUE(estimate.possible);
  SignalColumns signals{SignalColumns::Kind::ForceReading, {}};
  for (const clampd::Run& run : runs)
    signals.rows.push_back(Eigen::MatrixXd::Ones(static_cast<Eigen::Index>(run.size()), 1));
  const std::vector<FitRun> fitted = fit_runs(runs);
  const SignalScores scores = SignalScorer(fitted, estimate).score(signals);
  const double offset = scores.score[0] / scores.information(0, 0);
  EXPECT_NEAR(offset, 25.0, 4.0 / std::sqrt(scores.information(0, 0)) + 3.0);
  EXPECT_LT(scores.information(0, 0), scores.alone[0]);
}

TEST(ExtendedFit, LateChannelsAreMovedBackAndWhatIsMissingDoesNotCount) {
  std::vector<FitRun> runs{{0.0, {0.0, 1e-3, 2e-3}, {1, 2, 3}, {4, 5, 6}, {7, 8, 9}, {1, 1, 1}, {1, 1, 1}}};
  move_by({.force = 1}, runs);
  EXPECT_EQ(runs[0].force_N, (std::vector<double>{5, 6, 6}));
  EXPECT_EQ(runs[0].use_force, (std::vector<std::uint8_t>{1, 1, 0}));
  EXPECT_EQ(runs[0].velocity_rad_s, (std::vector<double>{7, 8, 9}));
  move_by({.force = 9}, runs);  // later than the run is long
  EXPECT_EQ(runs[0].use_force, (std::vector<std::uint8_t>{0, 0, 0}));
}

}  // namespace
}  // namespace clampd
