#include "clampd/experiment/robust_design.hpp"

#include <cmath>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/experiment/reference.hpp"

namespace clampd {
namespace {

std::vector<double> kept_design() {
  return {kKnownRobustBlocks_Nm.begin(), kKnownRobustBlocks_Nm.end()};
}

TEST(RobustPrior, CoversNominalAndTableIIEvenly) {
  const BrakeParameters nominal;
  const std::vector<BrakeParameters> brakes = draw_prior(nominal, 400, 3);
  ASSERT_EQ(brakes.size(), 400U);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    int between = 0;
    double lowest = 1e9;
    double highest = -1e9;
    for (const BrakeParameters& brake : brakes) {
      const double share = std::log(brake.theta[at] / nominal.theta[at]) / std::log(kTableII[i]);
      lowest = std::min(lowest, share);
      highest = std::max(highest, share);
      between += share >= 0.0 && share <= 1.0 ? 1 : 0;
    }
    EXPECT_NEAR(lowest, -kBeyondTableII, 0.01);
    EXPECT_NEAR(highest, 1.0 + kBeyondTableII, 0.01);
    EXPECT_NEAR(between, 400.0 / (1.0 + 2.0 * kBeyondTableII), 2.0);
  }
}

TEST(RobustPrior, RepeatsForASeed) {
  const auto first = draw_prior({}, 20, 7);
  const auto second = draw_prior({}, 20, 7);
  for (std::size_t k = 0; k < first.size(); ++k) EXPECT_EQ(first[k].theta, second[k].theta);
  EXPECT_NE(draw_prior({}, 20, 8)[0].theta, first[0].theta);
}

RobustGain gain_of_kept_design(const NoiseLevels& noise) {
  RobustOptions options;
  options.noise = noise;
  const std::vector<BrakeParameters> brakes = draw_prior(options.nominal, 100, 21);
  const PlainStep step = best_step(options, brakes).value();
  const RobustEvaluation baseline = evaluate_robust(step.trajectory, options.nominal, brakes, noise).value();
  const RobustEvaluation design =
      evaluate_robust(response_to(kept_design(), 20, options.nominal), options.nominal, brakes, noise)
          .value();
  EXPECT_TRUE(std::isfinite(design.worst_decile_logdet));
  return gain_over(baseline, design);
}

TEST(RobustDesign, KeptDesignBeatsAPlainStep) {
  const RobustGain gain = gain_of_kept_design(RobustOptions{}.noise);
  RecordProperty("mean", std::to_string(gain.mean));
  RecordProperty("worst_decile", std::to_string(gain.worst_decile));
  EXPECT_GE(gain.mean, 3.8);
  EXPECT_GE(gain.worst_decile, 4.7);
}

TEST(RobustDesign, KeptDesignBeatsAPlainStepWithBetterSensorsToo) {
  const RobustGain gain =
      gain_of_kept_design({.sensors = {.force_N = 30.0, .velocity_rad_s = 0.3}, .torque_Nm = 0.0142});
  EXPECT_GE(gain.mean, 2.0);
  EXPECT_GE(gain.worst_decile, 2.0);
}

RobustOptions short_search() {
  RobustOptions options;
  options.samples = 160;
  options.starts = 3;
  options.search_brakes = 4;
  options.verify_brakes = 10;
  options.limits.force_N = 20e3;
  return options;
}

TEST(RobustDesign, SearchKeepsItsLimitsAndDoesNotDependOnThreads) {
  RobustOptions options = short_search();
  double last = 0.0;
  options.progress = [&](double fraction, double) {
    EXPECT_GE(fraction, last);
    last = fraction;
  };
  options.threads = 1;
  const RobustSummary one = design_robust_experiment(options);
  EXPECT_DOUBLE_EQ(last, 1.0);
  options.progress = nullptr;
  options.threads = 2;
  const RobustSummary two = design_robust_experiment(options);
  ASSERT_TRUE(one.found) << one.message;
  EXPECT_EQ(one.block_torque_Nm, two.block_torque_Nm);
  EXPECT_EQ(one.evaluations, two.evaluations);
  EXPECT_LE(one.evaluation.force_max_N, options.limits.force_N);
  EXPECT_LE(one.evaluation.velocity_max_rad_s, options.limits.velocity_rad_s);
  EXPECT_LE(std::abs(one.trajectory.velocity_rad_s.back()), options.limits.end_velocity_rad_s + 0.1);
  EXPECT_TRUE(build_reference(one.trajectory, options.nominal));
}

RobustTarget for_parameters(std::vector<Parameter> parameters) {
  return {std::move(parameters), response_to(kept_design(), 20, {})};
}

/// The trajectories that ship beside the check's own, for what they have been designed for.
TEST(RobustDesign, ShippedFurtherTrajectoriesTellMoreThanMoreRunsOfTheChecksOwn) {
  const std::vector<BrakeParameters> brakes = draw_prior({}, 50, 23);
  const NoiseLevels noise = RobustOptions{}.noise;
  for (const auto& [name, parameters, at_least] :
       {std::tuple("sliding", std::vector{TC, Tv}, 4.0), std::tuple("breakaway", std::vector{Ts0, mus}, 6.0)}) {
    const RobustTarget target = for_parameters(parameters);
    const clampd::Run trajectory =
        read_run(std::string(CLAMPD_SOURCE_DIR) + "/configs/trajectory-" + name + ".csv").value().run;
    const RobustEvaluation design = evaluate_robust(trajectory, {}, brakes, noise, 3.0, target).value();
    const RobustEvaluation more = evaluate_robust(target.beside, {}, brakes, noise, 3.0, target).value();
    EXPECT_GT(gain_over(more, design, target).mean, at_least) << name;
    EXPECT_GT(gain_over(more, design, target).worst_decile, 2.0) << name;
    EXPECT_LT(design.stop_force_max_N, 12e3) << "gentle, whatever the brake";
  }
}

TEST(RobustDesign, SearchesForSomeParameters) {
  RobustOptions options;
  options.target = for_parameters({TC});
  options.starts = 3;
  options.search_brakes = 4;
  options.verify_brakes = 10;
  const RobustSummary summary = design_robust_experiment(options);
  ASSERT_TRUE(summary.found) << summary.message;
  EXPECT_GT(summary.gain.mean, 1.5) << "over four runs more of the check's own";
  options.target->parameters.clear();
  EXPECT_FALSE(options.validate());
}

TEST(RobustDesign, SaysWhenNothingIsPossible) {
  RobustOptions options = short_search();
  options.limits.torque_Nm = 0.04;  // below the static friction: the brake never moves
  const RobustSummary summary = design_robust_experiment(options);
  EXPECT_FALSE(summary.found);
  EXPECT_FALSE(summary.message.empty());
}

TEST(RobustDesign, RefusesImpossibleOptions) {
  const auto refuses = [](auto change) {
    RobustOptions options;
    change(options);
    return !options.validate();
  };
  EXPECT_TRUE(RobustOptions{}.validate());
  EXPECT_TRUE(refuses([](RobustOptions& o) { o.samples = 310; }));
  EXPECT_TRUE(refuses([](RobustOptions& o) { o.noise.torque_Nm = -1.0; }));
  EXPECT_TRUE(refuses([](RobustOptions& o) { o.search_brakes = 1; }));
  EXPECT_TRUE(refuses([](RobustOptions& o) { o.verify_brakes = 1; }));
  EXPECT_TRUE(refuses([](RobustOptions& o) { o.starts = 0; }));
}

}  // namespace
}  // namespace clampd
