#pragma once

#include <concepts>

namespace clampd {

/// What the sensors would read without noise: h of (6).
struct Reading {
  double force_N;
  double velocity_rad_s;
};

/// Partial derivatives of the two readings by the true clamp force and the true velocity.
struct ReadingSlopes {
  double force_by_force;
  double force_by_velocity;
  double velocity_by_force;
  double velocity_by_velocity;
};

/// From true clamp force and velocity to the readings; memoryless. `evaluate` gives dreading/dparameter as
/// gradient[2 * kParameters]: all of the force reading first, then all of the velocity reading.
template <class R>
concept Readings = requires(const R readings, double force_N, double velocity_rad_s, double* gradient) {
  { R::kParameters } -> std::convertible_to<int>;
  { readings.read(force_N, velocity_rad_s) } -> std::same_as<Reading>;
  { readings.evaluate(force_N, velocity_rad_s, gradient) } -> std::same_as<ReadingSlopes>;
}
&&std::constructible_from<R, const double*>;

/// The paper's (6): force and velocity as they are.
struct IdealReadings {
  static constexpr int kParameters = 0;

  explicit IdealReadings(const double*) {}

  Reading read(double force_N, double velocity_rad_s) const noexcept { return {force_N, velocity_rad_s}; }
  ReadingSlopes evaluate(double, double, double*) const noexcept { return {1.0, 0.0, 0.0, 1.0}; }
};
static_assert(Readings<IdealReadings>);

}  // namespace clampd
