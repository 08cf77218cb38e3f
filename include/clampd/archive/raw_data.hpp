#pragma once

#include <string>

#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// The last samples before a check's fault as CSV, one a row, SI units in the header. Errors: the check has
/// none.
Result<std::string> format_flight_recorder(const CheckRecord& check);

/// Writes the raw runs of a check as run files into a folder, which is made: run-01.csv, run-02.csv, ... How
/// many. Errors: the check has none, or retention removed them; a file is there already.
Result<std::size_t> write_run_files(const CheckRecord& check, const std::string& folder);

}  // namespace clampd
