#include "tests/support/blind/detectability.hpp"

#include <cmath>
#include <limits>

#include "clampd/base/nan.hpp"
#include "clampd/identify/extended_fit.hpp"

namespace clampd::blind {
namespace {


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
  // A plain effect can lead the estimator to where the filter gets lost: then the truth is a better start.
  constexpr double kPlain_nats = 300.0;
  if (nats < kPlain_nats || found.initial_states.size() != runs.size()) return nats;
  ExtendedEstimate truth = found;
  truth.parameters.base = set.answer.brake;
  for (std::size_t i = 0; i < runs.size(); ++i)
    truth.initial_states[i].head<2>() << set.noise_free[i].position_rad[0],
        set.noise_free[i].velocity_rad_s[0];
  return std::fmin(nats, nats_of(runs, fit_knowing_noise(runs, truth, set.answer.noise)));
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
