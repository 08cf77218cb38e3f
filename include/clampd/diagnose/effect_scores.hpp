#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/parallel.hpp"
#include "clampd/base/result.hpp"
#include "clampd/brake/effect.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/run.hpp"

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

/// What the runs of one brake say about strengths d where all of them are neutral, the base model's
/// parameters, its noise and the runs' initial states fitted. As far as the model is linear in them, they
/// grow the log-likelihood by score . d - 1/2 d . information d. A single brake may tell next to nothing;
/// scores and informations of many brakes add up.
struct EffectScores {
  std::vector<EffectDirection> directions;
  Eigen::VectorXd score;        ///< one over the strength's unit
  Eigen::MatrixXd information;  ///< symmetric; a row of zeros: these runs do not show that strength
};

/// The strengths of all effects that have one, for each choice and start of a shape, in the catalogue's
/// order: the same list for any runs. Without those whose phase differs from brake to brake (order scans),
/// which do not add up.
std::vector<EffectDirection> effects_with_strengths();

/// Fits the base model to the runs by the prediction error method, from these values, and scores
/// effects_with_strengths() beside it. Errors: no runs, or a base model that cannot be fitted.
Result<EffectScores> score_effects(std::span<const Run> runs, const BrakeParameters& start,
                                   const ThreadBudget& threads = {});

}  // namespace clampd
