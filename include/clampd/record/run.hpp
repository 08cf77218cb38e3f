#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"

namespace clampd {

/// A further column of a run, in the units that its map gives it.
struct RunColumn {
  std::string name;
  std::vector<double> values;
};

/// One recorded run: contiguous arrays of equal length n, SI units.
/// Row k holds the readings at time_s[k]; torque_Nm[k] acts from there until the next row.
struct Run {
  std::string name;  ///< file name or "repeat 3": used in messages
  std::vector<double> time_s;
  std::vector<double> torque_Nm;
  std::vector<double> velocity_rad_s;
  std::vector<double> force_N;
  std::vector<double> position_rad;  ///< empty where the rig has no position reading
  /// 1, or 0 in rows in which the drive was off: no torque acted, whatever its reading. Empty: on throughout.
  std::vector<double> drive_enabled;
  std::vector<RunColumn> others;  ///< of a foreign file, those that its ColumnMap names

  std::size_t size() const { return time_s.size(); }
};

/// The torque reading while the drive was off.
struct TorqueWhileOff {
  double mean_Nm = 0.0;
  double sd_Nm = 0.0;  ///< of the mean; readings may wander
  std::size_t rows = 0;

  bool operator==(const TorqueWhileOff&) const = default;
};

/// Of all rows with the drive off; nothing where they are fewer than 20 or all read the same.
std::optional<TorqueWhileOff> torque_while_off(std::span<const Run> runs);

/// Both together.
std::optional<TorqueWhileOff> pooled(const std::optional<TorqueWhileOff>& a,
                                     const std::optional<TorqueWhileOff>& b);

/// Whether the drive was on at any time.
bool is_driven(const Run& run);

/// Those that are.
std::vector<Run> driven_runs(std::span<const Run> runs);

/// A run as read from a file, and what a careful reader would tell its user about it.
struct LoadedRun {
  Run run;
  std::vector<std::string> notices;  ///< e.g. columns that were ignored
};

/// Reads a CSV run file with the header of docs
/// `time_s,torque_Nm,velocity_rad_s,force_N[,position_rad][,drive_enabled]`, columns in any order. Errors
/// name file, line and column: file missing or empty, column missing or twice, a field that is not a finite
/// number, a drive_enabled that is not 0 or 1, a time that does not increase, a row of the wrong length.
Result<LoadedRun> read_run(const std::string& path);

/// The same from text; `name` stands for the file in messages.
Result<LoadedRun> parse_run(const std::string& text, const std::string& name);

/// Where a quantity of a run stands in a file that names and scales its columns otherwise.
struct ColumnSource {
  std::string column;
  double scale = 1.0;  ///< reading times scale is in SI units
  double wrap = 0.0;   ///< the reading starts again at zero after this many units; 0: never
  double offset = 0.0;  ///< in SI units, added after scaling
  std::string minus = {};  ///< another column, in the same units, that is subtracted from it
  double late_s = 0.0;     ///< by which the reading comes too late
};

/// The columns of a foreign file. What is absent leaves its array in the run empty.
struct ColumnMap {
  ColumnSource time{"time_s"};
  std::optional<ColumnSource> torque{ColumnSource{"torque_Nm"}};
  std::optional<ColumnSource> velocity;
  std::optional<ColumnSource> position;
  std::optional<ColumnSource> force;
  std::optional<ColumnSource> drive_enabled;
  /// Further ones, by the names that they have in Run::others.
  std::vector<std::pair<std::string, ColumnSource>> others;
  int skip_lines = 0;  ///< before the header
};

/// The line of names in a file of somebody else's.
struct TableHeader {
  int skip_lines = 0;  ///< before it; 0 if they are comments or empty
  std::vector<std::string> names;
};

/// The first line that is followed by as many numbers. Error: there is none.
Result<TableHeader> find_header(const std::string& text, const std::string& name);

/// As read_run() without a map, errors included. Columns may also be separated by semicolons or tabs; then
/// numbers may have a decimal comma.
Result<LoadedRun> read_run(const std::string& path, const ColumnMap& columns);
Result<LoadedRun> parse_run(const std::string& text, const std::string& name, const ColumnMap& columns);

/// CSV text with 17 significant digits at most, so that reading it back gives the same doubles.
std::string format_run(const Run& run);

/// Writes to a temporary file beside `path` and renames it: nothing half-written is ever left at `path`.
Result<void> write_run(const std::string& path, const Run& run);

}  // namespace clampd
