// Fixed-seed Monte Carlo: are the estimators as good, and as honest, as theory says?

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "clampd/identify/information.hpp"
#include "clampd/identify/method.hpp"
#include "support/excitation.hpp"
#include "support/reference_brake.hpp"

namespace clampd {
namespace {

constexpr double kTruthStep_s = 2e-5;
constexpr NoiseLevels kCoarseSensors{{75.0, 1.5}, 0.0};
constexpr NoiseLevels kFineSensorsNoisyTorque{{30.0, 0.3}, 0.0142};

/// Runs of an independent brake whose acting torque carries noise that its reading does not show.
class Bench {
 public:
  Bench(const NoiseLevels& noise, std::uint64_t seed) : noise_(noise), generator_(seed) {}

  std::vector<clampd::Run> runs(std::size_t count, const BrakeParameters& truth = {}) {
    std::vector<clampd::Run> runs;
    for (std::size_t r = 0; r < count; ++r) {
      std::vector<double> acting = torque_;
      for (double& value : acting) value += noise_.torque_Nm * normal_(generator_);
      const auto trace = support::simulate_reference(truth, 0.0, 0.0, acting, kTruthStep_s);
      runs.push_back(support::noisy_run(torque_, trace.force_N, trace.velocity_rad_s, noise_.sensors.force_N,
                                        noise_.sensors.velocity_rad_s, generator_));
    }
    return runs;
  }

  ParameterMatrix bound(double count) const {
    return cramer_rao(initial_state_unknown(
               joint_information(BrakeParameters{}, BrakeState::Zero(), {torque_}, noise_))) /
           count;
  }

  std::mt19937_64& generator() { return generator_; }

 private:
  NoiseLevels noise_;
  std::vector<double> torque_ = support::strong_torque();
  std::mt19937_64 generator_;
  std::normal_distribution<double> normal_;
};

ParameterVector normalised_error(const Estimate& estimate) {
  return estimate.parameters.theta.cwiseQuotient(nominal_parameters()) - ParameterVector::Ones();
}

struct Study {
  int checks = 0;
  int converged = 0;
  double normalised_square = 0.0;  ///< mean of e^T covariance^-1 e; 7 if the covariance is honest
  ParameterVector variance = ParameterVector::Zero();
  ParameterVector mean = ParameterVector::Zero();
  std::vector<double> torque_noise_Nm;

  /// Geometric mean and least of the Cramer-Rao variance over the estimates'.
  double efficiency(const ParameterMatrix& bound) const {
    return std::exp(bound.diagonal().cwiseQuotient(variance).array().log().mean());
  }
  double least_efficiency(const ParameterMatrix& bound) const {
    return bound.diagonal().cwiseQuotient(variance).minCoeff();
  }
};

Study study(Method method, const NoiseLevels& noise, int checks, std::size_t repeats, std::uint64_t seed,
            const EstimatorOptions& options = {}) {
  Study result;
  result.checks = checks;
  Bench bench(noise, seed);
  ParameterVector square = ParameterVector::Zero();
  for (int i = 0; i < checks; ++i) {
    const Estimate estimate = identify_brake(method, bench.runs(repeats), options);
    if (!estimate.converged()) continue;
    ++result.converged;
    const ParameterVector error = normalised_error(estimate);
    result.mean += error;
    square += error.cwiseAbs2();
    result.normalised_square += error.dot(estimate.covariance_normalised.ldlt().solve(error));
    result.torque_noise_Nm.push_back(estimate.noise_torque_Nm);
  }
  result.mean /= result.converged;
  result.variance = square / result.converged - result.mean.cwiseAbs2();
  result.normalised_square /= result.converged;
  const ParameterMatrix bound = bench.bound(static_cast<double>(repeats));
  std::printf("%s, %d x %zu runs: %d converged, efficiency %.3f, least %.3f, normalised square %.2f\n",
              to_string(method).data(), checks, repeats, result.converged, result.efficiency(bound),
              result.least_efficiency(bound), result.normalised_square);
  return result;
}

EstimatorOptions known(const NoiseLevels& noise) {
  EstimatorOptions options;
  options.noise_force_N = noise.sensors.force_N;
  options.noise_velocity_rad_s = noise.sensors.velocity_rad_s;
  options.noise_torque_Nm = noise.torque_Nm;
  return options;
}

TEST(MonteCarlo, OutputErrorsReachTheBoundWithoutTorqueNoise) {
  const Study found = study(Method::OutputError, kCoarseSensors, 2000, 1, 20240611, known(kCoarseSensors));
  const ParameterMatrix bound = Bench(kCoarseSensors, 0).bound(1.0);
  EXPECT_EQ(found.converged, found.checks);
  EXPECT_GE(found.efficiency(bound), 0.97);
  EXPECT_GE(found.least_efficiency(bound), 0.92);
  EXPECT_LT((found.mean.cwiseAbs().cwiseQuotient(found.variance.cwiseSqrt())).maxCoeff(), 0.1);
  EXPECT_NEAR(found.normalised_square, 7.0, 0.7);
}

TEST(MonteCarlo, PredictionErrorsReachTheBoundUnderKnownTorqueNoise) {
  EstimatorOptions options;
  options.noise_torque_Nm = kFineSensorsNoisyTorque.torque_Nm;
  const Study found = study(Method::PredictionError, kFineSensorsNoisyTorque, 2000, 1, 5, options);
  const ParameterMatrix bound = Bench(kFineSensorsNoisyTorque, 0).bound(1.0);
  EXPECT_GE(found.converged, found.checks * 999 / 1000);
  EXPECT_GE(found.efficiency(bound), 0.95);
  EXPECT_GE(found.least_efficiency(bound), 0.88);
  EXPECT_NEAR(found.normalised_square, 7.0, 0.7);
}

TEST(MonteCarlo, RepeatsTellTheTorqueNoise) {
  constexpr int kChecks = 150;
  const Study found = study(Method::PredictionError, kFineSensorsNoisyTorque, kChecks, 20, 6);
  const ParameterMatrix bound = Bench(kFineSensorsNoisyTorque, 0).bound(20.0);
  EXPECT_EQ(found.converged, kChecks);
  EXPECT_GE(found.efficiency(bound), 0.9);
  // The least of seven, from 150 checks: two standard errors of a variance below its limit of 0.82.
  EXPECT_GE(found.least_efficiency(bound), 0.82 * (1.0 - 2.0 * std::sqrt(2.0 / kChecks)));
  double mean_variance = 0.0;
  int within = 0;
  for (const double noise : found.torque_noise_Nm) {
    const double ratio = noise * noise / (0.0142 * 0.0142);
    mean_variance += ratio / found.converged;
    within += std::abs(ratio - 1.0) < 0.25;
  }
  std::printf("torque variance: mean %.3f of the truth, %d of %d within 25 %%\n", mean_variance, within,
              kChecks);
  EXPECT_NEAR(mean_variance, 1.0, 0.05);
  EXPECT_GE(within, kChecks * 95 / 100);
  EXPECT_NEAR(found.normalised_square, 7.0, 0.7);
}

TEST(MonteCarlo, OutputErrorsOfRepeatsAreHonestUnderTorqueNoise) {
  // An open-loop simulation answers torque noise nonlinearly, which biases static friction by half a standard
  // deviation of twenty repeats; the covariance counts that too.
  const Study found = study(Method::OutputError, kFineSensorsNoisyTorque, 150, 20, 17);
  EXPECT_EQ(found.converged, found.checks);
  EXPECT_NEAR(found.normalised_square, 7.0, 0.7);
}

TEST(MonteCarlo, BothAreHonestOnRepeatsWithoutTorqueNoise) {
  for (const Method method : {Method::OutputError, Method::PredictionError}) {
    const Study found = study(method, kCoarseSensors, 200, 20, 18);
    EXPECT_EQ(found.converged, found.checks);
    EXPECT_NEAR(found.normalised_square, 7.0, 0.7);
  }
}

TEST(MonteCarlo, OneRunOfUnknownNoiseIsNearlyHonest) {
  // One run cannot tell little torque noise from none: without any it is reported larger on purpose, and with
  // some that looks like none the uncertainty is too small now and then.
  for (const NoiseLevels& noise : {kCoarseSensors, kFineSensorsNoisyTorque})
    for (const Method method : {Method::OutputError, Method::PredictionError}) {
      const Study found = study(method, noise, 500, 1, 9);
      EXPECT_GE(found.converged, found.checks * 99 / 100);
      // Widened to Student's interval with no less than four degrees: variances at most twice as large, 7
      // / 2.
      EXPECT_GT(found.normalised_square, 3.5);
      EXPECT_LT(found.normalised_square, 10.0);
    }
}

TEST(MonteCarlo, OutputErrorsConvergeFromHalfToOneAndAHalfTimesTheTruth) {
  constexpr int kFits = 500;
  Bench bench(kCoarseSensors, 77);
  const ParameterMatrix information = bench.bound(1.0).inverse();
  std::uniform_real_distribution<double> factor(0.5, 1.5);
  int same = 0;
  for (int i = 0; i < kFits; ++i) {
    const std::vector<clampd::Run> runs = bench.runs(1);
    EstimatorOptions options;
    for (double& value : options.start.theta) value *= factor(bench.generator());
    const Estimate far = identify_brake(Method::OutputError, runs, options);
    const Estimate near = identify_brake(Method::OutputError, runs, {});
    const ParameterVector difference = normalised_error(far) - normalised_error(near);
    same += far.converged() && near.converged() && difference.dot(information * difference) < 1.0;
  }
  std::printf("same optimum from within 50 %%: %d of %d\n", same, kFits);
  EXPECT_GE(same, kFits * 99 / 100);
}

TEST(MonteCarlo, RunsThatDifferAreNoticed) {
  for (const double spread : {0.0, 0.2}) {
    int differ = 0;
    double square = 0.0;
    constexpr int kChecks = 20;
    for (int check = 0; check < kChecks; ++check) {
      Bench bench(kFineSensorsNoisyTorque, 100 + static_cast<std::uint64_t>(check));
      std::normal_distribution<double> normal;
      std::vector<clampd::Run> runs;
      for (int repeat = 0; repeat < 20; ++repeat) {
        BrakeParameters brake;
        brake.theta[TC] *= 1.0 + spread * normal(bench.generator());
        runs.push_back(bench.runs(1, brake).front());
      }
      const Estimate estimate = identify_brake(Method::PredictionError, runs, {});
      ASSERT_TRUE(estimate.converged()) << estimate.message;
      differ += estimate.runs_differ;
      const double error = normalised_error(estimate)[TC];
      square += error * error / estimate.covariance_normalised(TC, TC) / kChecks;
    }
    std::printf("TC spread %.0f %%: %d of %d called different, squared error of TC %.2f\n", 100.0 * spread,
                differ, kChecks, square);
    if (spread > 0.0) {
      EXPECT_EQ(differ, kChecks);
      EXPECT_LT(square, 3.0);
    } else {
      EXPECT_LE(differ, 1);
    }
  }
}

}  // namespace
}  // namespace clampd
