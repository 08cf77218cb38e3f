#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "clampd/base/parallel.hpp"
#include "src/identify/initial_state_prior.hpp"
#include "src/identify/minimiser.hpp"

namespace clampd::identify {

/// What the fits of any model have in common: the weighted innovations of all runs as a function of the
/// unknowns, for ceres::TinySolver, with gains that stay as they are. Each run's residuals are compressed to
/// the rows of the triangular factor of its [J e]: the same cost, gradient and Gauss-Newton matrix, and the
/// solver's work does not grow with the length of the runs.
///
/// Unknowns: parameters, then each run's initial_states. The points of the last evaluation and of the one
/// before are remembered: the solver asks for the cost of a step first and for the derivatives when it has
/// taken the step, and comes back where a step was no good.
///
/// A Fit derives from it and gives, all of them const and for run r:
///   is_possible(point)                             whether there is a model
///   model_at(point)                                that model
///   linearise_run(model, r, initial, linear)       false where the state leaves all bounds
///   normal_of_run(r, linear)                       its normal equations: any columns, initial_states, data
///   squares_of_run(model, r, initial)              what their last element is, without derivatives
///   normal_by_unknowns(r)                          now_.normals[r], each column's parameter as it is
///   searched column(i)                                      of parameter i in there
template <class Fit, class RecordedRun, class Linear, class Normal, class Initial>
class FitOfRuns {
 public:
  using Scalar = double;
  enum { NUM_RESIDUALS = Eigen::Dynamic, NUM_PARAMETERS = Eigen::Dynamic };
  using Point = Eigen::Ref<const Eigen::VectorXd>;  ///< the unknowns

  int NumParameters() const { return parameters_ + initial_states_ * static_cast<int>(runs_.size()); }
  int NumResiduals() const { return columns_ * static_cast<int>(runs_.size()); }

  bool operator()(const double* unknowns, double* residuals, double* jacobian) const {
    const Eigen::Map<const Eigen::VectorXd> point(unknowns, NumParameters());
    Eigen::Map<Eigen::VectorXd> residual_rows(residuals, NumResiduals());
    residual_rows.setZero();
    if (jacobian == nullptr) {
      residual_rows[0] = std::sqrt(std::min(cost_at(point), kImpossible));
      return true;
    }
    Eigen::Map<Eigen::MatrixXd> jacobian_rows(jacobian, NumResiduals(), NumParameters());
    jacobian_rows.setZero();
    if (!fit().evaluate(point)) {
      residual_rows[0] = std::sqrt(kImpossible);
      return true;
    }
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      const Normal factor = semidefinite_factor(fit().normal_by_unknowns(r));
      const auto row = static_cast<Eigen::Index>(r) * columns_;
      for (int i = 0; i < parameters_; ++i)
        jacobian_rows.col(i).segment(row, columns_) = factor.col(fit().column(i));
      jacobian_rows.block(row, first_of(r), columns_, initial_states_) =
          factor.middleCols(columns_ - 1 - initial_states_, initial_states_);
      residual_rows.segment(row, columns_) = factor.col(columns_ - 1);
    }
    return true;
  }

  /// Linearises all runs; false where that is impossible.
  bool evaluate(const Point& point) const {
    if (point == now_.point) return now_.possible;
    std::swap(now_, before_);
    if (point == now_.point) return now_.possible;
    return linearise_at(point, [&](const auto& model, std::size_t r, const Initial& initial, Linear& linear) {
      return fit().linearise_run(model, r, initial, linear);
    });
  }
  /// Whether points that are asked for their cost are mostly left again: then that is all that is computed.
  void try_out(bool mostly) { trying_ = mostly; }

  /// Of the point evaluated last.
  double sum_of_squares() const {
    double sum = 0.0;
    for (const Normal& normal : now_.normals) sum += normal(columns_ - 1, columns_ - 1);
    return sum;
  }
  const Normal& normal(std::size_t run) const { return now_.normals[run]; }
  std::span<Linear> linear_runs() { return now_.linear; }
  std::span<const Linear> linear_runs() const { return now_.linear; }
  /// Of a run's initial state from the centre of its prior.
  Initial prior_distance(std::size_t run) const { return initial_of(now_.point, run) - centres_[run]; }

  int parameters() const { return parameters_; }
  Initial initial_of(const Point& point, std::size_t run) const {
    return point.segment(first_of(run), initial_states_);
  }

 protected:
  struct Evaluation {
    std::vector<Linear> linear;
    std::vector<Normal> normals;  ///< with the priors of the initial states
    Eigen::VectorXd point;
    bool possible = false;
  };

  FitOfRuns(std::span<const RecordedRun> runs, const ThreadBudget& threads)
      : runs_(runs), threads_(threads), longest_first_(runs.size()), squares_(runs.size()) {
    std::iota(longest_first_.begin(), longest_first_.end(), 0);
    std::stable_sort(longest_first_.begin(), longest_first_.end(),
                     [&](std::size_t a, std::size_t b) { return runs[a].size() > runs[b].size(); });
  }
  /// `prior`: standard deviations of initial_states; `columns`: of a run's normal equations.
  /// `resize_run(run, linear)` makes room. Nothing allocates any more if sizes are fixed.
  template <class ResizeRun>
  void set_size(int parameters, std::span<const double> prior, int columns, const ResizeRun& resize_run) {
    parameters_ = parameters;
    initial_states_ = static_cast<int>(prior.size());
    prior_.assign(prior.begin(), prior.end());
    centres_.assign(runs_.size(), Initial::Zero(initial_states_));
    columns_ = columns;
    for (Evaluation* evaluation : {&now_, &before_}) {
      evaluation->linear.resize(runs_.size());
      for (std::size_t r = 0; r < runs_.size(); ++r) resize_run(runs_[r], evaluation->linear[r]);
      evaluation->normals.resize(runs_.size());
      evaluation->point.resize(NumParameters());
    }
    invalidate();
  }

  /// Index of a run's first unknown.
  Eigen::Index first_of(std::size_t run) const {
    return parameters_ + initial_states_ * static_cast<Eigen::Index>(run);
  }
  /// The longest first: no thread is left with one at the end.
  template <class Work>
  void for_each_run(const Work& work) const {
    for_each_index(runs_.size(), threads_, [&](std::size_t place) { work(longest_first_[place]); });
  }
  void invalidate() {
    for (Evaluation* evaluation : {&now_, &before_}) {
      evaluation->point.setConstant(std::numeric_limits<double>::quiet_NaN());
      evaluation->possible = false;
    }
  }
  /// now_ by `linearise_run` of the same arguments as the Fit's.
  template <class LineariseRun>
  bool linearise_at(const Point& point, const LineariseRun& linearise_run) const {
    now_.point = point;
    now_.possible = false;
    if (!fit().is_possible(point)) return false;
    const auto model = fit().model_at(point);
    std::atomic<bool> possible{true};
    for_each_run([&](std::size_t r) {
      if (possible && !(linearise_run(model, r, initial_of(point, r), now_.linear[r]) && weigh(r)))
        possible = false;
    });
    return now_.possible = possible;
  }
  /// The normal equations of a run that is linearised, under its gains. False if they cannot be used.
  bool weigh(std::size_t run) const {
    Normal& normal = now_.normals[run] = fit().normal_of_run(run, now_.linear[run]);
    add_prior(prior_, prior_distance(run), normal);
    return normal.allFinite();
  }

  std::span<const RecordedRun> runs_;
  ThreadBudget threads_;
  int parameters_ = 0, initial_states_ = 0, columns_ = 0;
  std::vector<double> prior_;
  std::vector<Initial> centres_;  ///< of the prior, per run
  mutable Evaluation now_, before_;

 private:
  const Fit& fit() const { return static_cast<const Fit&>(*this); }
  double cost_at(const Point& point) const {
    if (!trying_) return fit().evaluate(point) ? sum_of_squares() : kImpossible;
    if (!fit().is_possible(point)) return kImpossible;
    const auto model = fit().model_at(point);
    for_each_run([&](std::size_t r) {
      const Initial initial = initial_of(point, r);
      squares_[r] =
          fit().squares_of_run(model, r, initial) + prior_squares(prior_, Initial(initial - centres_[r]));
    });
    return std::accumulate(squares_.begin(), squares_.end(), 0.0);
  }

  std::vector<std::size_t> longest_first_;  ///< the runs
  mutable std::vector<double> squares_;     ///< of the runs, in cost_at()
  bool trying_ = false;
};

}  // namespace clampd::identify
