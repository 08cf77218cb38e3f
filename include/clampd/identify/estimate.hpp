#pragma once

#include <array>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/parallel.hpp"
#include "clampd/base/result.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// How runs become parameters.
enum class Method {
  OutputError,      ///< identify_output_error(): the torque taken as exact while fitting
  PredictionError,  ///< identify_prediction_error(): torque noise modelled
};

/// What a residual costs.
enum class Loss {
  Squared,  ///< Gaussian noise; efficient
  Robust,   ///< Huber's: linear beyond 2.5 standard deviations, so that spikes in the readings count little
};

/// What both estimators want to know.
struct EstimatorOptions {
  BrakeParameters start;     ///< theta: initial guess; fixed: J and N as known
  int max_iterations = 200;  ///< from each start
  /// Parameters that stay at their start value.
  std::array<bool, kParameterCount> held{};
  /// Standard deviations of the noise, if known; otherwise estimated with the parameters. Torque: the error
  /// of its reading, white, one value held over each millisecond.
  std::optional<double> noise_force_N;
  std::optional<double> noise_velocity_rad_s;
  std::optional<double> noise_torque_Nm;
  Loss loss = Loss::Squared;
  ThreadBudget threads;  ///< for runs beside each other; the result is the same

  Result<void> validate() const;
};

enum class Termination {
  Converged,
  IterationLimit,
  NotIdentifiable,
  NumericalFailure,
  Unexplained,  ///< what is left is far above the noise (ResidualLevel): no result, whatever the search ended
                ///< at
};
std::string_view to_string(Termination termination) noexcept;

/// d theta / theta_nom by an error common to all force readings (per N) and to all velocity readings (per
/// rad/s).
using OffsetSensitivity = Eigen::Matrix<double, static_cast<int>(kParameterCount), 2>;

/// A parameter of an effect beside the base model, SI. NaN where the data do not determine it.
struct EffectEstimate {
  std::string effect;  ///< name of the effect
  std::string parameter;
  std::string unit;
  double value = 0.0;
  double sd = 0.0;  ///< NaN for choices, which are not estimated
  /// d value by an error common to all force readings (per N) and to all velocity readings (per rad/s).
  std::array<double, 2> offset_sensitivity{};
};

/// Probability of calling runs different that are not.
inline constexpr double kRunsDiffer = 1e-3;

/// What an estimator found out from one or several runs: shared theta, each run its own initial state, every
/// run with the same noise. Numbers are NaN where there is no estimate; entries of held parameters in the
/// covariances are zero. Not identifiable: NaN for those parameters that the data do not determine.
struct Estimate {
  Termination termination = Termination::NumericalFailure;
  std::string message;  ///< why it stopped, in words
  /// By which the numbers were found; where the output error method got lost, not the one that was asked for.
  Method method = Method::OutputError;
  int iterations = 0;
  double wall_s = 0.0;
  BrakeParameters parameters;
  /// THE uncertainty, of theta / theta_nom: by the noise of the readings and of the torque, wider where the
  /// torque's noise is itself uncertain (value ± 1.96 of its standard deviations is the 95 % interval); or,
  /// where the runs differ from each other by significantly more than that, by their scatter
  /// (covariance_over_runs).
  ParameterMatrix covariance_normalised;
  bool runs_differ = false;  ///< the latter: something changes from run to run
  /// Of the noise estimates that each standard deviation rests on (Welch and Satterthwaite); infinite: as
  /// good as known.
  ParameterVector degrees_of_freedom = ParameterVector::Constant(std::numeric_limits<double>::infinity());
  /// Chance that runs that differ by nothing but this noise scatter as much as these; 1 where it cannot be
  /// told, as from one run. runs_differ takes 8 runs, fewer give no covariance; this takes 2.
  double runs_agree_p = 1.0;
  /// The same if the torque reading were exact: the inverse of (14).
  ParameterMatrix covariance_exact_torque;
  /// Cluster-robust (sandwich) covariance over runs, which presumes no noise model; NaN for fewer than 8
  /// runs.
  ParameterMatrix covariance_over_runs;
  /// What a wrong tare does to the estimate; repeats that share a tare cannot show it by their scatter.
  OffsetSensitivity offset_sensitivity = OffsetSensitivity::Zero();
  std::vector<Eigen::Vector2d> initial_states;  ///< per run: position from contact (rad), velocity (rad/s)
  double noise_force_N = 0.0;                   ///< standard deviations, estimated or as given
  double noise_velocity_rad_s = 0.0;
  double noise_torque_Nm = 0.0;
  double force_rms_N = 0.0;  ///< of the residuals over all runs: open-loop for OEM, one-step for PEM
  double velocity_rms_rad_s = 0.0;
  /// Of the data under the weights of the fit: Gaussian, residuals independent (OEM) or innovations (PEM).
  double log_likelihood = 0.0;
  std::vector<double> run_force_rms_N;  ///< the same per run
  std::vector<double> run_velocity_rms_rad_s;
  std::vector<EffectEstimate> effects;  ///< of an extended model, in its order
  /// Of theta / theta_nom, then of `effects`, each in its unit: THE uncertainty with effects. Zero where one
  /// is held or a choice; empty without effects, and where not all are identifiable.
  Eigen::MatrixXd covariance_with_effects;

  bool converged() const { return termination == Termination::Converged; }
};

}  // namespace clampd
