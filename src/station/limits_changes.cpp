#include <algorithm>

#include <fmt/format.h>

#include "clampd/station/limits.hpp"

namespace clampd {
namespace {

void compare(const std::string& name, std::string_view unit, const LimitInterval& before,
             const LimitInterval& after, std::vector<std::string>& changes) {
  if (before.lower != after.lower)
    changes.push_back(fmt::format("{}: lower {:.6g} -> {:.6g} {}", name, before.lower, after.lower, unit));
  if (before.upper != after.upper)
    changes.push_back(fmt::format("{}: upper {:.6g} -> {:.6g} {}", name, before.upper, after.upper, unit));
}

const EffectLimit* find(const LimitSet& limits, const EffectLimit& wanted) {
  const auto found =
      std::find_if(limits.effects.begin(), limits.effects.end(), [&](const EffectLimit& limit) {
        return limit.effect == wanted.effect && limit.parameter == wanted.parameter;
      });
  return found == limits.effects.end() ? nullptr : &*found;
}

}  // namespace

std::vector<std::string> changes_between(const LimitSet& before, const LimitSet& after) {
  std::vector<std::string> changes;
  if (before.guard_band_k != after.guard_band_k)
    changes.push_back(fmt::format("guard_band_k: {} -> {}", before.guard_band_k, after.guard_band_k));
  for (std::size_t i = 0; i < kParameterCount; ++i)
    compare(std::string(kParameterTable[i].name), kParameterTable[i].unit, before.intervals[i],
            after.intervals[i], changes);
  for (const EffectLimit& limit : after.effects) {
    const std::string name = fmt::format("{}.{}", limit.effect, limit.parameter);
    if (const EffectLimit* old = find(before, limit))
      compare(name, "", old->interval, limit.interval, changes);
    else
      changes.push_back(
          fmt::format("{}: new, {:.6g} to {:.6g}", name, limit.interval.lower, limit.interval.upper));
  }
  for (const EffectLimit& limit : before.effects)
    if (find(after, limit) == nullptr)
      changes.push_back(fmt::format("{}.{}: no longer limited", limit.effect, limit.parameter));
  return changes;
}

}  // namespace clampd
