#include "clampd/simulation/saved_model.hpp"

#include <algorithm>
#include <cmath>
#include <string_view>

#include <fmt/format.h>

namespace clampd {
namespace {

/// A value of the model that the simulated brake takes for granted.
struct Given {
  std::string_view effect;
  std::string_view parameter;
  double value;
  double tolerance;  ///< from which on it is another form
};
constexpr Given kGiven[] = {
    {"friction-asymmetry", "viscous", 0.0, 2e-5},
    {"cogging", "order", sim::kCoggingOrder, 0.05},
    {"stiffness-hysteresis", "travel", sim::kHysteresisTravel_rad, 0.2},
    {"pad-relaxation", "time_constant", sim::kRelaxationTime_s, 0.05},
    {"stiffness-shape", "exponent", 4.0, 0.0},
    {"channel-skew", "channel", 1.0, 0.0},
};

double value_named(const EffectValues& values, std::string_view parameter) {
  const auto& parameters = info_of(*values.effect).parameters;
  for (std::size_t i = 0; i < parameters.size(); ++i)
    if (parameters[i].name == parameter) return values.values[i];
  return 0.0;
}

/// The one value that the simulated brake has of an effect.
double simulated_value(const EffectValues& values) {
  const std::string_view name = info_of(*values.effect).name;
  if (name == "cogging") return std::hypot(value_named(values, "sine"), value_named(values, "cosine"));
  if (name == "stiffness-shape") return value_named(values, "force") / std::pow(15.0, 4.0);
  if (name == "channel-skew") return value_named(values, "fraction") + value_named(values, "whole");
  return values.values.front();
}

Result<void> check_form(const EffectValues& values) {
  const std::string_view name = info_of(*values.effect).name;
  if (name == "force-hum")
    return failure("the amplitude of force-hum differs from run to run and is not in the file: leave it out");
  for (const Given& given : kGiven) {
    if (given.effect != name) continue;
    const double value = value_named(values, given.parameter);
    if (std::abs(value - given.value) <= given.tolerance) continue;
    return failure(
        fmt::format("the simulated brake has {} with {} = {:.4g} only, not {:.4g}: mend the file, or "
                    "leave the effect out",
                    name, given.parameter, given.value, value));
  }
  return {};
}

}  // namespace

Result<sim::Effects> simulated_effects(const ExtendedParameters& model) {
  sim::Effects effects;
  for (const EffectValues& values : model.effects) {
    const Result<void> known = check_form(values).and_then(
        [&] { return sim::set_effect(effects, info_of(*values.effect).name, simulated_value(values)); });
    if (!known) return tl::unexpected(known.error());
  }
  return effects;
}

}  // namespace clampd
