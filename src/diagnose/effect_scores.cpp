#include "clampd/diagnose/effect_scores.hpp"

#include <algorithm>

#include "clampd/identify/extended_fit.hpp"
#include "clampd/identify/parameter_scores.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/diagnose/combinations.hpp"
#include "src/diagnose/look.hpp"

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

/// The effects of some scores, each once, that one linearisation can hold beside the base model.
struct Batch {
  std::size_t first = 0, last = 0;  ///< of the scores
  std::vector<EffectValues> effects;
};

bool is_same(const EffectValues& a, const EffectValues& b) {
  return a.effect == b.effect && a.values == b.values;
}

std::vector<Batch> batches_of(std::span<const EffectScore> scores) {
  std::vector<Batch> batches;
  for (std::size_t i = 0; i < scores.size(); ++i) {
    const EffectValues& effect = scores[i].effect;
    if (batches.empty() || !is_same(batches.back().effects.back(), effect)) {
      if (batches.empty() || !diagnosing::room_for({{}, batches.back().effects}, {&effect, 1}))
        batches.push_back({i, i, {}});
      batches.back().effects.push_back(effect);
    }
    batches.back().last = i + 1;
  }
  return batches;
}

/// Fills in score and information of the batch's scores; leaves them at zero where the filter diverges.
void score_batch(std::span<const FitRun> runs, const ExtendedEstimate& base, const Batch& batch,
                 std::span<EffectScore> scores) {
  ExtendedEstimate extended = base;
  for (const EffectValues& effect : batch.effects) extended = with_effect(extended, effect);
  const ParameterScores found = score_parameters(runs, extended);
  if (!found.possible) return;
  constexpr auto kBase = static_cast<Eigen::Index>(kParameterCount);
  const statistics::ScaledFactor base_factor(found.information.topLeftCorner<kBase, kBase>());
  const ExtendedBrake brake(extended.parameters);
  int effect = 0;
  for (std::size_t i = batch.first; i < batch.last; ++i) {
    if (!is_same(batch.effects[static_cast<std::size_t>(effect)], scores[i].effect)) ++effect;
    const auto place = std::find_if(brake.places().begin(), brake.places().end(), [&](const auto& each) {
      return each.effect == effect && each.parameter == static_cast<int>(scores[i].parameter);
    });
    const auto at = static_cast<Eigen::Index>(place - brake.places().begin());
    const Eigen::VectorXd across = found.information.col(at).head<kBase>();
    const Eigen::VectorXd followed = base_factor.solve(across);
    const double own = found.information(at, at) - across.dot(followed);
    if (!(own > kLeastOwn * found.information(at, at))) continue;
    scores[i].information = own;
    scores[i].score = found.gradient[at] - followed.dot(found.gradient.head<kBase>());
  }
}

}  // namespace

std::vector<EffectScore> effects_with_strengths() {
  std::vector<EffectScore> scores;
  for (const Effect* effect : effects()) {
    const EffectInfo& info = info_of(*effect);
    if (info.order_scan || info.removes_readings) continue;
    for (const std::vector<double>& values : neutral_values(*effect))
      for (std::size_t i = 0; i < info.parameters.size(); ++i)
        if (info.parameters[i].role == Role::Strength) scores.push_back({{effect, values}, i, 0.0, 0.0});
  }
  return scores;
}

Result<std::vector<EffectScore>> score_effects(std::span<const Run> runs, const BrakeParameters& start,
                                               const ThreadBudget& threads) {
  if (runs.empty()) return failure("there are no runs");
  const ExtendedEstimate base = fit_base(runs, start, threads);
  if (!base.possible)
    return failure(
        "the base model cannot be fitted to these runs; `clampctl diagnose` says what is wrong with them");
  const std::vector<FitRun> fitted = fit_runs(runs);
  std::vector<EffectScore> scores = effects_with_strengths();
  const std::vector<Batch> batches = batches_of(scores);
  for_each_index(batches.size(), threads,
                 [&](std::size_t batch) { score_batch(fitted, base, batches[batch], scores); });
  return scores;
}

}  // namespace clampd
