#include "clampd/brake/extended_brake.hpp"

#include "clampd/base/assert.hpp"
#include "src/brake/extended_equations.hpp"

namespace clampd {

namespace {

constexpr int kWidth = 8;  // derivatives of a Jet

}  // namespace

/// The same equations in plain numbers, and in numbers with derivatives by eight directions each: directions
/// are states, parameters, torque.
struct ExtendedBrake::Numbers {
  Numbers(const ExtendedParameters& parameters, int states, std::span<const Place> places)
      : plain(parameters) {
    const int directions = states + static_cast<int>(places.size()) + 1;
    for (int first = 0; first < directions; first += kWidth) {
      ExtendedEquations<Jet>& chunk =
          chunks.emplace_back(parameters, left_out(parameters, states, places, first));
      for (std::size_t i = 0; i < places.size(); ++i)
        seed(chunk.number(places[i]), states + static_cast<int>(i), first);
    }
  }

  static bool is_in_chunk(int direction, int first) {
    return direction >= first && direction < first + kWidth;
  }

  static void seed(Jet& number, int direction, int first) {
    if (is_in_chunk(direction, first)) number.v[direction - first] = 1.0;
  }

  /// Effects on which nothing in a chunk of directions depends: neutral ones without states whose parameters
  /// are not among them.
  static std::vector<bool> left_out(const ExtendedParameters& parameters, int states,
                                    std::span<const Place> places, int first) {
    std::vector<bool> effects;
    for (const EffectValues& values : parameters.effects)
      effects.push_back(info_of(*values.effect).states == 0 && is_neutral(values));
    for (std::size_t i = 0; i < places.size(); ++i)
      if (places[i].effect >= 0 && is_in_chunk(states + static_cast<int>(i), first))
        effects[static_cast<std::size_t>(places[i].effect)] = false;
    return effects;
  }

  const ExtendedEquations<double> plain;
  std::vector<ExtendedEquations<Jet>> chunks;
};

ExtendedBrake::ExtendedBrake(const ExtendedParameters& parameters) {
  for (int i = 0; i < static_cast<int>(kParameterCount); ++i) places_.push_back({-1, i});
  std::size_t own = 0;
  for (std::size_t e = 0; e < parameters.effects.size(); ++e) {
    const EffectValues& values = parameters.effects[e];
    CLAMPD_ASSERT(values.effect != nullptr);
    const EffectInfo& info = values.effect->info();
    CLAMPD_ASSERT(values.values.size() == info.parameters.size());
    for (std::size_t i = 0; i < info.parameters.size(); ++i)
      if (is_estimated(info.parameters[i])) places_.push_back({static_cast<int>(e), static_cast<int>(i)});
    for (int i = 0; i < info.free_states; ++i) free_states_.push_back(states_ + i);
    states_ += info.states;
    own += info.parameters.size();
  }
  CLAMPD_ASSERT(states_ <= kMaxStates && static_cast<int>(places_.size()) <= kMaxParameters);
  CLAMPD_ASSERT(own <= ExtendedEquations<double>::kMaxOwn);
  numbers_ = std::make_unique<const Numbers>(parameters, states_, places_);
}

ExtendedBrake::~ExtendedBrake() = default;

ExtendedBrake::State ExtendedBrake::settled(double position_rad, double velocity_rad_s,
                                            const RowInput& first) const noexcept {
  double states[kMaxStates] = {};
  numbers_->plain.settle(position_rad, velocity_rad_s, first, states);
  return Eigen::Map<const Eigen::VectorXd>(states, states_);
}

ExtendedBrake::State ExtendedBrake::settled(double position_rad, double velocity_rad_s, const RowInput& first,
                                            double* jacobian) const noexcept {
  const int columns = 2 + parameters();
  State result(states_);
  for (int c = 0; c < static_cast<int>(numbers_->chunks.size()); ++c) {
    Jet states[kMaxStates];
    Jet position(position_rad), velocity(velocity_rad_s);
    Numbers::seed(position, 0, c * kWidth);
    Numbers::seed(velocity, 1, c * kWidth);
    numbers_->chunks[static_cast<std::size_t>(c)].settle(position, velocity, first, states);
    for (int i = 0; i < states_; ++i) {
      result[i] = states[i].a;
      for (int j = 0; j < kWidth; ++j) {
        // Directions 0 and 1 are position and velocity, the parameters follow after all states.
        const int direction = c * kWidth + j;
        const int column = direction < 2 ? direction : direction - states_ + 2;
        if ((direction < 2 || direction >= states_) && column < columns)
          jacobian[i * columns + column] = states[i].v[j];
      }
    }
  }
  return result;
}

Reading ExtendedBrake::read(const State& state, const RowInput& row) const noexcept {
  double states[kMaxStates] = {};
  std::copy_n(state.data(), states_, states);
  const auto readout = numbers_->plain.read(states, row);
  return {readout.force_N, readout.velocity_rad_s};
}

Reading ExtendedBrake::read(const State& state, const RowInput& row, double* jacobian) const noexcept {
  const int columns = states_ + parameters();
  Reading reading{};
  for (int c = 0; c * kWidth < columns; ++c) {
    Jet states[kMaxStates];
    for (int i = 0; i < states_; ++i) {
      states[i] = Jet(state[i]);
      Numbers::seed(states[i], i, c * kWidth);
    }
    const auto readout = numbers_->chunks[static_cast<std::size_t>(c)].read(states, row);
    reading = {readout.force_N.a, readout.velocity_rad_s.a};
    const int count = std::min(kWidth, columns - c * kWidth);
    std::copy_n(readout.force_N.v.data(), count, jacobian + c * kWidth);
    std::copy_n(readout.velocity_rad_s.v.data(), count, jacobian + columns + c * kWidth);
  }
  return reading;
}

ExtendedBrake::State ExtendedBrake::advance(const State& state, const RowInput& row) const noexcept {
  double states[kMaxStates] = {};
  std::copy_n(state.data(), states_, states);
  numbers_->plain.advance(states, row.torque_Nm, row, numbers_->plain);
  return Eigen::Map<const Eigen::VectorXd>(states, states_);
}

ExtendedBrake::State ExtendedBrake::advance(const State& state, const RowInput& row,
                                            double* jacobian) const noexcept {
  const int columns = states_ + parameters() + 1;
  State result(states_);
  for (int c = 0; c * kWidth < columns; ++c) {
    Jet states[kMaxStates];
    for (int i = 0; i < states_; ++i) {
      states[i] = Jet(state[i]);
      Numbers::seed(states[i], i, c * kWidth);
    }
    Jet torque(row.torque_Nm);
    Numbers::seed(torque, columns - 1, c * kWidth);
    numbers_->chunks[static_cast<std::size_t>(c)].advance(states, torque, row, numbers_->plain);
    const int count = std::min(kWidth, columns - c * kWidth);
    for (int i = 0; i < states_; ++i) {
      result[i] = states[i].a;
      std::copy_n(states[i].v.data(), count, jacobian + i * columns + c * kWidth);
    }
  }
  return result;
}

double ExtendedBrake::acting_torque(double reading_Nm) const noexcept {
  return numbers_->plain.acting_torque(reading_Nm);
}

double ExtendedBrake::acting_torque(double reading_Nm, double* gradient) const noexcept {
  double torque_Nm = reading_Nm;
  for (int c = 0; c < static_cast<int>(numbers_->chunks.size()); ++c) {
    const Jet acting = numbers_->chunks[static_cast<std::size_t>(c)].acting_torque(reading_Nm);
    torque_Nm = acting.a;
    for (int j = 0; j < kWidth; ++j) {
      const int parameter = c * kWidth + j - states_;
      if (parameter >= 0 && parameter < parameters()) gradient[parameter] = acting.v[j];
    }
  }
  return torque_Nm;
}

bool ExtendedBrake::is_bounded(const State& state) noexcept {
  return state.allFinite() && clampd::is_bounded(BrakeState(state[0], state[1]));
}

}  // namespace clampd
