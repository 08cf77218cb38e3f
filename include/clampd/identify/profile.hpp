#pragma once

#include <limits>
#include <string>
#include <vector>

#include "clampd/identify/method.hpp"

namespace clampd {

/// How well the data fit if one parameter is held at a value and all others follow.
struct ProfilePoint {
  double value = 0.0;  ///< SI
  double deviance =
      std::numeric_limits<double>::infinity();  ///< twice the loss of log-likelihood; infinite: no fit
  bool converged = false;                       ///< the fit of all others came to its end
};

/// Profile likelihood of one parameter.
struct Profile {
  Parameter parameter = k1;
  std::vector<ProfilePoint> points;  ///< rising values, the estimate among them
  /// Where the deviance passes 3.84: the 95 % interval that presumes no symmetry. Infinite on a side where it
  /// does not within the points: the data do not bound the parameter there.
  double lower = -std::numeric_limits<double>::infinity();
  double upper = std::numeric_limits<double>::infinity();
  /// All fits converged, and none is better than the estimate's own: only then the interval is what it says.
  bool converged = false;
  std::string message;  ///< what is wrong with it, in words; empty if nothing is
};

/// Around a converged estimate: three standard deviations to both sides in steps of half of one, and on, in
/// steps twice as long each, to twelve, until the deviance has passed 3.84 or the parameter's bound is
/// reached.
///
/// The cost is that of the fit, its weights and (by the prediction error method) its filters' gains held as
/// they are at the estimate. It is no likelihood as such: the output error method's leaves the torque's noise
/// out, and runs may differ from each other. Its rise above the minimum is therefore multiplied by v' / v, v
/// being the reported variance of the parameter (Estimate::covariance_normalised) and v' the one that the
/// cost's own curvature there implies: near the estimate the interval is that of ± 1.96 reported standard
/// deviations, away from it it keeps the cost's asymmetry (the vertical adjustment of Chandler and Bate,
/// Biometrika 94, 2007).
///
/// Each fit starts where its neighbours' point to, and a second time, on the way back, from the next one
/// outside.
Profile profile_likelihood(Parameter parameter, Method method, std::span<const Run> runs,
                           const EstimatorOptions& options, const Estimate& estimate);

}  // namespace clampd
