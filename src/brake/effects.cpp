#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

std::string_view to_string(Location location) noexcept {
  switch (location) {
    case Location::TorqueBalance:
      return "torque-balance";
    case Location::Stiffness:
      return "stiffness";
    case Location::ForceReading:
      return "force-reading";
    case Location::VelocityReading:
      return "velocity-reading";
    case Location::TorqueReading:
      return "torque-reading";
    case Location::Timing:
      return "timing";
  }
  return "?";
}

std::span<const Effect* const> effects() {
  static const std::array kCatalogue{
#define CLAMPD_EFFECT(name) &name(),
#include "src/brake/effects/catalogue.inc"
#undef CLAMPD_EFFECT
  };
  return kCatalogue;
}

const Effect* find_effect(std::string_view name) {
  for (const Effect* effect : effects())
    if (effect->info().name == name) return effect;
  return nullptr;
}

const EffectInfo& info_of(const Effect& effect) {
  return effect.info();
}

std::string_view choice_of(const EffectParameter& parameter, double value) noexcept {
  if (!(value >= 1.0 && value <= static_cast<double>(parameter.choices.size()))) return {};
  return parameter.choices[effects_detail::chosen<std::size_t>(value) - 1];
}

std::string in_words(const EffectParameter& parameter) {
  std::string words(parameter.description);
  for (std::size_t i = 0; i < parameter.choices.size(); ++i)
    words += fmt::format("{} {} {}", i == 0 ? ":" : ";", i + 1, parameter.choices[i]);
  return words;
}

std::vector<double> starts_of(const Effect& effect, std::size_t parameter, std::span<const Run> runs) {
  return effect.starts(parameter, runs);
}

std::vector<double> chosen_otherwise(const Effect& effect, std::vector<double> values, std::size_t parameter,
                                     double choice) {
  return effect.chosen_otherwise(std::move(values), parameter, choice);
}

std::vector<std::size_t> effects_detail::chain_of(const std::vector<EffectValues>& values) {
  const std::span<const Effect* const> catalogue = effects();
  const auto place = [&](std::size_t i) {
    return std::find(catalogue.begin(), catalogue.end(), values[i].effect);
  };
  std::vector<std::size_t> chain(values.size());
  std::iota(chain.begin(), chain.end(), std::size_t{0});
  std::stable_sort(chain.begin(), chain.end(),
                   [&](std::size_t a, std::size_t b) { return place(a) < place(b); });
  return chain;
}

bool is_neutral(const EffectValues& values) {
  const auto& parameters = values.effect->info().parameters;
  bool has_strength = false;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    if (parameters[i].role != EffectParameter::Role::Strength) continue;
    if (values.values[i] != parameters[i].neutral) return false;
    has_strength = true;
  }
  return has_strength;
}

std::string size_in_words(double value, std::string_view unit) {
  if (unit == "s") return fmt::format("{:.2g} ms", 1e3 * value);
  if (unit == "1") return fmt::format("{:.2g} %", 100.0 * value);
  if (unit == "rad" && std::abs(value) < 0.01) return fmt::format("{:.3g} mrad", 1e3 * value);
  return fmt::format("{:.3g} {}", value, unit);
}

/// Of the strengths the one that is known to be there, by its name where there are several.
std::string effects_detail::strength_in_words(const EffectInfo& info, std::span<const double> values, std::span<const double> sds) {
  std::size_t strongest = 0;
  double most = 0.0;
  int count = 0;
  for (std::size_t i = 0; i < info.parameters.size(); ++i) {
    if (info.parameters[i].role != EffectParameter::Role::Strength) continue;
    ++count;
    const double certainty = std::abs(values[i] - info.parameters[i].neutral) / sds[i];
    if (certainty > most) {
      most = certainty;
      strongest = i;
    }
  }
  const EffectParameter& parameter = info.parameters[strongest];
  const std::string size = size_in_words(values[strongest], parameter.unit);
  return count > 1 ? fmt::format("{} {}", parameter.name, size) : size;
}

std::string Effect::in_words(std::span<const double> values, std::span<const double> sds, double) const {
  return fmt::format("{} ({})", info().cause, effects_detail::strength_in_words(info(), values, sds));
}

std::string in_words(const EffectValues& values, std::span<const double> sds, double amplitude) {
  return values.effect->in_words(values.values, sds, amplitude);
}

EffectDelays delays_of(const EffectValues& values) {
  return values.effect->delays(values.values);
}

}  // namespace clampd
