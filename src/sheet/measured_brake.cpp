#include "src/sheet/measured_brake.hpp"

#include <cmath>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/control/control_law.hpp"
#include "clampd/control/motion_observer.hpp"
#include "clampd/sheet/sheet.hpp"

namespace clampd {
namespace {

constexpr double kTravel_rad = 90.0;  ///< farther than any brake closes
constexpr double kStep_rad = 0.25;    ///< on the way there
constexpr double kInstant_s = 1e-6;   ///< short enough that nothing but the velocity changes
constexpr double kMostTorque_Nm = 20.0;
constexpr double kCreep_rad_s = 1e-3;

ExtendedParameters with_perfect_sensors(const ExtendedParameters& parameters) {
  ExtendedParameters brake{parameters.base, {}};
  for (const EffectValues& effect : parameters.effects)
    if (changes_brake(info_of(*effect.effect))) brake.effects.push_back(effect);
  return brake;
}

RowInput held(double torque_Nm, double gap_s) {
  return {torque_Nm, torque_Nm, torque_Nm, torque_Nm, 0.0, gap_s, 0.0};
}

}  // namespace

MeasuredBrake::MeasuredBrake(const ExtendedParameters& parameters)
    : brake_(with_perfect_sensors(parameters)) {
  CLAMPD_ASSERT(brake_.states() == 2);
}

ExtendedBrake::State MeasuredBrake::state(double position_rad, double velocity_rad_s) const {
  return Eigen::Vector2d(position_rad, velocity_rad_s);
}

double MeasuredBrake::force_N(double position_rad, double velocity_rad_s) const {
  return brake_.read(state(position_rad, velocity_rad_s), held(0.0, kPeriod_s)).force_N;
}

double MeasuredBrake::acceleration(double position_rad, double velocity_rad_s, double torque_Nm) const {
  const ExtendedBrake::State next =
      brake_.advance(state(position_rad, velocity_rad_s), held(torque_Nm, kInstant_s));
  return (next[1] - velocity_rad_s) / kInstant_s;
}

std::optional<double> MeasuredBrake::position_of_force(double wanted_N) const {
  if (wanted_N <= 0.0) return 0.0;
  double low = 0.0, high = 0.0, before_N = 0.0;
  for (; before_N < wanted_N; low = high - kStep_rad) {
    high += kStep_rad;
    const double here_N = force_N(high, 0.0);
    if (high > kTravel_rad || here_N < before_N) return std::nullopt;
    before_N = here_N;
  }
  return turning_point(low, high, [&](double x) { return force_N(x, 0.0) < wanted_N; });
}

double MeasuredBrake::slope_N_rad(double position_rad) const {
  constexpr double kAside_rad = 1e-4;
  return (force_N(position_rad + kAside_rad, 0.0) - force_N(position_rad - kAside_rad, 0.0)) /
         (2.0 * kAside_rad);
}

double MeasuredBrake::torque_Nm(double position_rad, double velocity_rad_s) const {
  // The acceleration is linear in the torque as long as the motor moves.
  constexpr double kAside_Nm = 0.1;
  const double less = acceleration(position_rad, velocity_rad_s, 0.0);
  const double more = acceleration(position_rad, velocity_rad_s, kAside_Nm);
  return -less * kAside_Nm / (more - less);
}

double MeasuredBrake::breakaway_Nm(double position_rad, double direction) const {
  return turning_point(-kMostTorque_Nm * direction, kMostTorque_Nm * direction, [&](double torque_Nm) {
    const ExtendedBrake::State next = brake_.advance(state(position_rad, 0.0), held(torque_Nm, kPeriod_s));
    return !(direction * (next[0] - position_rad) > 0.0);
  });
}

double MeasuredBrake::commanded_Nm(const ExtendedBrake::State& now, const Move& move,
                                   const NominalDrive& drive) const {
  const double position_rad = now[0], velocity_rad_s = now[1];
  const double load_N = force_N(position_rad, velocity_rad_s);
  const double ahead = move.to_rad > move.from_rad ? 1.0 : -1.0;
  const double moving_rad_s = std::abs(velocity_rad_s) > kCreep_rad_s ? velocity_rad_s : ahead * kCreep_rad_s;
  const double speed_rad_s = std::abs(moving_rad_s);
  const double friction_Nm = (torque_Nm(position_rad, moving_rad_s) - drive.ratio_m_rad * load_N) *
                             (moving_rad_s > 0.0 ? 1.0 : -1.0);
  const MotionState known{.position_rad = position_rad,
                          .velocity_rad_s = velocity_rad_s,
                          .friction_excess_Nm = friction_Nm - drive.dry_friction_Nm(speed_rad_s, load_N) -
                                                drive.viscous_Nm_s_rad * speed_rad_s};
  return limited_torque_Nm(move_torque_Nm(move.to_rad, move.speed_limit_rad_s, drive, known, load_N),
                           {.torque_Nm = move.torque_limit_Nm}, drive, velocity_rad_s, load_N,
                           slope_N_rad(position_rad));
}

std::optional<double> MeasuredBrake::move_time_s(const Move& move, const NominalDrive& drive) const {
  return walk_time_s(state(move.from_rad, 0.0), move, drive.period_s,
                     [&](const ExtendedBrake::State& now) -> std::optional<ExtendedBrake::State> {
                       const ExtendedBrake::State next =
                           brake_.advance(now, held(commanded_Nm(now, move, drive), drive.period_s));
                       if (!ExtendedBrake::is_bounded(next)) return std::nullopt;
                       return next;
                     });
}

}  // namespace clampd
