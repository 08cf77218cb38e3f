#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "clampd/brake/parameters.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

struct OutputErrorOptions {
  BrakeParameters start;     ///< theta: initial guess; fixed: J and N as known
  int max_iterations = 100;  ///< from each start
  /// Sensor noise, if known. Otherwise both are estimated with the parameters by (9).
  std::optional<double> noise_force_N;
  std::optional<double> noise_velocity_rad_s;

  Result<void> validate() const;
};

enum class Termination { Converged, IterationLimit, NotIdentifiable, NumericalFailure };
std::string_view to_string(Termination termination) noexcept;

/// d theta / theta_nom by an error common to all force readings (per N) and to all velocity readings (per
/// rad/s).
using OffsetSensitivity = Eigen::Matrix<double, static_cast<int>(kParameterCount), 2>;

/// Result of the output error method (Procedure 2) on one or several runs.
struct OutputErrorSummary {
  Termination termination = Termination::NumericalFailure;
  std::string message;  ///< why it stopped, in words
  int iterations = 0;
  double wall_s = 0.0;
  BrakeParameters parameters;  ///< theta is NaN unless there is an estimate
  ParameterMatrix
      covariance_normalised;  ///< of theta / theta_nom, Cramér-Rao (white sensor noise, exact torque)
  /// Cluster-robust (sandwich) covariance over runs, also honest under torque noise; NaN for fewer than 8
  /// runs.
  ParameterMatrix covariance_normalised_over_runs;
  /// What a wrong tare does to the estimate; repeats that share a tare cannot show it by their scatter.
  OffsetSensitivity offset_sensitivity = OffsetSensitivity::Zero();
  std::vector<Eigen::Vector2d> initial_states;  ///< per run: position from contact (rad), velocity (rad/s)
  double noise_force_N = 0.0;                   ///< estimated sd, by (9)
  double noise_velocity_rad_s = 0.0;
  double force_rms_N = 0.0;  ///< of the residuals over all runs
  double velocity_rms_rad_s = 0.0;
  std::vector<double> run_force_rms_N;  ///< the same per run
  std::vector<double> run_velocity_rms_rad_s;

  bool converged() const { return termination == Termination::Converged; }
};

/// Shared theta, each run its own initial state, every run weighted by the same noise.
OutputErrorSummary identify_output_error(std::span<const Run> runs, const OutputErrorOptions& options);

}  // namespace clampd
