#pragma once

// A record's rows in the tables: how it is written, and how it is read back, whole or in part. What is stored
// there and cannot be one of clampd's throws sql::Damaged or nlohmann::json::exception.

#include <optional>
#include <string>

#include "clampd/record/check_record.hpp"
#include "src/archive/database.hpp"

namespace clampd {

void insert_record(SQLite::Database& database, const CheckRecord& record);

/// A row of all columns of `checks`.
void read_check(SQLite::Statement& statement, CheckRecord& record);
/// The rest, of the check that `record.id` names.
void read_parameters(SQLite::Database& database, CheckRecord& record);
/// All of the runs but their rows.
void read_run_figures(SQLite::Database& database, CheckRecord& record);
/// Parameters, whole runs, histogram and flight recorder. Errors: a run's checksum does not match.
Result<void> read_details(SQLite::Database& database, const std::string& path, CheckRecord& record);

/// The text of a run's file from its columns `csv` (as older versions stored it) and `data` (compressed).
Result<std::string> read_run_text(sql::Columns& columns);

/// A cause as JSON; empty if there is none.
std::string cause_text(const std::optional<CauseRecord>& cause);
std::optional<CauseRecord> cause_from(const std::string& text);

}  // namespace clampd
