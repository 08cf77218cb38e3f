#pragma once

#include <concepts>

namespace clampd {

/// Partial derivatives of a sliding friction torque.
struct FrictionPoint {
  double torque_Nm;
  double by_force_Nm_N;
  double by_velocity_Nm_s_rad;
};

/// A friction law with a set-valued sign: while sliding in direction `sign` (+1 or -1) its torque is
/// `sliding_Nm(F, v, sign)`, smooth in F and v also across v = 0 for a fixed sign; at rest it holds any
/// torque up to `holding_Nm(F)`. `evaluate` adds the partial derivatives, the ones by its parameters into
/// gradient[kParameters]. tests/brake/friction_law_suite.hpp checks a law against this contract.
template <class L>
concept FrictionLaw = requires(const L law, double force_N, double velocity_rad_s, double sign,
                               double* gradient) {
  { L::kParameters } -> std::convertible_to<int>;
  { law.holding_Nm(force_N) } -> std::same_as<double>;
  { law.sliding_Nm(force_N, velocity_rad_s, sign) } -> std::same_as<double>;
  { law.evaluate(force_N, velocity_rad_s, sign, gradient) } -> std::same_as<FrictionPoint>;
}
&&std::constructible_from<L, const double*>;

/// Equations (4) and (5) with tanh(eps v) taken to its limit, the sign of v:
/// Tf = Tv v + sign (TC + (Ts - TC) / (1 + (v / ws)^2)), Ts = Ts0 + mus F.
struct StribeckFriction {
  static constexpr int kParameters = 5;

  double coulomb_Nm;
  double static_Nm;
  double viscous_Nm_s_rad;
  double load_Nm_N;
  double inverse_speed_s_rad;
  double squared_speed_rad2_s2;

  /// parameters: TC, Ts0, Tv, mus, ws.
  explicit StribeckFriction(const double* parameters)
      : coulomb_Nm(parameters[0]),
        static_Nm(parameters[1]),
        viscous_Nm_s_rad(parameters[2]),
        load_Nm_N(parameters[3]),
        inverse_speed_s_rad(1.0 / parameters[4]),
        squared_speed_rad2_s2(parameters[4] * parameters[4]) {}

  /// Ts of (5).
  double holding_Nm(double force_N) const noexcept { return static_Nm + load_Nm_N * force_N; }

  double sliding_Nm(double force_N, double velocity_rad_s, double sign) const noexcept {
    // One division with everything but v in its numerator: this is the longest chain of the innermost loop.
    const double excess = sign * squared_speed_rad2_s2 * (holding_Nm(force_N) - coulomb_Nm);
    return excess / (squared_speed_rad2_s2 + velocity_rad_s * velocity_rad_s) +
           (viscous_Nm_s_rad * velocity_rad_s + sign * coulomb_Nm);
  }

  FrictionPoint evaluate(double force_N, double velocity_rad_s, double sign,
                         double* gradient) const noexcept {
    const double excess = sign * squared_speed_rad2_s2 * (holding_Nm(force_N) - coulomb_Nm);
    const double inverse = 1.0 / (squared_speed_rad2_s2 + velocity_rad_s * velocity_rad_s);
    const double share = sign * squared_speed_rad2_s2 * inverse;
    const double slope = -2.0 * velocity_rad_s * excess * inverse * inverse;
    gradient[0] = sign - share;
    gradient[1] = share;
    gradient[2] = velocity_rad_s;
    gradient[3] = share * force_N;
    gradient[4] = -slope * velocity_rad_s * inverse_speed_s_rad;
    return {excess * inverse + (viscous_Nm_s_rad * velocity_rad_s + sign * coulomb_Nm), load_Nm_N * share,
            viscous_Nm_s_rad + slope};
  }
};
static_assert(FrictionLaw<StribeckFriction>);

}  // namespace clampd
