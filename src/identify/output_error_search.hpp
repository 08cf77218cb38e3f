#pragma once

#include <limits>
#include <span>

#include "src/identify/joint_fit.hpp"

namespace clampd::identify {

/// Where the output error method ended from one start.
struct OutputErrorAttempt {
  Eigen::VectorXd unknowns;
  Variances weights;  ///< R of the fit, by (9) or as known
  /// Negative log-likelihood per row; infinite if the model cannot be simulated there.
  double score = std::numeric_limits<double>::infinity();
  bool settled = false;  ///< neither cost nor noise changed any more before the iterations ran out
};

/// The output error method's fits from several starts.
class OutputErrorSearch {
 public:
  OutputErrorSearch(std::span<const Run> runs, const EstimatorOptions& options);

  OutputErrorAttempt best();
  /// The fit, evaluated at an attempt's result.
  JointFit& fit_at(const OutputErrorAttempt& attempt);
  int iterations() const { return iterations_; }

 private:
  OutputErrorAttempt attempt(const ParameterVector& theta);
  /// Near the right minimum, more often than not, from a start that is not.
  ParameterVector filtered_start(const ParameterVector& theta);
  bool poor(const OutputErrorAttempt& attempt);
  Variances known_or(const Eigen::Vector2d& mean_squares) const;

  std::span<const Run> runs_;
  const EstimatorOptions& options_;
  JointFit fit_;
  Minimiser minimise_;
  Variances seen_;  ///< without a model
  int iterations_ = 0;
};

}  // namespace clampd::identify
