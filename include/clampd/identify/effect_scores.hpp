#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/parallel.hpp"
#include "clampd/base/result.hpp"
#include "clampd/brake/effect_direction.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// What the runs of one brake say about strengths d where all of them are neutral, the base model's
/// parameters, its noise and the runs' initial states fitted. As far as the model is linear in them, they
/// grow the log-likelihood by score . d - 1/2 d . information d. A single brake may tell next to nothing;
/// scores and informations of many brakes add up.
struct EffectScores {
  std::vector<EffectDirection> directions;
  Eigen::VectorXd score;        ///< one over the strength's unit
  Eigen::MatrixXd information;  ///< symmetric; a row of zeros: these runs do not show that strength
};

/// Fits the base model to the runs by the prediction error method, from these values, and scores
/// effects_with_strengths() beside it. Errors: no runs, or a base model that cannot be fitted.
Result<EffectScores> score_effects(std::span<const Run> runs, const BrakeParameters& start,
                                   const ThreadBudget& threads = {});

}  // namespace clampd
