#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "clampd/attribution/population.hpp"
#include "clampd/base/result.hpp"
#include "clampd/identify/effect_scores.hpp"

namespace clampd::reanalysis {

/// What a check of a job of the kind score-effects says.
struct ScoredCheck {
  std::string check;
  std::string serial;
  std::string station;
  std::string fixture;  ///< empty: none
  std::string batch;    ///< empty: none
  EffectScores scores;
};

/// The checks of a line with what they say about each effect.
struct Population {
  std::vector<EffectDirection> directions;  ///< those of the table
  attribution::PopulationTable table;
  std::int64_t repeated = 0;  ///< checks left out: a brake counts once at each station, by its first check
};

/// "force-lag.time_constant"; what was chosen for it in brackets.
attribution::Direction direction_in_words(const EffectDirection& direction);

/// The part of a document of clampd.effect_scores/2 that says what the scores are.
nlohmann::ordered_json scores_json(const EffectScores& scores);

/// Scores as such a document has them. Errors: it is none, or of effects that this version does not know.
Result<EffectScores> parse_scores(const std::string& document);

/// Puts together what checks, in chronological order, say. Errors: they are of versions whose effects differ.
Result<Population> population_of(std::vector<ScoredCheck> checks);

}  // namespace clampd::reanalysis
