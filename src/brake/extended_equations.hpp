#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "clampd/brake/extended_brake.hpp"
#include "clampd/brake/integrator.hpp"
#include "src/brake/effects/effect_equations.hpp"

namespace clampd {

/// The extended brake in any number type: the scheme of integrator.hpp (Runge-Kutta of order four with the
/// sign of friction frozen, the instant of v = 0 found inside of a step, then stick or reversal), with the
/// effects' share at each stage. Their own states change with the travel or the time of a stretch in one
/// direction and are known there in closed form.
template <class T>
class ExtendedEquations {
 public:
  static constexpr int kMaxOwn = ExtendedBrake::kMaxParameters;
  using Stage = effects_detail::Stage;

  /// Effects (by their place in the model) that are `left_out` are so of all equations.
  explicit ExtendedEquations(const ExtendedParameters& parameters, const std::vector<bool>& left_out = {})
      : fixed_(parameters.base.fixed) {
    for (std::size_t i = 0; i < kParameterCount; ++i)
      theta_[i] = T(parameters.base.theta[static_cast<Eigen::Index>(i)]);
    int own = 0;
    for (const EffectValues& values : parameters.effects) {
      parts_.push_back({values.effect, own, states_});
      for (const double value : values.values) own_[own++] = T(value);
      states_ += values.effect->info().states;
      is_stiff_ = is_stiff_ || values.effect->is_stiff();
    }
    for (const std::size_t part : effects_detail::chain_of(parameters.effects)) {
      if (!left_out.empty() && left_out[part]) continue;
      for (std::size_t stage = 0; stage < effects_detail::kStages; ++stage)
        if (parts_[part].effect->acts_on(static_cast<Stage>(stage))) chains_[stage].push_back(parts_[part]);
    }
  }

  T& number(const ExtendedBrake::Place& place) {
    if (place.effect < 0) return theta_[place.parameter];
    return own_[parts_[static_cast<std::size_t>(place.effect)].own + place.parameter];
  }

  void settle(const T& position, const T& velocity, const RowInput& first, T* states) const {
    states[0] = position;
    states[1] = velocity;
    std::fill(states + 2, states + states_, T(0.0));
    effects_detail::Instant<T> now = start_of(first, effects_detail::value_of(velocity) < 0.0 ? -1.0 : 1.0);
    evaluate_balance(now, position, velocity, T(0.0), T(0.0), T(first.torque_Nm), states);
    each(parts_, states,
         [&](const auto& effect, const auto& own, int at) { effect.on_settle(now, own, states + at); });
  }

  effects_detail::Readout<T> read(const T* states, const RowInput& row) const {
    effects_detail::Readout<T> readout{row.time_s, row.run, force_at(states, row), states[1]};
    each(chain(Stage::Read), states,
         [&](const auto& effect, const auto& own, int) { effect.on_read(readout, own); });
    return readout;
  }

  /// What acts in the long run while the torque reads the same all the time.
  T acting_torque(double reading_Nm) const {
    const T reading(reading_Nm);
    T states[ExtendedBrake::kMaxStates], next[ExtendedBrake::kMaxStates];
    std::fill(states, states + ExtendedBrake::kMaxStates, T(0.0));
    constexpr double kForEver_s = std::numeric_limits<double>::infinity();
    effects_detail::TorqueInput<T> input{reading, reading, reading, reading, kForEver_s};
    undo_reading(input, states, next);
    return input.torque_Nm;
  }

  /// `values` is the same model in plain numbers: it finds the crossings.
  void advance(T* states, const T& torque, const RowInput& row,
               const ExtendedEquations<double>& values) const {
    // An error of the torque that acts, whichever of the readings it is made of.
    const T error = torque - row.torque_Nm;
    effects_detail::TorqueInput<T> input{torque, row.previous_torque_Nm + error, row.next_torque_Nm + error,
                                         row.later_torque_Nm + error, row.gap_s};
    const int substeps = is_stiff_ ? values.substeps(plain(states).data(), row.torque_Nm, row) : 1;
    T next[ExtendedBrake::kMaxStates];
    std::copy(states, states + states_, next);
    undo_reading(input, states, next);
    if (chain(Stage::Filter).empty()) {
      std::copy(next + 2, next + states_, states + 2);
      move(states, input, row, substeps, values);
      return;
    }
    const T force_before = force_at(states, row);
    T midway[ExtendedBrake::kMaxStates];
    std::copy(next, next + states_, midway);
    std::copy(next, next + states_, states);
    const T until_reversal = move(states, input, row, substeps, values);
    const T force_after = force_at(states, row);
    const T velocity_before = midway[1];
    for (int i = 0; i < states_; ++i) midway[i] = 0.5 * (midway[i] + states[i]);
    midway[0] += row.gap_s / 8.0 * (velocity_before - states[1]);
    const T bend = 4.0 * (force_before - 2.0 * force_at(midway, row) + force_after);
    effects_detail::Transit<T> transit{row.gap_s,       force_before, force_after, bend,
                                       velocity_before, states[1],    T(0.0),      T(0.0)};
    constexpr double kAtOnce = 1e-6;  // of a row: no straight of its own
    if (until_reversal > kAtOnce * row.gap_s && until_reversal < (1.0 - kAtOnce) * row.gap_s) {
      transit.until_reversal_s = until_reversal;
      transit.since_reversal_s = row.gap_s - until_reversal;
    }
    std::copy(states, states + states_, next);
    each(chain(Stage::Filter), states,
         [&](const auto& effect, const auto& own, int at) { effect.on_filter(transit, own, next + at); });
    std::copy(next, next + states_, states);
  }

  struct Reached {
    T position, velocity;
  };
  /// A length without derivatives is a plain number.
  template <class Length>
  Reached runge_kutta(const T* states, const T& torque, const RowInput& row, double direction,
                      const Length& length) const {
    effects_detail::Instant<T> now = start_of(row, direction);
    now.step_s = effects_detail::value_of(length);
    const T& p0 = states[0];
    const T& v0 = states[1];
    const Length half = 0.5 * length;
    const Length sixth = length / 6.0;
    const auto acceleration = [&](const T& position, const T& velocity, const T& elapsed) {
      evaluate_balance(now, position, velocity, position - p0, elapsed, torque, states);
      return acceleration_of(now);
    };
    const T a0 = acceleration(p0, v0, T(0.0));
    const T v1 = v0 + half * a0;
    const T a1 = acceleration(p0 + half * v0, v1, T(half));
    const T v2 = v0 + half * a1;
    const T a2 = acceleration(p0 + half * v1, v2, T(half));
    const T v3 = v0 + length * a2;
    const T a3 = acceleration(p0 + length * v2, v3, T(length));
    return {p0 + sixth * (v0 + 2.0 * (v1 + v2) + v3), v0 + sixth * (a0 + 2.0 * (a1 + a2) + a3)};
  }

  T acceleration_at(const T* states, const Reached& at, const T& elapsed, const T& torque,
                    const RowInput& row, double direction) const {
    effects_detail::Instant<T> now = start_of(row, direction);
    evaluate_balance(now, at.position, at.velocity, at.position - states[0], elapsed, torque, states);
    return acceleration_of(now);
  }

  /// As integrator::crossing_time().
  double crossing_time(const T* states, const T& torque, const RowInput& row, double direction, double length,
                       double end_velocity) const {
    double low = 0.0;
    double high = length;
    double time = states[1] == 0.0 ? 0.5 * length : length * states[1] / (states[1] - end_velocity);
    for (int iteration = 0; iteration < 40; ++iteration) {
      const Reached reached = runge_kutta(states, torque, row, direction, time);
      (direction * reached.velocity >= 0.0 ? low : high) = time;
      const double slope = acceleration_at(states, reached, time, torque, row, direction);
      double next = time - reached.velocity / slope;
      if (!(next > low && next < high)) {
        if (next == low || next == high) return next;
        next = 0.5 * (low + high);
      }
      if (std::abs(next - time) <= 1e-12 * length) return next;
      time = next;
    }
    return time;
  }

  /// Of 1 ms from `states` on.
  int substeps(const double* states, double torque_Nm,
               const RowInput& row) const requires std::is_same_v<T, double> {
    effects_detail::Instant<double> now = start_of(row, states[1] < 0.0 ? -1.0 : 1.0);
    evaluate_balance(now, states[0], states[1], 0.0, 0.0, torque_Nm, states);
    int most = 1;
    for (const Part& part : parts_)
      most = std::max(
          most, part.effect->substeps({own_ + part.own, states + part.state}, now, acceleration_of(now)));
    return most;
  }

 private:
  /// A reading of torque is undone from its end.
  void undo_reading(effects_detail::TorqueInput<T>& input, const T* states, T* next) const {
    const std::vector<Part>& undone = chain(Stage::Torque);
    for (auto part = undone.rbegin(); part != undone.rend(); ++part)
      static_cast<const effects_detail::Equations<T>&>(*part->effect)
          .on_torque(input, {own_ + part->own, states + part->state}, next + part->state);
  }

  /// An effect, and where its parameters and its states begin.
  struct Part {
    const Effect* effect;
    int own;
    int state;
  };

  std::array<double, ExtendedBrake::kMaxStates> plain(const T* states) const {
    std::array<double, ExtendedBrake::kMaxStates> values{};
    for (int i = 0; i < states_; ++i)
      values[static_cast<std::size_t>(i)] = effects_detail::value_of(states[i]);
    return values;
  }

  const std::vector<Part>& chain(Stage stage) const { return chains_[static_cast<std::size_t>(stage)]; }

  template <class Act>
  void each(const std::vector<Part>& chain, const T* states, const Act& act) const {
    for (const Part& part : chain)
      act(static_cast<const effects_detail::Equations<T>&>(*part.effect),
          effects_detail::Own<T>{own_ + part.own, states + part.state}, part.state);
  }

  effects_detail::Instant<T> start_of(const RowInput& row, double direction) const {
    effects_detail::Instant<T> now;
    now.time_s = row.time_s;
    now.run = row.run;
    now.direction = direction;
    return now;
  }

  /// Of an instant from where the brake is: all up to the clamp force.
  void evaluate_force(effects_detail::Instant<T>& now, const T& position, const T& velocity, const T& travel,
                      const T& elapsed, const T* states) const {
    now.elapsed_s = elapsed;
    now.travel = travel;
    now.position = position;
    now.velocity = velocity;
    now.pad_position = position;
    each(chain(Stage::Pad), states,
         [&](const auto& effect, const auto& own, int) { effect.on_pad(now, own); });
    if (now.pad_position > 0.0)
      now.elastic_N = now.pad_position * now.pad_position * (theta_[k1] * now.pad_position + theta_[k2]);
    else
      now.elastic_N = T(0.0);
    now.force_N = now.elastic_N;
    each(chain(Stage::Force), states,
         [&](const auto& effect, const auto& own, int) { effect.on_force(now, own); });
  }

  /// Then the friction level.
  void evaluate_friction(effects_detail::Instant<T>& now, const T& position, const T& velocity,
                         const T& travel, const T& elapsed, const T* states) const {
    evaluate_force(now, position, velocity, travel, elapsed, states);
    now.coulomb_Nm = theta_[TC];
    now.static_Nm = theta_[Ts0] + theta_[mus] * now.force_N;
    now.viscous_Nm_s_rad = theta_[Tv];
    now.friction_ratio = T(now.direction);
    now.opposing_Nm = T(0.0);
    each(chain(Stage::Friction), states,
         [&](const auto& effect, const auto& own, int) { effect.on_friction(now, own); });
    const T speed = velocity / theta_[ws];
    now.level_Nm = now.coulomb_Nm + (now.static_Nm - now.coulomb_Nm) / (1.0 + speed * speed);
  }

  /// Everything.
  void evaluate_balance(effects_detail::Instant<T>& now, const T& position, const T& velocity,
                        const T& travel, const T& elapsed, const T& torque, const T* states) const {
    evaluate_friction(now, position, velocity, travel, elapsed, states);
    now.torque_Nm = torque;
    now.ratio_m_rad = T(fixed_.ratio_m_rad);
    now.inertia_kg_m2 = T(fixed_.inertia_kg_m2);
    each(chain(Stage::Balance), states,
         [&](const auto& effect, const auto& own, int) { effect.on_balance(now, own); });
  }

  T net_torque(const effects_detail::Instant<T>& now) const {
    return now.torque_Nm - now.ratio_m_rad * now.force_N - now.viscous_Nm_s_rad * now.velocity -
           now.friction_ratio * now.level_Nm - now.opposing_Nm;
  }
  T acceleration_of(const effects_detail::Instant<T>& now) const {
    return net_torque(now) / now.inertia_kg_m2;
  }

  T force_at(const T* states, const RowInput& row) const {
    effects_detail::Instant<T> now = start_of(row, effects_detail::value_of(states[1]) < 0.0 ? -1.0 : 1.0);
    evaluate_force(now, states[0], states[1], T(0.0), T(0.0), states);
    return now.force_N;
  }

  /// At rest: the direction in which the brake breaks away, or 0 if friction holds it.
  double breakaway(const T* states, const T& torque, const RowInput& row) const {
    for (const double direction : {1.0, -1.0}) {
      effects_detail::Instant<T> now = start_of(row, direction);
      evaluate_balance(now, states[0], T(0.0), T(0.0), T(0.0), torque, states);
      if (direction * effects_detail::value_of(net_torque(now)) > 0.0) return direction;
    }
    return 0.0;
  }

  void finish(T* states, const Reached& reached, const T& elapsed, const RowInput& row,
              double direction) const {
    if (!has_own_states()) {
      states[0] = reached.position;
      states[1] = reached.velocity;
      return;
    }
    effects_detail::Instant<T> end = start_of(row, direction);
    evaluate_friction(end, reached.position, reached.velocity, reached.position - states[0], elapsed, states);
    T next[ExtendedBrake::kMaxStates];
    std::copy(states, states + states_, next);
    each(chain(Stage::Remember), states,
         [&](const auto& effect, const auto& own, int at) { effect.on_remember(end, own, next + at); });
    std::copy(next + 2, next + states_, states + 2);
    states[0] = reached.position;
    states[1] = reached.velocity;
  }

  /// From row to row. Returns when in between the brake last came to rest or reversed; 0: it did not.
  T move(T* states, const effects_detail::TorqueInput<T>& input, const RowInput& row, int substeps,
         const ExtendedEquations<double>& values) const {
    T reversal(0.0);
    const auto stretch = [&](const T& torque, double begin_s, double length_s) {
      const int steps = std::max(1, static_cast<int>(std::ceil(substeps * length_s / kMaxStep_s - 1e-6)));
      for (int i = 0; i < steps; ++i) {
        const T within = step(states, torque, row, length_s / steps, values);
        if (within > 0.0) reversal = begin_s + i * (length_s / steps) + within;
      }
    };
    if (input.early_s > 0.0) stretch(input.early_torque_Nm, 0.0, input.early_s);
    stretch(input.torque_Nm, input.early_s, row.gap_s - input.early_s);
    return reversal;
  }

  /// Returns when in it the brake last came to rest or reversed; 0: it did not.
  T step(T* states, const T& torque, const RowInput& row, double length,
         const ExtendedEquations<double>& values) const {
    T left = T(length);
    T reversal = T(0.0);
    for (int crossing = 0; crossing < kMaxCrossings; ++crossing) {
      const double velocity = effects_detail::value_of(states[1]);
      const double direction =
          velocity != 0.0 ? std::copysign(1.0, velocity) : breakaway(states, torque, row);
      if (direction == 0.0) {
        // An infinitesimal velocity dies within an infinitesimal time.
        finish(states, {states[0], T(0.0)}, left, row, 1.0);
        return reversal;
      }
      const Reached reached = crossing == 0 ? runge_kutta(states, torque, row, direction, length)
                                            : runge_kutta(states, torque, row, direction, left);
      const double end_velocity = effects_detail::value_of(reached.velocity);
      if (!(direction * end_velocity < 0.0)) {
        finish(states, reached, left, row, direction);
        return reversal;
      }
      T time(values.crossing_time(plain(states).data(), effects_detail::value_of(torque), row, direction,
                                  effects_detail::value_of(left), end_velocity));
      if constexpr (!std::is_same_v<T, double>) {
        // The implicit function theorem on the located instant: one step of Newton's in these numbers.
        const Reached there = runge_kutta(states, torque, row, direction, time);
        const double slope =
            effects_detail::value_of(acceleration_at(states, there, time, torque, row, direction));
        if (slope != 0.0) time -= (there.velocity - effects_detail::value_of(there.velocity)) / slope;
      }
      Reached stop = runge_kutta(states, torque, row, direction, time);
      stop.velocity = T(0.0);
      finish(states, stop, time, row, direction);
      left -= time;
      reversal = length - left;
      if (!(left > 0.0)) break;
    }
    return reversal;
  }

  bool has_own_states() const { return states_ > 2; }  ///< to be remembered from row to row

  std::vector<Part> parts_;                                        ///< as the model lists them
  std::array<std::vector<Part>, effects_detail::kStages> chains_;  ///< as they act one on another
  FixedParameters fixed_;
  T theta_[kParameterCount];
  T own_[kMaxOwn];
  int states_ = 2;
  bool is_stiff_ = false;
};

}  // namespace clampd
