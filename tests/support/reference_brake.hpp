#pragma once

#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "clampd/parameters/brake_parameters.hpp"

namespace clampd::support {

/// The brake by another road, to check the product's integrator against: its own transcription of equations
/// (2) to (5), Moreau time stepping (friction as a soft threshold on the velocity, so that rest needs no
/// events), second order by a midpoint position and one correction of the friction level, steps of
/// microseconds.
class ReferenceBrake {
 public:
  ReferenceBrake(const BrakeParameters& parameters, double position_rad, double velocity_rad_s)
      : theta_(parameters.theta),
        fixed_(parameters.fixed),
        position_(position_rad),
        velocity_(velocity_rad_s) {}

  void advance(double torque_Nm, double duration_s, double step_s) {
    const long steps = std::lround(duration_s / step_s);
    const double h = duration_s / static_cast<double>(steps);
    for (long i = 0; i < steps; ++i) {
      const double middle = position_ + 0.5 * h * velocity_;
      const double predicted = kick(middle, velocity_, velocity_, torque_Nm, h);
      const double next = kick(middle, velocity_, 0.5 * (velocity_ + predicted), torque_Nm, h);
      position_ += 0.5 * h * (velocity_ + next);
      velocity_ = next;
    }
  }

  double position_rad() const { return position_; }
  double velocity_rad_s() const { return velocity_; }
  double force_N() const { return force(position_); }

 private:
  double force(double x) const {
    return x < 0.0 ? 0.0 : theta_[0] * std::pow(x, 3) + theta_[1] * std::pow(x, 2);
  }

  /// Velocity after h; friction level and viscous torque taken at velocity `at`.
  double kick(double x, double velocity, double at, double torque_Nm, double h) const {
    const double load = force(x);
    const double holding = theta_[3] + theta_[5] * load;
    const double level = theta_[2] + (holding - theta_[2]) / (1.0 + std::pow(at / theta_[6], 2));
    const double gain = h / fixed_.inertia_kg_m2;
    const double free = velocity + gain * (torque_Nm - fixed_.ratio_m_rad * load - theta_[4] * at);
    const double rest = std::abs(free) - gain * level;
    return rest <= 0.0 ? 0.0 : std::copysign(rest, free);
  }

  ParameterVector theta_;
  FixedParameters fixed_;
  double position_;
  double velocity_;
};

struct ReferenceTrace {
  std::vector<double> position_rad, velocity_rad_s, force_N;
};

/// Sampled at 1 ms; torque_Nm[k] acts from sample k.
inline ReferenceTrace simulate_reference(const BrakeParameters& parameters, double position_rad,
                                         double velocity_rad_s, std::span<const double> torque_Nm,
                                         double step_s = 1e-6) {
  ReferenceBrake brake(parameters, position_rad, velocity_rad_s);
  ReferenceTrace trace;
  for (const double torque : torque_Nm) {
    trace.position_rad.push_back(brake.position_rad());
    trace.velocity_rad_s.push_back(brake.velocity_rad_s());
    trace.force_N.push_back(brake.force_N());
    brake.advance(torque, 1e-3, step_s);
  }
  return trace;
}

}  // namespace clampd::support
