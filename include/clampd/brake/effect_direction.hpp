#pragma once

#include <cstddef>
#include <vector>

#include "clampd/brake/effect.hpp"

namespace clampd {

/// A strength of an effect.
struct EffectDirection {
  EffectValues effect;        ///< shapes and choices as they are looked at, strengths neutral
  std::size_t parameter = 0;  ///< the strength, among the effect's parameters

  bool operator==(const EffectDirection& other) const {
    return effect.effect == other.effect.effect && effect.values == other.effect.values &&
           parameter == other.parameter;
  }
};

/// The strengths of all effects that have one, for each choice and start of a shape, in the catalogue's
/// order: the same list for any runs. Without those whose phase differs from brake to brake (order scans),
/// which do not add up.
std::vector<EffectDirection> effects_with_strengths();

}  // namespace clampd
