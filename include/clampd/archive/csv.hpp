#pragma once

#include <string>
#include <vector>

#include "clampd/record/check_record.hpp"

namespace clampd {

/// One row a check for spreadsheets and scripts (RFC 4180, header first, decimal points, SI units in the
/// header): traceability and verdict, then value, sd, lower, upper and verdict of every parameter that any of
/// the checks has, and of the sheet's characteristics as "sheet NAME". Empty cells where a check has no such
/// one. A text that a spreadsheet would run as a formula gets an apostrophe before it, also after a
/// semicolon, where a list in another locale begins a new cell. The last column says why a record is void.
std::string format_csv(const std::vector<CheckRecord>& checks);

}  // namespace clampd
