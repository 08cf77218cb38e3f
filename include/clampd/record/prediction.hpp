#pragma once

#include <cstddef>
#include <limits>
#include <span>
#include <string>
#include <vector>

namespace clampd {

/// A recorded quantity and what a model makes of it, row by row.
struct PredictedQuantity {
  std::string quantity;  ///< "position", "velocity", "force"
  std::string unit;
  std::vector<double> measured, predicted;  ///< one value a row; NaN where there is none
};

/// How far a prediction is from what was recorded.
struct PredictionError {
  std::string quantity, unit;
  double rms = std::numeric_limits<double>::quiet_NaN();
  double of_standard_deviation =
      std::numeric_limits<double>::quiet_NaN();  ///< rms over that of the measured quantity; NaN: constant
  double fit_percent = std::numeric_limits<double>::quiet_NaN();  ///< 100 (1 - of_standard_deviation)
};
PredictionError error_of(const PredictedQuantity& quantity);

/// One run, simulated from the recorded torque alone.
struct PredictedRun {
  std::string name;
  std::vector<double> time_s;
  std::vector<PredictedQuantity> quantities;  ///< from the first rows' state to the end
  /// The same, but set to the recorded motion anew every `horizon_s`: what drifts over minutes may be right
  /// over a second.
  struct Limited {
    double horizon_s = 0.0;
    std::vector<PredictedQuantity> quantities;
  };
  std::vector<Limited> limited;
  double diverged_s =
      std::numeric_limits<double>::quiet_NaN();  ///< when the simulation left all bounds; NaN: never
};

/// `run,time_s`, and measured, predicted and residual (measured less predicted) of each quantity; numbers
/// that read back the same, nothing for a NaN.
std::string format_residuals(std::span<const PredictedRun> runs);

}  // namespace clampd
