// Fixed-seed Monte Carlo: is the output error method as good, and as honest, as theory says?

#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "clampd/identify/information.hpp"
#include "clampd/identify/output_error.hpp"
#include "support/excitation.hpp"
#include "support/reference_brake.hpp"

namespace clampd {
namespace {

constexpr double kForceNoise_N = 75.0;
constexpr double kVelocityNoise_rad_s = 1.5;
constexpr double kTorqueNoise_Nm = 0.0142;

ParameterVector normalised_error(const Estimate& summary, const BrakeParameters& truth) {
  return (summary.parameters.theta - truth.theta).cwiseQuotient(nominal_parameters());
}

ParameterMatrix bound_of(const std::vector<double>& torque) {
  SensitivitySimulation buffer(torque.size());
  return cramer_rao(initial_state_unknown(joint_information(BrakeParameters{}, BrakeState::Zero(), {torque},
                                                            {kForceNoise_N, kVelocityNoise_rad_s}, buffer)));
}

TEST(OutputErrorMonteCarlo, ReachesTheCramerRaoBoundWithoutTorqueNoise) {
  constexpr int kRuns = 2000;
  const BrakeParameters truth;
  const auto torque = support::strong_torque();
  Simulation simulation(torque.size());
  simulate(truth, BrakeState::Zero(), {torque}, simulation);
  const ParameterMatrix bound = bound_of(torque);

  std::mt19937_64 generator(20240611);
  ParameterVector mean = ParameterVector::Zero();
  ParameterVector square = ParameterVector::Zero();
  ParameterVector reported = ParameterVector::Zero();
  int converged = 0;
  for (int i = 0; i < kRuns; ++i) {
    const clampd::Run run = support::noisy_run(torque, simulation.force_N, simulation.velocity_rad_s,
                                               kForceNoise_N, kVelocityNoise_rad_s, generator);
    const auto summary = identify_output_error({&run, 1}, {});
    converged += summary.converged();
    const ParameterVector error = normalised_error(summary, truth);
    mean += error / kRuns;
    square += error.cwiseAbs2() / kRuns;
    reported += summary.covariance_normalised.diagonal() / kRuns;
  }
  EXPECT_EQ(converged, kRuns);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    const double variance = square[k] - mean[k] * mean[k];
    std::printf("%-4s bias %+.3f sd, variance %.3f of the bound, reported %.3f of it\n",
                kParameterTable[i].name.data(), mean[k] / std::sqrt(variance), variance / bound(k, k),
                reported[k] / bound(k, k));
    EXPECT_LT(std::abs(mean[k]), 0.1 * std::sqrt(variance)) << kParameterTable[i].name;
    EXPECT_NEAR(variance / bound(k, k), 1.0, 0.1) << kParameterTable[i].name;
    EXPECT_NEAR(reported[k] / bound(k, k), 1.0, 0.1) << kParameterTable[i].name;
  }
}

TEST(OutputErrorMonteCarlo, ConvergesFromHalfToOneAndAHalfTimesTheTruth) {
  constexpr int kRuns = 200;
  const BrakeParameters truth;
  const auto torque = support::strong_torque();
  Simulation simulation(torque.size());
  simulate(truth, BrakeState::Zero(), {torque}, simulation);
  const ParameterMatrix information = bound_of(torque).inverse();
  std::mt19937_64 generator(5);
  std::uniform_real_distribution<double> factor(0.5, 1.5);
  int found = 0;
  for (int i = 0; i < kRuns; ++i) {
    const clampd::Run run = support::noisy_run(torque, simulation.force_N, simulation.velocity_rad_s,
                                               kForceNoise_N, kVelocityNoise_rad_s, generator);
    EstimatorOptions options;
    for (auto& value : options.start.theta) value *= factor(generator);
    const auto summary = identify_output_error({&run, 1}, options);
    const ParameterVector error = normalised_error(summary, truth);
    // 40: beyond one in a million of a chi-square with seven degrees of freedom.
    found += summary.converged() && error.dot(information * error) < 40.0;
  }
  std::printf("converged from within 50 %%: %d of %d\n", found, kRuns);
  EXPECT_GE(found, kRuns * 99 / 100);
}

TEST(OutputErrorMonteCarlo, CovarianceOverRunsIsHonestUnderTorqueNoise) {
  // Twenty repeats of an independent brake whose acting torque carries noise that its reading does not show.
  constexpr int kChecks = 40;
  constexpr std::size_t kRepeats = 20;
  BrakeParameters truth;
  truth.theta =
      truth.theta.cwiseProduct((ParameterVector() << 0.95, 1.02, 1.1, 0.95, 1.1, 1.03, 0.9).finished());
  const auto torque = support::strong_torque();
  std::mt19937_64 generator(99);
  std::normal_distribution<double> normal;
  double robust = 0.0;
  double naive = 0.0;
  int converged = 0;
  for (int check = 0; check < kChecks; ++check) {
    std::vector<clampd::Run> runs;
    for (std::size_t repeat = 0; repeat < kRepeats; ++repeat) {
      std::vector<double> acting = torque;
      for (double& value : acting) value += kTorqueNoise_Nm * normal(generator);
      const auto trace = support::simulate_reference(truth, 0.0, 0.0, acting, 2e-5);
      runs.push_back(support::noisy_run(torque, trace.force_N, trace.velocity_rad_s, kForceNoise_N,
                                        kVelocityNoise_rad_s, generator));
    }
    const auto summary = identify_output_error(runs, {});
    converged += summary.converged();
    const ParameterVector error = normalised_error(summary, truth);
    robust += error.dot(summary.covariance_over_runs.ldlt().solve(error)) / kChecks;
    naive += error.dot(summary.covariance_normalised.ldlt().solve(error)) / kChecks;
  }
  // Seven parameters from a covariance estimated on twenty runs: Hotelling's T^2 with mean 7 * 19 / 11 and,
  // over forty checks, a standard error of 1.4.
  const double expected = 7.0 * 19.0 / 11.0;
  std::printf("mean squared normalised error: over runs %.1f (expected %.1f), Cramer-Rao %.1f\n", robust,
              expected, naive);
  EXPECT_EQ(converged, kChecks);
  EXPECT_NEAR(robust, expected, 3.0 * 1.44);
  EXPECT_GT(naive, 2.0 * 7.0);
}

}  // namespace
}  // namespace clampd
