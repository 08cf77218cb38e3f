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
  /// Of each run's score the square over its own covariance, summed, and in how many directions: chi-square where the
  /// runs differ by their noise alone, the parameters that all share taken off. Whatever motions the runs are of.
  double score_squares = 0.0;
  double score_degrees = 0.0;
};

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
