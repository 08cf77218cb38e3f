#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/record/run.hpp"

namespace clampd {

/// The equation that an effect is part of.
enum class Location { TorqueBalance, Stiffness, ForceReading, VelocityReading, TorqueReading, Timing };

/// "torque-balance", ... as in every JSON document.
std::string_view to_string(Location location) noexcept;

/// A parameter of an effect.
struct EffectParameter {
  enum class Role {
    Strength,    ///< at `neutral` the base model is recovered; looked at from its `starts`, if any, too
    Shape,       ///< estimated, from each of its `starts`: nothing tells it while the strengths are neutral
    Choice,      ///< one of `starts`, not estimated
    Refinement,  ///< the same; others than the first are tried once the rest fits
  };
  std::string_view name;
  std::string_view unit;
  std::string_view description;
  Role role = Role::Strength;
  double lower = 0.0;
  double upper = 0.0;
  double neutral = 0.0;
  double scale = 1.0;        ///< the size of a change that matters
  bool logarithmic = false;  ///< estimated as its logarithm; must be positive
  std::vector<double> starts = {};
  /// What its values 1, 2, ... are called; empty where it is a quantity.
  std::vector<std::string_view> choices = {};
};

/// What this value of a parameter is called; empty where it is a quantity.
std::string_view choice_of(const EffectParameter& parameter, double value) noexcept;

/// Its description, with what its values are called: "of the reading", "that is late: 1 force, 2 velocity".
std::string in_words(const EffectParameter& parameter);

inline bool is_estimated(const EffectParameter& parameter) {
  return parameter.role == EffectParameter::Role::Strength || parameter.role == EffectParameter::Role::Shape;
}

/// How a scan over orders looks for a wave over the motor's position: a grid that is finer than what one run over the whole travel
/// resolves, and a finer one around each of its peaks.
struct OrderScan {
  double first, last, step;
  double neighbourhood;  ///< to either side of a peak
  double fine_step;
};

/// What there is to be said of an effect, besides its equations.
struct EffectInfo {
  std::string_view name;  ///< as in every file and JSON document
  Location location = Location::TorqueBalance;
  std::string_view cause;       ///< a sentence that a technician understands
  std::string_view excitation;  ///< what a run must do to show it: "reversals under load"
  std::vector<EffectParameter> parameters = {};
  /// States of its own, beside position and velocity of the brake.
  int states = 0;
  /// The first so many of them start at an unknown value in each run, near zero; the others settled.
  int free_states = 0;
  double free_state_deviation = 1e5;  ///< of their prior around that value
  /// Whether evidence pays for each as for a parameter; if not, they are drawn from their prior in each run.
  bool free_states_count = true;
  bool differs_by_run = false;  ///< it makes another brake of each run
  /// May be named more than once, as a harmonic: its last parameter a multiple or part of the first one's.
  bool repeatable = false;
  /// Its one parameter is the zero of the reading that `location` names: of force and velocity as a tare sets it, of torque as the
  /// reading shows it while the drive is off.
  bool is_zero = false;
  /// It says which readings are spikes: whoever fits it leaves these out, since it has no equations. Its parameters are the share of
  /// readings, the standard deviation of the spikes, and the channel: 1 force, 2 velocity.
  bool removes_readings = false;
  /// Where it is a torque that is a wave over the motor's position, and is looked for by a scan. Its parameters are then the
  /// amplitudes of the sine and of the cosine, and the order.
  std::optional<OrderScan> order_scan = {};
  /// A wrong scale of the force reading does the same in any run: then stiffness and friction are read by
  /// that scale too.
  bool is_like_a_scale_of_force = false;
};

/// One physical effect beside the base model, pluggable: src/brake/effects/effect_equations.hpp.
class Effect;

/// THE catalogue of effects, in the order in which they act one on another, from the torque that acts to the
/// readings; a new one is one file in src/brake/effects
/// and one line in catalogue.inc there.
std::span<const Effect* const> effects();

/// Whether an effect changes the brake itself; the others are in how the station reads it.
inline bool changes_brake(const EffectInfo& effect) {
  return effect.location == Location::TorqueBalance || effect.location == Location::Stiffness;
}

/// Null if there is none of that name.
const Effect* find_effect(std::string_view name);

const EffectInfo& info_of(const Effect& effect);

/// The values of an effect's `starts` that depend on the runs, for one of its parameters (index); the table's
/// where they do not.
std::vector<double> starts_of(const Effect& effect, std::size_t parameter, std::span<const Run> runs);

/// Values of an effect that mean about the same once one of its parameters (index) is chosen otherwise.
std::vector<double> chosen_otherwise(const Effect& effect, std::vector<double> values, std::size_t parameter,
                                     double choice);

/// One effect as part of a model: a value for each of its parameters, SI.
struct EffectValues {
  const Effect* effect = nullptr;
  std::vector<double> values;
};

/// What an effect with these values does, as a part of a sentence that a technician understands. `sds`: the standard deviations of its
/// values, NaN or 0 where there is none. `amplitude`: of its free states over all runs, NaN where it has none.
std::string in_words(const EffectValues& values, std::span<const double> sds, double amplitude);

/// A value with a size that people can read: seconds as milliseconds, shares as per cent, small angles as milliradians.
std::string size_in_words(double value, std::string_view unit);

/// Whether an effect with these values is there in name only: its strengths, and it has some, are neutral.
bool is_neutral(const EffectValues& values);

/// How many whole samples late the readings are that an effect describes: the data are then moved instead of
/// the model.
struct EffectDelays {
  int force = 0, velocity = 0, torque = 0;

  bool none() const noexcept { return force == 0 && velocity == 0 && torque == 0; }
};
EffectDelays delays_of(const EffectValues& values);

}  // namespace clampd
