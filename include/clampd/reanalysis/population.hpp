#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "clampd/attribution/population.hpp"
#include "clampd/base/result.hpp"
#include "clampd/diagnose/effect_scores.hpp"

namespace clampd::reanalysis {

/// What a check of a job of the kind score-effects says.
struct ScoredCheck {
  std::string check;
  std::string serial;
  std::string station;
  std::string fixture;  ///< empty: none
  std::string batch;    ///< empty: none
  std::vector<EffectScore> scores;
};

/// The checks of a line with what they say about each effect.
struct Population {
  std::vector<EffectScore> directions;  ///< those of the table, with the first check's answers
  attribution::PopulationTable table;
  std::int64_t repeated = 0;  ///< checks left out: a brake counts once at each station, by its first check
};

/// "force-lag.time_constant"; what was chosen for it in brackets.
attribution::Direction direction_in_words(const EffectScore& score);

/// Scores as a document of clampd.effect_scores/1 has them. Errors: it is none, or of effects that this
/// version does not know.
Result<std::vector<EffectScore>> parse_scores(const std::string& document);

/// Puts together what checks, in chronological order, say. Errors: they are of versions whose effects differ.
Result<Population> population_of(const std::vector<ScoredCheck>& checks);

}  // namespace clampd::reanalysis
