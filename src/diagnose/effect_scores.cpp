#include "clampd/diagnose/effect_scores.hpp"

#include <algorithm>
#include <utility>

#include "clampd/identify/extended_fit.hpp"
#include "clampd/identify/parameter_scores.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd {
namespace {

using Role = EffectParameter::Role;

/// A strength whose information falls below this share when the base model follows is one that the base model
/// explains itself.
constexpr double kLeastOwn = 1e-6;

bool has_strength(const Effect& effect) {
  const auto& parameters = info_of(effect).parameters;
  return std::any_of(parameters.begin(), parameters.end(),
                     [](const auto& parameter) { return parameter.role == Role::Strength; });
}

/// Strengths neutral, refinements as they come first, every combination of shapes and choices.
std::vector<std::vector<double>> neutral_values(const Effect& effect) {
  std::vector<std::vector<double>> list{{}};
  const auto& parameters = info_of(effect).parameters;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    std::vector<double> values = parameters[i].starts;
    if (parameters[i].role == Role::Strength) values = {parameters[i].neutral};
    if (parameters[i].role == Role::Refinement) values.resize(1);
    std::vector<std::vector<double>> longer;
    for (const auto& begun : list)
      for (const double value : values) {
        longer.push_back(begun);
        longer.back().push_back(value);
      }
    list = std::move(longer);
  }
  return list;
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
  int states = 0, parameters = 0;
  for (std::size_t i = 0; i < scores.size(); ++i) {
    const EffectValues& effect = scores[i].effect;
    if (!batches.empty() && is_same(batches.back().effects.back(), effect)) {
      batches.back().last = i + 1;
      continue;
    }
    const EffectInfo& info = info_of(*effect.effect);
    states += info.states;
    parameters += static_cast<int>(info.parameters.size());
    if (batches.empty() || states > ExtendedBrake::kMaxStates || parameters > ExtendedBrake::kMaxParameters) {
      batches.push_back({i, i, {}});
      states = 2 + info.states;
      parameters = static_cast<int>(kParameterCount + info.parameters.size());
    }
    batches.back().last = i + 1;
    batches.back().effects.push_back(effect);
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
  for (std::size_t i = batch.first; i < batch.last; ++i) {
    const auto effect = std::find_if(batch.effects.begin(), batch.effects.end(),
                                     [&](const auto& each) { return is_same(each, scores[i].effect); }) -
                        batch.effects.begin();
    const auto place = std::find_if(brake.places().begin(), brake.places().end(), [&](const auto& each) {
      return each.effect == static_cast<int>(effect) &&
             each.parameter == static_cast<int>(scores[i].parameter);
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
    if (!has_strength(*effect) || info.order_scan || info.removes_readings) continue;
    for (std::vector<double>& values : neutral_values(*effect))
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
