#pragma once

#include <optional>

#include "clampd/brake/extended_brake.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "src/sheet/response.hpp"

namespace clampd {

/// A brake with effects beside the base model on a test bench: what it does, measured by stopwatch and torque
/// wrench on its equations, since there is no closed form. Positions are from contact. Its effects are
/// without memory (check_countable), so that position and velocity are all of its state.
class MeasuredBrake {
 public:
  /// Effects in the station's readings are left out: its sensors are perfect.
  explicit MeasuredBrake(const ExtendedParameters& parameters);

  /// The smallest position where it has this force at rest; nothing if it never has.
  std::optional<double> position_of_force(double force_N) const;
  /// dF/dx at rest.
  double slope_N_rad(double position_rad) const;
  /// That keeps the motor at this velocity, other than zero, when it passes this place.
  double torque_Nm(double position_rad, double velocity_rad_s) const;
  /// From which on the motor moves, in this direction, from rest at this place.
  double breakaway_Nm(double position_rad, double direction) const;
  /// As move_time_s() of response.hpp.
  std::optional<double> move_time_s(const Move& move, const NominalDrive& drive) const;

 private:
  ExtendedBrake::State state(double position_rad, double velocity_rad_s) const;
  double force_N(double position_rad, double velocity_rad_s) const;
  double acceleration(double position_rad, double velocity_rad_s, double torque_Nm) const;
  double commanded_Nm(const ExtendedBrake::State& now, const Move& move, const NominalDrive& drive) const;

  ExtendedBrake brake_;
};

}  // namespace clampd
