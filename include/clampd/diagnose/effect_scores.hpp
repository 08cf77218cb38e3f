#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "clampd/base/parallel.hpp"
#include "clampd/base/result.hpp"
#include "clampd/brake/effect.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// What the runs of one brake say about one strength of an effect where it is neutral, the base model's
/// parameters, its noise and the runs' initial states fitted. A strength d grows the log-likelihood by score
/// d - 1/2 information d^2, as far as the model is linear in it: the strength is about score / information,
/// known to 1 / sqrt(information). A single brake may tell next to nothing; scores and informations of many
/// brakes add up.
struct EffectScore {
  EffectValues effect;        ///< shapes and choices as they were looked at, strengths neutral
  std::size_t parameter = 0;  ///< the strength, among the effect's parameters
  double score = 0.0;         ///< one over the strength's unit
  double information = 0.0;   ///< that squared; 0: these runs do not show it
};

/// Scores of all effects that have a strength, one for each strength, choice and start of a shape, in the
/// catalogue's order: the same list for any runs. Without those whose phase differs from brake to brake
/// (order scans), which do not add up.
std::vector<EffectScore> effects_with_strengths();

/// Fits the base model to the runs by the prediction error method, from these values, and scores
/// effects_with_strengths() beside it. Errors: no runs, or a base model that cannot be fitted.
Result<std::vector<EffectScore>> score_effects(std::span<const Run> runs, const BrakeParameters& start,
                                               const ThreadBudget& threads = {});

}  // namespace clampd
