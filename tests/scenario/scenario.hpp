#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "clampd/experiment/reference.hpp"
#include "clampd/simulation/simulate.hpp"

namespace clampd::scenario {

inline std::string config(const std::string& name) {
  return std::string(CLAMPD_SOURCE_DIR) + "/configs/" + name;
}

inline Run shipped_trajectory() {
  return read_run(config("trajectory.csv")).value().run;
}
inline Reference shipped_reference(double period_s = kPeriod_s) {
  return build_reference(shipped_trajectory(), BrakeParameters{}, {.period_s = period_s}).value();
}
inline sim::PlantConfiguration shipped_plant() {
  return sim::read_plant_configuration(config("plant.toml")).value();
}

/// The noisiest sensors that are supported.
inline sim::PlantConfiguration noisy_plant() {
  return sim::read_plant_configuration(config("brakes/noisy-bench.toml")).value();
}

/// True force minus reference over all rows of all runs.
struct TrackingError {
  double rms_N = 0.0;
  double max_N = 0.0;
};

inline TrackingError tracking_error(const SimulatedCheck& check, const Reference& reference) {
  TrackingError error;
  double sum = 0.0;
  std::size_t rows = 0;
  for (const SimulatedRun& run : check.runs) {
    for (std::size_t k = 0; k < reference.rows.size(); ++k) {
      const double e = run.truth[k].force_N - reference.rows[k].force_N;
      sum += e * e;
      error.max_N = std::max(error.max_N, std::abs(e));
      ++rows;
    }
  }
  error.rms_N = rows > 0 ? std::sqrt(sum / static_cast<double>(rows)) : 0.0;
  return error;
}

}  // namespace clampd::scenario
