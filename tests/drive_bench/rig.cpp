#include "tests/drive_bench/rig.hpp"

#include <algorithm>
#include <cmath>
#include <deque>

namespace clampd::drive_bench {
namespace {

double at(const std::vector<double>& by_tick, std::size_t tick) {
  return tick < by_tick.size() ? by_tick[tick] : 0.0;
}

/// What is known at a control tick, and sums over the steps until the next.
struct Tick {
  double position = 0.0, velocity = 0.0;  ///< true, at the tick
  double measured_position = 0.0, measured_velocity = 0.0;
  double command = 0.0;  ///< that acts from here
  double mean_torque = 0.0, mean_direction = 0.0;
  double measured_load = 0.0;
  bool stuck = false;
};

class Controller {
 public:
  Controller(const Plant& plant, const Rig& rig, const Motion& motion)
      : plant_(plant), rig_(rig), motion_(motion) {}

  /// The torque that acts from this tick on.
  double command(std::size_t k, double position, double velocity) {
    pending_.push_back(wanted(k, position, velocity));
    if (pending_.size() <= static_cast<std::size_t>(rig_.command_delay)) return 0.0;
    const double result = pending_.front();
    pending_.pop_front();
    return result;
  }

 private:
  double wanted(std::size_t k, double position, double velocity) {
    if (motion_.mode == ControlMode::Torque) return rig_.torque_scale * motion_.feed_forward[k];
    const double w = rig_.bandwidth_rad_s, inertia = plant_.inertia + plant_.load_inertia, gain = inertia * w;
    double reference = motion_.velocity[k];
    if (motion_.mode == ControlMode::Position) {
      const double most = 1.2 * fastest();
      reference = std::clamp(reference + 0.25 * w * (motion_.position[k] - position), -most, most);
    }
    double torque = gain * (reference - velocity) + integral_;
    if (rig_.feed_forward) {
      torque += inertia * motion_.feed_forward[k];
      if (motion_.velocity[k] != 0.0) torque += std::copysign(0.9 * plant_.coulomb, motion_.velocity[k]);
    }
    const double limited = std::clamp(torque, -rig_.torque_limit, rig_.torque_limit);
    if (limited == torque) integral_ += 0.25 * w * gain * (reference - velocity) * rig_.tick_s;
    return limited;
  }

  double fastest() {
    if (fastest_ == 0.0) {
      for (const double v : motion_.velocity) fastest_ = std::max(fastest_, std::abs(v));
      if (fastest_ == 0.0) fastest_ = plant_.speed;
    }
    return fastest_;
  }

  const Plant& plant_;
  const Rig& rig_;
  const Motion& motion_;
  std::deque<double> pending_;
  double integral_ = 0.0, fastest_ = 0.0;
};

std::vector<Tick> simulate(const Plant& plant, const Rig& rig, const Motion& motion, std::size_t run,
                           Random& noise) {
  Controller controller(plant, rig, motion);
  PlantState state;
  state.position = state.load_position = motion.position.front();
  state.velocity = state.load_velocity = motion.velocity.front();
  const double rate = stiffness_rate(plant, 1.5 * plant.speed);
  const int steps = std::clamp(static_cast<int>(std::ceil(rig.tick_s * rate / 0.1)), 8, 400);
  const double step_s = rig.tick_s / steps;
  const double follow = rig.inner_loop ? -std::expm1(-10.0 * step_s / rig.tick_s) : 1.0;
  const double smooth = -std::expm1(-4.0 * rig.bandwidth_rad_s * rig.tick_s);
  double last = 0.0, estimate = state.velocity, torque = 0.0;
  std::vector<Tick> ticks(motion.position.size());
  const std::vector<double> hidden_load = by_tick(plant.hidden_load, run, ticks.size(), rig.tick_s);
  const std::vector<double> measured_load = by_tick(plant.measured_load, run, ticks.size(), rig.tick_s);
  for (std::size_t k = 0; k < ticks.size(); ++k) {
    Tick& tick = ticks[k];
    tick.position = state.position;
    tick.velocity = state.velocity;
    tick.measured_position = rig.encoder_step > 0.0
                                 ? std::floor(state.position / rig.encoder_step) * rig.encoder_step
                                 : state.position;
    tick.measured_velocity = state.velocity + rig.velocity_noise * noise.normal();
    if (k > 0) estimate += smooth * ((tick.measured_position - last) / rig.tick_s - estimate);
    last = tick.measured_position;
    const bool tachometer = rig.velocity_column == VelocityColumn::Tachometer;
    tick.command =
        controller.command(k, tick.measured_position, tachometer ? tick.measured_velocity : estimate);
    tick.measured_load = at(measured_load, k);
    const double load = tick.measured_load + at(hidden_load, k);
    for (int step = 0; step < steps; ++step) {
      torque += follow * (tick.command - torque);
      const DryFriction dry = advance(plant, state, torque, load, tick.measured_load, run, step_s);
      tick.mean_torque += torque / steps;
      tick.mean_direction += dry.direction / steps;
      tick.stuck = tick.stuck || dry.stuck;
    }
  }
  return ticks;
}

/// One row's columns before noise and shifts.
void write_row(const Rig& rig, const std::vector<Tick>& ticks, std::size_t row, Recording& recording) {
  const auto n = static_cast<std::size_t>(rig.ticks_per_row);
  const std::size_t k = row * n, before = k - n;
  const double row_s = rig.row_s();
  recording.time_s.push_back(static_cast<double>(row) * row_s);
  double torque = ticks[k].command, position = ticks[k].measured_position;
  if (rig.torque_column == TorqueColumn::Sampled)
    torque = 0.5 * (ticks[k - 1].mean_torque + ticks[k].mean_torque);
  if (rig.torque_column == TorqueColumn::Averaged) {
    torque = position = 0.0;
    for (std::size_t i = before; i < k; ++i) {
      torque += ticks[i].mean_torque / static_cast<double>(n);
      position +=
          0.5 * (ticks[i].measured_position + ticks[i + 1].measured_position) / static_cast<double>(n);
    }
  }
  recording.torque.push_back(torque);
  if (rig.has_position) recording.position.push_back(position);
  if (!rig.has_velocity) return;
  const double backward = (ticks[k].measured_position - ticks[before].measured_position) / row_s;
  double velocity = backward;
  if (rig.torque_column != TorqueColumn::Averaged &&
      rig.velocity_column != VelocityColumn::BackwardDifference)
    velocity = rig.velocity_column == VelocityColumn::Tachometer
                   ? ticks[k].measured_velocity
                   : 0.5 * (backward + (ticks[k + n].measured_position - ticks[k].measured_position) / row_s);
  recording.velocity.push_back(velocity);
}

Recording::Truth truth_of(const Rig& rig, const std::vector<Tick>& ticks, std::size_t row) {
  const auto n = static_cast<std::size_t>(rig.ticks_per_row);
  const std::size_t k = row * n;
  const double row_s = rig.row_s();
  Recording::Truth truth;
  truth.time_s = static_cast<double>(k) * rig.tick_s + 0.5 * row_s;
  truth.position = 0.5 * (ticks[k].position + ticks[k + n].position);
  truth.velocity = (ticks[k + n].position - ticks[k].position) / row_s;
  truth.acceleration = (ticks[k + n].velocity - ticks[k].velocity) / row_s;
  for (std::size_t i = k; i < k + n; ++i) {
    truth.torque += ticks[i].mean_torque / static_cast<double>(n);
    truth.direction += ticks[i].mean_direction / static_cast<double>(n);
    truth.load += ticks[i].measured_load / static_cast<double>(n);
    truth.stuck = truth.stuck || ticks[i].stuck;
  }
  truth.torque += rig.torque_offset;
  return truth;
}

}  // namespace

Recording record(const Plant& plant, const Rig& rig, const Motion& motion, std::size_t run, Random noise) {
  const std::vector<Tick> ticks = simulate(plant, rig, motion, run, noise);
  Recording recording;
  const std::size_t rows = ticks.size() / static_cast<std::size_t>(rig.ticks_per_row);
  std::vector<Recording::Truth> truth;
  for (std::size_t row = 1; row + 1 < rows; ++row) {
    write_row(rig, ticks, row, recording);
    truth.push_back(truth_of(rig, ticks, row));
    if (plant.measured_load.is_there())
      recording.load.push_back(truth.back().load + 0.3 * rig.torque_noise * noise.normal());
  }
  const auto count = static_cast<int>(recording.torque.size());
  const std::vector<double> on_time = recording.torque;
  for (int row = 0; row < count;
       ++row) {  // the logger's shift, of the column and of what it would be without noise
    const auto from = static_cast<std::size_t>(std::clamp(row - rig.torque_late_rows, 0, count - 1));
    recording.torque[static_cast<std::size_t>(row)] =
        on_time[from] + rig.torque_offset + rig.torque_noise * noise.normal();
    Recording::Truth shifted = truth[static_cast<std::size_t>(row)];
    shifted.torque = truth[from].torque;
    recording.truth.push_back(shifted);
  }
  return recording;
}

}  // namespace clampd::drive_bench
