#pragma once

#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/identify/estimate.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"
#include "support/reference_brake.hpp"

namespace clampd::support {

/// A run of the reference brake, and the states it really had.
struct NoisyRun {
  Run run;
  ReferenceTrace truth;
};

/// The recorded torque plus white noise acts on the reference brake; its readings carry the sensors' noise.
inline NoisyRun run_reference_brake(const BrakeParameters& parameters, const BrakeState& initial,
                                    const std::vector<double>& torque_Nm, const NoiseLevels& noise,
                                    std::mt19937_64& generator, double step_s = 2e-5) {
  std::normal_distribution<double> normal;
  std::vector<double> acting = torque_Nm;
  for (double& value : acting) value += noise.torque_Nm * normal(generator);
  NoisyRun result;
  result.truth = simulate_reference(parameters, initial[0], initial[1], acting, step_s);
  result.run.name = "reference brake";
  result.run.torque_Nm = torque_Nm;
  for (std::size_t k = 0; k < torque_Nm.size(); ++k) {
    result.run.time_s.push_back(1e-3 * static_cast<double>(k));
    result.run.force_N.push_back(result.truth.force_N[k] + noise.sensors.force_N * normal(generator));
    result.run.velocity_rad_s.push_back(result.truth.velocity_rad_s[k] +
                                        noise.sensors.velocity_rad_s * normal(generator));
  }
  return result;
}

/// A brake as far from nominal as the paper's Table II goes.
inline BrakeParameters unlike_nominal() {
  BrakeParameters brake;
  brake.theta =
      brake.theta.cwiseProduct((ParameterVector() << 0.9, 0.95, 1.3, 0.9, 1.3, 1.05, 0.7).finished());
  return brake;
}

/// (estimate - truth) / theta_nom.
inline ParameterVector normalised_error(const BrakeParameters& estimate, const BrakeParameters& truth) {
  return (estimate.theta - truth.theta).cwiseQuotient(nominal_parameters());
}

/// Of a brake that does nothing.
inline Run constant_run(std::size_t rows, double torque_Nm, double velocity_rad_s, double force_N) {
  Run run;
  run.name = "constant";
  for (std::size_t k = 0; k < rows; ++k) run.time_s.push_back(1e-3 * static_cast<double>(k));
  run.torque_Nm.assign(rows, torque_Nm);
  run.velocity_rad_s.assign(rows, velocity_rad_s);
  run.force_N.assign(rows, force_N);
  return run;
}

/// Whatever the runs were: converged with numbers, or without any.
inline void expect_no_nonsense(const Estimate& estimate) {
  EXPECT_FALSE(estimate.message.empty());
  if (estimate.converged()) {
    EXPECT_TRUE(estimate.parameters.theta.allFinite());
    EXPECT_TRUE(estimate.covariance_normalised.allFinite());
    EXPECT_GT(estimate.covariance_normalised.diagonal().minCoeff(), 0.0);
  }
  if (estimate.termination == Termination::NotIdentifiable) {
    EXPECT_TRUE(estimate.covariance_normalised.array().isNaN().all());
  }
  if (estimate.termination == Termination::NumericalFailure) {
    EXPECT_TRUE(estimate.parameters.theta.array().isNaN().all());
  }
}

}  // namespace clampd::support
