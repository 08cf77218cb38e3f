#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
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

/// A valid check (PASS or FAIL, not void) on its way into a table.
struct LineCheck {
  std::string_view record;  ///< its id; empty: it is not known whether it comes twice
  std::string_view serial;
  std::string_view batch;    ///< empty: not known
  std::string_view station;
  std::string_view fixture;  ///< empty: the station has one
  double started_s = 0.0;    ///< seconds since 1970
  bool simulated = false;
  /// Of each parameter, in the order in which they were added: the value and its standard deviation.
  std::span<const std::pair<double, double>> readings;
};

/// Makes a table of the checks of one part number, one after another.
class LineTableBuilder {
 public:
  LineTableBuilder();
  ~LineTableBuilder();
  LineTableBuilder(const LineTableBuilder&) = delete;
  LineTableBuilder& operator=(const LineTableBuilder&) = delete;

  /// Its number. All parameters before the first check.
  std::size_t add_parameter(const std::string& name, const std::string& unit);
  void add(const LineCheck& check);
  /// Counts a row that becomes no check: &LineTable::invalid, voided or incomplete.
  void leave_out(std::size_t LineTable::*why);
  /// What was added so far, not yet numbered.
  const LineTable& table() const { return table_; }
  /// Ends it. Simulated brakes stay only where there are no others. Error: fewer than `least` valid checks.
  Result<LineTable> finish(std::string part_number, std::size_t least);

 private:
  class Names;
  struct Seen;
  void leave_out_simulated();
  void divide_time();

  LineTable table_;
  std::unique_ptr<Seen> seen_;
};

/// Reads what `clampctl results --csv` of several stations wrote. Columns in any order: record, serial,
/// part_number, batch, station, fixture, started, verdict, simulated, void, and a pair "NAME [unit]" and
/// "NAME sd [unit]" for each parameter; other columns are ignored. Errors say file and line,
/// or that there are fewer than `least` valid checks.
Result<LineTable> read_line_table(const std::vector<std::string>& files, std::size_t least = 10);

/// How many equal periods the time of so many checks at so many stations is divided into.
int periods_of(std::size_t checks, int stations);

}  // namespace clampd::attribution
