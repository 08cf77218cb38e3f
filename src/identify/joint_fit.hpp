#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/identify/estimate.hpp"
#include "src/identify/fit_of_runs.hpp"
#include "src/identify/joint_normal.hpp"

namespace clampd::identify {

/// Whether a series of reading pairs hangs together more than white noise would once in some thousand cases:
/// the sum of its first three autocorrelations, of each reading.
class LagSums {
 public:
  void start_run() { before_ = 0; }
  void add(const Eigen::Vector2d& residual);
  bool white() const;

 private:
  static constexpr int kLags = 3;
  Eigen::Vector2d past_[kLags];
  int before_ = 0;
  double rows_ = 0.0;
  Eigen::Vector2d square_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d lagged_ = Eigen::Vector2d::Zero();
};

bool within_bounds(const ParameterVector& theta);

/// The fit of the paper's brake: open-loop, or the innovations of filters with gains that stay as they are.
/// Sized once, an evaluation allocates nothing.
///
/// Unknowns: the parameters that are not held, logarithmic where they cannot change sign (all but k1, which
/// is normalised by (11)); then two a run for its initial state. Normal equations have all parameters, each
/// normalised.
class JointFit : public FitOfRuns<JointFit, Run, LinearRun, Normal, Eigen::Vector2d> {
 public:
  JointFit(std::span<const Run> runs, const EstimatorOptions& options);

  /// The cost is impossible beyond kReach of where stay_near() was told.
  bool operator()(const double* unknowns, double* residuals, double* jacobian) const;
  /// The solver's next steps begin here.
  void stay_near(const Eigen::VectorXd& unknowns) { anchor_ = unknowns; }

  /// After a held parameter's start value has changed in the options.
  void forget() { invalidate(); }

  /// Unknowns at theta, each run at its guessed initial state; that guess is the centre of its weak prior.
  Eigen::VectorXd start_from(const ParameterVector& theta);
  Eigen::VectorXd unknowns_of(const ParameterVector& theta, std::span<const Eigen::Vector2d> initial) const;
  ParameterVector theta_of(const Point& unknowns) const;

  /// Open-loop from here on, readings weighted with R.
  void use_output_errors(const Variances& variances);
  /// After something else used the runs' gains; the last evaluation stays valid.
  void restore_output_errors();
  /// Innovations from here on, with the gains of extended Kalman filters at these unknowns, where it is
  /// evaluated then. False, and no use until something else is used, if a filter diverges there.
  bool use_innovations(const Eigen::VectorXd& unknowns, const Variances& variances);
  const Variances& variances() const { return variances_; }

  /// Huber weights from the last evaluated point's residuals; the largest change of a weight.
  double update_weights();

  /// Of the last evaluated point.
  double log_likelihood() const;
  /// By how much a Gauss-Newton step would lower sum_of_squares().
  double expected_decrease() const;
  /// That step, into NumParameters() rows.
  void gauss_newton_step(Eigen::VectorXd& step) const;
  JointNormal joint_normal(const Held& held) const { return eliminate_initial_states(now_.normals, held); }
  const Run& run(std::size_t run) const { return runs_[run]; }
  BrakeParameters brake() const { return model_at(now_.point); }
  Eigen::Vector2d initial(std::size_t run) const { return initial_of(now_.point, run); }
  bool uses_innovations() const { return innovations_; }
  /// Mean squared residuals (force N^2, velocity rad^2/s^2), weighted if the loss is robust: (9), its
  /// diagonal.
  Eigen::Vector2d mean_squares() const;
  Eigen::Vector2d mean_squares(std::size_t run) const;
  bool white() const;
  std::vector<Eigen::Vector2d> prior_distances() const;
  std::span<const ReadingWeights> weights() const { return weights_; }

 private:
  friend FitOfRuns;
  bool is_possible(const Point& unknowns) const { return within_bounds(theta_of(unknowns)); }
  BrakeParameters model_at(const Point& unknowns) const { return {theta_of(unknowns), options_.start.fixed}; }
  bool linearise_run(const BrakeParameters& parameters, std::size_t r, const Eigen::Vector2d& initial,
                     LinearRun& linear) const {
    return innovations_ ? linearise_with_gains(runs_[r], parameters, initial, linear)
                        : linearise(runs_[r], parameters, initial, linear);
  }
  Normal normal_of_run(std::size_t, LinearRun& linear) const { return normal_equations(linear); }
  double squares_of_run(const BrakeParameters& parameters, std::size_t r,
                        const Eigen::Vector2d& initial) const {
    return sum_of_squares_of(runs_[r], parameters, initial, now_.linear[r].gains);
  }
  Normal normal_by_unknowns(std::size_t r) const;
  int column(int i) const { return free_[static_cast<std::size_t>(i)]; }

  bool is_within_reach(const double* unknowns) const;
  void use_output_error_gains(Evaluation& evaluation);
  void weigh_all();

  const EstimatorOptions& options_;
  std::vector<int> free_;  ///< the parameters that are not held
  Variances variances_;
  std::vector<ReadingWeights> weights_;
  bool innovations_ = false;
  Eigen::VectorXd anchor_;
};

using Minimiser = MinimiserOf<JointFit>;

}  // namespace clampd::identify
