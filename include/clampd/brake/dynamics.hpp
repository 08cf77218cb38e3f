#pragma once

#include <cmath>

#include <Eigen/Core>

#include "clampd/brake/actuator.hpp"
#include "clampd/brake/friction.hpp"
#include "clampd/brake/readings.hpp"
#include "clampd/brake/stiffness.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// State (position from contact in rad, velocity in rad/s).
using BrakeState = Eigen::Vector2d;

/// Acceleration and its partial derivatives at a point while sliding.
template <int kParameterCount_>
struct AccelerationPoint {
  double value;
  double by_position;
  double by_velocity;
  double by_torque;
  double by_parameter[kParameterCount_];
};

/// The torque balance (2) with the sign of the friction mended, x'' = (Ta - N F(x) - Tf) / J, composed of
/// four replaceable laws. The parameter vector is theirs one after the other: stiffness, friction, actuator,
/// readings; for the paper's four this is the order of kParameterTable.
template <StiffnessLaw Stiffness_, FrictionLaw Friction_, Actuator Actuator_, Readings Readings_>
class BrakeModel {
 public:
  using Stiffness = Stiffness_;
  using Friction = Friction_;

  static constexpr int kParameters =
      Stiffness_::kParameters + Friction_::kParameters + Actuator_::kParameters + Readings_::kParameters;
  using Parameters = Eigen::Matrix<double, kParameters, 1>;
  using Acceleration = AccelerationPoint<kParameters>;

  BrakeModel(const Parameters& parameters, const FixedParameters& fixed)
      : stiffness_(parameters.data()),
        friction_(parameters.data() + kFriction),
        actuator_(parameters.data() + kActuator),
        readings_(parameters.data() + kReadings),
        ratio_m_rad_(fixed.ratio_m_rad),
        inverse_inertia_(1.0 / fixed.inertia_kg_m2) {}

  /// Acceleration in rad/s^2 while sliding in direction `sign` (+1 or -1).
  double acceleration(double position, double velocity, double torque_Nm, double sign) const noexcept {
    const double force = stiffness_.force_N(position);
    return (actuator_.acting_Nm(torque_Nm, velocity) - ratio_m_rad_ * force -
            friction_.sliding_Nm(force, velocity, sign)) *
           inverse_inertia_;
  }

  Acceleration linearise(double position, double velocity, double torque_Nm, double sign) const noexcept {
    Acceleration point;
    double* gradient = point.by_parameter;
    const ForcePoint force = stiffness_.evaluate(position, gradient);
    const FrictionPoint friction = friction_.evaluate(force.force_N, velocity, sign, gradient + kFriction);
    const TorquePoint torque = actuator_.evaluate(torque_Nm, velocity, gradient + kActuator);
    const double by_force = -(ratio_m_rad_ + friction.by_force_Nm_N) * inverse_inertia_;
    point.value = (torque.torque_Nm - ratio_m_rad_ * force.force_N - friction.torque_Nm) * inverse_inertia_;
    point.by_position = by_force * force.slope_N_rad;
    point.by_velocity = (torque.by_velocity_Nm_s_rad - friction.by_velocity_Nm_s_rad) * inverse_inertia_;
    point.by_torque = torque.by_reading * inverse_inertia_;
    for (int i = 0; i < kFriction; ++i) gradient[i] *= by_force;
    for (int i = kFriction; i < kActuator; ++i) gradient[i] *= -inverse_inertia_;
    for (int i = kActuator; i < kReadings; ++i) gradient[i] *= inverse_inertia_;
    for (int i = kReadings; i < kParameters; ++i) gradient[i] = 0.0;
    return point;
  }

  /// At rest: the direction in which the brake breaks away, or 0 if friction holds it.
  double breakaway_sign(double position, double torque_Nm) const noexcept {
    const double force = stiffness_.force_N(position);
    const double load = actuator_.acting_Nm(torque_Nm, 0.0) - ratio_m_rad_ * force;
    const double holding = friction_.holding_Nm(force);
    if (std::abs(load) <= holding) return 0.0;
    return load > 0.0 ? 1.0 : -1.0;
  }

  Reading read(const BrakeState& state) const noexcept {
    return readings_.read(stiffness_.force_N(state[0]), state[1]);
  }

  /// d(force reading, velocity reading) / d(position, velocity) and / dparameters at a state.
  void linearise_readings(const BrakeState& state, Eigen::Matrix2d& by_state,
                          Eigen::Matrix<double, 2, kParameters>& by_parameter) const noexcept {
    double stiffness_gradient[Stiffness_::kParameters > 0 ? Stiffness_::kParameters : 1];
    double readings_gradient[Readings_::kParameters > 0 ? 2 * Readings_::kParameters : 1];
    const ForcePoint force = stiffness_.evaluate(state[0], stiffness_gradient);
    const ReadingSlopes slopes = readings_.evaluate(force.force_N, state[1], readings_gradient);
    by_state << slopes.force_by_force * force.slope_N_rad, slopes.force_by_velocity,
        slopes.velocity_by_force * force.slope_N_rad, slopes.velocity_by_velocity;
    by_parameter.setZero();
    for (int i = 0; i < kFriction; ++i) {
      by_parameter(0, i) = slopes.force_by_force * stiffness_gradient[i];
      by_parameter(1, i) = slopes.velocity_by_force * stiffness_gradient[i];
    }
    for (int i = 0; i < Readings_::kParameters; ++i) {
      by_parameter(0, kReadings + i) = readings_gradient[i];
      by_parameter(1, kReadings + i) = readings_gradient[Readings_::kParameters + i];
    }
  }

  const Stiffness_& stiffness() const noexcept { return stiffness_; }
  const Friction_& friction() const noexcept { return friction_; }

 private:
  static constexpr int kFriction = Stiffness_::kParameters;
  static constexpr int kActuator = kFriction + Friction_::kParameters;
  static constexpr int kReadings = kActuator + Actuator_::kParameters;

  Stiffness_ stiffness_;
  Friction_ friction_;
  Actuator_ actuator_;
  Readings_ readings_;
  double ratio_m_rad_;
  double inverse_inertia_;
};

/// The paper's brake.
using PaperBrake = BrakeModel<PolynomialStiffness, StribeckFriction, IdealActuator, IdealReadings>;
static_assert(PaperBrake::kParameters == static_cast<int>(kParameterCount));

inline PaperBrake paper_brake(const BrakeParameters& parameters) {
  return PaperBrake(parameters.theta, parameters.fixed);
}

}  // namespace clampd
