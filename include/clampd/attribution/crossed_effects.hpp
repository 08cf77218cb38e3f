#pragma once

#include <cstdint>
#include <initializer_list>
#include <utility>
#include <vector>

#include <Eigen/Core>

namespace clampd::attribution {

/// Who made, carried and checked what: the levels of every check, by number from 0. All parameters of the
/// checks share them.
struct Layout {
  std::vector<std::int32_t> brake;    ///< of each check
  std::vector<std::int32_t> batch;    ///< of each check; -1: not known
  std::vector<std::int32_t> station;  ///< of each check
  std::vector<std::int32_t> fixture;  ///< of each check; a fixture of one station is not that of another
  std::vector<std::int32_t>
      period;  ///< of each check: equal parts of the time from the first check to the last
  int brakes = 0;
  int batches = 0;
  int stations = 0;
  int fixtures = 0;
  int periods = 1;
};

/// Standard deviations of the random effects, in the unit of the readings. Those that the data cannot have
/// are zero.
struct Deviations {
  double repeat = 0.0;   ///< of checks of one brake at one station, beyond what identification says of itself
  double brake = 0.0;    ///< of brakes of one batch
  double batch = 0.0;    ///< of part batches
  double station = 0.0;  ///< of stations, as long as they are used
  double fixture = 0.0;  ///< of a station's fixtures
  double period = 0.0;   ///< of periods, the same at all stations
  double wander = 0.0;   ///< of a station's periods
};

/// Which of them the data can have, by the layout alone.
struct Components {
  bool repeat = false;  ///< otherwise it is a part of `brake`: no brakes were checked twice
  bool batch = false;
  bool station = false;
  bool fixture = false;
  bool period = false;
  bool wander = false;
};

/// A change that is held against a model without it: what it adds to each cell (see CrossedEffects).
struct Change {
  Eigen::VectorXd shape;  ///< per cell
};

/// Predictions of the random effects, and how well they are known.
struct Levels {
  Eigen::VectorXd station;           ///< best linear unbiased predictions, per station, of zero mean
  Eigen::VectorXd station_variance;  ///< what is left of their variance, given the data
  Eigen::VectorXd batch;             ///< the same, per batch
  Eigen::VectorXd batch_variance;
};

/// How much a change would explain.
struct Evidence {
  double size = 0.0;  ///< in the unit of the readings
  double sd = 0.0;
  double z() const { return sd > 0.0 ? size / sd : 0.0; }
};

/// The linear mixed model of one parameter over a line:
///
///   reading = mean + changes + brake + batch + station + fixture + period + station's period + repeat,
///
/// all random but the mean and the named changes, each reading with the variance that its identification
/// reported beside the variance of a repeat. Variances by restricted maximum likelihood (Patterson and
/// Thompson 1971), levels by Henderson's equations (1975). Brakes and batches are eliminated one after
/// another (Schur complements of rank one), so that a likelihood costs one pass over the checks and one
/// factorisation of the size of the *cells*: what has a station, a fixture and a period in common.
class CrossedEffects {
 public:
  /// Readings and their standard deviations, in the order of `layout`, which must outlive this. At least
  /// three checks.
  CrossedEffects(const Layout& layout, const std::vector<double>& readings,
                 const std::vector<double>& deviations);

  int cells() const { return static_cast<int>(cell_station_.size()); }
  int station_of(int cell) const { return cell_station_[static_cast<std::size_t>(cell)]; }
  int period_of(int cell) const { return cell_period_[static_cast<std::size_t>(cell)]; }
  int fixture_of(int cell) const { return cell_fixture_[static_cast<std::size_t>(cell)]; }
  const Components& components() const { return components_; }

  /// Minus twice the restricted log likelihood, up to a constant that the deviations do not change. Infinite
  /// where rounding leaves no positive definite matrix.
  double deviance(const Deviations& deviations) const;

  /// The most likely deviations, from a start that the spread of the readings gives. False: no convergence.
  bool fit();
  /// The most likely deviations if these components had none. Those of the model stay.
  Deviations fit_without(std::initializer_list<bool Components::*> components);
  /// Minus twice the restricted log likelihood and its derivatives by the logarithm of each deviation, in the
  /// order of their members; zero for those that the data cannot have.
  double deviance(const Deviations& deviations, std::vector<double>& slopes) const;
  const Deviations& deviations() const { return deviations_; }
  /// For tests, and for what is fitted already.
  void set_deviations(const Deviations& deviations) { deviations_ = deviations; }

  /// Adds a change to the mean; the deviations stay.
  void add_change(Change change) { changes_.push_back(std::move(change)); }
  void drop_changes() { changes_.clear(); }

  /// Evidence for each change beside those that were added: the score test at the fitted deviations, and the
  /// size that it implies.
  std::vector<Evidence> evidence(const std::vector<Change>& candidates) const;

  /// Levels of stations and batches at the fitted deviations.
  Levels levels() const;

  double mean() const;  ///< of the line, by generalised least squares, without the named changes

 private:
  struct Reduced;
  struct Solution;

  Reduced reduce(const Deviations& deviations, bool keep_batches) const;
  void add_repeated_brake(std::size_t brake, const Deviations& deviations, Reduced& reduced) const;
  Solution solve(const Reduced& reduced, const Deviations& deviations) const;
  void number_cells();
  void sort_checks(const std::vector<double>& readings, const std::vector<double>& deviations);
  void find_components();
  const Layout& layout_;
  Components components_;
  std::vector<Change> changes_;
  Deviations deviations_;
  double shift_ = 0.0;  ///< is taken from the readings, and they are divided by
  double scale_ = 1.0;  ///< so that rounding does not depend on their unit

  /// Checks sorted by batch, then brake.
  std::vector<double> reading_;
  std::vector<double> variance_;
  std::vector<std::int32_t> cell_;
  struct Brake {
    std::size_t begin, end;
  };
  struct Batch {
    std::size_t first_brake, last_brake;
    std::int32_t number;  ///< -1: brakes without a batch
  };
  std::vector<Brake> brake_;
  std::vector<Batch> batch_;
  std::size_t repeated_ = 0;  ///< checks beyond the first one of each brake

  std::vector<std::int32_t> cell_station_, cell_fixture_, cell_period_;
  std::vector<std::int32_t> cell_of_check_;  ///< in the layout's order
};

}  // namespace clampd::attribution
