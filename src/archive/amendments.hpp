#pragma once

// What is said of a record after it was saved. The record's own rows never change: an amendment is a row of
// its own, with its own entry in the chain of checksums.

#include <string>

#include "clampd/record/check_record.hpp"
#include "src/archive/database.hpp"

namespace clampd {

inline constexpr const char* kVoided = "void";               ///< content: {"reason", "by"}
inline constexpr const char* kSettled = "settled";           ///< content: {"cause", "reason"}
inline constexpr const char* kRunsRemoved = "runs-removed";  ///< of raw runs, by retention

/// Within the caller's transaction, its entry in the chain included.
void amend(SQLite::Database& database, const std::string& check_id, const std::string& kind,
           const std::string& made, const std::string& content);

/// Reads what was said of one check after the other.
class Amendments {
 public:
  explicit Amendments(SQLite::Database& database);

  void apply_to(CheckRecord& record);
  void apply_to(CheckSummary& summary);

 private:
  SQLite::Statement rows_;
};

}  // namespace clampd
