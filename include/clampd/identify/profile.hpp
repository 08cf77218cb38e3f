#pragma once

#include <limits>
#include <vector>

#include "clampd/identify/method.hpp"

namespace clampd {

/// How well the data fit if one parameter is held at a value and all others follow.
struct ProfilePoint {
  double value = 0.0;  ///< SI
  double deviance =
      std::numeric_limits<double>::infinity();  ///< twice the loss of log-likelihood; infinite: no fit
};

/// Profile likelihood of one parameter.
struct Profile {
  Parameter parameter = k1;
  std::vector<ProfilePoint> points;  ///< rising values
  /// Where the deviance passes 3.84: the 95 % interval that presumes no normal distribution. Infinite on a
  /// side where it does not within the points: the data do not bound the parameter there.
  double lower = -std::numeric_limits<double>::infinity();
  double upper = std::numeric_limits<double>::infinity();
};

/// Over three standard deviations to both sides of a converged estimate, in steps of half of one, with the
/// estimate's noise. The output error method takes the torque as exact and is then too sure of itself: under
/// torque noise profile with the prediction error method.
Profile profile_likelihood(Parameter parameter, Method method, std::span<const Run> runs,
                           const EstimatorOptions& options, const Estimate& estimate);

}  // namespace clampd
