#pragma once

#include <string>
#include <vector>

#include "clampd/archive/store.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// A check as a technician reads it: verdict, reason, parameters and the sheet against their limits,
/// tracking, timing, record id. UTF-8, at most 100 columns, ending with a line break. `colour`: with ANSI
/// colours.
std::string format_check(const CheckRecord& record, bool colour);

/// The sheet as part of it, and where runs alone are identified: characteristic, value, deviation, limits and
/// verdict, and why something is not known.
std::string format_sheet(const SheetRecord& sheet, bool colour);

/// One line a check, newest first as listed.
std::string format_checks(const std::vector<CheckSummary>& checks, bool colour);

}  // namespace clampd
