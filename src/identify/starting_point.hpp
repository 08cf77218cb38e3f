#pragma once

#include <span>

#include "clampd/brake/dynamics.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd::identify {

/// The sensors' white noise without any model: third differences of the readings, which no smooth motion
/// survives. Never less than kSmallestNoise.
SensorNoise noise_without_model(std::span<const Run> runs);

/// The same of the position readings, their rounding included; 0 where there are none.
double position_noise_without_model(std::span<const Run> runs);

/// Below these the noise is not believed: quantisation, or a simulated run without any.
inline constexpr SensorNoise kSmallestNoise{0.05, 5e-4};

/// The initial state as the readings suggest it: the travel is the integral of the velocity reading, and the
/// position of contact is where the travel fits the force reading under the stiffness of theta.
BrakeState initial_state_guess(const Run& run, const ParameterVector& theta);

/// A start for theta by equation error, linear least squares on the measured signals: the stiffness from
/// force over travel, the friction from the integrated torque balance while sliding, the Stribeck velocity
/// from a grid. Biased by the noise of its regressors, but close whatever the initial guess. Parameters that
/// the runs do not show stay as in `fallback`.
ParameterVector equation_error_start(std::span<const Run> runs, const BrakeParameters& fallback,
                                     const SensorNoise& noise);

}  // namespace clampd::identify
