#include "drivers/sim/effects.hpp"

#include <charconv>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace clampd::sim {

namespace {

/// A parameter of a model's effect that the simulated brake takes for granted.
struct GivenParameter {
  std::string_view effect;
  std::string_view name;
  double value;
  double tolerance;  ///< from which on it is another form
};
constexpr GivenParameter kGiven[] = {
    {"friction-asymmetry", "viscous", 0.0, 2e-5},
    {"cogging", "order", kCoggingOrder, 0.05},
    {"stiffness-hysteresis", "travel", kHysteresisTravel_rad, 0.2},
    {"pad-relaxation", "time_constant", kRelaxationTime_s, 0.05},
    {"stiffness-shape", "exponent", 4.0, 0.0},
    {"channel-skew", "channel", 1.0, 0.0},
};

double value_named(std::span<const EffectParameterValue> parameters, std::string_view name) {
  for (const EffectParameterValue& parameter : parameters)
    if (parameter.name == name) return parameter.value;
  return 0.0;
}

/// The one value that the simulated brake has of an effect.
double value_of(std::string_view effect, std::span<const EffectParameterValue> parameters) {
  if (effect == "cogging") return std::hypot(value_named(parameters, "sine"), value_named(parameters, "cosine"));
  if (effect == "stiffness-shape") return value_named(parameters, "force") / std::pow(15.0, 4.0);
  if (effect == "channel-skew") return value_named(parameters, "fraction") + value_named(parameters, "whole");
  return parameters.front().value;
}

Result<void> check_form(std::string_view effect, std::span<const EffectParameterValue> parameters) {
  if (effect == "force-hum")
    return failure("the amplitude of force-hum differs from run to run and is not in the file: leave it out");
  for (const GivenParameter& given : kGiven) {
    if (given.effect != effect) continue;
    const double value = value_named(parameters, given.name);
    if (std::abs(value - given.value) <= given.tolerance) continue;
    return failure(fmt::format("the simulated brake has {} with {} = {:.4g} only, not {:.4g}: mend the file, or leave the effect out", effect,
                               given.name, given.value, value));
  }
  return {};
}

}  // namespace

Result<void> set_effect(Effects& effects, std::string_view name, std::span<const EffectParameterValue> parameters) {
  return check_form(name, parameters).and_then([&] { return set_effect(effects, name, value_of(name, parameters)); });
}

Result<void> set_effect(Effects& effects, std::string_view name, double value) {
  for (const EffectInfo& info : kEffectTable) {
    if (info.name != name) continue;
    if (!std::isfinite(value) || value < info.lower || value > info.upper)
      return failure(fmt::format("effect {}: {} {} is not within [{}, {}] ({})", name, value, info.unit,
                                 info.lower, info.upper, info.meaning));
    effects.*info.member = value;
    return {};
  }
  std::vector<std::string_view> names;
  for (const EffectInfo& info : kEffectTable) names.push_back(info.name);
  return failure(fmt::format("unknown effect '{}'; known are: {}", name, fmt::join(names, ", ")));
}

Result<void> set_effect(Effects& effects, std::string_view assignment) {
  const std::size_t equals = assignment.find('=');
  if (equals == std::string_view::npos)
    return failure(fmt::format("effect '{}': write NAME=VALUE, e.g. cogging=0.02", assignment));
  const std::string_view text = assignment.substr(equals + 1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size())
    return failure(fmt::format("effect '{}': '{}' is not a number", assignment, text));
  return set_effect(effects, assignment.substr(0, equals), value);
}

}  // namespace clampd::sim
