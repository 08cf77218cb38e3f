#include "tests/support/blind/detectability.hpp"

#include <cmath>
#include <limits>

#include "clampd/identify/extended_fit.hpp"
#include "clampd/identify/prediction_error.hpp"
#include "src/identify/linear_run.hpp"

namespace clampd::blind {

double detectability_nats(const BlindSet& set) {
  const NoiseLevels& noise = set.answer.noise;
  EstimatorOptions options;
  options.start = set.answer.brake;
  options.noise_force_N = noise.sensors.force_N;
  options.noise_velocity_rad_s = noise.sensors.velocity_rad_s;
  options.noise_torque_Nm = noise.torque_Nm;
  const Estimate estimate = identify_prediction_error(set.noise_free, options);
  if (estimate.initial_states.size() != set.noise_free.size())
    return std::numeric_limits<double>::quiet_NaN();
  double nats = 0.0;
  for (std::size_t i = 0; i < set.noise_free.size(); ++i) {
    const Run& run = set.noise_free[i];
    identify::LinearRun linear;
    linear.resize(run.size());
    if (!identify::extended_kalman_filter(run, estimate.parameters, estimate.initial_states[i],
                                          identify::variances_of(noise), {}, linear))
      return std::numeric_limits<double>::quiet_NaN();
    for (std::size_t k = 0; k < run.size(); ++k)
      nats += 0.5 * linear.rows[k].residual.dot(linear.gains[k].weight * linear.rows[k].residual);
  }
  return nats;
}

double nats_left(const BlindSet& set, const ExtendedParameters& model) {
  ExtendedEstimate estimate = fit_base(set.noise_free, set.answer.brake);
  if (!estimate.possible) return std::numeric_limits<double>::quiet_NaN();
  estimate.parameters.base = model.base;
  for (const EffectValues& effect : model.effects) estimate = with_effect(estimate, effect);
  estimate.noise = set.answer.noise;
  std::vector<FitRun> runs = fit_runs(set.noise_free);
  for (const EffectValues& effect : model.effects) move_by(delays_of(effect), runs);
  ExtendedFitOptions options;
  options.estimate_noise = false;
  estimate = fit_extended(runs, estimate, options);
  if (!estimate.possible) return std::numeric_limits<double>::quiet_NaN();
  double nats = 0.0;
  for (const FilteredRun& run : filter_runs(runs, estimate))
    for (const std::vector<double>* channel : {&run.force, &run.velocity})
      for (const double innovation : *channel)
        if (std::isfinite(innovation)) nats += 0.5 * innovation * innovation;
  return nats;
}

}  // namespace clampd::blind
