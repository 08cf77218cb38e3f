#include "tests/sheet/plant_measurement.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <string_view>
#include <utility>

#include "clampd/control/control_law.hpp"
#include "drivers/sim/simulated_brake.hpp"

namespace clampd::support {
namespace {

constexpr double kPeriod_s = 1e-3;

/// A brake that starts at rest at a position from contact, and whose torque acts without delay, as that of a
/// loop does that predicts well.
class Bench {
 public:
  Bench(sim::PlantConfiguration plant, double from_rad) : brake_(started(std::move(plant), from_rad)) {}

  /// The state at which the next torque begins to act: already decided, whatever that torque is.
  sim::Truth now() const {
    sim::SimulatedBrake ahead = brake_;
    ahead.sample();
    return ahead.truth();
  }
  void drive(double torque_Nm) {
    brake_.command({torque_Nm, true});
    brake_.sample();
  }

 private:
  static sim::PlantConfiguration started(sim::PlantConfiguration plant, double from_rad) {
    plant.clearance_rad = -from_rad;
    plant.sensors = {};
    return plant;
  }

  sim::SimulatedBrake brake_;
};

/// Against a motion in this direction.
double friction_Nm(const sim::PlantConfiguration& plant, double force_N, double speed_rad_s,
                   double direction) {
  const ParameterVector& p = plant.brake.theta;
  const double coulomb_Nm = p[TC] + plant.effects.coulomb_load_Nm_N * force_N;
  return coulomb_Nm + (p[Ts0] + p[mus] * force_N - coulomb_Nm) / (1.0 + std::pow(speed_rad_s / p[ws], 2)) +
         (p[Tv] + plant.effects.quadratic_drag_Nm_s2_rad2 * speed_rad_s) * speed_rad_s +
         plant.effects.friction_asymmetry_Nm * direction;
}

double force_at(const sim::PlantConfiguration& plant, double x) {
  const ParameterVector& p = plant.brake.theta;
  return ((plant.effects.stiffness_shape_N_rad4 * x + p[k1]) * x + p[k2]) * x * x;
}

/// Where the force is, found by going there.
std::optional<double> position_rad(const sim::PlantConfiguration& plant, double force_N) {
  const auto force = [&](double x) { return force_at(plant, x); };
  double x = 0.0;
  for (double step = 1.0; step > 1e-10; step /= 2.0)
    while (force(x + step) < force_N) {
      if (x > 88.0 || force(x + step) < force(x)) return std::nullopt;
      x += step;
    }
  return x;
}

/// The law of the loop's moves with what an observer knows at its best.
double move_torque(const sim::Truth& now, double to_rad, const Circumstances& at,
                   const sim::PlantConfiguration& plant) {
  const NominalDrive drive;
  const double speed = std::abs(now.velocity_rad_s);
  const double direction = speed > 0.0 ? now.velocity_rad_s / speed : to_rad > now.position_rad ? 1.0 : -1.0;
  const MotionState motion{now.position_rad, now.velocity_rad_s,
                           friction_Nm(plant, now.force_N, speed, direction) -
                               drive.dry_friction_Nm(speed, now.force_N) - drive.viscous_Nm_s_rad * speed};
  const double x = std::max(now.position_rad, 0.0);
  return limited_torque_Nm(move_torque_Nm(to_rad, at.speed_limit_rad_s, drive, motion, now.force_N),
                           {.torque_Nm = at.torque_limit_Nm}, drive, now.velocity_rad_s, now.force_N,
                           (force_at(plant, x + 1e-3) - force_at(plant, x - 1e-3)) / 2e-3);
}

std::optional<double> time_of_move(const sim::PlantConfiguration& plant, double from_rad, double to_rad,
                                   double level_N, const Circumstances& at) {
  Bench bench(plant, from_rad);
  const double sign = to_rad > from_rad ? 1.0 : -1.0;
  // Without force there is nothing to see of it but the place.
  const double level_rad = *position_rad(plant, level_N);
  sim::Truth now = bench.now();
  for (int k = 0; k < 3000; ++k) {
    bench.drive(move_torque(now, to_rad, at, plant));
    const sim::Truth next = bench.now();
    if (sign * (next.position_rad - level_rad) >= 0.0) {
      // Constant acceleration within the period.
      const double acceleration = (next.velocity_rad_s - now.velocity_rad_s) / kPeriod_s;
      double part = 0.0;
      for (double step = 0.5; step > 1e-9; step /= 2.0) {
        const double t = (part + step) * kPeriod_s;
        const double x = now.position_rad + t * (now.velocity_rad_s + 0.5 * t * acceleration);
        if (sign * (x - level_rad) < 0.0) part += step;
      }
      return (k + part) * kPeriod_s;
    }
    now = next;
  }
  return std::nullopt;
}

/// The torque of friction while the motor turns at one speed, at the very place: what is left of the drive's
/// when load and acceleration have been taken off.
double friction_at(const sim::PlantConfiguration& plant, double from_rad, double at_rad, double speed_rad_s) {
  Bench bench(plant, from_rad);
  const double sign = at_rad > from_rad ? 1.0 : -1.0;
  const double ratio_m_rad = plant.brake.fixed.ratio_m_rad * (1.0 + plant.effects.ratio_error);
  const double inertia_kg_m2 = plant.brake.fixed.inertia_kg_m2 * (1.0 + plant.effects.inertia_error);
  double sum_Nm = 0.0, before_Nm = 0.0, before_rad = from_rad;
  sim::Truth now = bench.now();
  for (int k = 0; k < 20'000; ++k) {
    const double error = sign * speed_rad_s - now.velocity_rad_s;
    sum_Nm = std::clamp(sum_Nm + 0.02 * error, -0.5, 0.5);
    const double torque_Nm =
        std::clamp(ratio_m_rad * now.force_N + sign * friction_Nm(plant, now.force_N, speed_rad_s, sign) +
                       0.2 * error + sum_Nm,
                   -3.0, 3.0);
    bench.drive(torque_Nm);
    const sim::Truth next = bench.now();
    const double middle_rad = 0.5 * (now.position_rad + next.position_rad);
    const double here_Nm = sign * (torque_Nm - ratio_m_rad * 0.5 * (now.force_N + next.force_N) -
                                   inertia_kg_m2 * (next.velocity_rad_s - now.velocity_rad_s) / kPeriod_s);
    if (sign * (middle_rad - at_rad) >= 0.0)
      return before_Nm + (here_Nm - before_Nm) * (at_rad - before_rad) / (middle_rad - before_rad);
    before_Nm = here_Nm;
    before_rad = middle_rad;
    now = next;
  }
  return std::nan("");
}

/// The torque at which it breaks away in one direction, by halving.
double breakaway_Nm(const sim::PlantConfiguration& plant, double from_rad, double sign) {
  double stays = -3.0 * sign, goes = 3.0 * sign;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (stays + goes);
    Bench bench(plant, from_rad);
    for (int k = 0; k < 3; ++k) bench.drive(middle);
    (sign * (bench.now().position_rad - from_rad) > 0.0 ? goes : stays) = middle;
  }
  return 0.5 * (stays + goes);
}

}  // namespace

std::optional<double> measure(const Characteristic& characteristic, sim::PlantConfiguration plant) {
  const std::string_view kind = characteristic.kind->name;
  const Circumstances& at = characteristic.circumstances;
  if (kind == "contact-point") return plant.encoder_zero_rad;
  if (kind == "clearance") return plant.clearance_rad;
  if (kind == "drag") return friction_at(plant, -25.0, -1.0, at.speed_rad_s);
  const std::optional<double> x = position_rad(plant, at.force_N);
  if (!x) return std::nullopt;
  if (kind == "apply-time") return time_of_move(plant, -at.clearance_rad, *x, at.share * at.force_N, at);
  if (kind == "release-time") return time_of_move(plant, *x, -at.clearance_rad, at.share * at.force_N, at);
  if (kind == "hysteresis")
    return friction_at(plant, std::max(0.0, *x - 8.0), *x, at.speed_rad_s) +
           friction_at(plant, *x + 8.0, *x, at.speed_rad_s);
  if (kind == "holding-margin") return -breakaway_Nm(plant, *x, -1.0);
  if (kind == "least-torque") return breakaway_Nm(plant, *x, 1.0);
  if (kind == "stiffness")
    return (Bench(plant, *x + 1e-3).now().force_N - Bench(plant, *x - 1e-3).now().force_N) / 2e-3;
  return std::nullopt;
}

}  // namespace clampd::support
