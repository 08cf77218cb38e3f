#include "clampd/simulation/saved_model.hpp"

#include <vector>

namespace clampd {

Result<sim::Effects> simulated_effects(const ExtendedParameters& model) {
  sim::Effects effects;
  for (const EffectValues& effect : model.effects) {
    const EffectInfo& info = info_of(*effect.effect);
    std::vector<sim::EffectParameterValue> values;
    for (std::size_t i = 0; i < info.parameters.size(); ++i) values.push_back({info.parameters[i].name, effect.values[i]});
    if (const Result<void> known = sim::set_effect(effects, info.name, values); !known) return tl::unexpected(known.error());
  }
  return effects;
}

}  // namespace clampd
