#pragma once

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// The equation that an effect is part of.
enum class Location { TorqueBalance, Stiffness, ForceReading, VelocityReading, TorqueReading, Timing };

/// "torque-balance", ... as in every JSON document.
std::string_view to_string(Location location) noexcept;

/// A parameter of an effect.
struct EffectParameter {
  enum class Role {
    Strength,  ///< at `neutral` the base model is recovered
    Shape,     ///< means nothing while the strengths are neutral; estimated from its `starts`
    Choice,    ///< one of `starts`, not estimated
  };
  std::string_view name;
  std::string_view unit;
  std::string_view description;
  Role role = Role::Strength;
  double lower = 0.0;
  double upper = 0.0;
  double neutral = 0.0;
  double scale = 1.0;  ///< the size of a change that matters
  /// Estimated as its logarithm; must be positive.
  bool logarithmic = false;
  std::vector<double> starts = {};
};

/// What there is to be said of an effect, besides its equations.
struct EffectInfo {
  std::string_view name;  ///< as in every file and JSON document
  Location location = Location::TorqueBalance;
  std::string_view cause;       ///< what is so, in a technician's words, without figures: "the brake has ..."
  std::string_view excitation;  ///< what a run must do to show it: "reversals under load"
  std::vector<EffectParameter> parameters = {};
};

class Effect;

/// THE catalogue of effects; a new one is one file in src/brake/effects and one line there.
std::span<const Effect* const> effects();

/// Null if there is none of that name.
const Effect* find_effect(std::string_view name);

const EffectInfo& info_of(const Effect& effect);

/// One effect as part of a model: a value for each of its parameters.
struct EffectValues {
  const Effect* effect = nullptr;
  std::vector<double> values;
};

}  // namespace clampd
