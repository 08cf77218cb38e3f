#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/identify/estimate.hpp"
#include "src/identify/joint_normal.hpp"
#include "src/identify/minimiser.hpp"

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

/// The weighted residuals of all runs as a function of the unknowns, for ceres::TinySolver: open-loop, or the
/// innovations of filters with gains that stay as they are. Each run's 2n residuals are compressed to the ten
/// rows of the triangular factor of [J e]: the same cost, gradient and Gauss-Newton matrix, and the solver's
/// work no longer grows with n.
///
/// Unknowns: the parameters that are not held, logarithmic where they cannot change sign (all but k1, which
/// is normalised by (11)); then two a run for its initial state.
class JointFit {
 public:
  using Scalar = double;
  enum { NUM_RESIDUALS = Eigen::Dynamic, NUM_PARAMETERS = Eigen::Dynamic };

  JointFit(std::span<const Run> runs, const EstimatorOptions& options);

  int NumParameters() const { return free_ + 2 * static_cast<int>(runs_.size()); }
  int NumResiduals() const { return (kUnknowns + 1) * static_cast<int>(runs_.size()); }
  /// Impossible beyond kReach of where stay_near() was told.
  bool operator()(const double* unknowns, double* residuals, double* jacobian) const;
  /// The solver's next steps begin here.
  void stay_near(const Eigen::VectorXd& unknowns) { anchor_ = unknowns; }

  /// After a held parameter's start value has changed in the options.
  void forget() { invalidate(); }

  /// Unknowns at theta, each run at its guessed initial state; that guess is the centre of its weak prior.
  Eigen::VectorXd start_from(const ParameterVector& theta);
  Eigen::VectorXd unknowns_of(const ParameterVector& theta, std::span<const Eigen::Vector2d> initial) const;
  ParameterVector theta_of(const Eigen::VectorXd& unknowns) const;
  Eigen::Vector2d initial_of(const Eigen::VectorXd& unknowns, std::size_t run) const;

  /// Open-loop from here on, readings weighted with R.
  void use_output_errors(const Variances& variances);
  /// After something else used the runs' gains; the last evaluation stays valid.
  void restore_output_errors();
  /// Innovations from here on, with the gains of extended Kalman filters at these unknowns. False, and
  /// nothing changed for good, if a filter diverges there.
  bool use_innovations(const Eigen::VectorXd& unknowns, const Variances& variances);
  const Variances& variances() const { return variances_; }

  /// Huber weights from the last evaluated point's residuals; the largest change of a weight.
  double update_weights();

  /// Linearises all runs; false where that is impossible. Remembers the last point: the solver asks for the
  /// cost of a step first and for the derivatives when it has taken the step.
  bool evaluate(const Eigen::VectorXd& unknowns) const;

  /// Of the last evaluated point.
  double sum_of_squares() const;
  double log_likelihood() const;
  /// By how much a Gauss-Newton step would lower sum_of_squares().
  double expected_decrease() const;
  /// That step, into NumParameters() rows.
  void gauss_newton_step(Eigen::VectorXd& step) const;
  JointNormal joint_normal(const Held& held) const { return eliminate_initial_states(now_.normals, held); }
  const Normal& normal(std::size_t run) const { return now_.normals[run]; }
  const Run& run(std::size_t run) const { return runs_[run]; }
  BrakeParameters parameters() const { return {theta_of(now_.unknowns), options_.start.fixed}; }
  Eigen::Vector2d initial(std::size_t run) const { return initial_of(now_.unknowns, run); }
  bool uses_innovations() const { return innovations_; }
  /// Mean squared residuals (force N^2, velocity rad^2/s^2), weighted if the loss is robust: (9), its
  /// diagonal.
  Eigen::Vector2d mean_squares() const;
  Eigen::Vector2d mean_squares(std::size_t run) const;
  bool white() const;
  /// How far each run's initial state is from the centre of its prior.
  std::vector<Eigen::Vector2d> prior_distances() const;
  std::span<LinearRun> linear_runs() { return now_.linear; }
  std::span<const LinearRun> linear_runs() const { return now_.linear; }
  std::span<const ReadingWeights> weights() const { return weights_; }

 private:
  struct Evaluation {
    std::vector<LinearRun> linear;
    std::vector<Normal> normals;
    Eigen::VectorXd unknowns;
    ParameterVector normalised;
    bool possible = false;
  };

  bool evaluate(const double* unknowns) const;
  bool is_within_reach(const double* unknowns) const;
  void weigh() const;
  void set_output_error_gains(Evaluation& evaluation);
  void invalidate();

  std::span<const Run> runs_;
  const EstimatorOptions& options_;
  int free_ = 0;
  Variances variances_;
  std::vector<ReadingWeights> weights_;
  std::vector<Eigen::Vector2d> guesses_;
  bool innovations_ = false;
  Eigen::VectorXd anchor_;
  /// The last evaluation and the one before: the solver comes back to the latter when a step was no good.
  mutable Evaluation now_, before_;
};

bool within_bounds(const ParameterVector& theta);

using Minimiser = MinimiserOf<JointFit>;

}  // namespace clampd::identify
