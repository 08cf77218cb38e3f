#include "tests/support/blind/detectability.hpp"

#include <cmath>
#include <limits>

#include "clampd/identify/extended_fit.hpp"

namespace clampd::blind {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// By an estimate fitted to the noise-free readings with the true noise; NaN if it is none.
double nats_of(const std::vector<FitRun>& runs, const ExtendedEstimate& estimate) {
  if (!estimate.possible) return kNaN;
  const std::vector<FilteredRun> filtered = filter_runs(runs, estimate);
  if (filtered.empty()) return kNaN;
  double nats = 0.0;
  for (const FilteredRun& run : filtered)
    for (const std::vector<double>* channel : {&run.force, &run.velocity})
      for (const double innovation : *channel)
        if (!std::isnan(innovation)) nats += 0.5 * innovation * innovation;
  return nats;
}

ExtendedEstimate fit_knowing_noise(const std::vector<FitRun>& runs, ExtendedEstimate start,
                                   const NoiseLevels& noise) {
  start.noise = noise;
  ExtendedFitOptions options;
  options.estimate_noise = false;
  options.max_iterations = 15;  // strong effects take long to settle, and need no second digit
  return fit_extended(runs, start, options);
}

}  // namespace

double detectability_nats(const BlindSet& set) {
  const std::vector<FitRun> runs = fit_runs(set.noise_free);
  const ExtendedEstimate found = fit_base(set.noise_free, set.answer.brake);
  const double nats = nats_of(runs, fit_knowing_noise(runs, found, set.answer.noise));
  if (!std::isnan(nats) || found.initial_states.size() != runs.size()) return nats;
  // An effect can lead the estimator to where the filter gets lost.
  ExtendedEstimate truth = found;
  truth.parameters.base = set.answer.brake;
  return nats_of(runs, fit_knowing_noise(runs, truth, set.answer.noise));
}

double nats_left(const BlindSet& set, const ExtendedParameters& model) {
  ExtendedEstimate estimate = fit_base(set.noise_free, set.answer.brake);
  if (!estimate.possible) return kNaN;
  estimate.parameters.base = model.base;
  std::vector<FitRun> runs = fit_runs(set.noise_free);
  for (const EffectValues& effect : model.effects) {
    estimate = with_effect(estimate, effect);
    move_by(delays_of(effect), runs);
  }
  return nats_of(runs, fit_knowing_noise(runs, estimate, set.answer.noise));
}

}  // namespace clampd::blind
