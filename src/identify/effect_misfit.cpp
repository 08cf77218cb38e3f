#include "src/identify/effect_misfit.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "clampd/identify/extended_fit.hpp"
#include "clampd/identify/parameter_scores.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/effect_places.hpp"

namespace clampd::identify {
namespace {

constexpr auto kBase = static_cast<Eigen::Index>(kParameterCount);

/// That the variance over all strengths counts for, beside that of one over a few runs.
constexpr double kDegreesOfAll = 40.0;

/// Twice the nats by which a strength may fall behind the best one until it weighs 1 / e^3, and the share of
/// the best one's evidence that is added to them.
constexpr double kBehind = 6.0;
constexpr double kShareBehind = 0.1;

/// Of the weight of the best one: others do not matter.
constexpr double kLeastWeight = 1e-3;

/// What runs say about a strength when others follow.
struct StrengthScore {
  EffectDirection direction;
  double estimate = 0.0;
  double information = 0.0;
  double scatter = 1.0;   ///< mean square by which runs differ from the estimate, over what the noise makes
  double evidence = 0.0;  ///< square of the estimate over its variance
};

/// A tare sets these; what is left of them is no misfit of the model.
bool is_tared(const EffectDirection& direction) {
  const EffectInfo& info = info_of(*direction.effect.effect);
  return info.is_zero &&
         (info.location == Location::ForceReading || info.location == Location::VelocityReading);
}

std::vector<StrengthScore> score_strengths(const ParameterScores& found,
                                           std::span<const EffectDirection> directions,
                                           std::span<const Eigen::Index> places) {
  std::vector<Eigen::Index> follow;
  for (Eigen::Index i = 0; i < kBase; ++i) follow.push_back(i);
  for (std::size_t k = 0; k < directions.size(); ++k)
    if (is_tared(directions[k])) follow.push_back(places[k]);
  const statistics::ScaledFactor factor(Eigen::MatrixXd(found.information(follow, follow)));
  std::vector<StrengthScore> strengths;
  for (std::size_t k = 0; k < directions.size(); ++k) {
    if (is_tared(directions[k])) continue;
    const Eigen::Index place = places[k];
    const Eigen::VectorXd followed = factor.solve(Eigen::VectorXd(found.information(follow, place)));
    const auto score_of = [&](const auto& runs) {
      return runs.gradient[place] - followed.dot(runs.gradient(follow));
    };
    const auto information_of = [&](const auto& runs) {
      return runs.information(place, place) - 2.0 * followed.dot(runs.information(follow, place)) +
             followed.dot(runs.information(follow, follow) * followed);
    };
    StrengthScore strength{.direction = directions[k], .information = information_of(found)};
    if (!(strength.information > kLeastOwnInformation * found.information(place, place))) continue;
    strength.estimate = score_of(found) / strength.information;
    double squares = 0.0, counted = 0.0;
    for (const ParameterScores::OfRun& run : found.of_runs) {
      const double own = information_of(run);
      if (!(own > kLeastOwnInformation * strength.information)) continue;
      squares += std::pow(score_of(run) - own * strength.estimate, 2) / own;
      ++counted;
    }
    if (counted < 2.0) continue;
    strength.scatter = squares / (counted - 1.0);
    if (std::isfinite(strength.estimate) && std::isfinite(strength.scatter)) strengths.push_back(strength);
  }
  return strengths;
}

/// Their evidence, each by its moderated variance, and how many degrees of freedom that has.
double weigh_evidence(std::vector<StrengthScore>& strengths, double degrees_of_one) {
  double of_all = 0.0;
  for (const StrengthScore& strength : strengths)
    of_all += strength.scatter / static_cast<double>(strengths.size());
  const double degrees = kDegreesOfAll + degrees_of_one;
  for (StrengthScore& strength : strengths) {
    const double variance =
        (kDegreesOfAll * std::max(1.0, of_all) + degrees_of_one * std::max(1.0, strength.scatter)) / degrees;
    strength.evidence = strength.estimate * strength.estimate * strength.information / variance;
  }
  return degrees;
}

ExtendedEstimate as_estimated(const Estimate& joint, const NoiseLevels& noise) {
  ExtendedEstimate estimate;
  estimate.possible = true;
  estimate.parameters.base = joint.parameters;
  estimate.noise = noise;
  for (const Eigen::Vector2d& initial : joint.initial_states) estimate.initial_states.emplace_back(initial);
  return estimate;
}

/// The mean square of what the strengths that may be the cause do to the estimate; nothing where the
/// estimate's filter does not stay bounded beside them.
std::optional<ParameterMatrix> moved_by(std::span<const StrengthScore> strengths, double most,
                                        std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                        const Held& held) {
  std::vector<EffectDirection> directions;
  std::vector<double> squares, weights;
  double sum = 0.0;
  for (const StrengthScore& strength : strengths) {
    const double weight = std::exp(-3.0 * (most - strength.evidence) / (kBehind + kShareBehind * most));
    if (weight < kLeastWeight) continue;
    directions.push_back(strength.direction);
    squares.push_back(strength.estimate * strength.estimate * (1.0 + 1.0 / strength.evidence));
    weights.push_back(weight);
    sum += weight;
  }
  const std::vector<EffectValues> effects = effects_of(directions);
  const std::vector<Eigen::Index> places = places_of(directions, effects);
  const ParameterScores found = score_parameters(runs, estimate, effects);
  if (!found.possible) return std::nullopt;
  std::vector<Eigen::Index> free;
  for (Eigen::Index i = 0; i < kBase; ++i)
    if (!held[static_cast<std::size_t>(i)]) free.push_back(i);
  const statistics::ScaledFactor factor(Eigen::MatrixXd(found.information(free, free)));
  const ParameterVector nominal = nominal_parameters();
  ParameterMatrix mean = ParameterMatrix::Zero();
  for (std::size_t k = 0; k < directions.size(); ++k) {
    ParameterVector moved = ParameterVector::Zero();
    moved(free) = factor.solve(Eigen::VectorXd(found.information(free, places[k])));
    moved = moved.cwiseQuotient(nominal).eval();
    mean += weights[k] / sum * squares[k] * moved * moved.transpose();
  }
  if (!mean.allFinite()) return std::nullopt;
  return mean;
}

}  // namespace

EffectMisfit effect_misfit(std::span<const Run> runs, const Estimate& joint, const Held& held,
                           const NoiseLevels& noise) {
  EffectMisfit misfit;
  if (runs.size() < kFewestRepeats) return misfit;
  const bool is_fitted = joint.method == Method::PredictionError &&
                         std::none_of(held.begin(), held.end(), [](bool is_held) { return is_held; });
  const ExtendedEstimate estimate = as_estimated(joint, noise);
  const ExtendedEstimate base = is_fitted ? estimate : fit_base(runs, joint.parameters);
  if (!base.possible) return misfit;
  const std::vector<EffectDirection> directions = effects_with_strengths();
  const std::vector<EffectValues> effects = effects_of(directions);
  const std::vector<FitRun> fit = fit_runs(runs);
  const ParameterScores found = score_parameters(fit, base, effects);
  if (!found.possible) return misfit;
  std::vector<StrengthScore> strengths = score_strengths(found, directions, places_of(directions, effects));
  if (strengths.empty()) return misfit;
  const double degrees = weigh_evidence(strengths, static_cast<double>(runs.size()) - 1.0);
  double most = 0.0;
  for (const StrengthScore& strength : strengths) most = std::max(most, strength.evidence);
  misfit.can_tell = true;
  misfit.p_value =
      std::min(1.0, static_cast<double>(strengths.size()) * statistics::fisher_f_p_value(most, 1.0, degrees));
  if (!(misfit.p_value < kSystematic)) return misfit;
  if (const auto moved = moved_by(strengths, most, fit, estimate, held))
    misfit.covariance_normalised = *moved;
  return misfit;
}

}  // namespace clampd::identify
