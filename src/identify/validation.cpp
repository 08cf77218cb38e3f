#include "clampd/identify/validation.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <boost/math/special_functions/gamma.hpp>

namespace clampd {

namespace {

ChannelMisfit misfit_of(std::span<const double> measured, std::span<const double> model, double noise) {
  std::vector<double> residuals(measured.size());
  double square = 0.0;
  for (std::size_t k = 0; k < measured.size(); ++k) {
    residuals[k] = measured[k] - model[k];
    square += residuals[k] * residuals[k];
  }
  const double mean_square = square / static_cast<double>(measured.size());
  return {std::sqrt(mean_square), mean_square / (noise * noise), portmanteau(residuals)};
}

}  // namespace

Portmanteau portmanteau(std::span<const double> residuals, int lags) {
  Portmanteau result;
  const auto count = static_cast<int>(residuals.size());
  result.lags = std::clamp(lags, 0, std::max(0, count / 4));
  double mean = 0.0;
  double square = 0.0;
  for (const double residual : residuals) {
    mean += residual / count;
    square += residual * residual;
  }
  double variance = 0.0;
  for (const double residual : residuals) variance += (residual - mean) * (residual - mean);
  // Of a constant series only the rounding of its mean is left.
  if (result.lags == 0 || !(variance > 1e-24 * square)) return result;
  for (int lag = 1; lag <= result.lags; ++lag) {
    double product = 0.0;
    for (int k = lag; k < count; ++k)
      product += (residuals[static_cast<std::size_t>(k)] - mean) *
                 (residuals[static_cast<std::size_t>(k - lag)] - mean);
    const double correlation = product / variance;
    result.statistic += correlation * correlation / (count - lag);
  }
  result.statistic *= static_cast<double>(count) * (count + 2.0);
  result.p_value = boost::math::gamma_q(0.5 * result.lags, 0.5 * result.statistic);
  return result;
}

RunMisfit assess_run(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                     const SensorNoise& noise) {
  RunMisfit misfit;
  if (run.size() == 0) return misfit;
  Simulation simulation(run.size());
  simulate(parameters, initial, excitation_of(run), simulation);
  misfit.simulated = simulation.complete();
  if (!misfit.simulated) return misfit;
  misfit.force = misfit_of(run.force_N, simulation.force_N, noise.force_N);
  misfit.velocity = misfit_of(run.velocity_rad_s, simulation.velocity_rad_s, noise.velocity_rad_s);
  return misfit;
}

}  // namespace clampd
