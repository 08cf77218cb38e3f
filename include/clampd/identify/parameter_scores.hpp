#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/identify/extended_fit.hpp"

namespace clampd {

/// What runs say about changes d of a model's parameters (those of ExtendedBrake, SI) from an estimate, the
/// runs' initial states following: half the squared innovations, each over its variance, are
/// half_squares - gradient . d + 1/2 d . information d.
struct ParameterScores {
  bool possible = false;  ///< the filter stays bounded and the estimate within its bounds
  double half_squares = 0.0;
  double largest_innovation = 0.0;  ///< over its standard deviation, before anything follows
  Eigen::VectorXd gradient;
  Eigen::MatrixXd information;
  /// Of each run alone; they add up to the above.
  struct OfRun {
    Eigen::VectorXd gradient;
    Eigen::MatrixXd information;
  };
  std::vector<OfRun> of_runs;
};

/// By the extended Kalman filter of fit_extended(); the noise is the estimate's. The parameters of the
/// effects `beside` the estimate's model come after its own, those of each as ExtendedBrake has them. They may
/// be more than one model holds, since they change nothing where they stand: their strengths have to be
/// neutral. Those beside which the filter does not stay bounded are told of as if no reading showed them.
ParameterScores score_parameters(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                 std::span<const EffectValues> beside = {});

}  // namespace clampd
