#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "clampd/line/capability.hpp"
#include "clampd/line/control_chart.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// One parameter over many brakes.
struct ParameterStatistics {
  std::string name;
  std::string unit;
  double lower = 0.0;  ///< limits of the newest check
  double upper = 0.0;
  bool limits_changed = false;  ///< among these checks
  std::vector<double> values;   ///< one a brake, the first one first
  quality::Capability capability;
  quality::ChartPair charts;  ///< individual values and moving ranges
};

/// What checks say about the line. Capability and charts take the last valid check (PASS or FAIL) of each
/// serial number, so that a brake counts once however often it was checked. Brakes of several part numbers are never in
/// one of them: each part then has statistics of its own. Where a part has recipes, brakes that were judged by other
/// limits than those of the newest check are left out.
struct LineStatistics {
  std::string part_number;  ///< of all these checks; empty: none was given, or there are several
  std::vector<LineStatistics> parts;  ///< where there are several part numbers; then `parameters` is empty
  std::size_t checks = 0;
  std::size_t passed = 0;
  std::size_t failed = 0;
  std::size_t invalid = 0;          ///< ERROR, TIMEOUT, ABORTED
  std::size_t marked = 0;           ///< passed or failed, but the model does not explain all of the motion
  std::size_t simulated = 0;        ///< checks of simulated brakes
  bool simulated_left_out = false;  ///< since there are real ones too, and only those are counted then
  std::size_t other_limits = 0;     ///< brakes left out, since a recipe had other limits for them
  std::size_t voided = 0;           ///< void checks, which are counted nowhere else
  std::string first;                ///< start of the first check, RFC 3339
  std::string last;
  std::vector<std::string> serials;             ///< of the brakes that count, the first one first
  std::vector<ParameterStatistics> parameters;  ///< of which at least two values are there
};

/// Checks as the archive lists them, the last one saved first, whatever the clock said; those of
/// `master_serial` are left out.
LineStatistics line_statistics(std::vector<CheckRecord> newest_first, const std::string& master_serial);

}  // namespace clampd
