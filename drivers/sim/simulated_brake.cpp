#include "drivers/sim/simulated_brake.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"

namespace clampd::sim {
namespace {

double quantised(double value, double quantum) noexcept {
  return quantum > 0.0 ? std::round(value / quantum) * quantum : value;
}

/// y' = (u - y) / lag over a step h in which u goes straight from `before` to `after`; y before is `value`.
double lagged(double value, double before, double after, double lag_s, double h) noexcept {
  const double behind = (after - before) * lag_s / h;
  return after - behind + (value - before + behind) * std::exp(-h / lag_s);
}

}  // namespace

SimulatedBrake::SimulatedBrake(const PlantConfiguration& configuration, std::int64_t cycle_ns)
    : configuration_(configuration),
      random_(configuration.seed),
      spoiler_(configuration.spoiled, configuration.seed + 1),
      cycle_ns_(cycle_ns),
      cycle_s_(1e-9 * static_cast<double>(cycle_ns)),
      steps_(static_cast<int>(std::ceil(cycle_s_ / configuration.step_s - 1e-9))),
      speed_steps_(std::clamp(static_cast<int>(std::lround(configuration.speed_period_s / cycle_s_ * steps_)),
                              1, steps_)) {
  CLAMPD_ASSERT(configuration.validate().has_value());
  state_.position_rad = -configuration.clearance_rad;
  state_.pad_position_rad = state_.position_rad;
  state_.force_N = pad_force(0.0);
  state_.relaxed_N = state_.force_N;
  state_.filtered_force_N = state_.force_N;
  force_history_N_.assign(
      static_cast<std::size_t>(configuration.effects.channel_skew * kPeriod_s / cycle_s_ * steps_) + 2,
      state_.force_N);
}

void SimulatedBrake::command(const DriveCommand& command) noexcept {
  newest_ = command;
  fresh_ = true;
}

BrakeFeedback SimulatedBrake::sample() noexcept {
  latch_command();
  const BrakeFeedback feedback = read();
  advance();
  ++index_;
  return feedback;
}

void SimulatedBrake::latch_command() noexcept {
  if (fresh_) {
    fresh_ = false;
    silent_samples_ = 0;
    if (!newest_.enable) tripped_ = false;
    enabled_ = newest_.enable && !tripped_;
    torque_Nm_ =
        enabled_ && std::isfinite(newest_.torque_Nm)
            ? std::clamp(newest_.torque_Nm, -configuration_.torque_limit_Nm, configuration_.torque_limit_Nm)
            : 0.0;
  } else {
    // The last command may be up to one sample older than the instant that latched it: count it as that old,
    // so that the torque is zero no later than watchdog_s after the command came.
    ++silent_samples_;
    if (enabled_ && static_cast<double>(silent_samples_ + 1) * cycle_s_ >= configuration_.watchdog_s - 1e-9) {
      tripped_ = true;
      enabled_ = false;
      torque_Nm_ = 0.0;
    }
  }
  follow_speed(speed_steps_ * cycle_s_ / steps_);
}

/// The torque for the next step h, if the brake is told its speed. Where the torque is limited, the integral
/// waits.
void SimulatedBrake::follow_speed(double h) noexcept {
  if (!enabled_) integral_Nm_ = 0.0;
  if (!enabled_ || newest_.commanded != CommandedQuantity::Velocity) return;
  if (!std::isfinite(newest_.velocity_rad_s)) {
    torque_Nm_ = 0.0;
    return;
  }
  const double bandwidth_rad_s = configuration_.speed_bandwidth_rad_s;
  const double gain_Nm_s_rad = configuration_.brake.fixed.inertia_kg_m2 * bandwidth_rad_s;
  const double missing_rad_s = newest_.velocity_rad_s - (state_.velocity_rad_s + velocity_error_rad_s_);
  const double wanted_Nm = gain_Nm_s_rad * missing_rad_s + integral_Nm_;
  torque_Nm_ = std::clamp(wanted_Nm, -configuration_.torque_limit_Nm, configuration_.torque_limit_Nm);
  if (torque_Nm_ == wanted_Nm || missing_rad_s * wanted_Nm < 0.0)
    integral_Nm_ += 0.25 * bandwidth_rad_s * gain_Nm_s_rad * missing_rad_s * h;
}

BrakeFeedback SimulatedBrake::read() noexcept {
  const SensorSettings& sensors = configuration_.sensors;
  const Effects& effects = configuration_.effects;
  const double time_s = static_cast<double>(index_) * cycle_s_ + lateness_s_;
  if (effects.torque_lag_s <= 0.0) state_.torque_Nm = torque_Nm_;
  truth_ = {time_s,  state_.position_rad, state_.velocity_rad_s, state_.force_N, state_.torque_Nm, enabled_,
            tripped_};

  double force_N = force_before(effects.channel_skew * kPeriod_s / cycle_s_);
  force_N += effects.force_offset_N + sensors.force_offset_N +
             effects.force_hum_N * std::sin(2.0 * std::numbers::pi * kHumFrequency_Hz * time_s + 0.4);
  if (effects.outliers > 0.0) {
    const double draw = std::generate_canonical<double, 53>(random_);
    if (draw < effects.outliers)
      force_N += draw < 0.5 * effects.outliers ? kOutlierForce_N : -kOutlierForce_N;
  }
  force_N += gaussian(sensors.force_noise_N);
  if (effects.force_saturation_N > 0.0)
    force_N = std::clamp(force_N, -effects.force_saturation_N, effects.force_saturation_N);

  const double velocity_rad_s =
      (effects.velocity_lag_s > 0.0 ? state_.filtered_velocity_rad_s : state_.velocity_rad_s) +
      sensors.velocity_offset_rad_s + gaussian(sensors.velocity_noise_rad_s);
  const double torque_Nm =
      (1.0 + effects.torque_gain) * torque_Nm_ + effects.torque_offset_Nm + gaussian(sensors.torque_noise_Nm);
  const double position_rad =
      state_.position_rad + configuration_.encoder_zero_rad + gaussian(sensors.position_noise_rad);

  BrakeFeedback feedback;
  feedback.sample_index = index_;
  feedback.brake_time_ns = index_ * cycle_ns_ + std::llround(lateness_s_ * 1e9);
  feedback.torque_Nm = quantised(torque_Nm, sensors.torque_quantum_Nm);
  feedback.velocity_rad_s = quantised(velocity_rad_s, sensors.velocity_quantum_rad_s);
  feedback.force_N = quantised(force_N, sensors.force_quantum_N);
  feedback.position_rad = quantised(position_rad, sensors.position_quantum_rad);
  feedback.drive_enabled = enabled_;
  feedback.watchdog_tripped = tripped_;
  unspoiled_ = feedback;
  for (ScriptedFault& fault : configuration_.faults) fault.when.observe(time_s, state_.force_N);
  spoiler_.apply(feedback, time_s, state_.force_N);
  velocity_error_rad_s_ =
      (configuration_.speed_loop_is_spoiled ? feedback : unspoiled_).velocity_rad_s - state_.velocity_rad_s;
  return feedback;
}

void SimulatedBrake::advance() noexcept {
  const double jitter_s = configuration_.sampling_jitter_s;
  const double before_s = std::exchange(
      lateness_s_, jitter_s > 0.0 ? std::clamp(gaussian(jitter_s), -3.0 * jitter_s, 3.0 * jitter_s) : 0.0);
  const double h = (cycle_s_ + lateness_s_ - before_s) / steps_;
  for (int i = 0; i < steps_; ++i) {
    if (i > 0 && i % speed_steps_ == 0) {
      follow_speed(h * speed_steps_);
      if (configuration_.effects.torque_lag_s <= 0.0) state_.torque_Nm = torque_Nm_;
    }
    step(h);
    newest_force_ = (newest_force_ + 1) % force_history_N_.size();
    force_history_N_[newest_force_] =
        configuration_.effects.force_lag_s > 0.0 ? state_.filtered_force_N : state_.force_N;
  }
}

/// What the load cell had so many samples ago, between the integrator's steps, too.
double SimulatedBrake::force_before(double samples) const noexcept {
  const double steps = samples * steps_;
  const auto whole = static_cast<std::size_t>(steps);
  const double part = steps - static_cast<double>(whole);
  const std::size_t size = force_history_N_.size();
  const auto before = [&](std::size_t age) { return force_history_N_[(newest_force_ + size - age) % size]; };
  return (1.0 - part) * before(whole) + (part > 0.0 ? part * before(whole + 1) : 0.0);
}

void SimulatedBrake::step(double h) noexcept {
  const Effects& effects = configuration_.effects;
  const double v = state_.velocity_rad_s;
  const double acting_Nm = mean_torque(h);

  const double before_rad = state_.position_rad;
  state_.position_rad = before_rad + 0.5 * h * v;
  carry_pads();
  const double force_N = pad_force(v);
  const double ratio = configuration_.brake.fixed.ratio_m_rad * (1.0 + effects.ratio_error);
  double torque_Nm = acting_Nm - ratio * force_N;
  if (effects.cogging_Nm > 0.0)
    torque_Nm -= effects.cogging_Nm *
                 std::sin(kCoggingOrder * (state_.position_rad + configuration_.encoder_zero_rad));
  const double next =
      effects.presliding_rad > 0.0 ? slide_on_bristles(h, torque_Nm, force_N) : slide(h, torque_Nm, force_N);
  state_.position_rad += 0.5 * h * next;
  state_.velocity_rad_s = next;
  if (state_.position_rad < -configuration_.open_stop_rad ||
      state_.position_rad > configuration_.closed_stop_rad) {
    state_.position_rad =
        std::clamp(state_.position_rad, -configuration_.open_stop_rad, configuration_.closed_stop_rad);
    state_.velocity_rad_s = 0.0;
  }
  press(h, before_rad);
  if (effects.velocity_lag_s > 0.0)
    state_.filtered_velocity_rad_s =
        lagged(state_.filtered_velocity_rad_s, v, state_.velocity_rad_s, effects.velocity_lag_s, h);
}

/// What moves the brake over a step is the mean of a torque that lags.
double SimulatedBrake::mean_torque(double h) noexcept {
  const double lag_s = configuration_.effects.torque_lag_s;
  if (!(lag_s > 0.0)) return state_.torque_Nm;
  const double distance_Nm = state_.torque_Nm - torque_Nm_;
  const double gone = -std::expm1(-h / lag_s);
  const double acting_Nm = torque_Nm_ + distance_Nm * gone * lag_s / h;
  state_.torque_Nm = torque_Nm_ + distance_Nm * (1.0 - gone);
  return acting_Nm;
}

/// The motor takes the pads along, within the backlash.
void SimulatedBrake::carry_pads() noexcept {
  const double backlash_rad = configuration_.effects.backlash_rad;
  state_.pad_position_rad = backlash_rad > 0.0 ? std::clamp(state_.pad_position_rad, state_.position_rad,
                                                            state_.position_rad + backlash_rad)
                                               : state_.position_rad;
}

double SimulatedBrake::viscous_Nm_s_rad(double v) const noexcept {
  const double drift = 1.0 + configuration_.effects.friction_drift * static_cast<double>(run_);
  return configuration_.brake.theta[Tv] * drift +
         configuration_.effects.quadratic_drag_Nm_s2_rad2 * std::abs(v);
}

double SimulatedBrake::inertia_kg_m2() const noexcept {
  return configuration_.brake.fixed.inertia_kg_m2 * (1.0 + configuration_.effects.inertia_error);
}

/// The next velocity with Dahl's bristles in place of the set-valued sign: z' = v - |v| z / z_max, integrated
/// exactly over the step.
double SimulatedBrake::slide_on_bristles(double h, double torque_Nm, double force_N) noexcept {
  const Effects& effects = configuration_.effects;
  const double v = state_.velocity_rad_s, inertia = inertia_kg_m2();
  const double level = friction_level(std::abs(v), force_N);
  const double steady_rad = std::copysign(effects.presliding_rad, v);
  state_.bristle_rad =
      steady_rad + (state_.bristle_rad - steady_rad) * std::exp(-h * std::abs(v) / effects.presliding_rad);
  const double friction_Nm = (level + effects.friction_asymmetry_Nm * std::copysign(1.0, v)) *
                             state_.bristle_rad / effects.presliding_rad;
  return (v + h / inertia * (torque_Nm - friction_Nm)) / (1.0 + h / inertia * viscous_Nm_s_rad(v));
}

/// The next velocity with friction as a projection.
double SimulatedBrake::slide(double h, double torque_Nm, double force_N) const noexcept {
  const double v = state_.velocity_rad_s, inertia = inertia_kg_m2(), viscous = viscous_Nm_s_rad(v);
  double next = v;
  const double bias_Nm = configuration_.effects.friction_asymmetry_Nm;
  double forward = 0.0, backward = 0.0, impulse = 0.0;
  // Twice, so that the Stribeck level belongs to the midpoint: second order while sliding.
  for (int pass = 0; pass < 2; ++pass) {
    const double level = friction_level(0.5 * std::abs(v + next), force_N);
    impulse = h / inertia * (torque_Nm - 0.5 * viscous * v);
    forward = h / inertia * std::max(0.0, level + bias_Nm);
    backward = h / inertia * std::max(0.0, level - bias_Nm);
    const double free = v + impulse;
    const double slip = free > forward ? free - forward : free < -backward ? free + backward : 0.0;
    next = slip / (1.0 + 0.5 * h / inertia * viscous);
  }
  // The projection spends the whole step on stopping. What is left of it belongs to the other direction, if
  // the torque overcomes the friction at rest: otherwise each reversal under load would come late by part
  // of a step.
  if (v != 0.0 && next * v <= 0.0) {
    const double braking = v > 0.0 ? forward - impulse : backward + impulse;
    const double left = std::clamp(1.0 - std::abs(v) / std::max(braking, 1e-300), 0.0, 1.0);
    const double level = friction_level(0.0, force_N);
    const double push_Nm = torque_Nm > 0.0 ? torque_Nm - std::max(0.0, level + bias_Nm)
                                           : -torque_Nm - std::max(0.0, level - bias_Nm);
    next = push_Nm > 0.0 ? std::copysign(push_Nm, torque_Nm) * left * h / inertia : 0.0;
  }
  return next;
}

/// Hysteresis, relaxation and force of the pads after the motion of a step.
void SimulatedBrake::press(double h, double before_rad) noexcept {
  const Effects& effects = configuration_.effects;
  const ParameterVector& theta = configuration_.brake.theta;
  const double travel_rad = state_.position_rad - before_rad;
  state_.hysteresis =
      std::copysign(1.0, travel_rad) + (state_.hysteresis - std::copysign(1.0, travel_rad)) *
                                           std::exp(-std::abs(travel_rad) / kHysteresisTravel_rad);
  carry_pads();
  if (effects.pad_relaxation > 0.0) {
    const double x = std::max(0.0, state_.pad_position_rad);
    const double elastic_N = (theta[k1] * x + theta[k2]) * x * x;
    state_.relaxed_N += (elastic_N - state_.relaxed_N) * -std::expm1(-h / kRelaxationTime_s);
  }
  const double force_before_N = state_.force_N;
  state_.force_N = pad_force(state_.velocity_rad_s);
  if (effects.force_lag_s > 0.0)
    state_.filtered_force_N =
        lagged(state_.filtered_force_N, force_before_N, state_.force_N, effects.force_lag_s, h);
}

double SimulatedBrake::pad_force(double velocity_rad_s) const noexcept {
  const Effects& effects = configuration_.effects;
  const ParameterVector& theta = configuration_.brake.theta;
  const double x = state_.pad_position_rad;
  if (x <= 0.0) return 0.0;
  double force_N = ((effects.stiffness_shape_N_rad4 * x + theta[k1]) * x + theta[k2]) * x * x;
  force_N *= 1.0 - 0.5 * effects.stiffness_hysteresis * (1.0 - state_.hysteresis);
  force_N -= effects.pad_relaxation * state_.relaxed_N;
  if (effects.pad_damping_N_s_rad > 0.0) force_N += effects.pad_damping_N_s_rad * velocity_rad_s;
  return std::max(0.0, force_N);  // pads do not pull
}

double SimulatedBrake::friction_level(double speed_rad_s, double force_N) const noexcept {
  const ParameterVector& theta = configuration_.brake.theta;
  const Effects& effects = configuration_.effects;
  const double drift = 1.0 + effects.friction_drift * static_cast<double>(run_);
  const double coulomb_Nm = theta[TC] * drift + effects.coulomb_load_Nm_N * force_N;
  const double static_Nm = theta[Ts0] + theta[mus] * force_N;
  const double ratio = speed_rad_s / theta[ws];
  return std::max(0.0, coulomb_Nm + (static_Nm - coulomb_Nm) / (1.0 + ratio * ratio));
}

double SimulatedBrake::gaussian(double sd) noexcept {
  return sd * normal_(random_);
}

}  // namespace clampd::sim
