#pragma once

#include <algorithm>
#include <cmath>

#include "clampd/brake/dynamics.hpp"

namespace clampd {

/// The largest internal step: the paper's sample period.
inline constexpr double kMaxStep_s = 1e-3;

/// Beyond these a simulation has left every physical brake (the stiffness polynomial has turned over) and is
/// called diverged; before anything can overflow.
inline constexpr double kDivergedPosition_rad = 1e3;
inline constexpr double kDivergedVelocity_rad_s = 1e5;

/// Zero crossings of the velocity resolved within one step; more would be a numerical flutter, which ends at
/// rest.
inline constexpr int kMaxCrossings = 8;

inline bool is_bounded(const BrakeState& state) noexcept {
  return std::abs(state[0]) < kDivergedPosition_rad && std::abs(state[1]) < kDivergedVelocity_rad_s;
}

namespace integrator {

/// Classical Runge-Kutta step with the sign of friction frozen.
template <class Model>
BrakeState runge_kutta(const Model& model, const BrakeState& state, double torque_Nm, double sign,
                       double step_s) noexcept {
  const double half = 0.5 * step_s;
  const double p0 = state[0];
  const double v0 = state[1];
  const double a0 = model.acceleration(p0, v0, torque_Nm, sign);
  const double v1 = v0 + half * a0;
  const double a1 = model.acceleration(p0 + half * v0, v1, torque_Nm, sign);
  const double v2 = v0 + half * a1;
  const double a2 = model.acceleration(p0 + half * v1, v2, torque_Nm, sign);
  const double v3 = v0 + step_s * a2;
  const double a3 = model.acceleration(p0 + step_s * v2, v3, torque_Nm, sign);
  return {p0 + step_s / 6.0 * (v0 + 2.0 * (v1 + v2) + v3), v0 + step_s / 6.0 * (a0 + 2.0 * (a1 + a2) + a3)};
}

/// The root in (0, step) of the velocity reached by a Runge-Kutta step of that length: the instant of v = 0,
/// in the arithmetic of the very map that is then taken, so that its implicit derivative is exact. Expects
/// sign * v >= 0 before and sign * v < 0 after the whole step.
template <class Model>
double crossing_time(const Model& model, const BrakeState& state, double torque_Nm, double sign,
                     double step_s, double end_velocity) noexcept {
  double low = 0.0;
  double high = step_s;
  double time = state[1] == 0.0 ? 0.5 * step_s : step_s * state[1] / (state[1] - end_velocity);
  for (int iteration = 0; iteration < 60; ++iteration) {
    const BrakeState reached = runge_kutta(model, state, torque_Nm, sign, time);
    (sign * reached[1] >= 0.0 ? low : high) = time;
    const double slope = model.acceleration(reached[0], reached[1], torque_Nm, sign);
    double next = time - reached[1] / slope;
    if (!(next > low && next < high)) {
      if (next == low || next == high) return next;
      next = 0.5 * (low + high);
    }
    if (std::abs(next - time) <= 1e-16 * step_s) return next;
    time = next;
  }
  return time;
}

}  // namespace integrator

/// One step of the set-valued model (the limit eps -> infinity of (4)): torque held over the step,
/// Runge-Kutta of order four with the sign of friction frozen, the instant of v = 0 found inside of the step;
/// there the brake sticks if friction holds the load, else it goes on in the direction of the load. Rest is v
/// = 0 exactly. step_s must not exceed kMaxStep_s for the stated accuracy. Neither allocates nor fails: a
/// diverging state grows until is_bounded() is false, which the caller checks.
template <class Model>
BrakeState advance(const Model& model, BrakeState state, double torque_Nm, double step_s) noexcept {
  double left_s = step_s;
  for (int crossing = 0; crossing < kMaxCrossings; ++crossing) {
    const double sign =
        state[1] != 0.0 ? std::copysign(1.0, state[1]) : model.breakaway_sign(state[0], torque_Nm);
    if (sign == 0.0) return state;
    const BrakeState reached = integrator::runge_kutta(model, state, torque_Nm, sign, left_s);
    if (!(sign * reached[1] < 0.0)) return reached;
    const double time = integrator::crossing_time(model, state, torque_Nm, sign, left_s, reached[1]);
    state = integrator::runge_kutta(model, state, torque_Nm, sign, time);
    state[1] = 0.0;
    left_s -= time;
    if (!(left_s > 0.0)) return state;
  }
  return state;
}

/// The same for a torque that is held for longer, in as few equal steps as that accuracy takes.
template <class Model>
BrakeState advance_over(const Model& model, BrakeState state, double torque_Nm, double time_s) noexcept {
  const int steps = std::max(1, static_cast<int>(std::ceil(time_s / kMaxStep_s - 1e-6)));
  for (int i = 0; i < steps; ++i) state = advance(model, state, torque_Nm, time_s / steps);
  return state;
}

}  // namespace clampd
