#pragma once

#include <optional>

#include "clampd/brake/dynamics.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// A move from rest, as the station's own law makes it.
struct Move {
  double from_rad = 0.0;   ///< from contact, at rest
  double to_rad = 0.0;     ///< where the law takes it
  double level_rad = 0.0;  ///< between the two: the time is taken when it is passed
  double torque_limit_Nm = 3.0;
  double speed_limit_rad_s = 270.0;
};

/// Seconds from the instant the drive's torque begins to act until the motor passes the level; nothing if it
/// does not within kLongestMove_s. The law (`move_torque_Nm`, limits last) is made for this drive
/// and knows what the loop observes: the state at the instant at which its torque acts, and what this brake's
/// friction differs by.
std::optional<double> move_time_s(const PaperBrake& brake, const Move& move, const NominalDrive& drive);

inline constexpr double kLongestMove_s = 3.0;

/// Where `is_before` turns from true to false on the way from one number to another, to the last bit.
template <class IsBefore>
double turning_point(double from, double to, const IsBefore& is_before) {
  constexpr int kHalvings = 60;
  for (int i = 0; i < kHalvings; ++i) {
    const double middle = 0.5 * (from + to);
    (is_before(middle) ? from : to) = middle;
  }
  return 0.5 * (from + to);
}

/// The instant within a period, as a share of it, at which a cubic through both ends' positions and
/// velocities passes the level, which lies between the ends.
double passing_share(const BrakeState& before, const BrakeState& after, double level_rad, double period_s);

/// The walk of move_time_s() from a state whose first two numbers are position and velocity. `advance`: the
/// state a period later; nothing where it leaves all bounds.
template <class State, class Advance>
std::optional<double> walk_time_s(State state, const Move& move, double period_s, const Advance& advance) {
  const double direction = move.to_rad > move.from_rad ? 1.0 : -1.0;
  for (int k = 0; k * period_s < kLongestMove_s; ++k) {
    const std::optional<State> next = advance(state);
    if (!next) return std::nullopt;
    if (direction * ((*next)[0] - move.level_rad) >= 0.0)
      return (k +
              passing_share(state.template head<2>(), next->template head<2>(), move.level_rad, period_s)) *
             period_s;
    state = *next;
  }
  return std::nullopt;
}

/// The smallest position from contact where a brake has this force; nothing if it never has.
std::optional<double> position_of_force(const PaperBrake& brake, double force_N);

}  // namespace clampd
