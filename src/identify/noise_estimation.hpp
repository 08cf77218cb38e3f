#pragma once

#include <span>

#include "src/identify/joint_fit.hpp"

namespace clampd::identify {

/// Where the search for the torque's noise starts.
inline constexpr double kTorqueNoiseStart_Nm = 1e-2;

/// Which variances are known and stay.
struct KnownVariances {
  bool force = false;
  bool velocity = false;
  bool torque = false;
};

/// Enough from any start: scoring settles in three or four.
inline constexpr int kScoringIterations = 12;

struct NoiseFit {
  Variances variances;
  bool white = false;      ///< the innovations that are left, parameters refitted, do not hang together
  double criterion = 0.0;  ///< minus the restricted log-likelihood, less a constant
  /// Variance of the torque's variance, over its square: how well it is known. Zero where it was given.
  double torque_spread = 0.0;
};

/// Restricted maximum likelihood for the variances of the noise, for runs linearised about some trajectory:
/// parameters and initial states are integrated out, so that what they absorb is not taken for small noise
/// (plain maximum likelihood lets the torque's noise collapse to zero). Fisher scoring from `start`. The
/// runs' gains end as those of the result.
NoiseFit estimate_noise(std::span<LinearRun> runs, std::span<const ReadingWeights> weights,
                        std::span<const Eigen::Vector2d> prior_distances, const Held& held,
                        const Variances& start, const KnownVariances& known, int max_iterations);

/// Minus the restricted log-likelihood; leaves the gains for these variances in the runs.
double restricted_likelihood(std::span<LinearRun> runs, std::span<const ReadingWeights> weights,
                             std::span<const Eigen::Vector2d> prior_distances, const Held& held,
                             const Variances& variances, std::vector<Normal>& normals);

/// Its derivatives by the variances (force, velocity, torque) that the runs' gains are for, right after
/// restricted_likelihood() wrote `normals`. Second ones: the average of observed and expected information
/// (Gilmour, Thompson and Cullis 1995), which needs no more than another pass over the rows.
struct LikelihoodSlopes {
  Eigen::Vector3d gradient;
  Eigen::Matrix3d information;
};
LikelihoodSlopes restricted_likelihood_slopes(std::span<LinearRun> runs,
                                              std::span<const ReadingWeights> weights,
                                              std::span<const Normal> normals, const Held& held);

/// The noise of readings and torque at the fit's last evaluated point, what the options do not know; the fit
/// keeps its weights.
NoiseFit noise_of_output_errors(JointFit& fit, const EstimatorOptions& options);

}  // namespace clampd::identify
