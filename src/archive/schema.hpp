#pragma once

#include <string>

#include "clampd/base/result.hpp"
#include "src/archive/database.hpp"

namespace clampd {

/// What this version writes (PRAGMA user_version).
inline constexpr int kSchemaVersion = 18;

/// The version that a file has; 0 for an empty one. Errors: it is another program's database, or a newer
/// version's.
Result<int> schema_version(SQLite::Database& database, const std::string& path);

/// Brings it from that version up to date: the time grows in proportion to the number of checks.
void migrate(SQLite::Database& database, int version);

}  // namespace clampd
