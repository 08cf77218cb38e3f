#include "clampd/diagnose/effect_scores.hpp"

#include "clampd/identify/extended_fit.hpp"
#include "clampd/identify/parameter_scores.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/diagnose/combinations.hpp"

namespace clampd {
namespace {

using Role = EffectParameter::Role;

/// A strength whose information falls below this share when the base model follows is one that the base model
/// explains itself.
constexpr double kLeastOwn = 1e-6;

/// Strengths neutral, every combination of shapes and choices.
std::vector<std::vector<double>> neutral_values(const Effect& effect) {
  return diagnosing::combinations(effect, [&](std::size_t i) {
    const EffectParameter& parameter = info_of(effect).parameters[i];
    return parameter.role == Role::Strength ? std::vector{parameter.neutral} : parameter.starts;
  });
}

/// The effects of the directions, each once.
std::vector<EffectValues> effects_of(std::span<const EffectDirection> directions) {
  std::vector<EffectValues> effects;
  for (const EffectDirection& direction : directions)
    if (effects.empty() || effects.back().effect != direction.effect.effect ||
        effects.back().values != direction.effect.values)
      effects.push_back(direction.effect);
  return effects;
}

/// Where the strengths of the effects stand among the parameters of a model that has the base model's, then
/// those of the effects.
std::vector<Eigen::Index> places_of_strengths(std::span<const EffectValues> effects) {
  std::vector<Eigen::Index> places;
  auto place = static_cast<Eigen::Index>(kParameterCount);
  for (const EffectValues& effect : effects)
    for (const EffectParameter& parameter : info_of(*effect.effect).parameters) {
      if (!is_estimated(parameter)) continue;
      if (parameter.role == Role::Strength) places.push_back(place);
      ++place;
    }
  return places;
}

}  // namespace

std::vector<EffectDirection> effects_with_strengths() {
  std::vector<EffectDirection> directions;
  for (const Effect* effect : effects()) {
    const EffectInfo& info = info_of(*effect);
    if (info.order_scan || info.removes_readings) continue;
    for (const std::vector<double>& values : neutral_values(*effect))
      for (std::size_t i = 0; i < info.parameters.size(); ++i)
        if (info.parameters[i].role == Role::Strength) directions.push_back({{effect, values}, i});
  }
  return directions;
}

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
  const std::vector<Eigen::Index> places = places_of_strengths(effects);
  const Eigen::MatrixXd across = found.information(Eigen::seqN(0, kBase), places);
  const Eigen::MatrixXd followed =
      statistics::ScaledFactor(found.information.topLeftCorner<kBase, kBase>()).solve_columns(across);
  scores.information = found.information(places, places) - across.transpose() * followed;
  scores.score = found.gradient(places) - followed.transpose() * found.gradient.head<kBase>();
  for (std::size_t i = 0; i < places.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    if (scores.information(at, at) > kLeastOwn * found.information(places[i], places[i])) continue;
    scores.information.row(at).setZero();
    scores.information.col(at).setZero();
    scores.score[at] = 0.0;
  }
  return scores;
}

}  // namespace clampd
