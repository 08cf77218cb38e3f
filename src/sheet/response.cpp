#include "src/sheet/response.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/brake/integrator.hpp"
#include "clampd/control/control_law.hpp"
#include "clampd/experiment/known_brake.hpp"

namespace clampd {
namespace {

/// What the station's loop makes of a state that it knows.
double commanded_Nm(const PaperBrake& brake, const BrakeState& state, const Move& move,
                    const NominalDrive& drive) {
  const double force_N = brake.stiffness().force_N(state[0]);
  const ControlLimits limits{.torque_Nm = move.torque_limit_Nm};
  return limited_torque_Nm(
      move_torque_Nm(move.to_rad, move.speed_limit_rad_s, drive, known_motion(brake, state, drive), force_N),
      limits, drive, state[1], force_N, known_stiffness(brake).slope_N_rad(state[0]));
}

}  // namespace

double passing_share(const BrakeState& before, const BrakeState& after, double level_rad, double period_s) {
  const double direction = after[0] > before[0] ? 1.0 : -1.0;
  const auto position_rad = [&](double s) {
    const double t = 1.0 - s;
    return t * t * ((1.0 + 2.0 * s) * before[0] + s * period_s * before[1]) +
           s * s * ((1.0 + 2.0 * t) * after[0] - t * period_s * after[1]);
  };
  return turning_point(0.0, 1.0, [&](double s) { return direction * (position_rad(s) - level_rad) < 0.0; });
}

std::optional<double> move_time_s(const PaperBrake& brake, const Move& move, const NominalDrive& drive) {
  return walk_time_s(BrakeState(move.from_rad, 0.0), move, drive.period_s,
                     [&](const BrakeState& now) -> std::optional<BrakeState> {
                       const BrakeState next =
                           advance_over(brake, now, commanded_Nm(brake, now, move, drive), drive.period_s);
                       if (!is_bounded(next)) return std::nullopt;
                       return next;
                     });
}

std::optional<double> position_of_force(const PaperBrake& brake, double force_N) {
  if (force_N <= 0.0) return 0.0;
  const PolynomialStiffness& stiffness = brake.stiffness();
  // Where the polynomial turns over, it has its most; without that, it grows beyond any force.
  const double high = stiffness.cubic_N_rad3 < 0.0
                          ? -2.0 * stiffness.quadratic_N_rad2 / (3.0 * stiffness.cubic_N_rad3)
                          : std::sqrt(force_N / stiffness.quadratic_N_rad2);
  if (!(stiffness.force_N(high) >= force_N)) return std::nullopt;
  return turning_point(0.0, high, [&](double x) { return stiffness.force_N(x) < force_N; });
}

}  // namespace clampd
