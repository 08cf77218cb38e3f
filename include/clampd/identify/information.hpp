#pragma once

#include <optional>

#include <Eigen/Core>

#include "clampd/brake/simulation.hpp"

namespace clampd {

/// Standard deviations of the sensors' white noise: the diagonal of R, as roots.
struct SensorNoise {
  double force_N = 75.0;
  double velocity_rad_s = 1.5;
};

/// All noise of a run. Torque: white error of the recorded torque, one value held over each step of
/// kMaxStep_s; it moves the brake, so that the readings share it (the paper's Q).
struct NoiseLevels {
  SensorNoise sensors;
  double torque_Nm = 0.0;
};

/// The initial state is a nuisance with this very weak prior, so that a start at rest, where nothing depends
/// on an infinitesimal initial velocity, does not make the information singular.
inline constexpr double kInitialPositionPrior_rad = 10.0;
inline constexpr double kInitialVelocityPrior_rad_s = 100.0;

/// Over the columns of SensitivityRows: seven normalised parameters, initial position, initial velocity.
using JointInformation = Eigen::Matrix<double, kSensitivityColumns, kSensitivityColumns>;

/// Equation (14a): the sum over the rows of J^T R^-1 J. NaN if the simulation is not complete.
JointInformation joint_information(const SensitivitySimulation& simulation,
                                   const SensorNoise& noise) noexcept;

/// Fisher information (14) of a run of the brake, simulated into the caller's buffer (excitation.size()
/// rows). Blocks: the top left 7 x 7 is the information if the initial state is known.
JointInformation joint_information(const BrakeParameters& parameters, const BrakeState& initial,
                                   const Excitation& excitation, const SensorNoise& noise,
                                   SensitivitySimulation& buffer) noexcept;

/// Fisher information of a run whose acting torque differs from the recorded one by white noise: the sum of
/// the squared, S(k)-weighted innovation sensitivities of the Kalman filter along the nominal response.
/// Without torque noise it is (14a). `excitation` is the recorded torque: for a brake under feedback, what
/// the controller commanded. NaN if the simulation is not complete.
JointInformation joint_information(const BrakeParameters& parameters, const BrakeState& initial,
                                   const Excitation& excitation, const NoiseLevels& noise);

/// Information on the normalised parameters if the initial state is known.
inline ParameterMatrix initial_state_known(const JointInformation& joint) {
  return joint.topLeftCorner<static_cast<int>(kParameterCount), static_cast<int>(kParameterCount)>();
}

/// Information on the normalised parameters if the initial state has to be estimated too (Schur complement).
ParameterMatrix initial_state_unknown(const JointInformation& joint);

/// log det of an information matrix; minus infinity if it is not positive definite or not finite.
double log_det(const ParameterMatrix& information);

/// The Cramer-Rao bound, the inverse of an information matrix; NaN if that is numerically singular.
ParameterMatrix cramer_rao(const ParameterMatrix& information);

/// The parameter that the information tells least about when it is numerically singular.
std::optional<Parameter> unidentifiable_parameter(const ParameterMatrix& information);

}  // namespace clampd
