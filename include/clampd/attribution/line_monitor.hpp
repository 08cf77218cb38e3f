#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "clampd/attribution/change_detector.hpp"
#include "clampd/attribution/line_table.hpp"

namespace clampd::attribution {

inline constexpr double kDay_s = 86400.0;

struct Alarm {
  double raised_s = 0.0;  ///< end of the day whose checks raised it, seconds since 1970
  ChangeDetector::Change change;
  double evidence = 0.0;
};

/// One station in one parameter.
struct StationMonitor {
  ChangeDetector detector;
  std::optional<Alarm> alarm;
  double level = 0.0;  ///< by least squares over all comparisons with other stations
  int days = 0;        ///< on which it was compared
  /// Comparisons that are too few for a reading wait here.
  double pending_information = 0.0;
  double pending_sum = 0.0;
  double usual_variance = 0.0;  ///< of the first reading; the others count in it
  /// Sums over its readings by which its spread from day to day is estimated (DerSimonian and Laird 1986).
  double information = 0.0, squared_information = 0.0, mean = 0.0, squares = 0.0;
};

struct ParameterMonitor {
  std::string name;
  std::string unit;
  double within_squares = 0.0;  ///< of checks about the mean of their station, day and batch
  double within_degrees = 0.0;
  /// Comparisons of two stations: how much they weigh (symmetric), and the weighted differences.
  Eigen::MatrixXd comparisons;
  Eigen::MatrixXd differences;
  std::vector<StationMonitor> stations;
};

/// Everything that the monitor remembers.
struct LineMonitor {
  double false_alarms_per_year = 1.0;  ///< of the whole line, on average, at most
  std::string part_number;
  std::vector<std::string> stations;
  std::vector<double> last_s;                      ///< of each station, the last check that was counted
  std::int64_t last_day = -1;                      ///< that was counted, since 1970
  std::map<std::string, std::int64_t> brakes_day;  ///< when each brake was last seen; the latest kMostBrakes
  std::vector<ParameterMonitor> parameters;

  static constexpr std::size_t kMostBrakes = 100000;

  /// An alarm is raised where the evidence reaches it: days of all detectors in a year, divided by the alarms
  /// allowed.
  double threshold() const;
};

struct MonitorCount {
  std::size_t counted = 0;
  std::size_t before = 0;    ///< of days that were counted earlier
  std::size_t late = 0;      ///< of them newer than what had been counted of their station
  std::size_t waiting = 0;   ///< of the last day, which may not be over
  std::size_t repeated = 0;  ///< of brakes that were seen before
  std::size_t alone = 0;     ///< no other station checked that batch on that day
};

/// Counts the checks of all days but the last one, which are newer than what was counted. Fails, and changes
/// nothing, where the table has other parameters or another part number.
Result<MonitorCount> monitor(LineMonitor& line, const LineTable& table);

/// A cause was mended: the station's detector and level begin anew. Fails where there is no such station or
/// parameter, or no alarm.
Result<void> acknowledge(LineMonitor& line, const std::string& station, const std::string& parameter);

}  // namespace clampd::attribution
