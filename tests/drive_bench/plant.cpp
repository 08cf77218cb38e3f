#include "tests/drive_bench/plant.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/drive_bench/random.hpp"

namespace clampd::drive_bench {
namespace {

double sign(double x) {
  return static_cast<double>((x > 0.0) - (x < 0.0));
}

/// How far a hysteresis of this length has come, from `from`, when the position moves on by `way`. Exact for
/// any way.
double relaxed(double from, double way, double length) {
  const double end = sign(way);
  return end + (from - end) * std::exp(-std::abs(way) / length);
}

double payload_at(const Plant& p, double t) {
  if (p.payload_inertia == 0.0) return 0.0;
  const bool carried =
      std::fmod(t + p.payload_start_s, p.payload_period_s) < p.payload_share * p.payload_period_s;
  return carried ? p.payload_inertia : 0.0;
}

double inertia_at(const Plant& plant, double q, double t) {
  const Plant::Ripple& ripple = plant.inertia_ripple;
  return plant.inertia * (1.0 + ripple.amplitude * std::cos(ripple.wave_number * q + ripple.phase)) +
         payload_at(plant, t);
}

/// How deep the drive has pressed the end stop in.
double stop_depth(const Plant& p, double q) {
  return std::max(p.stop_side * (q - p.stop_place), 0.0);
}

/// The end stop pushes and never pulls.
double stop_torque(const Plant& p, double q, double v) {
  return p.stop_side * p.stop_stiffness * stop_depth(p, q) *
         std::max(1.0 + p.stop_damping * p.stop_side * v, 0.0);
}

/// Level of the dry friction of a motion (or a push) in `direction`.
double dry_level(const Plant& p, double q, double v, double direction, double t, double pressing,
                 std::size_t run) {
  const double speed = std::abs(v);
  double level = p.coulomb * (1.0 + direction * p.dry_asymmetry);
  level *= 1.0 + p.friction_ripple.amplitude *
                     std::sin(p.friction_ripple.wave_number * q + p.friction_ripple.phase);
  if (p.warm_up != 0.0) level *= 1.0 + p.warm_up * std::exp(-t / p.warm_up_time_s);
  if (run < p.run_factor.size()) level *= p.run_factor[run];
  if (p.stribeck_forward != 0.0 || p.stribeck_backward != 0.0)
    level += (direction >= 0.0 ? p.stribeck_forward : p.stribeck_backward) *
             std::exp(-std::pow(speed / p.stribeck_speed, p.stribeck_exponent));
  if (p.power != 0.0) level += p.power * std::pow(speed / p.speed, p.power_exponent);
  if (p.load_friction != 0.0) level += p.load_friction * std::abs(gravity_torque(p, q) + pressing);
  if (p.sticky_level != 0.0)
    level += p.sticky_level * std::exp(-std::pow((q - p.sticky_place) / p.sticky_width, 2.0));
  return std::max(level, 0.0);
}

/// All that resists the motion but dry friction, inertia and the shaft.
double smooth_torque(const Plant& p, double q, double v, double cable, double t) {
  double torque = p.viscous * (1.0 + sign(v) * p.viscous_asymmetry) * v + p.quadratic * v * std::abs(v);
  if (p.gravity != 0.0) torque += gravity_torque(p, q);
  for (const Plant::Ripple& ripple : p.cogging)
    torque += ripple.amplitude * std::sin(ripple.wave_number * q + ripple.phase);
  const double stretch = q - p.centre;
  torque += p.spring * stretch + p.spring_cubic * stretch * stretch * stretch;
  if (p.stop_stiffness != 0.0) torque += stop_torque(p, q, v);
  torque += p.cable_level * cable;
  if (p.inertia_ripple.amplitude !=
      0.0)  // the other half of what energy needs where the inertia changes on the way
    torque -= 0.5 * p.inertia * p.inertia_ripple.amplitude * p.inertia_ripple.wave_number *
              std::sin(p.inertia_ripple.wave_number * q + p.inertia_ripple.phase) * v * v;
  if (p.chatter_amplitude != 0.0 && std::abs(v) > p.chatter_from && std::abs(v) < p.chatter_to)
    torque += p.chatter_amplitude * std::sin(2.0 * std::numbers::pi * p.chatter_Hz * t);
  return torque;
}

double acting(const Plant& p, PlantState& state, double torque, double step_s) {
  if (p.torque_lag_s > 0.0)
    state.acting_torque += (torque - state.acting_torque) * -std::expm1(-step_s / p.torque_lag_s);
  else
    state.acting_torque = torque;
  const double relative = state.acting_torque / p.torque_scale;
  return state.acting_torque * (1.0 - p.saturation * relative * relative);
}

/// Share of the torque that a motor with a weakened field keeps at a speed.
double field_at(const Plant& p, double v) {
  return p.base_speed > 0.0 ? p.base_speed / std::max(std::abs(v), p.base_speed) : 1.0;
}

double shaft_torque(const Plant& p, double q, double v, double load_q, double load_v) {
  double torque = p.shaft_stiffness * (q - load_q) + p.shaft_damping * (v - load_v);
  if (p.clutch_torque != 0.0)
    torque += p.clutch_torque * std::clamp((v - load_v) / p.clutch_creep, -1.0, 1.0);
  return torque;
}

/// What is left of a velocity after an impulse of dry friction.
double after_friction(double free_velocity, double impulse_velocity) {
  return sign(free_velocity) * std::max(std::abs(free_velocity) - impulse_velocity, 0.0);
}

void add_knocks(const LoadSignal& load, double tick_s, Random& random, std::vector<double>& torque) {
  const double end_s = static_cast<double>(torque.size()) * tick_s;
  const auto pause_s = [&] { return -load.knock_pause_s * std::log(random.uniform()); };
  for (double start_s = pause_s(); start_s < end_s; start_s += load.knock_s + pause_s()) {
    const double height = load.knock_level * random.uniform(0.5, 1.5) * random.sign();
    for (auto k = static_cast<std::size_t>(std::ceil(start_s / tick_s)); k < torque.size(); ++k) {
      const double progress = (static_cast<double>(k) * tick_s - start_s) / load.knock_s;
      if (progress >= 1.0) break;
      torque[k] += height * std::sin(std::numbers::pi * progress);
    }
  }
}

}  // namespace

std::vector<double> by_tick(const LoadSignal& load, std::size_t run, std::size_t ticks, double tick_s) {
  if (!load.is_there()) return {};
  Random random(load.seed, run);
  std::vector<double> torque(ticks, load.amplitude * random.uniform(-0.5, 0.5));
  for (int sine = 0; sine < 4 && load.amplitude != 0.0; ++sine) {
    const double w = 2.0 * std::numbers::pi * random.log_uniform(load.slowest_Hz, load.fastest_Hz);
    const double phase = random.phase();
    for (std::size_t k = 0; k < ticks; ++k)
      torque[k] += 0.6 * load.amplitude * std::sin(w * static_cast<double>(k) * tick_s + phase);
  }
  if (load.knock_level != 0.0) add_knocks(load, tick_s, random, torque);
  if (load.walk_sd == 0.0) return torque;
  const double keep = std::exp(-tick_s / load.walk_memory_s);
  double value = load.walk_sd * random.normal();
  for (double& each : torque) {
    each += value;
    value = keep * value + load.walk_sd * std::sqrt(1.0 - keep * keep) * random.normal();
  }
  return torque;
}

double gravity_torque(const Plant& plant, double position) {
  return plant.linear ? plant.gravity : plant.gravity * std::sin(position + plant.gravity_phase);
}

DryFriction advance(const Plant& p, PlantState& s, double torque, double load, double measured_load,
                    std::size_t run, double h) {
  const double drive = acting(p, s, torque, h);
  const bool two_masses = p.load_inertia > 0.0;
  const bool bristles = p.bristle_length > 0.0;
  // Torque without dry friction (with bristles: with them) at a state.
  const auto net = [&](double q, double v, double z, double cable, double load_q, double load_v, double t) {
    double sum = drive * field_at(p, v) - load - smooth_torque(p, q, v, cable, t);
    if (two_masses) sum -= shaft_torque(p, q, v, load_q, load_v);
    if (bristles) {
      const double level = dry_level(p, q, v, sign(v), t, measured_load, run);
      const double damping = 0.6 * std::sqrt(p.inertia * std::max(level, 1e-300) / p.bristle_length);
      sum -= level * z + damping * v * (1.0 - sign(v) * z);
    }
    return sum;
  };
  const auto rubbed = [&](double free_velocity, double q, double v, double t, double step) {
    if (bristles) return free_velocity;
    const double level = dry_level(p, q, v, sign(free_velocity), t, measured_load, run);
    return after_friction(free_velocity, level * step / inertia_at(p, q, t));
  };

  const double half = 0.5 * h;
  const double q0 = s.position, v0 = s.velocity;
  const double free_half =
      v0 + half * net(q0, v0, s.bristle, s.cable, s.load_position, s.load_velocity, s.time_s) /
               inertia_at(p, q0, s.time_s);
  const double v_half = rubbed(free_half, q0, v0, s.time_s, half);
  const double q_half = q0 + 0.5 * half * (v0 + v_half);
  const double z_half = bristles ? relaxed(s.bristle, q_half - q0, p.bristle_length) : 0.0;
  const double cable_half = p.cable_level != 0.0 ? relaxed(s.cable, q_half - q0, p.cable_length) : 0.0;
  double load_q_half = 0.0, load_v_half = 0.0;
  if (two_masses) {
    load_v_half =
        s.load_velocity + half * shaft_torque(p, q0, v0, s.load_position, s.load_velocity) / p.load_inertia;
    load_q_half = s.load_position + half * s.load_velocity;
  }

  const double t_half = s.time_s + half;
  const double mass = inertia_at(p, q_half, t_half);
  const double free =
      v0 + h * net(q_half, v_half, z_half, cable_half, load_q_half, load_v_half, t_half) / mass;
  const double v1 = rubbed(free, q_half, v_half, t_half, h);
  DryFriction dry;
  if (bristles) {
    dry.direction = sign(v_half);
  } else {
    const double full = dry_level(p, q_half, v_half, sign(free), t_half, measured_load, run) * h / mass;
    dry.direction = full > 0.0 ? (free - v1) / full : sign(v1);
    dry.stuck = v0 == 0.0 && v1 == 0.0;
  }
  const double q1 = q0 + 0.5 * h * (v0 + v1);
  if (bristles) s.bristle = relaxed(s.bristle, q1 - q0, p.bristle_length);
  if (p.cable_level != 0.0) s.cable = relaxed(s.cable, q1 - q0, p.cable_length);
  if (two_masses) {
    s.load_velocity += h * shaft_torque(p, q_half, v_half, load_q_half, load_v_half) / p.load_inertia;
    s.load_position += h * load_v_half;
  }
  s.position = q1;
  s.velocity = v1;
  s.time_s += h;
  return dry;
}

double stiffness_rate(const Plant& p, double speed) {
  double rate =
      (p.viscous * (1.0 + std::abs(p.viscous_asymmetry)) + 2.0 * std::abs(p.quadratic) * speed) / p.inertia;
  if (p.bristle_length > 0.0) {
    const double level = p.coulomb + std::max(p.stribeck_forward, p.stribeck_backward);
    rate =
        std::max({rate, 2.0 * std::sqrt(level / (p.inertia * p.bristle_length)), speed / p.bristle_length});
  }
  if (p.cable_level > 0.0) rate = std::max(rate, std::sqrt(p.cable_level / (p.inertia * p.cable_length)));
  if (p.load_inertia > 0.0)
    rate = std::max({rate, std::sqrt(p.shaft_stiffness * (1.0 / p.load_inertia + 1.0 / p.inertia)),
                     p.clutch_torque / p.clutch_creep * (1.0 / p.load_inertia + 1.0 / p.inertia)});
  if (p.stop_stiffness > 0.0)
    rate = std::max(rate, std::sqrt(p.stop_stiffness / p.inertia) * (1.0 + p.stop_damping * speed));
  for (const Plant::Ripple& ripple : p.cogging) rate = std::max(rate, ripple.wave_number * speed);
  rate = std::max(rate, 2.0 * std::numbers::pi * p.chatter_Hz);
  if (p.sticky_level > 0.0) rate = std::max(rate, 2.0 * speed / p.sticky_width);
  return rate;
}

double stored_energy(const Plant& p, const PlantState& s) {
  double energy = 0.5 * inertia_at(p, s.position, s.time_s) * s.velocity * s.velocity;
  energy += p.linear ? p.gravity * s.position : -p.gravity * std::cos(s.position + p.gravity_phase);
  for (const Plant::Ripple& ripple : p.cogging)
    energy -=
        ripple.amplitude / ripple.wave_number * std::cos(ripple.wave_number * s.position + ripple.phase);
  const double stretch = s.position - p.centre, twist = s.position - s.load_position;
  energy += 0.5 * p.spring * stretch * stretch + 0.25 * p.spring_cubic * std::pow(stretch, 4.0);
  energy += 0.5 * p.stop_stiffness * std::pow(stop_depth(p, s.position), 2.0);
  if (p.load_inertia > 0.0)
    energy +=
        0.5 * p.load_inertia * s.load_velocity * s.load_velocity + 0.5 * p.shaft_stiffness * twist * twist;
  return energy;
}

}  // namespace clampd::drive_bench
