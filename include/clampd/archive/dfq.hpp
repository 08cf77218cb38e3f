#pragma once

#include <map>
#include <string>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// The checks as one Q-DAS ASCII transfer file (AQDEF, .dfq), the oldest first. Lines end with CR LF, numbers
/// have decimal points, texts are ISO 8859-1 (what that has not becomes '?').
///
/// Header: K0100 number of characteristics; K1001 part number, K1002 title, K1081 station, K1086 fixture,
/// K1900 remark (what the numbers of operators and stations stand for, that times are UTC, whether brakes
/// were simulated). One characteristic per parameter and then per characteristic of the sheet, i: K2001/i
/// number, K2002/i name, K2004/i 0 (variable), K2022/i decimals, K2101/i nominal, K2110/i and K2111/i lower
/// and upper limit, K2142/i unit. One value set per check: K0001/i value and, where it says nothing about the
/// brake (an ERROR, TIMEOUT or ABORTED check, one that is void, no estimate), K0002/i 255 with the value 0;
/// for the whole set ("/0") K0004 start as dd.MM.yyyy/HH:mm:ss, K0006 batch, K0008 operator, K0009 verdict
/// and record id, K0010 station, K0014 serial number. Where the operators and stations are too many for
/// K1900's 255 characters, K0009 names them instead.
///
/// `nominal`: values for K2101 by name; a parameter without one has no K2101.
/// Errors: no checks, none that has parameters, or checks of different parts or with different parameters,
/// units or limits: a file describes one set of characteristics.
Result<std::string> format_dfq(const std::vector<CheckRecord>& checks,
                               const std::map<std::string, double>& nominal);

}  // namespace clampd
