#pragma once

#include <cmath>
#include <span>

#include "clampd/brake/dynamics.hpp"

namespace clampd {

/// The paper's own discretisation, for comparison only: forward Euler (8) on the friction (4) with tanh(eps
/// v). At 1 ms it is stable in friction only for eps < (2 J / ts - Tv) / Ts, where it creeps by hundreds of
/// newtons under load; above, the velocity chatters. The product uses advance().
inline BrakeState euler_step(const BrakeParameters& parameters, const BrakeState& state, double torque_Nm,
                             double step_s, double epsilon_s_rad) noexcept {
  const PolynomialStiffness stiffness(parameters.theta.data());
  const StribeckFriction friction(parameters.theta.data() + PolynomialStiffness::kParameters);
  const double force = stiffness.force_N(state[0]);
  // With the smooth sign in place of the sign, the sliding law is (4).
  const double friction_Nm = friction.sliding_Nm(force, state[1], std::tanh(epsilon_s_rad * state[1]));
  const double acceleration =
      (torque_Nm - parameters.fixed.ratio_m_rad * force - friction_Nm) / parameters.fixed.inertia_kg_m2;
  return {state[0] + step_s * state[1], state[1] + step_s * acceleration};
}

/// states[k] at sample k, torque_Nm[k] acting from there; both of the same length.
inline void simulate_euler(const BrakeParameters& parameters, BrakeState state,
                           std::span<const double> torque_Nm, double step_s, double epsilon_s_rad,
                           std::span<BrakeState> states) noexcept {
  for (std::size_t k = 0; k < states.size(); ++k) {
    states[k] = state;
    state = euler_step(parameters, state, torque_Nm[k], step_s, epsilon_s_rad);
  }
}

}  // namespace clampd
