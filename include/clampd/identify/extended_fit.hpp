#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/parallel.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// Runs as they enter a fit: moved by the delays of a model, and with readings that do not count marked.
struct FitRun {
  double number = 0.0;  ///< of the run, from 0, in chronological order
  std::vector<double> time_s, torque_Nm, force_N, velocity_rad_s;
  std::vector<std::uint8_t> use_force, use_velocity;
  /// A reading more, of all runs together, at one of them: what acted then was nothing.
  std::optional<TorqueWhileOff> torque_while_off = {};

  std::size_t size() const { return time_s.size(); }
};

/// Number 0, 1, ... in the order given, every reading counting.
std::vector<FitRun> fit_runs(std::span<const Run> runs,
                             const std::optional<TorqueWhileOff>& torque_while_off = {});

/// A channel that is recorded d samples late is moved back by d; the readings at the end that it then lacks
/// do not count.
void move_by(const EffectDelays& delays, std::vector<FitRun>& runs);

/// Readings that `delays` cannot use (of the first rows, seen from the data as recorded), marked as not
/// counting: so that models with and without the delays are judged by the same readings.
void drop_unusable(const EffectDelays& delays, std::vector<FitRun>& runs);

/// What an extended model makes of runs. Numbers of a failed fit are NaN.
struct ExtendedEstimate {
  bool possible = false;  ///< the filter stays bounded
  bool settled = false;   ///< nothing more to gain when it ended
  int iterations = 0;
  ExtendedParameters parameters;
  /// Of ExtendedBrake's parameters, SI; NaN rows and columns for what the data do not determine.
  Eigen::MatrixXd covariance;
  /// Per run: position (rad), velocity (rad/s), then the free states.
  std::vector<Eigen::VectorXd> initial_states;
  NoiseLevels noise;
  double log_likelihood = 0.0;
  double readings = 0.0;  ///< that counted
};

struct ExtendedFitOptions {
  int max_iterations = 40;
  bool estimate_noise = true;
  bool hold_parameters = false;  ///< the runs' initial states are all that moves
  std::array<bool, kParameterCount> held{};
  /// Given up where, after the first descent, this is more than a few times what a step promises away.
  double least_log_likelihood = -std::numeric_limits<double>::infinity();
  ThreadBudget threads;  ///< for runs beside each other; the result is the same
};

/// The prediction error method (Procedure 3, on innovations) for a model with any effects: maximum likelihood
/// of parameters, initial states and noise by an extended Kalman filter over all of the model's states, the
/// torque's noise its only process noise. Starts at `start`, its noise included; its initial states are also
/// the centres of their weak prior. Choices stay as they are.
ExtendedEstimate fit_extended(std::span<const FitRun> runs, const ExtendedEstimate& start,
                              const ExtendedFitOptions& options = {});

/// A first estimate of the base model, by identify_prediction_error(). Not possible if that fails.
ExtendedEstimate fit_base(std::span<const Run> runs, const BrakeParameters& start,
                          const ThreadBudget& threads = {});

/// The same estimate with an effect more, at these values, or with one less.
ExtendedEstimate with_effect(const ExtendedEstimate& estimate, const EffectValues& effect);
ExtendedEstimate without_effect(const ExtendedEstimate& estimate, std::size_t index);

/// Log-likelihood at an estimate and what a Gauss-Newton step from there would make of it; the step itself,
/// of the parameters of ExtendedBrake, SI. Infinite and empty if the filter diverges.
struct StepForecast {
  double log_likelihood;
  double after_step;
  Eigen::VectorXd step;
  /// Standard deviations of the parameters; infinite where the data do not tell.
  Eigen::VectorXd sd;
};
StepForecast forecast(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                      const ThreadBudget& threads = {});

/// That of with_effect(estimate, effect) for each of several effects, all from one linearisation: at values
/// and settled states that change nothing, neither the brake's motion nor a reading nor another effect.
std::vector<StepForecast> forecast_each(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                        std::span<const EffectValues> effects,
                                        const ThreadBudget& threads = {});

/// The estimate's covariance, its standard deviations no smaller than what the runs tell by how far they
/// contradict each other, which also knows of errors that the model does not: the sandwich of White (1982)
/// over runs, without bias for few of them (Bell, McCaffrey 2002), the larger of both (Angrist, Pischke 2009,
/// 8.2). From fewer than five runs, and where it is not finite, as it is.
Eigen::MatrixXd covariance_over_runs(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                     const ThreadBudget& threads = {});

/// Runs filtered at an estimate. Innovations over their standard deviations: 1 and white if the model is
/// right.
struct FilteredRun {
  std::vector<double> force, velocity;  ///< innovation / standard deviation; NaN where it does not count
  std::vector<double> predicted_force_N, predicted_velocity_rad_s;  ///< one step ahead
  std::vector<double> position_rad, true_velocity_rad_s;            ///< of the model, the same
  std::vector<double> disturbance_Nm;                               ///< smoothed torque error of the row
  std::vector<double> simulated_force_N, simulated_velocity_rad_s;  ///< with the smoothed torque errors
  double log_likelihood = 0.0;
};
std::vector<FilteredRun> filter_runs(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
                                     const ThreadBudget& threads = {});

/// A disturbance that a free function would add: to the torque balance (N m), to the pads' force (N), to the
/// readings; one value a row and column.
struct SignalColumns {
  enum class Kind { Torque, Force, ForceReading, VelocityReading };
  Kind kind = Kind::Torque;
  std::vector<Eigen::MatrixXd> rows;  ///< per run: rows x columns
};

/// Score of each column at an estimate, the parameters and initial states following: with coefficients c the
/// log-likelihood grows by score . c - 1/2 c . information c.
struct SignalScores {
  Eigen::VectorXd score;
  Eigen::MatrixXd information;
  Eigen::VectorXd alone;  ///< the information's diagonal if nothing followed
};
/// Scores any number of signals against runs filtered once. Keeps references to runs and estimate.
class SignalScorer {
 public:
  SignalScorer(std::span<const FitRun> runs, const ExtendedEstimate& estimate,
               const ThreadBudget& threads = {});
  ~SignalScorer();
  SignalScorer(const SignalScorer&) = delete;
  SignalScorer& operator=(const SignalScorer&) = delete;

  /// `blocks`: information is computed within blocks of so many neighbouring columns only (0: everywhere).
  /// All zero if the filter diverges. May be called from several threads.
  SignalScores score(const SignalColumns& signals, int blocks = 0) const;

 private:
  struct Filtered;
  std::unique_ptr<const Filtered> filtered_;
};

}  // namespace clampd
