#include "src/archive/database.hpp"

namespace clampd {

Result<void> CheckStore::save_limits(const LimitsRevision& limits) {
  try {
    // Nearly every check: the limits of the one before.
    SQLite::Statement known(database_->handle, "SELECT 1 FROM limits_revisions WHERE sha256 = ?");
    known.bind(1, limits.sha256);
    if (known.executeStep()) return {};
    SQLite::Statement insert(
        database_->handle,
        "INSERT INTO limits_revisions (sha256, revision, author, changed, file, contents, first_used) "
        "VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING");
    int index = 0;
    for (const std::string* text : {&limits.sha256, &limits.revision, &limits.author, &limits.changed,
                                    &limits.file, &limits.contents, &limits.first_used})
      insert.bind(++index, *text);
    insert.exec();
    return {};
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

Result<std::vector<LimitsRevision>> CheckStore::limits_history() const {
  try {
    SQLite::Statement statement(database_->handle,
                                "SELECT sha256, revision, author, changed, file, contents, first_used FROM "
                                "limits_revisions ORDER BY first_used, rowid");
    std::vector<LimitsRevision> history;
    while (statement.executeStep()) {
      LimitsRevision& limits = history.emplace_back();
      sql::Columns(statement) >> limits.sha256 >> limits.revision >> limits.author >> limits.changed >>
          limits.file >> limits.contents >> limits.first_used;
    }
    return history;
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

}  // namespace clampd
