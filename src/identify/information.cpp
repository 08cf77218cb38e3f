#include "clampd/identify/information.hpp"

#include <cmath>
#include <limits>

#include <Eigen/LU>

#include "clampd/base/nan.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/linear_run.hpp"

namespace clampd {

namespace {


/// Smallest eigenvalue of the unit-diagonal information at which its inverse still has correct digits:
/// sensitivities carry about ten.
using identify::kTheta;

constexpr double kSingularInformation = 1e-10;

struct ScaledSpectrum {
  ParameterVector
      scale;  ///< square roots of the diagonal; the spectrum is that of the matrix divided by them
  statistics::Spectrum of_scaled;
  bool singular = true;
};

ScaledSpectrum spectrum_of(const ParameterMatrix& information) {
  ScaledSpectrum spectrum;
  spectrum.scale = information.diagonal().cwiseMax(0.0).cwiseSqrt();
  if (!information.allFinite() || !(spectrum.scale.minCoeff() > 0.0)) return spectrum;
  spectrum.of_scaled = statistics::spectrum_of(statistics::scaled_by(information, spectrum.scale));
  spectrum.singular = !spectrum.of_scaled.ok || !(spectrum.of_scaled.values[0] > kSingularInformation);
  return spectrum;
}

}  // namespace

JointInformation joint_information(const SensitivitySimulation& simulation,
                                   const SensorNoise& noise) noexcept {
  const auto& force = simulation.force_sensitivity;
  const auto& velocity = simulation.velocity_sensitivity;
  JointInformation information = force.transpose().lazyProduct(force) / (noise.force_N * noise.force_N);
  information += velocity.transpose().lazyProduct(velocity) / (noise.velocity_rad_s * noise.velocity_rad_s);
  return information;
}

JointInformation joint_information(const BrakeParameters& parameters, const BrakeState& initial,
                                   const Excitation& excitation, const SensorNoise& noise,
                                   SensitivitySimulation& buffer) noexcept {
  simulate(parameters, initial, excitation, buffer);
  return joint_information(buffer, noise);
}

JointInformation joint_information(const BrakeParameters& parameters, const BrakeState& initial,
                                   const Excitation& excitation, const NoiseLevels& noise) {
  identify::LinearRun linear;
  linear.resize(excitation.size());
  if (!identify::linearise(identify::run_without_readings(excitation), parameters, initial, linear))
    return JointInformation::Constant(kNaN);
  identify::update_gains(identify::variances_of(noise), {}, linear);
  return identify::normal_equations(linear).topLeftCorner<kSensitivityColumns, kSensitivityColumns>();
}

ParameterMatrix initial_state_unknown(const JointInformation& joint) {
  Eigen::Matrix2d initial = joint.bottomRightCorner<2, 2>();
  initial(0, 0) += 1.0 / (kInitialPositionPrior_rad * kInitialPositionPrior_rad);
  initial(1, 1) += 1.0 / (kInitialVelocityPrior_rad_s * kInitialVelocityPrior_rad_s);
  const Eigen::Matrix<double, 2, kTheta> cross = joint.bottomLeftCorner<2, kTheta>();
  return joint.topLeftCorner<kTheta, kTheta>() - cross.transpose() * (initial.inverse() * cross);
}

double log_det(const ParameterMatrix& information) {
  const statistics::SymmetricFactor factor(information);
  if (!information.allFinite() || !(factor.smallest_pivot() > 0.0))
    return -std::numeric_limits<double>::infinity();
  return factor.log_determinant(0.0);
}

ParameterMatrix cramer_rao(const ParameterMatrix& information) {
  const ScaledSpectrum spectrum = spectrum_of(information);
  if (spectrum.singular) return ParameterMatrix::Constant(kNaN);
  const ParameterVector inverse = spectrum.scale.cwiseInverse();
  const ParameterMatrix directions = inverse.asDiagonal() * ParameterMatrix(spectrum.of_scaled.vectors);
  const ParameterVector variances = spectrum.of_scaled.values.cwiseInverse();
  return directions * variances.asDiagonal() * directions.transpose();
}

std::optional<Parameter> unidentifiable_parameter(const ParameterMatrix& information) {
  const ScaledSpectrum spectrum = spectrum_of(information);
  if (!spectrum.singular) return std::nullopt;
  Eigen::Index least = 0;
  if (spectrum.scale.minCoeff(&least) > 0.0 && information.allFinite())
    spectrum.of_scaled.vectors.col(0).cwiseAbs().maxCoeff(&least);
  return static_cast<Parameter>(least);
}

}  // namespace clampd
