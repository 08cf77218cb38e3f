#pragma once

#include <span>
#include <string>

#include <nlohmann/json_fwd.hpp>

#include "clampd/attribution/population.hpp"
#include "clampd/brake/effect_direction.hpp"

namespace clampd {

/// What was found, in words. `directions`: those of the table.
std::string format_population(const attribution::PopulationTable& table,
                              std::span<const EffectDirection> directions,
                              const attribution::PopulationResult& result, double false_alarms);

/// The same as clampd.population/2.
nlohmann::ordered_json population_json(const attribution::PopulationTable& table,
                                       std::span<const EffectDirection> directions,
                                       const attribution::PopulationResult& result, double false_alarms);

}  // namespace clampd
