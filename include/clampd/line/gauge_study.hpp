#pragma once

#include <map>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/line/gauge.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// A crossed gauge study of one quantity.
struct GaugeQuantity {
  std::string name;
  std::string unit;
  double lower = 0.0;  ///< limits; NaN: none
  double upper = 0.0;
  std::vector<quality::GaugeReading> readings;
  quality::GaugeStudy study;
};

/// Studies of every parameter: parts are serial numbers, operators those who checked, repeats their checks.
/// Only valid checks (PASS or FAIL) count. Errors: those of gauge_anova(), with the parameter; no valid
/// checks.
Result<std::vector<GaugeQuantity>> gauge_of_checks(const std::vector<CheckRecord>& checks);

/// Studies of every numeric column of a CSV file with the columns `part` (or `serial`) and `operator`; a
/// column `trial` is not needed and ignored. `tolerances`: upper minus lower limit by column. Errors name
/// file, line and column.
Result<std::vector<GaugeQuantity>> gauge_of_csv(const std::string& text, const std::string& name,
                                                const std::map<std::string, double>& tolerances);

}  // namespace clampd
