#pragma once

#include <cmath>

#include "clampd/brake/integrator.hpp"

namespace clampd {

/// Derivatives of a state, one column each, in the order: the model's parameters (per SI unit), the initial
/// position, the initial velocity, the torque reading (a constant added to it over the whole time
/// propagated).
template <int kParameters>
struct Tangent {
  static constexpr int kColumns = kParameters + 3;
  static constexpr int kPosition = kParameters;
  static constexpr int kVelocity = kParameters + 1;
  static constexpr int kTorque = kParameters + 2;

  using Columns = Eigen::Array<double, kColumns, 1>;
  Columns position = Columns::Zero();
  Columns velocity = Columns::Zero();

  /// At the start: the state depends on itself only.
  static Tangent identity() noexcept {
    Tangent tangent;
    tangent.position[kPosition] = 1.0;
    tangent.velocity[kVelocity] = 1.0;
    return tangent;
  }
};

namespace integrator {

/// Derivative of a Runge-Kutta step by its own length.
struct StepSlope {
  double position;
  double velocity;
};

/// runge_kutta() and its exact derivatives, chained onto `tangent`; the same arithmetic for the state.
///
/// Parameters and torque act through the four stage accelerations only, and what a change of a stage's
/// acceleration does to the end of the step is the same for all of them: it is computed once, and each column
/// then costs eight products.
template <class Model>
BrakeState runge_kutta_tangent(const Model& model, const BrakeState& state,
                               Tangent<Model::kParameters>& tangent, double torque_Nm, double sign,
                               double step_s, StepSlope* step_slope) noexcept {
  using T = Tangent<Model::kParameters>;
  constexpr int kForced = Model::kParameters;
  const double half = 0.5 * step_s;
  const double sixth = step_s / 6.0;
  const double p0 = state[0];
  const double v0 = state[1];
  const auto a0 = model.linearise(p0, v0, torque_Nm, sign);
  const double v1 = v0 + half * a0.value;
  const auto a1 = model.linearise(p0 + half * v0, v1, torque_Nm, sign);
  const double v2 = v0 + half * a1.value;
  const auto a2 = model.linearise(p0 + half * v1, v2, torque_Nm, sign);
  const double v3 = v0 + step_s * a2.value;
  const auto a3 = model.linearise(p0 + step_s * v2, v3, torque_Nm, sign);

  // End of the step by the state at its start; dp1 ... and dv1 ... are of the stages' points.
  const auto by_start = [&](double dp0, double dv0, double& end_position, double& end_velocity) {
    const double da0 = a0.by_position * dp0 + a0.by_velocity * dv0;
    const double dv1 = dv0 + half * da0;
    const double da1 = a1.by_position * (dp0 + half * dv0) + a1.by_velocity * dv1;
    const double dv2 = dv0 + half * da1;
    const double da2 = a2.by_position * (dp0 + half * dv1) + a2.by_velocity * dv2;
    const double dv3 = dv0 + step_s * da2;
    const double da3 = a3.by_position * (dp0 + step_s * dv2) + a3.by_velocity * dv3;
    end_position = dp0 + sixth * (dv0 + 2.0 * (dv1 + dv2) + dv3);
    end_velocity = dv0 + sixth * (da0 + 2.0 * (da1 + da2) + da3);
  };
  double position_by_position, velocity_by_position, position_by_velocity, velocity_by_velocity;
  by_start(1.0, 0.0, position_by_position, velocity_by_position);
  by_start(0.0, 1.0, position_by_velocity, velocity_by_velocity);

  // End of the step by the stages' accelerations, the last stage first.
  double position_by[4];
  double velocity_by[4];
  position_by[3] = 0.0;
  velocity_by[3] = sixth;
  position_by[2] = sixth * step_s;
  velocity_by[2] = sixth * (2.0 + step_s * a3.by_velocity);
  {
    const double da2 = half * a2.by_velocity;
    const double dv3 = step_s * da2;
    const double da3 = step_s * half * a3.by_position + a3.by_velocity * dv3;
    position_by[1] = sixth * (step_s + dv3);
    velocity_by[1] = sixth * (2.0 + 2.0 * da2 + da3);
  }
  {
    const double da1 = half * a1.by_velocity;
    const double dv2 = half * da1;
    const double da2 = half * half * a2.by_position + a2.by_velocity * dv2;
    const double dv3 = step_s * da2;
    const double da3 = step_s * dv2 * a3.by_position + a3.by_velocity * dv3;
    position_by[0] = sixth * (step_s + 2.0 * dv2 + dv3);
    velocity_by[0] = sixth * (1.0 + 2.0 * (da1 + da2) + da3);
  }

  const typename T::Columns position = tangent.position;
  tangent.position = position_by_position * position + position_by_velocity * tangent.velocity;
  tangent.velocity = velocity_by_position * position + velocity_by_velocity * tangent.velocity;
  using Forced = Eigen::Map<const Eigen::Array<double, kForced, 1>>;
  const Forced f0(a0.by_parameter), f1(a1.by_parameter), f2(a2.by_parameter), f3(a3.by_parameter);
  tangent.position.template head<kForced>() +=
      position_by[0] * f0 + position_by[1] * f1 + position_by[2] * f2;
  tangent.velocity.template head<kForced>() +=
      velocity_by[0] * f0 + velocity_by[1] * f1 + velocity_by[2] * f2 + velocity_by[3] * f3;
  tangent.position[T::kTorque] +=
      position_by[0] * a0.by_torque + position_by[1] * a1.by_torque + position_by[2] * a2.by_torque;
  tangent.velocity[T::kTorque] += velocity_by[0] * a0.by_torque + velocity_by[1] * a1.by_torque +
                                  velocity_by[2] * a2.by_torque + velocity_by[3] * a3.by_torque;

  if (step_slope != nullptr) {
    const double dv1 = 0.5 * a0.value;
    const double da1 = a1.by_position * 0.5 * v0 + a1.by_velocity * dv1;
    const double dv2 = 0.5 * a1.value + half * da1;
    const double da2 = a2.by_position * (0.5 * v1 + half * dv1) + a2.by_velocity * dv2;
    const double dv3 = a2.value + step_s * da2;
    const double da3 = a3.by_position * (v2 + step_s * dv2) + a3.by_velocity * dv3;
    step_slope->position = (v0 + 2.0 * (v1 + v2) + v3) / 6.0 + sixth * (2.0 * (dv1 + dv2) + dv3);
    step_slope->velocity =
        (a0.value + 2.0 * (a1.value + a2.value) + a3.value) / 6.0 + sixth * (2.0 * (da1 + da2) + da3);
  }
  return {p0 + sixth * (v0 + 2.0 * (v1 + v2) + v3),
          v0 + sixth * (a0.value + 2.0 * (a1.value + a2.value) + a3.value)};
}

}  // namespace integrator

/// advance() with the exact derivative of its discrete map chained onto `tangent`; through a zero crossing by
/// the implicit function theorem on the located instant. At rest the velocity columns vanish: an
/// infinitesimal velocity dies within an infinitesimal time. Where sticking and sliding just balance, the map
/// has a kink, and the derivative is that of the branch taken.
template <class Model>
BrakeState advance_with_tangent(const Model& model, BrakeState state, Tangent<Model::kParameters>& tangent,
                                double torque_Nm, double step_s) noexcept {
  using T = Tangent<Model::kParameters>;
  using Columns = typename T::Columns;
  double left_s = step_s;
  Columns left_tangent = Columns::Zero();  // of the time left after the crossings so far
  for (int crossing = 0; crossing < kMaxCrossings; ++crossing) {
    const double sign =
        state[1] != 0.0 ? std::copysign(1.0, state[1]) : model.breakaway_sign(state[0], torque_Nm);
    if (sign == 0.0) {
      tangent.velocity.setZero();
      return state;
    }
    const T before = tangent;
    integrator::StepSlope slope{};
    BrakeState reached = integrator::runge_kutta_tangent(model, state, tangent, torque_Nm, sign, left_s,
                                                         crossing > 0 ? &slope : nullptr);
    if (!(sign * reached[1] < 0.0)) {
      if (crossing > 0) {
        tangent.position += slope.position * left_tangent;
        tangent.velocity += slope.velocity * left_tangent;
      }
      return reached;
    }
    const double time = integrator::crossing_time(model, state, torque_Nm, sign, left_s, reached[1]);
    tangent = before;
    state = integrator::runge_kutta_tangent(model, state, tangent, torque_Nm, sign, time, &slope);
    const Columns time_tangent =
        slope.velocity != 0.0 ? Columns(-tangent.velocity / slope.velocity) : Columns(Columns::Zero());
    tangent.position += slope.position * time_tangent;
    tangent.velocity.setZero();
    state[1] = 0.0;
    left_tangent -= time_tangent;
    left_s -= time;
    if (!(left_s > 0.0)) return state;
  }
  return state;
}

/// A step linearised about its start: x(k+1) = f + transition dx + by_parameter dp + by_torque dT.
template <int kParameters>
struct LinearStep {
  Eigen::Matrix2d transition;                                           ///< A of (19)
  Eigen::Matrix<double, 2, kParameters, Eigen::RowMajor> by_parameter;  ///< per SI unit
  Eigen::Vector2d by_torque;  ///< of a torque error held over the step
};

/// advance() and its linearisation.
template <class Model>
BrakeState linearise_step(const Model& model, const BrakeState& state, double torque_Nm, double step_s,
                          LinearStep<Model::kParameters>& step) noexcept {
  using T = Tangent<Model::kParameters>;
  T tangent = T::identity();
  const BrakeState reached = advance_with_tangent(model, state, tangent, torque_Nm, step_s);
  step.transition << tangent.position[T::kPosition], tangent.position[T::kVelocity],
      tangent.velocity[T::kPosition], tangent.velocity[T::kVelocity];
  step.by_parameter.row(0) = tangent.position.template head<Model::kParameters>();
  step.by_parameter.row(1) = tangent.velocity.template head<Model::kParameters>();
  step.by_torque << tangent.position[T::kTorque], tangent.velocity[T::kTorque];
  return reached;
}

}  // namespace clampd
