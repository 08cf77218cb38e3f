#pragma once

#include <chrono>
#include <span>
#include <string>

#include "clampd/identify/residual_level.hpp"
#include "src/identify/joint_fit.hpp"

namespace clampd::identify {

/// An estimate without any number: all NaN, the fixed parameters as given.
Estimate empty_estimate(const EstimatorOptions& options);

/// The first thing wrong with the runs or the options, in words.
Result<void> check_input(std::span<const Run> runs, const EstimatorOptions& options);

/// Fills the estimate from a fit evaluated at `unknowns`, whose runs have noise of these variances, the
/// torque's known as well as NoiseFit::torque_spread tells, and says whether it can be relied on. `settled`:
/// the search ended by itself.
void conclude(JointFit& fit, const Eigen::VectorXd& unknowns, const Variances& variances,
              double torque_spread, bool settled, const EstimatorOptions& options, Estimate& estimate);

/// What the estimate leaves of the runs, by its method.
ResidualLevel level_of(std::span<const Run> runs, const Estimate& estimate);

/// Makes an estimate one without numbers: Unexplained. What is left of the runs stays in it.
void withdraw(std::string why, Estimate& estimate);

/// The same for a prediction error estimate that is far above the noise; any other stays as it is.
void withdraw_unexplained(std::span<const Run> runs, Estimate& estimate);

class Stopwatch {
 public:
  double seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count();
  }

 private:
  std::chrono::steady_clock::time_point began_ = std::chrono::steady_clock::now();
};

}  // namespace clampd::identify
