#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

namespace clampd::attribution {

/// A strength of an effect that all checks were asked about.
struct Direction {
  std::string name;  ///< for people and scripts, unique
  std::string unit;
  bool is_one_sided = false;  ///< less than nothing has no meaning
};

/// Checks that have something in common which may be at fault.
struct CheckGroup {
  enum class Kind { Line, Station, Fixture, Batch };
  Kind kind = Kind::Line;
  std::string name;         ///< empty for the line
  std::vector<int> checks;  ///< numbers of its rows, ascending
};

/// What the checks of a line say about each direction: rows are checks, columns directions.
struct PopulationTable {
  std::vector<Direction> directions;
  Eigen::MatrixXd score;           ///< slope of the log-likelihood where the strength is neutral, 1/unit
  Eigen::MatrixXd information;     ///< of the strength, 1/unit^2; 0: this check does not show it
  std::vector<CheckGroup> groups;  ///< Line first, with all checks
};

/// A direction that a group of checks has, none of which may show it by itself.
struct PopulationFinding {
  struct Suspect {
    int direction = 0;
    int group = 0;

    bool operator==(const Suspect&) const = default;
  };
  Suspect suspect;
  double size = 0.0;  ///< the mean strength; of a station, fixture or batch against the others
  double sd = 0.0;
  double t = 0.0;               ///< size over sd
  double p = 1.0;               ///< probability of as much without a cause, for this one test
  double of_one_check = 0.0;    ///< what a typical check of the group shows of it: size over its own sd
  std::vector<Suspect> rivals;  ///< that these checks do not tell from it, the likeliest first
};

struct PopulationOptions {
  double false_alarms = 0.01;  ///< the probability that anything is found where there is nothing
  int most_findings = 20;
};

struct PopulationResult {
  std::vector<PopulationFinding> findings;  ///< in the order in which they were found, the strongest first
  double tests = 0.0;                       ///< independent directions times groups that were large enough
  int groups_too_small = 0;
  /// Per direction: by how much more the scores differ from check to check than their information says. 1:
  /// not at all.
  Eigen::VectorXd overdispersion;
};

/// Groups with fewer checks, or that leave fewer to compare with, are not looked at.
inline constexpr int kFewestOfGroup = 5;

/// An effect that a single check shows to so many of its standard deviations is no faint one: beside it, nothing else is looked for in
/// its group, since scores are linear and their correlations those of small effects.
inline constexpr double kShownByOneCheck = 2.0;

/// Evidence summed over checks (docs/population.md): forward selection among all directions and groups, by t
/// statistics whose variance is the one that the scores show from check to check.
PopulationResult attribute_effects(const PopulationTable& table, const PopulationOptions& options = {});

}  // namespace clampd::attribution
