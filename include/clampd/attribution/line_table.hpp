#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "clampd/attribution/crossed_effects.hpp"
#include "clampd/base/result.hpp"

namespace clampd::attribution {

/// One parameter of all checks.
struct ParameterReadings {
  std::string name;
  std::string unit;
  std::vector<double> values;
  std::vector<double> deviations;  ///< standard deviations that the identification reported
};

/// The valid checks of a line, of many stations.
struct LineTable {
  Layout layout;
  std::vector<std::string> stations;  ///< by their numbers
  std::vector<std::string> fixtures;  ///< "station / fixture"
  std::vector<std::string> batches;
  std::vector<std::string> brakes;  ///< serial numbers
  std::string part_number;          ///< of all checks
  std::vector<double> started_s;    ///< of each check, seconds since 1970
  double first_s = 0.0;             ///< start of the first check, seconds since 1970
  double last_s = 0.0;
  std::vector<ParameterReadings> parameters;

  std::size_t rows = 0;     ///< that were read
  std::size_t invalid = 0;  ///< of them neither PASS nor FAIL
  std::size_t voided = 0;
  std::size_t simulated = 0;   ///< left out beside real brakes
  std::size_t incomplete = 0;  ///< without a serial number, a station, a time, or one of the parameters
  std::size_t doubled = 0;     ///< records that were there already

  std::size_t checks() const { return layout.brake.size(); }
  /// When a period begins, seconds since 1970.
  double begin_of_period_s(int period) const {
    return first_s + (last_s - first_s) * period / (layout.periods > 0 ? layout.periods : 1);
  }
};

/// Reads what `clampctl results --csv` of several stations wrote. Columns in any order: record, serial,
/// part_number, batch, station, fixture, started, verdict, simulated, void, and a pair "NAME [unit]" and
/// "NAME sd [unit]" for each parameter; other columns are ignored. Errors say file and line,
/// or that there are fewer than `least` valid checks.
Result<LineTable> read_line_table(const std::vector<std::string>& files, std::size_t least = 10);

/// How many equal periods the time of so many checks at so many stations is divided into.
int periods_of(std::size_t checks, int stations);

}  // namespace clampd::attribution
