#include "src/identify/effect_places.hpp"

namespace clampd::identify {

std::vector<EffectValues> effects_of(std::span<const EffectDirection> directions) {
  std::vector<EffectValues> effects;
  for (const EffectDirection& direction : directions)
    if (effects.empty() || effects.back().effect != direction.effect.effect ||
        effects.back().values != direction.effect.values)
      effects.push_back(direction.effect);
  return effects;
}

std::vector<Eigen::Index> places_of(std::span<const EffectDirection> directions,
                                    std::span<const EffectValues> effects) {
  std::vector<Eigen::Index> places(directions.size());
  auto place = static_cast<Eigen::Index>(kParameterCount);
  for (const EffectValues& effect : effects)
    for (std::size_t i = 0; i < info_of(*effect.effect).parameters.size(); ++i) {
      if (!is_estimated(info_of(*effect.effect).parameters[i])) continue;
      for (std::size_t k = 0; k < directions.size(); ++k)
        if (directions[k] == EffectDirection{effect, i}) places[k] = place;
      ++place;
    }
  return places;
}

}  // namespace clampd::identify
