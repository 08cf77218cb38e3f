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

inline constexpr int kHalvings = 60;  ///< of an interval, until nothing is left of it

/// The instant within a period, as a share of it, at which a cubic through both ends' positions and
/// velocities passes the level, which lies between the ends.
double passing_share(const BrakeState& before, const BrakeState& after, double level_rad, double period_s);

/// The smallest position from contact where a brake has this force; nothing if it never has.
std::optional<double> position_of_force(const PaperBrake& brake, double force_N);

}  // namespace clampd
