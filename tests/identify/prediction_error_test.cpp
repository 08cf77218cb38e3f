#include "clampd/identify/prediction_error.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "clampd/identify/method.hpp"
#include "clampd/identify/output_error.hpp"
#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd {
namespace {

using support::constant_run;
using support::expect_no_nonsense;
using support::normalised_error;
using ::testing::HasSubstr;

const NoiseLevels kNoise{{30.0, 0.3}, 0.0142};

clampd::Run strong_run(unsigned seed, const BrakeParameters& truth = {}, const NoiseLevels& noise = kNoise,
                       const BrakeState& initial = BrakeState::Zero()) {
  std::mt19937_64 generator(seed);
  return support::run_reference_brake(truth, initial, support::strong_torque(), noise, generator).run;
}

clampd::Run exact_run(const BrakeParameters& truth, const BrakeState& initial = BrakeState::Zero()) {
  const auto torque = support::strong_torque();
  Simulation simulation(torque.size());
  simulate(truth, initial, {torque}, simulation);
  std::mt19937_64 unused;
  return support::noisy_run(torque, simulation.force_N, simulation.velocity_rad_s, 0.0, 0.0, unused);
}

/// Errors in the reported standard deviations, held parameters zero.
ParameterVector in_deviations(const Estimate& estimate, const BrakeParameters& truth) {
  ParameterVector error = normalised_error(estimate.parameters, truth);
  for (int i = 0; i < error.size(); ++i) {
    const double variance = estimate.covariance_normalised(i, i);
    error[i] = variance > 0.0 ? error[i] / std::sqrt(variance) : 0.0;
  }
  return error;
}

TEST(PredictionError, RecoversTheParametersOfANoiseFreeRunExactly) {
  const BrakeParameters truth = support::unlike_nominal();
  const clampd::Run run = exact_run(truth);
  const Estimate estimate = identify_prediction_error({&run, 1}, {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  EXPECT_LT((estimate.parameters.theta.cwiseQuotient(truth.theta).array() - 1.0).abs().maxCoeff(), 1e-4);
}

TEST(PredictionError, StartsWarmAndStaysAtTheOptimum) {
  const clampd::Run run = strong_run(2, support::unlike_nominal());
  const Estimate cold = identify_prediction_error({&run, 1}, {});
  EstimatorOptions options;
  options.start = cold.parameters;
  const Estimate warm = identify_prediction_error({&run, 1}, options);
  ASSERT_TRUE(cold.converged() && warm.converged());
  EXPECT_LE(warm.iterations, cold.iterations);
  const ParameterVector apart = normalised_error(warm.parameters, cold.parameters);
  EXPECT_LT(apart.dot(cold.covariance_normalised.ldlt().solve(apart)), 1.0);
}

TEST(PredictionError, OfAMethodIsWhatIdentifyGives) {
  const clampd::Run run = strong_run(3);
  EXPECT_EQ(identify_brake(Method::PredictionError, {&run, 1}, {}).parameters.theta,
            identify_prediction_error({&run, 1}, {}).parameters.theta);
  EXPECT_EQ(identify_brake(Method::OutputError, {&run, 1}, {}).parameters.theta,
            identify_output_error({&run, 1}, {}).parameters.theta);
  for (const Method method : {Method::OutputError, Method::PredictionError})
    EXPECT_EQ(parse_method(to_string(method)), method);
  EXPECT_FALSE(parse_method("oemm"));
}

TEST(Held, AnySubsetStaysAndTheOthersAreRight) {
  const BrakeParameters truth = support::unlike_nominal();
  std::vector<clampd::Run> runs;
  for (unsigned seed = 40; seed < 42; ++seed) runs.push_back(strong_run(seed, truth, {{75.0, 1.5}, 0.0}));
  std::mt19937_64 generator(12);
  // Held exactly at the truth: whatever is left must be right and no vaguer than with nothing held.
  const Estimate all[2] = {identify_output_error(runs, {}), identify_prediction_error(runs, {})};
  for (int trial = 0; trial < 24; ++trial) {
    EstimatorOptions options;
    int free = 0;
    while (free == 0) {
      free = 0;
      for (std::size_t i = 0; i < kParameterCount; ++i) {
        options.held[i] = trial < 7 ? static_cast<int>(i) == trial : generator() % 2 == 0;
        free += !options.held[i];
      }
    }
    for (std::size_t i = 0; i < kParameterCount; ++i)
      if (options.held[i])
        options.start.theta[static_cast<Eigen::Index>(i)] = truth.theta[static_cast<Eigen::Index>(i)];
    for (const Method method : {Method::OutputError, Method::PredictionError}) {
      const Estimate estimate = identify_brake(method, runs, options);
      const Estimate& with_all = all[method == Method::OutputError ? 0 : 1];
      ASSERT_TRUE(estimate.converged()) << trial << ' ' << estimate.message;
      const ParameterVector deviations = in_deviations(estimate, truth);
      for (Eigen::Index i = 0; i < deviations.size(); ++i) {
        if (options.held[static_cast<std::size_t>(i)]) {
          EXPECT_EQ(estimate.parameters.theta[i], truth.theta[i]) << trial;
          EXPECT_TRUE((estimate.covariance_normalised.row(i).array() == 0.0).all()) << trial;
          EXPECT_TRUE((estimate.covariance_normalised.col(i).array() == 0.0).all()) << trial;
        } else {
          EXPECT_LT(std::abs(deviations[i]), 4.0)
              << trial << ' ' << kParameterTable[static_cast<std::size_t>(i)].name;
          EXPECT_GT(estimate.covariance_normalised(i, i), 0.0);
          EXPECT_LT(estimate.covariance_normalised(i, i), 1.3 * with_all.covariance_normalised(i, i))
              << trial;
        }
      }
    }
  }
}

TEST(PredictionError, EstimatesTheNoiseItDoesNotKnowAndKeepsWhatItKnows) {
  std::vector<clampd::Run> runs;
  for (unsigned seed = 60; seed < 80; ++seed) runs.push_back(strong_run(seed));
  const Estimate unknown = identify_prediction_error(runs, {});
  ASSERT_TRUE(unknown.converged()) << unknown.message;
  EXPECT_NEAR(unknown.noise_force_N, 30.0, 1.0);
  EXPECT_NEAR(unknown.noise_velocity_rad_s, 0.3, 0.01);
  EXPECT_NEAR(unknown.noise_torque_Nm, 0.0142, 0.25 * 0.0142);
  EXPECT_NEAR(unknown.force_rms_N, 30.0, 3.0);
  EstimatorOptions options;
  options.noise_force_N = 30.0;
  options.noise_velocity_rad_s = 0.3;
  options.noise_torque_Nm = 0.0142;
  const Estimate known = identify_prediction_error(runs, options);
  ASSERT_TRUE(known.converged()) << known.message;
  EXPECT_DOUBLE_EQ(known.noise_force_N, 30.0);
  EXPECT_DOUBLE_EQ(known.noise_velocity_rad_s, 0.3);
  EXPECT_DOUBLE_EQ(known.noise_torque_Nm, 0.0142);
  const ParameterVector apart = normalised_error(unknown.parameters, known.parameters);
  EXPECT_LT(apart.dot(known.covariance_normalised.ldlt().solve(apart)), 1.0);
  // One run more or less: the covariance is that of twenty.
  const Estimate single = identify_prediction_error({runs.data(), 1}, options);
  ASSERT_TRUE(single.converged());
  EXPECT_NEAR(single.covariance_normalised(k2, k2) / known.covariance_normalised(k2, k2), 20.0, 6.0);
}

TEST(Loss, RobustForgivesSpikesThatSquaredDoesNot) {
  const BrakeParameters truth = support::unlike_nominal();
  constexpr int kRuns = 8;
  for (const Method method : {Method::OutputError, Method::PredictionError}) {
    // For output errors no torque noise, which they do not model while fitting.
    const NoiseLevels noise = method == Method::OutputError ? NoiseLevels{{30.0, 0.3}, 0.0} : kNoise;
    double squared_worst = 0.0;
    double robust_error = 0.0;
    double squared_error = 0.0;
    for (unsigned i = 0; i < kRuns; ++i) {
      clampd::Run run = strong_run(200 + i, truth, noise);
      std::mt19937_64 generator(300 + i);
      for (int spike = 0; spike < 6; ++spike) run.force_N[generator() % 300] += 2000.0;
      EstimatorOptions options;
      options.noise_torque_Nm = noise.torque_Nm;
      const Estimate squared = identify_brake(method, {&run, 1}, options);
      options.loss = Loss::Robust;
      const Estimate robust = identify_brake(method, {&run, 1}, options);
      ASSERT_TRUE(robust.converged()) << i << ' ' << robust.message;
      EXPECT_LT(in_deviations(robust, truth).cwiseAbs().maxCoeff(), 3.5) << to_string(method) << ' ' << i;
      // In one and the same measure: the robust estimate's covariance.
      const auto distance = [&](const Estimate& estimate) {
        const ParameterVector error = normalised_error(estimate.parameters, truth);
        return error.dot(robust.covariance_normalised.ldlt().solve(error)) / kRuns;
      };
      robust_error += distance(robust);
      squared_error += squared.converged() ? distance(squared) : 1e3 / kRuns;
      if (squared.converged()) {
        const ParameterVector error = normalised_error(squared.parameters, truth);
        squared_worst = std::max(
            squared_worst,
            error.cwiseAbs().cwiseQuotient(robust.covariance_normalised.diagonal().cwiseSqrt()).maxCoeff());
      }
    }
    std::printf(
        "%s with spikes: squared error %.1f robust, %.1f squared; worst parameter of squared %.1f sd\n",
        to_string(method).data(), robust_error, squared_error, squared_worst);
    EXPECT_GT(squared_worst, 3.0) << to_string(method);
    EXPECT_GT(squared_error, 3.0 * robust_error) << to_string(method);
  }
}

TEST(Loss, RobustCostsLittleWithoutSpikes) {
  const clampd::Run run = strong_run(5);
  EstimatorOptions options;
  options.noise_torque_Nm = 0.0142;
  const Estimate squared = identify_prediction_error({&run, 1}, options);
  options.loss = Loss::Robust;
  const Estimate robust = identify_prediction_error({&run, 1}, options);
  ASSERT_TRUE(squared.converged() && robust.converged());
  const ParameterVector apart = normalised_error(robust.parameters, squared.parameters);
  EXPECT_LT(apart.dot(squared.covariance_normalised.ldlt().solve(apart)), 2.0);
  for (int i = 0; i < 7; ++i)
    EXPECT_NEAR(robust.covariance_normalised(i, i) / squared.covariance_normalised(i, i), 1.0, 0.2) << i;
}

TEST(PredictionError, FitsRunsWithTheirOwnInitialStatesJointly) {
  const BrakeParameters truth = support::unlike_nominal();
  const BrakeState initial[4] = {{-0.8, 0.0}, {0.0, 0.0}, {3.0, 0.0}, {-2.0, 15.0}};
  std::vector<clampd::Run> runs;
  for (unsigned r = 0; r < 4; ++r) runs.push_back(strong_run(80 + r, truth, kNoise, initial[r]));
  const Estimate estimate = identify_prediction_error(runs, {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  ASSERT_EQ(estimate.initial_states.size(), 4u);
  ASSERT_EQ(estimate.run_velocity_rms_rad_s.size(), 4u);
  for (std::size_t r = 0; r < 4; ++r) {
    EXPECT_NEAR(estimate.initial_states[r][0], initial[r][0], 0.1) << r;
    EXPECT_NEAR(estimate.run_velocity_rms_rad_s[r], 0.3, 0.1) << r;
  }
  EXPECT_LT(in_deviations(estimate, truth).cwiseAbs().maxCoeff(), 4.0);
  EXPECT_FALSE(estimate.runs_differ);
}

TEST(PredictionError, SaysWhenTheRunsCannotTell) {
  for (const clampd::Run& run : {constant_run(300, 0.0, 0.0, 0.0), constant_run(300, 0.5, 0.0, 20000.0),
                                 constant_run(300, 0.0, 10.0, 100.0), constant_run(3, 0.1, 0.0, 0.0),
                                 constant_run(2, 0.0, 0.0, 0.0)}) {
    const Estimate estimate = identify_prediction_error({&run, 1}, {});
    EXPECT_FALSE(estimate.converged()) << run.size() << " rows, " << run.force_N[0] << " N";
    expect_no_nonsense(estimate);
  }
}

TEST(PredictionError, SurvivesSpikes) {
  for (const Loss loss : {Loss::Squared, Loss::Robust})
    for (const double spike : {1e5, 1e9, 1e15, -1e12}) {
      clampd::Run run = strong_run(9);
      for (std::size_t k = 50; k < 300; k += 50) {
        run.force_N[k] = spike;
        run.velocity_rad_s[k + 3] = -spike;
      }
      EstimatorOptions options;
      options.loss = loss;
      expect_no_nonsense(identify_prediction_error({&run, 1}, options));
      run.torque_Nm[70] = spike;
      expect_no_nonsense(identify_prediction_error({&run, 1}, options));
    }
}

TEST(PredictionError, RejectsWhatIsNotARun) {
  const auto message_of = [](std::span<const clampd::Run> runs, const EstimatorOptions& options) {
    const Estimate estimate = identify_prediction_error(runs, options);
    EXPECT_EQ(estimate.termination, Termination::NumericalFailure);
    expect_no_nonsense(estimate);
    return estimate.message;
  };
  EXPECT_THAT(message_of({}, {}), HasSubstr("no run"));
  clampd::Run run = strong_run(10);
  EstimatorOptions nothing_left;
  nothing_left.held.fill(true);
  EXPECT_THAT(message_of({&run, 1}, nothing_left), HasSubstr("held"));
  EstimatorOptions negative;
  negative.noise_torque_Nm = -1.0;
  EXPECT_THAT(message_of({&run, 1}, negative), HasSubstr("torque noise"));
  run.velocity_rad_s[4] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message_of({&run, 1}, {}), HasSubstr("row 4 of velocity_rad_s"));
}

}  // namespace
}  // namespace clampd
