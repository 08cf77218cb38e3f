#include "clampd/brake/effect_direction.hpp"

#include "clampd/brake/effect_combinations.hpp"

namespace clampd {
namespace {

using Role = EffectParameter::Role;

/// Strengths neutral, every combination of shapes and choices.
std::vector<std::vector<double>> neutral_values(const Effect& effect) {
  return combinations(effect, [&](std::size_t i) {
    const EffectParameter& parameter = info_of(effect).parameters[i];
    return parameter.role == Role::Strength ? std::vector{parameter.neutral} : parameter.starts;
  });
}

}  // namespace

std::vector<EffectDirection> effects_with_strengths() {
  std::vector<EffectDirection> directions;
  for (const Effect* effect : effects()) {
    const EffectInfo& info = info_of(*effect);
    if (info.order_scan || info.removes_readings) continue;
    for (const std::vector<double>& values : neutral_values(*effect))
      for (std::size_t i = 0; i < info.parameters.size(); ++i)
        if (info.parameters[i].role == Role::Strength) directions.push_back({{effect, values}, i});
  }
  return directions;
}

}  // namespace clampd
