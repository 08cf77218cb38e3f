#pragma once

#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "src/identify/noise_estimation.hpp"

namespace clampd::identify {

/// Where the output error method ended from one start.
struct OutputErrorAttempt {
  Eigen::VectorXd unknowns;
  Variances weights;  ///< R of the fit, by (9) or as known
  /// Negative log-likelihood per row; infinite if the model cannot be simulated there.
  double score = std::numeric_limits<double>::infinity();
  std::optional<NoiseFit> noise;  ///< of readings and torque there, if it was looked for
  double promised = 0.0;  ///< what the slopes there promise still to gain: at a kink, where they are wrong,
                          ///< or before the end
  bool settled = false;           ///< neither cost nor noise changed any more before the iterations ran out
};

/// Whether a parameter that is to be estimated, and cannot be zero, has all but vanished.
bool has_vanished(const ParameterVector& theta, const Held& held);

/// The same brake with what has vanished as it is in the nominal one.
ParameterVector revived(ParameterVector theta, const Held& held);

/// The output error method's fits from several starts.
class OutputErrorSearch {
 public:
  OutputErrorSearch(std::span<const Run> runs, const EstimatorOptions& options);

  /// From the given start only; made once.
  OutputErrorAttempt& first();
  /// From others, too, where the first one is poor; made once.
  OutputErrorAttempt& best();
  /// Unlike starts, worst last, for what the given one cannot reach. Nothing where `index` is not a sensible
  /// brake.
  static constexpr int kOtherStarts = 5;
  std::optional<ParameterVector> other_start(int index);
  /// Neither white noise on the readings nor that with torque noise explains the residuals there.
  bool poor(OutputErrorAttempt& attempt);
  /// Poor, or explained by torque noise only, which is blamed for a wrong minimum just as well, or beside a
  /// parameter that has all but vanished: what other starts find is to be compared.
  bool doubtful(OutputErrorAttempt& attempt);
  /// Finds attempt.noise.
  const NoiseFit& noise_at(OutputErrorAttempt& attempt);
  /// Of the readings; of the torque, a guess.
  Variances variances_without_model() const;
  /// No more than what is seen without any model.
  bool plausible(const Variances& variances) const;
  /// The fit, evaluated at an attempt's result.
  JointFit& fit_at(const OutputErrorAttempt& attempt);
  int iterations() const { return iterations_; }

 private:
  OutputErrorAttempt attempt(const ParameterVector& theta);
  OutputErrorAttempt best_of_all_starts();
  /// Near the right minimum, more often than not, from a start that is not.
  ParameterVector filtered_start(const ParameterVector& theta);
  bool is_nominal_start() const { return options_.start.theta == nominal_parameters(); }
  Variances known_or(const Eigen::Vector2d& mean_squares) const;

  std::span<const Run> runs_;
  const EstimatorOptions& options_;
  JointFit fit_;
  Minimiser minimise_;
  Variances seen_;  ///< without a model
  std::optional<ParameterVector> by_equation_error_;
  std::optional<OutputErrorAttempt> first_, best_;
  int iterations_ = 0;
};

/// What an attempt of the search comes to.
Estimate output_error_estimate(OutputErrorSearch& search, OutputErrorAttempt& attempt,
                               const EstimatorOptions& options);

/// identify_prediction_error() of runs and options that check_input() has passed, after the output error
/// method's search of the same.
Estimate prediction_error_estimate(OutputErrorSearch& output_errors, std::span<const Run> runs,
                                   const EstimatorOptions& options);

}  // namespace clampd::identify
