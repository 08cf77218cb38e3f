#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/brake/effect_direction.hpp"

namespace clampd::identify {

/// A strength whose information falls below this share when others follow is one that these explain.
inline constexpr double kLeastOwnInformation = 1e-6;

/// The effects of the directions, each once; those of one effect stand side by side.
std::vector<EffectValues> effects_of(std::span<const EffectDirection> directions);

/// Where the directions stand among the parameters of a model that has the base model's, then those of these
/// effects (score_parameters).
std::vector<Eigen::Index> places_of(std::span<const EffectDirection> directions,
                                    std::span<const EffectValues> effects);

}  // namespace clampd::identify
