// The estimator that a station uses for a model with effects, against a simulated brake that shares none of
// its mathematics.

#include "clampd/identify/extended_identification.hpp"

#include <algorithm>
#include <cmath>
#include <ranges>
#include <span>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "clampd/record/run.hpp"
#include "clampd/simulation/simulate.hpp"
#include "drivers/sim/plant_configuration.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;
using Runs = std::vector<Run>;

Runs optimal_runs(std::string_view effect, double value, std::uint16_t repeats, std::uint64_t seed = 7) {
  const auto plant = sim::read_plant_configuration(CLAMPD_SOURCE_DIR "/configs/plant.toml");
  const auto trajectory = read_run(CLAMPD_SOURCE_DIR "/configs/trajectory.csv");
  EXPECT_TRUE(plant && trajectory);
  sim::PlantConfiguration brake = *plant;
  brake.seed = seed;
  if (!effect.empty()) {
    EXPECT_TRUE(sim::set_effect(brake.effects, effect, value));
  }
  const auto reference = build_reference(trajectory->run, BrakeParameters{});
  EXPECT_TRUE(reference);
  const auto runs = simulate_manoeuvre(brake, *reference, BrakeParameters{}, repeats);
  EXPECT_TRUE(runs) << runs.error().message;
  return *runs;
}

/// The effect's first parameters as given, the others at their first start.
ExtendedParameters model_with(std::string_view name, std::vector<double> values) {
  for (const EffectParameter& parameter :
       info_of(*find_effect(name)).parameters | std::views::drop(values.size()))
    values.push_back(parameter.starts.empty() ? parameter.neutral : parameter.starts.front());
  return {BrakeParameters{}, {{find_effect(name), std::move(values)}}};
}

struct Hidden {
  const char* label;
  const char* effect;
  double truth;  ///< of the first parameter
  double hidden;
  std::vector<double> start;
};
void PrintTo(const Hidden& hidden, std::ostream* out) {
  *out << hidden.label;
}

class ExtendedIdentification : public ::testing::TestWithParam<Hidden> {};

TEST_P(ExtendedIdentification, FindsEffectAndBaseWithinTheirUncertainty) {
  const Hidden& hidden = GetParam();
  const Runs runs = optimal_runs(hidden.effect, hidden.hidden, 4);
  const Estimate estimate = identify_extended(runs, model_with(hidden.effect, hidden.start), {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  ASSERT_EQ(estimate.effects.size(), info_of(*find_effect(hidden.effect)).parameters.size());
  const EffectEstimate& found = estimate.effects.front();
  EXPECT_EQ(found.effect, hidden.effect);
  EXPECT_NEAR(found.value, hidden.truth, 4.0 * found.sd);
  EXPECT_GT(found.sd, 0.0);
  EXPECT_LT(found.sd, 0.1 * std::abs(hidden.truth)) << "these runs know it well";
  const ParameterVector nominal = nominal_parameters();
  for (int i = 0; i < nominal.size(); ++i) {
    const double error = (estimate.parameters.theta[i] - nominal[i]) / nominal[i];
    EXPECT_LT(std::abs(error), 4.0 * std::sqrt(estimate.covariance_normalised(i, i)))
        << kParameterTable[static_cast<std::size_t>(i)].name;
  }
  EXPECT_LT(estimate.force_rms_N, 1.05 * 30.0) << "of the simulated load cell's noise";
  EXPECT_EQ(estimate.run_force_rms_N.size(), runs.size());
  EXPECT_EQ(estimate.initial_states.size(), runs.size());
}

INSTANTIATE_TEST_SUITE_P(Of, ExtendedIdentification,
                         ::testing::Values(Hidden{"backlash", "backlash", 0.3, 0.3, {0.1}},
                                           Hidden{"force_lag", "force-lag", 0.004, 0.004, {0.001}},
                                           Hidden{"torque_offset", "torque-offset", 0.05, 0.05, {0.0}}),
                         [](const auto& test) { return std::string(test.param.label); });

TEST(ExtendedIdentification, AnEffectThatIsNotThereIsAbsentAndNoReasonToRefuse) {
  const Runs runs = optimal_runs("", 0.0, 4);
  const Estimate estimate = identify_extended(runs, model_with("backlash", {0.4}), {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  const EffectEstimate& play = estimate.effects.at(0);
  EXPECT_LT(play.value, 3.0 * play.sd + 1e-9);
  EXPECT_GT(play.sd, 0.0);
  EXPECT_LT(play.sd, 0.05);

  // The shape of a hysteresis that is not there means nothing.
  const Estimate shaped = identify_extended(runs, model_with("stiffness-hysteresis", {0.03, 0.5}), {});
  EXPECT_TRUE(shaped.converged()) << shaped.message;
  EXPECT_NEAR(shaped.effects.at(0).value, 0.0, 0.01);
}

TEST(ExtendedIdentification, WithoutEffectsItIsThePredictionErrorMethod) {
  const Runs runs = optimal_runs("", 0.0, 8);
  const Estimate extended = identify_extended(runs, {}, {});
  const Estimate base = identify_prediction_error(runs, {});
  ASSERT_TRUE(extended.converged()) << extended.message;
  ASSERT_TRUE(base.converged()) << base.message;
  for (int i = 0; i < base.parameters.theta.size(); ++i) {
    const double sd = std::sqrt(base.covariance_normalised(i, i));
    const double nominal = nominal_parameters()[i];
    EXPECT_NEAR(extended.parameters.theta[i] / nominal, base.parameters.theta[i] / nominal, 0.5 * sd);
    EXPECT_NEAR(std::sqrt(extended.covariance_normalised(i, i)), sd, 0.2 * sd);
    EXPECT_GT(extended.covariance_over_runs(i, i), 0.0);
    const double largest = base.offset_sensitivity.col(0).cwiseAbs().maxCoeff();
    EXPECT_NEAR(extended.offset_sensitivity(i, 0), base.offset_sensitivity(i, 0), 0.1 * largest);
  }
  EXPECT_TRUE(extended.effects.empty());
  EXPECT_FALSE(extended.runs_differ);
}

TEST(ExtendedIdentification, OffsetsMoveTheEstimateAsItSays) {
  Runs runs = optimal_runs("backlash", 0.3, 4);
  const ExtendedParameters model = model_with("backlash", {0.4});
  const Estimate before = identify_extended(runs, model, {});
  constexpr double kOffset_N = 20.0;
  for (auto& run : runs)
    for (double& force : run.force_N) force += kOffset_N;
  const Estimate after = identify_extended(runs, model, {});
  ASSERT_TRUE(before.converged() && after.converged());
  const double moved = (after.parameters.theta[k2] - before.parameters.theta[k2]) / nominal_parameters()[k2];
  const double said = kOffset_N * before.offset_sensitivity(k2, 0);
  EXPECT_GT(std::abs(said), std::sqrt(before.covariance_normalised(k2, k2))) << "so that the test can fail";
  EXPECT_NEAR(moved, said, 0.25 * std::abs(said));
}

TEST(ExtendedIdentification, NamesWhatTheRunsDoNotDetermine) {
  // Drift from run to run cannot show in one run.
  const Runs runs = optimal_runs("", 0.0, 1);
  const Estimate estimate = identify_extended(runs, model_with("friction-drift", {0.0}), {});
  EXPECT_EQ(estimate.termination, Termination::NotIdentifiable);
  EXPECT_THAT(estimate.message, HasSubstr("friction-drift.coulomb"));
  EXPECT_TRUE(std::isnan(estimate.effects.at(0).value));
  EXPECT_TRUE(std::isfinite(estimate.parameters.theta[k2]));
}

TEST(ExtendedIdentification, APlayThatNoReversalTakesUpIsNotIdentifiable) {
  // The shipped trajectory goes back under load by less than this.
  const Runs runs = optimal_runs("backlash", 1.0, 2);
  const Estimate estimate = identify_extended(runs, model_with("backlash", {0.2}), {});
  EXPECT_EQ(estimate.termination, Termination::NotIdentifiable) << estimate.message;
  EXPECT_THAT(estimate.message, HasSubstr("backlash.play"));
}

TEST(ExtendedIdentification, HeldParametersStay) {
  const Runs runs = optimal_runs("backlash", 0.3, 2);
  EstimatorOptions options;
  options.held[Ts0] = true;
  options.start.theta[Ts0] *= 1.01;
  const Estimate estimate = identify_extended(runs, model_with("backlash", {0.3}), options);
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  EXPECT_EQ(estimate.parameters.theta[Ts0], options.start.theta[Ts0]);
  EXPECT_EQ(estimate.covariance_normalised(Ts0, Ts0), 0.0);
  EXPECT_GT(estimate.covariance_normalised(k2, k2), 0.0);
}

TEST(ExtendedIdentification, MovesTheDataOfALateChannel) {
  const Runs runs = optimal_runs("channel-skew", 3.4, 2);
  // fraction, whole, channel
  const Estimate estimate = identify_extended(runs, model_with("channel-skew", {0.2, 3.0, 1.0}), {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  EXPECT_NEAR(estimate.effects.at(0).value, 0.4, 3.0 * estimate.effects.at(0).sd);
  EXPECT_LT(estimate.effects.at(0).sd, 0.1);
  EXPECT_EQ(estimate.effects.at(1).value, 3.0);
  EXPECT_TRUE(std::isnan(estimate.effects.at(1).sd)) << "a choice is not estimated";
}

TEST(ExtendedIdentification, SpikesDoNotMoveIt) {
  const Runs runs = optimal_runs("outliers", 0.02, 4);
  const ExtendedParameters model = model_with("outliers", {0.02, 2000.0, 1.0});
  const Estimate estimate = identify_extended(runs, model, {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  EXPECT_LT(estimate.noise_force_N, 1.2 * 30.0);
  EXPECT_GT(identify_extended(runs, {}, {}).noise_force_N, 100.0) << "without the effect";
}

TEST(ExtendedIdentification, RefusesOptionsThatItCannotHonour) {
  const Runs runs = optimal_runs("", 0.0, 1);
  EstimatorOptions options;
  options.noise_force_N = 30.0;
  EXPECT_THAT(identify_extended(runs, {}, options).message, HasSubstr("or none of them"));
  options = {};
  options.loss = Loss::Robust;
  EXPECT_THAT(identify_extended(runs, {}, options).message, HasSubstr("robust loss"));
  EXPECT_THAT(identify_extended({}, {}, {}).message, HasSubstr("no run"));
}

}  // namespace
}  // namespace clampd
