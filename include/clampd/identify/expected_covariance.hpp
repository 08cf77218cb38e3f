#pragma once

#include <span>

#include "clampd/brake/simulation.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/identify/information.hpp"

namespace clampd {

/// What a run that has not been driven would bring to a joint estimate, its initial state estimated too, in
/// theta / theta_nom. NaN where the simulation leaves all bounds.
struct ExpectedContribution {
  ParameterMatrix information;  ///< under the weights of the fit: the sensitivities' J^T W J
  ParameterMatrix scatter;      ///< covariance of the score by the noise of readings and torque
};

/// Of a run with this excitation, the torque that is recorded. The output error method weighs readings as if
/// the torque were exact, so that torque noise adds to the scatter alone; for the prediction error method,
/// both are (14) with S(k) of (17).
ExpectedContribution expected_contribution(Method method, const BrakeParameters& parameters,
                                           const BrakeState& initial, const Excitation& excitation,
                                           const NoiseLevels& noise);

/// The covariance of theta / theta_nom that a joint estimate from so many runs of each kind would have, the
/// sandwich J^-1 V J^-1; NaN where they do not determine all parameters. `counts`: one for each contribution.
ParameterMatrix expected_covariance(std::span<const ExpectedContribution> contributions,
                                    std::span<const double> counts);

}  // namespace clampd
