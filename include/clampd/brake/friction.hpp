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
  double inverse_speed_s_rad;  ///< 1 / ws

  /// parameters: TC, Ts0, Tv, mus, ws.
  explicit StribeckFriction(const double* parameters)
      : coulomb_Nm(parameters[0]),
        static_Nm(parameters[1]),
        viscous_Nm_s_rad(parameters[2]),
        load_Nm_N(parameters[3]),
        inverse_speed_s_rad(1.0 / parameters[4]) {}

  /// Ts of (5).
  double holding_Nm(double force_N) const noexcept { return static_Nm + load_Nm_N * force_N; }

  double sliding_Nm(double force_N, double velocity_rad_s, double sign) const noexcept {
    const double ratio = velocity_rad_s * inverse_speed_s_rad;
    const double share = 1.0 / (1.0 + ratio * ratio);
    return viscous_Nm_s_rad * velocity_rad_s +
           sign * (coulomb_Nm + (holding_Nm(force_N) - coulomb_Nm) * share);
  }

  FrictionPoint evaluate(double force_N, double velocity_rad_s, double sign,
                         double* gradient) const noexcept {
    const double ratio = velocity_rad_s * inverse_speed_s_rad;
    const double share = 1.0 / (1.0 + ratio * ratio);
    const double excess = holding_Nm(force_N) - coulomb_Nm;
    // d share / d v = -2 v / ws^2 share^2;  d share / d ws = -(v / ws) d share / d v
    const double share_slope = -2.0 * ratio * inverse_speed_s_rad * share * share;
    gradient[0] = sign * (1.0 - share);
    gradient[1] = sign * share;
    gradient[2] = velocity_rad_s;
    gradient[3] = sign * share * force_N;
    gradient[4] = -sign * excess * share_slope * ratio;
    return {viscous_Nm_s_rad * velocity_rad_s + sign * (coulomb_Nm + excess * share),
            sign * load_Nm_N * share, viscous_Nm_s_rad + sign * excess * share_slope};
  }
};
static_assert(FrictionLaw<StribeckFriction>);

}  // namespace clampd
