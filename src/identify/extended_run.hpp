#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "clampd/identify/extended_fit.hpp"
#include "src/identify/linear_run.hpp"

namespace clampd::identify {

/// The estimated parameters as the unknowns of a fit: logarithmic where a parameter is positive by nature,
/// scaled elsewhere.
class Unknowns {
 public:
  Unknowns(const ExtendedParameters& model, std::span<const ExtendedBrake::Place> places,
           const std::array<bool, kParameterCount>& held, bool hold_effects);

  int count() const { return static_cast<int>(free_.size()); }
  /// Index of unknown i among ExtendedBrake's parameters.
  int parameter(int i) const { return free_[static_cast<std::size_t>(i)].parameter; }
  double from(const ExtendedParameters& model, int i) const;
  /// d parameter / d unknown, at the model.
  double slope(const ExtendedParameters& model, int i) const;
  /// Within the parameter's bounds, whatever the unknown is.
  void put(double unknown, int i, ExtendedParameters& model) const;
  bool is_logarithmic(int i) const { return free_[static_cast<std::size_t>(i)].logarithmic; }
  /// Of the unknown, where the parameter is at a bound of its own.
  double lower(int i) const { return std::min(at_lower(i), at_upper(i)); }
  double upper(int i) const { return std::max(at_lower(i), at_upper(i)); }

 private:
  struct Free {
    int parameter;
    ExtendedBrake::Place place;
    bool logarithmic;
    double scale;  ///< of either sign
    double lower, upper;
  };
  double in_units(int i, double value) const;
  double at_lower(int i) const { return in_units(i, free_[static_cast<std::size_t>(i)].lower); }
  double at_upper(int i) const { return in_units(i, free_[static_cast<std::size_t>(i)].upper); }
  std::vector<Free> free_;
};

bool within_bounds(const ExtendedParameters& model);

/// Row k of a run, with what follows it.
RowInput row_input(const FitRun& run, std::size_t k) noexcept;

/// A run linearised row by row about the estimates of a filter, for a model with any number of states n, and
/// parameters p; readings are taken one after the other, force first. Locals: the unknowns of the run's
/// initial state. All matrices row-major, one after the other.
struct ExtendedRun {
  void resize(std::size_t rows, int states, int parameters, int initial_states);
  int columns() const { return parameters + initial_states + 1; }

  std::size_t rows = 0;
  int states = 0;
  int parameters = 0;
  int initial_states = 0;
  std::vector<double> transition;    ///< n x n
  std::vector<double> step;          ///< n x p
  std::vector<double> torque;        ///< n, of a torque error held over the row
  std::vector<double> by_state;      ///< 2 x n
  std::vector<double> by_parameter;  ///< 2 x p
  std::vector<double> residual;      ///< 2, at the reference
  std::vector<double> correction;    ///< n, of the reference by the row's readings
  std::vector<double> gain;          ///< 2 x n; zero where a reading does not count
  std::vector<double> variance;      ///< 2, of the innovations
  std::vector<double> reference;     ///< n, before the row's readings are used
  std::vector<double> initial;       ///< n x (initial_states + p), of the first state
  Eigen::VectorXd off;  ///< [J e] of the torque while the drive was off; empty if it is not known
  /// columns x 2 rows: [J e] over the standard deviation; zero where a reading does not count.
  Eigen::MatrixXd innovations;
  Eigen::MatrixXd normal;        ///< [J e]^T S^-1 [J e]
  double log_determinant = 0.0;  ///< sum of log variance
  double readings = 0.0;         ///< that count
};

/// Whether gains are the ones of an extended Kalman filter, found on the way, or as they are.
enum class Gains { Renewed, Kept };

/// False where the state leaves all bounds.
bool linearise(const FitRun& run, const ExtendedBrake& brake, const ExtendedParameters& model,
               const Unknowns& unknowns, const Eigen::VectorXd& initial, const Variances& variances,
               Gains gains, ExtendedRun& out);

/// The state at a run's first row, with these initial_states.
ExtendedBrake::State first_state(const FitRun& run, const ExtendedBrake& brake,
                                 const Eigen::VectorXd& initial);

/// The innovations' squares over their variance under the gains of a run linearised before: the last element
/// of its normal equations, without the derivatives and for a small part of the time. Infinite where the
/// state leaves all bounds.
double sum_of_squares_of(const FitRun& run, const ExtendedBrake& brake, const Eigen::VectorXd& initial,
                         const ExtendedRun& linearised);

/// [J e] and its normal equations under the gains.
void compute_normal(const FitRun& run, ExtendedRun& out);

/// Of the weak prior of a run's initial_states: position, velocity, then the effects' free states.
std::vector<double> prior_deviations(const ExtendedParameters& model);

/// Normal equations of parameters and data when the initial_states follow.
struct Reduced {
  Eigen::MatrixXd information;
  Eigen::VectorXd gradient;
  double sum_of_squares = 0.0;
};
/// `normal` with the prior of the initial_states in it.
Reduced without_initial_states(const Eigen::MatrixXd& normal, int parameters, int initial_states);

/// Rows as they are, gains for these variances; the innovations themselves into `innovation` (2 a row).
void recompute_gains(const FitRun& run, const Variances& variances, ExtendedRun& out,
                     std::vector<double>& innovation);

/// What the disturbance smoother says: the square of each noise's estimate over its expected square, summed
/// over the rows, in units of the inverse variances.
struct NoiseSquares {
  double force = 0.0, force_expected = 0.0;
  double velocity = 0.0, velocity_expected = 0.0;
  double torque = 0.0, torque_expected = 0.0;
};
/// After regain(); with `disturbance`, also each row's smoothed torque error over its variance.
NoiseSquares smooth(const FitRun& run, const ExtendedRun& filtered, const std::vector<double>& innovation,
                    std::vector<double>* disturbance);

/// Columns of signals as the filter's innovations see them, over the standard deviations: columns x 2 rows.
Eigen::MatrixXd filter_signals(const FitRun& run, const ExtendedRun& filtered, SignalColumns::Kind kind,
                               const Eigen::MatrixXd& signals, const ExtendedParameters& model);

}  // namespace clampd::identify
