#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "clampd/attribution/population.hpp"
#include "clampd/base/result.hpp"
#include "clampd/diagnose/effect_scores.hpp"

namespace clampd::reanalysis {

/// A check of a job of the kind score-effects.
struct ScoredCheck {
  std::string check;
  std::string serial;
  std::string station;
  std::string fixture;   ///< empty: none
  std::string batch;     ///< empty: none
  std::string document;  ///< clampd.effect_scores/1
};

/// The checks of a line with what they say about each effect.
struct Population {
  std::vector<EffectScore> directions;  ///< those of the table; score and information are not filled in
  attribution::PopulationTable table;
  std::int64_t repeated = 0;  ///< checks left out: a brake counts once at each station, by its first check
};

/// "force-lag.time_constant"; what was chosen for it in brackets.
attribution::Direction direction_in_words(const EffectScore& score);

/// Puts together what checks, in chronological order, say. Errors: a document is none of
/// clampd.effect_scores/1, or they are of versions whose effects differ.
Result<Population> population_of(const std::vector<ScoredCheck>& checks);

}  // namespace clampd::reanalysis
