#include "clampd/identify/effect_scores.hpp"

#include "clampd/identify/extended_fit.hpp"
#include "clampd/identify/parameter_scores.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/effect_places.hpp"

namespace clampd {

using namespace identify;

Result<EffectScores> score_effects(std::span<const Run> runs, const BrakeParameters& start,
                                   const ThreadBudget& threads) {
  if (runs.empty()) return failure("there are no runs");
  const ExtendedEstimate base = fit_base(runs, start, threads);
  EffectScores scores{effects_with_strengths(), {}, {}};
  const std::vector<EffectValues> effects = effects_of(scores.directions);
  const ParameterScores found =
      base.possible ? score_parameters(fit_runs(runs), base, effects) : ParameterScores{};
  if (!found.possible)
    return failure(
        "the base model cannot be fitted to these runs; `clampctl diagnose` says what is wrong with them");
  constexpr auto kBase = static_cast<Eigen::Index>(kParameterCount);
  const std::vector<Eigen::Index> places = places_of(scores.directions, effects);
  const Eigen::MatrixXd across = found.information(Eigen::seqN(0, kBase), places);
  const Eigen::MatrixXd followed =
      statistics::ScaledFactor(found.information.topLeftCorner<kBase, kBase>()).solve_columns(across);
  scores.information = found.information(places, places) - across.transpose() * followed;
  scores.score = found.gradient(places) - followed.transpose() * found.gradient.head<kBase>();
  for (std::size_t i = 0; i < places.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    if (scores.information(at, at) > kLeastOwnInformation * found.information(places[i], places[i])) continue;
    scores.information.row(at).setZero();
    scores.information.col(at).setZero();
    scores.score[at] = 0.0;
  }
  return scores;
}

}  // namespace clampd
