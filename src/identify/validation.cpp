#include "clampd/identify/validation.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>

#include "clampd/statistics/distributions.hpp"

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

Result<void> check_runs(std::span<const Run> runs) {
  if (runs.empty()) return failure("no run to identify from");
  for (const Run& run : runs) {
    const std::size_t rows = run.size();
    if (rows < 2) return failure(fmt::format("run {}: has {} rows; at least 2 are needed", run.name, rows));
    const std::pair<std::string_view, const std::vector<double>*> columns[] = {
        {"time_s", &run.time_s},
        {"torque_Nm", &run.torque_Nm},
        {"velocity_rad_s", &run.velocity_rad_s},
        {"force_N", &run.force_N}};
    for (const auto& [name, column] : columns) {
      if (column->size() != rows)
        return failure(
            fmt::format("run {}: {} has {} rows, time_s {}", run.name, name, column->size(), rows));
      const auto bad =
          std::find_if_not(column->begin(), column->end(), [](double x) { return std::isfinite(x); });
      if (bad != column->end())
        return failure(
            fmt::format("run {}: row {} of {} is not finite", run.name, bad - column->begin(), name));
    }
    for (std::size_t k = 1; k < rows; ++k)
      if (steps_in(run.time_s[k] - run.time_s[k - 1]) == 0)
        return failure(
            fmt::format("run {}: from {} s to {} s time does not increase or leaps by more than {} s; split "
                        "the run there",
                        run.name, run.time_s[k - 1], run.time_s[k], kMaxGap_s));
  }
  return {};
}

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
  result.p_value = statistics::chi_squared_p_value(result.statistic, result.lags);
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
