#include "drivers/sim/effects.hpp"

#include <charconv>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace clampd::sim {

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
