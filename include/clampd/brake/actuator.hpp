#pragma once

#include <concepts>

namespace clampd {

struct TorquePoint {
  double torque_Nm;
  double by_reading;
  double by_velocity_Nm_s_rad;
};

/// From the torque reading to the torque that acts on the motor shaft; memoryless.
template <class A>
concept Actuator = requires(const A actuator, double reading_Nm, double velocity_rad_s, double* gradient) {
  { A::kParameters } -> std::convertible_to<int>;
  { actuator.acting_Nm(reading_Nm, velocity_rad_s) } -> std::same_as<double>;
  { actuator.evaluate(reading_Nm, velocity_rad_s, gradient) } -> std::same_as<TorquePoint>;
}
&&std::constructible_from<A, const double*>;

/// The paper's: what is read is what acts.
struct IdealActuator {
  static constexpr int kParameters = 0;

  explicit IdealActuator(const double*) {}

  double acting_Nm(double reading_Nm, double) const noexcept { return reading_Nm; }
  TorquePoint evaluate(double reading_Nm, double, double*) const noexcept { return {reading_Nm, 1.0, 0.0}; }
};
static_assert(Actuator<IdealActuator>);

}  // namespace clampd
