#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "clampd/brake/effect.hpp"
#include "clampd/brake/readings.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// The base model's parameters and the effects beside it.
struct ExtendedParameters {
  BrakeParameters base;
  std::vector<EffectValues> effects;
};

/// Of all its effects together.
EffectDelays delays_of(const ExtendedParameters& model);

/// As a TOML file: [parameters] and [fixed] as in read_brake_parameters(), and one table
/// [[effect]] (name, then its parameters) each. What format_extended_parameters() wrote,
/// read_extended_parameters() reads; a file without effects is a plain parameter file.
Result<ExtendedParameters> read_extended_parameters(const std::string& path);
Result<ExtendedParameters> parse_extended_parameters(std::string_view text, const std::string& path);
std::string format_extended_parameters(const ExtendedParameters& parameters);

/// What drives the brake from one row of a run to the next.
struct RowInput {
  double previous_torque_Nm = 0.0;  ///< reading of the row before
  double torque_Nm = 0.0;           ///< reading, held until the next row
  double next_torque_Nm = 0.0;      ///< of the next row
  double later_torque_Nm = 0.0;     ///< of the row after that
  double time_s = 0.0;              ///< of the row, in its run
  double gap_s = 0.0;               ///< to the next row
  double run = 0.0;                 ///< number of the run, from 0, in chronological order
};

/// The brake of dynamics.hpp in its set-valued limit with any effects beside it. Its state is position (rad
/// from contact), velocity (rad/s), then the effects' own states in their order. All functions but the
/// constructor neither allocate nor fail; a diverging state grows until is_bounded() is false.
class ExtendedBrake {
 public:
  static constexpr int kMaxStates = 8;
  static constexpr int kMaxParameters = 48;
  using State = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxStates, 1>;

  /// Asserts that states and parameters do not exceed the above.
  explicit ExtendedBrake(const ExtendedParameters& parameters);

  int states() const noexcept { return states_; }
  /// The seven of the base model, then the effects' that are not choices.
  int parameters() const noexcept { return static_cast<int>(places_.size()); }
  /// Of the states after position and velocity: those that start anywhere in each run.
  std::span<const int> free_states() const noexcept { return free_states_; }

  /// At rest for long enough at the first row's torque, or moving steadily.
  State settled(double position_rad, double velocity_rad_s, const RowInput& first) const noexcept;
  /// The same with d state / d (position, velocity, parameters), states() x (2 + parameters()), row-major.
  State settled(double position_rad, double velocity_rad_s, const RowInput& first,
                double* jacobian) const noexcept;

  Reading read(const State& state, const RowInput& row) const noexcept;
  /// The same with d (force, velocity reading) / d (state, parameters), 2 x (states() + parameters()),
  /// row-major.
  Reading read(const State& state, const RowInput& row, double* jacobian) const noexcept;

  State advance(const State& state, const RowInput& row) const noexcept;
  /// The same with d state / d (state, parameters, torque), states() x (states() + parameters() + 1),
  /// row-major; the torque's reading moves together with those of the rows beside it.
  State advance(const State& state, const RowInput& row, double* jacobian) const noexcept;

  /// The torque (N m) that acts in the long run while its reading stays at `reading_Nm`.
  double acting_torque(double reading_Nm) const noexcept;
  /// The same with its derivatives by the parameters.
  double acting_torque(double reading_Nm, double* gradient) const noexcept;

  static bool is_bounded(const State& state) noexcept;

  /// Where parameter i of the vector lives: the effect's index (-1: base) and the parameter's index in it.
  struct Place {
    int effect;
    int parameter;
  };
  std::span<const Place> places() const noexcept { return places_; }

  ~ExtendedBrake();
  ExtendedBrake(const ExtendedBrake&) = delete;
  ExtendedBrake& operator=(const ExtendedBrake&) = delete;

 private:
  struct Numbers;
  std::vector<Place> places_;
  std::vector<int> free_states_;
  int states_ = 2;
  std::unique_ptr<const Numbers> numbers_;
};

/// Whether a model has states and parameters left for these effects beside its own.
bool room_for(const ExtendedParameters& model, std::span<const EffectValues> further);

/// The value in a model that a place means.
double& value_at(ExtendedParameters& model, const ExtendedBrake::Place& place);
double value_at(const ExtendedParameters& model, const ExtendedBrake::Place& place);

/// What a place of an effect (not of the base model) is.
const EffectParameter& parameter_at(const ExtendedParameters& model, const ExtendedBrake::Place& place);

}  // namespace clampd
