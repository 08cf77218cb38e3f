#include "clampd/record/prediction.hpp"

#include <cmath>

#include <fmt/format.h>

namespace clampd {

PredictionError error_of(const PredictedQuantity& quantity) {
  PredictionError error;
  error.quantity = quantity.quantity;
  error.unit = quantity.unit;
  double count = 0.0, mean = 0.0, variance = 0.0, square = 0.0;
  const auto counts = [&](std::size_t k) {
    return std::isfinite(quantity.measured[k]) && std::isfinite(quantity.predicted[k]);
  };
  for (std::size_t k = 0; k < quantity.measured.size(); ++k)
    if (counts(k)) count += 1.0, mean += quantity.measured[k];
  if (count == 0.0) return error;
  mean /= count;
  for (std::size_t k = 0; k < quantity.measured.size(); ++k) {
    if (!counts(k)) continue;
    variance += std::pow(quantity.measured[k] - mean, 2) / count;
    square += std::pow(quantity.measured[k] - quantity.predicted[k], 2) / count;
  }
  error.rms = std::sqrt(square);
  if (variance == 0.0) return error;
  error.of_standard_deviation = std::sqrt(square / variance);
  error.fit_percent = 100.0 * (1.0 - error.of_standard_deviation);
  return error;
}

std::string format_residuals(std::span<const PredictedRun> runs) {
  std::string text = "run,time_s";
  if (!runs.empty())
    for (const PredictedQuantity& each : runs.front().quantities)
      text += fmt::format(",{0}_measured,{0}_predicted,{0}_residual", each.quantity);
  text += '\n';
  const auto append = [&](double value) { text += std::isfinite(value) ? fmt::format(",{}", value) : ","; };
  for (const PredictedRun& run : runs)
    for (std::size_t k = 0; k < run.time_s.size(); ++k) {
      // A name may hold a comma or a quote.
      std::string name;
      for (const char c : run.name) name += c == '"' ? "\"\"" : std::string(1, c);
      text += fmt::format("\"{}\",{}", name, run.time_s[k]);
      for (const PredictedQuantity& each : run.quantities) {
        append(each.measured[k]);
        append(each.predicted[k]);
        append(each.measured[k] - each.predicted[k]);
      }
      text += '\n';
    }
  return text;
}

}  // namespace clampd
