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

/// What the checks of a line say about the directions. Strengths d of a check grow its log-likelihood by
/// score . d - 1/2 d . information d.
struct PopulationTable {
  std::vector<Direction> directions;
  Eigen::MatrixXd score;                     ///< checks x directions, 1/unit
  std::vector<Eigen::MatrixXf> information;  ///< of each check; a row of zeros: it does not show that one
  std::vector<CheckGroup> groups;            ///< Line first, with all checks; a check is in one station's
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

/// A direction in which stations differ from each other, none of them alone.
struct StationDifference {
  int direction = 0;
  double sd = 0.0;            ///< of the stations' strengths, beyond what their checks leave open
  double p = 1.0;             ///< probability of as much without a cause, for this one test
  double of_one_check = 0.0;  ///< what a typical check shows of that deviation
  struct Level {
    int group = 0;
    double size = 0.0;  ///< against the stations' mean
    double sd = 0.0;
  };
  std::vector<Level> levels;  ///< of each station that was looked at, beside everything that was found
  std::vector<int> rivals;    ///< directions that these checks do not tell from it
};

struct PopulationOptions {
  double false_alarms = 0.01;  ///< the probability that anything is found where there is nothing
  int most_findings = 20;
};

struct PopulationResult {
  std::vector<PopulationFinding> findings;     ///< in the order in which they were found, the strongest first
  std::vector<StationDifference> differences;  ///< the same
  double tests = 0.0;                          ///< independent directions times what each was asked about
  int groups_too_small = 0;
  /// Per direction: by how much more the scores differ from check to check than their information says. 1:
  /// not at all.
  Eigen::VectorXd overdispersion;
};

/// Groups with fewer checks, or that leave fewer to compare with, are not looked at.
inline constexpr int kFewestOfGroup = 5;

/// Evidence summed over checks (docs/population.md): forward selection among all directions and groups, by t
/// statistics whose variance is the one that the scores show from check to check.
PopulationResult attribute_effects(const PopulationTable& table, const PopulationOptions& options = {});

}  // namespace clampd::attribution
