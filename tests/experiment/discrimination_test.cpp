#include "clampd/experiment/discrimination.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/experiment/reference.hpp"
#include "clampd/experiment/robust_design.hpp"
#include "clampd/identify/extended_fit.hpp"
#include "clampd/simulation/simulate.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

const Run& optimal() {
  static const Run kOptimal =
      response_to({kKnownRobustBlocks_Nm.begin(), kKnownRobustBlocks_Nm.end()}, kKnownRobustBlockSamples, {});
  return kOptimal;
}

struct Explanation {
  std::string effect;
  std::vector<double> start;
};

/// A brake that has the first, measured six times along the optimal trajectory, and what both make of that.
struct Case {
  std::string name;
  std::string simulated;  ///< effect of the simulated brake, and how much of it
  double value;
  Explanation first, second;
};

sim::PlantConfiguration plant_of(const Case& one) {
  sim::PlantConfiguration plant;
  plant.sensors = {.force_noise_N = 50.0, .velocity_noise_rad_s = 0.8, .torque_noise_Nm = 0.01};
  EXPECT_TRUE(sim::set_effect(plant.effects, one.simulated, one.value));
  return plant;
}

struct Rivals {
  std::vector<RivalModel> models;
  NoiseLevels noise;
};

Rivals rivals_of(const Case& one) {
  const BrakeParameters nominal;
  const std::vector<Run> runs =
      simulate_manoeuvre(plant_of(one), build_reference(optimal(), nominal).value(), nominal, 6).value();
  const ExtendedEstimate base = fit_base(runs, nominal);
  Rivals rivals;
  for (const Explanation& explanation : {one.first, one.second}) {
    const EffectValues values{find_effect(explanation.effect), explanation.start};
    std::vector<FitRun> moved = fit_runs(runs);
    move_by(delays_of(values), moved);
    const ExtendedEstimate estimate = fit_extended(moved, with_effect(base, values));
    EXPECT_TRUE(estimate.possible) << explanation.effect;
    rivals.models.push_back({explanation.effect, estimate.parameters, estimate.covariance});
    rivals.noise = estimate.noise;
  }
  return rivals;
}

/// A shorter search than the default: the tests' own time.
DiscriminationOptions quick() {
  DiscriminationOptions options;
  options.prototypes_kept = 3;
  options.refinement_evaluations = 30;
  return options;
}

class RivalPairs : public ::testing::TestWithParam<Case> {};

TEST_P(RivalPairs, TheDesignTellsMoreThanEveryListedManoeuvreAndTheBrakeCanDoIt) {
  const BrakeParameters nominal;
  const Rivals rivals = rivals_of(GetParam());
  const Result<Discrimination> design = design_discrimination(rivals.models, rivals.noise, nominal, quick());
  ASSERT_TRUE(design) << design.error().message;
  EXPECT_TRUE(design->settles) << design->why;
  EXPECT_GE(design->expected_evidence_nats, DiscriminationOptions{}.enough_nats);
  EXPECT_GE(design->repeats, 1);
  EXPECT_LE(design->repeats, DiscriminationOptions{}.most_repeats);
  EXPECT_THAT(design->why, HasSubstr(rivals.models[0].name));
  EXPECT_THAT(design->why, HasSubstr(rivals.models[1].name));
  EXPECT_GE(design->trajectory.size(), 300U);
  EXPECT_LE(design->trajectory.size(), 1220U);

  DiscriminationOptions anything = quick();  // some of the listed ones go further than a design may
  anything.force_limit_N = 30e3;
  anything.velocity_limit_rad_s = 300.0;
  for (const ManoeuvreInfo& manoeuvre : manoeuvres()) {
    const auto trajectory = make_manoeuvre(manoeuvre.name, nominal, optimal()).value();
    const Result<DiscriminationValue> value =
        evaluate_discrimination(trajectory, rivals.models, rivals.noise, nominal, anything);
    ASSERT_TRUE(value) << value.error().message;
    // A long one may tell more in all, a short one more a sample; none does both.
    EXPECT_TRUE(design->evidence_nats > value->evidence_nats ||
                design->evidence_per_sample_nats > value->evidence_per_sample_nats)
        << manoeuvre.name;
  }

  const SimulatedCheck check =
      simulate_check(plant_of(GetParam()), build_reference(design->trajectory, nominal).value(), nominal,
                     {.repeats = static_cast<std::uint16_t>(design->repeats)});
  EXPECT_EQ(check.fault, FaultCause::None) << to_string(check.fault);
  ASSERT_EQ(check.runs.size(), static_cast<std::size_t>(design->repeats));
  for (const SimulatedRun& run : check.runs)
    for (const sim::Truth& truth : run.truth) {
      ASSERT_LE(truth.force_N, 25e3);
      ASSERT_LE(std::abs(truth.velocity_rad_s), 250.0);
    }
  for (const SimulatedRun& run : check.runs)
    for (const double torque_Nm : run.readings.torque_Nm) ASSERT_LE(std::abs(torque_Nm), 3.0 + 0.06);
}

INSTANTIATE_TEST_SUITE_P(
    Discrimination, RivalPairs,
    ::testing::Values(
        Case{"LagOrSkew", "force-lag", 0.002, {"force-lag", {0.002}}, {"channel-skew", {0.2, 1, 1}}},
        Case{"LagOrSkewOfARow", "channel-skew", 1.0, {"force-lag", {0.001}}, {"channel-skew", {0.95, 0, 1}}},
        Case{"VelocityLagOrSkew",
             "velocity-lag",
             0.15e-3,
             {"velocity-lag", {0.15e-3}},
             {"channel-skew", {0.15, 0, 2}}},
        Case{"BacklashOrHysteresis",
             "backlash",
             0.05,
             {"backlash", {0.05}},
             {"stiffness-hysteresis", {0.01, 0.5, 1.0}}},
        Case{"RelaxationOrLag",
             "pad-relaxation",
             0.02,
             {"pad-relaxation", {0.02, 0.15}},
             {"force-lag", {0.001}}},
        Case{"GainOrInertia", "torque-gain", 0.03, {"torque-gain", {0.03}}, {"inertia-error", {-0.03}}},
        Case{"TorqueOrVelocityLag",
             "torque-lag",
             0.0005,
             {"torque-lag", {0.0005}},
             {"velocity-lag", {0.0005}}}),
    [](const ::testing::TestParamInfo<Case>& one) { return one.param.name; });

RivalModel model(std::string name, EffectValues values) {
  const ExtendedParameters parameters{{}, {std::move(values)}};
  const int size = ExtendedBrake(parameters).parameters();
  return {std::move(name), parameters,
          Eigen::MatrixXd::Constant(size, size, std::numeric_limits<double>::quiet_NaN())};
}

/// So short a filter is a delay.
TEST(Discrimination, TwinsCannotBeSettledAndItSaysSo) {
  const std::vector<RivalModel> twins = {
      model("velocity-lag", {find_effect("velocity-lag"), {0.02e-3}}),
      model("channel-skew", {find_effect("channel-skew"), {0.02, 0.0, 2.0}})};
  const Result<Discrimination> design = design_discrimination(twins, {{50.0, 0.8}, 0.01}, {}, quick());
  ASSERT_TRUE(design) << design.error().message;
  EXPECT_FALSE(design->settles);
  EXPECT_LT(design->expected_evidence_nats, 2.0);
  EXPECT_EQ(design->repeats, DiscriminationOptions{}.most_repeats);
  EXPECT_THAT(design->why, HasSubstr("cannot be told apart"));
}

/// While it slides and while it sticks, a constant torque is one whatever brings it about.
TEST(Discrimination, TheDriveOffTellsAnOffsetOfTheReadingFromAnAsymmetry) {
  std::vector<RivalModel> twins = {
      model("torque-offset", {find_effect("torque-offset"), {0.002}}),
      model("friction-asymmetry", {find_effect("friction-asymmetry"), {0.002, 0.0, 1.0}})};
  for (RivalModel& twin : twins) twin.covariance.setZero();
  twins[0].covariance(7, 7) = std::pow(0.0002, 2);
  const NoiseLevels noise{{50.0, 0.8}, 0.01};
  const Result<Discrimination> design = design_discrimination(twins, noise, {}, quick());
  ASSERT_TRUE(design) << design.error().message;
  EXPECT_TRUE(design->settles);
  EXPECT_EQ(design->name, "drive off");
  EXPECT_THAT(design->why, HasSubstr("torque-offset and friction-asymmetry would read differently"));
  EXPECT_EQ(design->repeats, 1);
  EXPECT_GE(design->expected_evidence_nats, DiscriminationOptions{}.wanted_nats);
  EXPECT_FALSE(is_driven(design->trajectory));
  // No longer than it takes: 1/2 (0.002 / sd)^2 nats, the sd of both, if the offset is not there.
  const double sd_Nm = std::hypot(0.01 / std::sqrt(static_cast<double>(design->trajectory.size())), 0.0002);
  EXPECT_NEAR(design->expected_evidence_nats, 0.5 * std::pow(0.002 / sd_Nm, 2), 1.0);
  EXPECT_FALSE(build_reference(design->trajectory, {})) << "nothing to track";

  twins[0].parameters.effects[0].values[0] = twins[1].parameters.effects[0].values[0] = 2e-5;
  EXPECT_FALSE(design_discrimination(twins, noise, {}, quick())->settles) << "too faint for ten seconds";
}

TEST(Discrimination, CountsTheTwoOfThreeThatAreHardestToTellApart) {
  const std::vector<RivalModel> rivals = {
      model("torque-offset", {find_effect("torque-offset"), {0.01}}),
      model("backlash", {find_effect("backlash"), {0.3}}),
      model("friction-asymmetry", {find_effect("friction-asymmetry"), {0.01, 0.0, 1.0}})};
  const auto trajectory = make_manoeuvre("apply-release", {}, optimal()).value();
  const NoiseLevels noise{{50.0, 0.8}, 0.01};
  const DiscriminationValue all = evaluate_discrimination(trajectory, rivals, noise, {}).value();
  ASSERT_TRUE(all.feasible) << all.infeasible;
  EXPECT_EQ(all.first, 0U);
  EXPECT_EQ(all.second, 2U);
  const DiscriminationValue apart =
      evaluate_discrimination(trajectory, std::span(rivals).first(2), noise, {}).value();
  EXPECT_GT(apart.evidence_nats, 100.0);
  EXPECT_LT(all.evidence_nats, 2.0);
}

TEST(Discrimination, WhatTheRunsSoFarTellHelps) {
  std::vector<RivalModel> rivals = {model("torque-gain", {find_effect("torque-gain"), {0.03}}),
                                    model("torque-offset", {find_effect("torque-offset"), {0.0}})};
  const auto trajectory = make_manoeuvre("staircase", {}, optimal()).value();
  const NoiseLevels noise{{50.0, 0.8}, 0.01};
  const double unknown = evaluate_discrimination(trajectory, rivals, noise, {})->evidence_nats;
  for (RivalModel& rival : rivals) {
    rival.covariance.setZero();
    for (Eigen::Index i = 0; i < static_cast<Eigen::Index>(kParameterCount); ++i)
      rival.covariance(i, i) = std::pow(0.01 * nominal_parameters()[i], 2);
    rival.covariance(7, 7) = 1e-6;
  }
  const double known = evaluate_discrimination(trajectory, rivals, noise, {})->evidence_nats;
  EXPECT_GT(known, 1.5 * unknown);
}

TEST(Discrimination, RepeatsExactlyWhateverTheThreads) {
  const std::vector<RivalModel> rivals = {
      model("backlash", {find_effect("backlash"), {0.05}}),
      model("stiffness-hysteresis", {find_effect("stiffness-hysteresis"), {0.01, 0.5, 1.0}})};
  DiscriminationOptions options = quick();
  options.prototypes_kept = 2;
  options.refinement_evaluations = 12;
  options.threads = 1;
  const Discrimination one = design_discrimination(rivals, {{50.0, 0.8}, 0.01}, {}, options).value();
  options.threads = 3;
  const Discrimination three = design_discrimination(rivals, {{50.0, 0.8}, 0.01}, {}, options).value();
  EXPECT_EQ(one.trajectory.torque_Nm, three.trajectory.torque_Nm);
  EXPECT_EQ(one.expected_evidence_nats, three.expected_evidence_nats);
  EXPECT_EQ(one.repeats, three.repeats);
  EXPECT_EQ(one.why, three.why);
}

TEST(Discrimination, RefusesWhatItCannotCompare) {
  const RivalModel backlash = model("backlash", {find_effect("backlash"), {0.05}});
  const std::vector<RivalModel> alone = {backlash};
  EXPECT_THAT(design_discrimination(alone, {}, {}).error().message, HasSubstr("two or three"));
  std::vector<RivalModel> pair = {backlash, backlash};
  pair[1].name = "other";
  pair[1].covariance.resize(3, 3);
  EXPECT_THAT(design_discrimination(pair, {}, {}).error().message, HasSubstr("other"));
  pair[1] = backlash;
  DiscriminationOptions options;
  options.longest_s = 0.1;
  EXPECT_THAT(design_discrimination(pair, {}, {}, options).error().message, HasSubstr("longest_s"));
  options = {};
  options.velocity_limit_rad_s = 0.5;
  EXPECT_FALSE(design_discrimination(pair, {{50.0, 0.8}, 0.01}, {}, options));
}

TEST(Discrimination, ATrajectoryThatARivalCannotDoIsNotFeasible) {
  std::vector<RivalModel> rivals = {model("backlash", {find_effect("backlash"), {0.05}}),
                                    model("torque-gain", {find_effect("torque-gain"), {0.1}})};
  const auto trajectory = make_manoeuvre("step", {}, optimal()).value();
  DiscriminationOptions options;
  EXPECT_TRUE(evaluate_discrimination(trajectory, rivals, {{50.0, 0.8}, 0.01}, {}, options)->feasible);
  options.force_limit_N = 18e3;
  const DiscriminationValue value =
      evaluate_discrimination(trajectory, rivals, {{50.0, 0.8}, 0.01}, {}, options).value();
  EXPECT_FALSE(value.feasible);
  EXPECT_THAT(value.infeasible, HasSubstr("would reach"));
}

}  // namespace
}  // namespace clampd
