#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "src/identify/joint_fit.hpp"

namespace clampd::identify {

/// Fewer runs do not span seven parameters: their scatter tells that they differ, but is no covariance.
inline constexpr std::size_t kFewestRunsForScatter = 8;

struct Uncertainty {
  ParameterMatrix information;              ///< under the weights of the fit
  ParameterMatrix covariance;               ///< under `variances`
  ParameterMatrix covariance_exact_torque;  ///< the same without torque noise
  ParameterMatrix covariance_over_runs;     ///< from the scatter of the runs' scores; NaN for a single run
  OffsetSensitivity offset_sensitivity;
  /// Of runs that differ by their noise alone: expectation and variance of the trace of (covariance^-1
  /// covariance_over_runs), times the number of runs less one. Of repeats of one motion it is chi-square; runs of several
  /// motions tell differently much.
  double scatter_expected = 0.0;
  double scatter_variance = 0.0;
};

/// Of one run's score, its initial state eliminated.
struct RunScore {
  Eigen::Matrix<double, kTheta, kUnknowns> eliminate;  ///< of all unknowns, the parameters' part
  ParameterMatrix by_readings;                         ///< its covariance by the readings' noise
  ParameterMatrix by_torque;                           ///< and by the torque's
};
RunScore run_score(const Normal& normal, const ScoreMoments& moments, const Variances& variances);

/// Of the estimate at the fit's last evaluated point, whose readings and torque have noise of these
/// variances, whatever weights the fit used. Rows and columns of held parameters are zero.
Uncertainty uncertainty_of(const JointFit& fit, std::span<const ScoreMoments> moments,
                           const Variances& variances, const Held& held);

/// What the runs bring to it whatever is held.
std::vector<ScoreMoments> score_moments_of(JointFit& fit);

/// Widens the covariance of an output error estimate by the bias that a noticeable torque noise leaves in it.
void add_curvature_bias(const JointFit& fit, const Variances& variances, const Held& held,
                        Uncertainty& uncertainty);

}  // namespace clampd::identify
