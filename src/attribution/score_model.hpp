#pragma once

#include <limits>
#include <vector>

#include "clampd/attribution/population.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::attribution {

/// Checks that are in both groups.
std::vector<int> common_checks(const CheckGroup& a, const CheckGroup& b);

/// A strength as the scores tell it.
struct Strength {
  double size = 0.0;
  /// By the information alone, to be multiplied by the overdispersion. Infinite: these checks do not tell it.
  /// Of stations, without what is elsewhere, which moves all of them together: common_variance().
  double variance = std::numeric_limits<double>::infinity();
  /// By how much the other strengths of the model move the size.
  double moved = 0.0;
  /// What a typical check shows of the largest other strength that the same checks have, in its standard
  /// deviations.
  double largest_beside = 0.0;

  bool is_known() const { return variance < std::numeric_limits<double>::infinity(); }
};

/// A linear model of the scores: stations have levels in some directions, fixtures, batches and the line have
/// others. It is asked about one direction after the other.
class ScoreModel {
 public:
  explicit ScoreModel(const PopulationTable& table);

  /// No station has levels, no group has anything.
  void clear();
  /// Each station has a level of its own in it.
  void let_stations_differ(int direction);
  /// A group has it.
  void add(const PopulationFinding::Suspect& suspect);

  struct Fit;
  /// The model with, besides, a level of each station in this direction.
  Fit fit(int direction) const;
  /// Beside those levels, what a fixture or a batch has more of it than the others.
  Strength of_group(const Fit& fit, int group) const;
  /// What a sum of the stations' strengths, with these weights, has of variance from what is elsewhere.
  double common_variance(const Fit& fit, const Eigen::VectorXd& weights) const;

  /// What a strength of one moves a typical check by, in its standard deviations.
  double of_one_check(int direction) const { return of_one_check_[static_cast<std::size_t>(direction)]; }
  std::size_t stations() const { return stations_.size(); }
  /// Its number among the table's groups; -1: checks of no station.
  int group_of(std::size_t station) const { return stations_[station].group; }
  Eigen::Index checks() const { return score_.rows(); }
  /// Scores over the root of their information, less their station's mean: checks x directions.
  const Eigen::MatrixXd& standardised() const { return standardised_; }

 private:
  struct Station {
    int group = -1;
    std::vector<int> checks;
    Eigen::MatrixXd information;
    Eigen::VectorXd score;
    std::vector<int> levels;  ///< directions
  };
  struct Column;

  void group_by_station();
  void move_far_checks_nearer();
  Column column(const Fit& fit, const PopulationFinding::Suspect& suspect) const;
  double shared(const Fit& fit, const Column& a, const Column& b) const;
  double own_score(const Fit& fit, const Column& column) const;
  void fit_levels(Fit& fit) const;
  void estimate_overdispersion(Fit& fit) const;

  const PopulationTable& table_;
  Eigen::MatrixXd score_;
  Eigen::MatrixXd standardised_;
  std::vector<double> of_one_check_;
  std::vector<Station> stations_;
  std::vector<int> station_of_;                        ///< by check
  std::vector<PopulationFinding::Suspect> elsewhere_;  ///< what the line, fixtures and batches have
};

/// Sums over a group's checks, and what the stations' levels have of them.
struct ScoreModel::Column {
  PopulationFinding::Suspect suspect;
  double score = 0.0, information = 0.0;
  std::vector<Eigen::VectorXd> across;  ///< by station, with each of its levels; empty: no checks there
};

struct ScoreModel::Fit {
  struct AtStation {
    std::vector<int> levels;  ///< the direction asked about among them
    Eigen::Index at = 0;      ///< which of them that is
    Eigen::VectorXd score;
    statistics::ScaledFactor information;
    Eigen::VectorXd strengths;
    Eigen::VectorXd weights;  ///< of the levels' scores in the level asked about, which has 1
    Eigen::VectorXd moved_by_elsewhere;
    Strength strength;  ///< of the direction asked about
  };
  int direction = 0;
  std::vector<AtStation> stations;
  std::vector<Column> elsewhere;  ///< that the levels leave something of
  statistics::ScaledFactor information_elsewhere;
  Eigen::VectorXd strengths_elsewhere;
  double overdispersion = 1.0;  ///< of the variance
  double degrees = 1.0;         ///< by how many it is known
};

}  // namespace clampd::attribution
