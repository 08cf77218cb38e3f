#include "clampd/record/utc.hpp"
#include "src/archive/database.hpp"

namespace clampd {

void sql::put_into_outbox(SQLite::Database& database, const std::string& check_id, const std::string& channel,
                          PublicationState state) {
  SQLite::Statement statement(
      database,
      "INSERT INTO publication (check_id, channel, state, queued, sequence) "
      "SELECT ?1, ?2, ?3, ?4, COALESCE(MAX(sequence), 0) + 1 FROM publication WHERE channel = ?2 "
      "ON CONFLICT (check_id, channel) DO UPDATE SET state = excluded.state");
  statement.bind(1, check_id);
  statement.bind(2, channel);
  statement.bind(3, static_cast<int>(state));
  statement.bind(4, format_utc(utc_now_ns()));
  statement.exec();
}

Result<void> CheckStore::mark_publication(const std::string& id, const std::string& channel,
                                          PublicationState state) {
  try {
    sql::put_into_outbox(database_->handle, id, channel, state);
    return {};
  } catch (const SQLite::Exception& exception) {
    if (exception.getErrorCode() == SQLITE_CONSTRAINT)
      return failure(fmt::format("{}: no check {} to publish", database_->path, id));
    return sql::explained(database_->path, exception);
  }
}

Result<std::optional<OutboxEntry>> CheckStore::next_in_outbox(const std::string& channel) const {
  try {
    SQLite::Statement statement(database_->handle,
                                "SELECT check_id, sequence, queued FROM publication "
                                "WHERE channel = ? AND state = 0 ORDER BY sequence LIMIT 1");
    statement.bind(1, channel);
    if (!statement.executeStep()) return std::optional<OutboxEntry>();
    OutboxEntry entry;
    sql::Columns(statement) >> entry.check_id >> entry.sequence >> entry.queued;
    return std::optional(std::move(entry));
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

Result<OutboxState> CheckStore::outbox(const std::string& channel) const {
  try {
    SQLite::Statement count(database_->handle,
                            "SELECT COUNT(*) FROM publication WHERE channel = ? AND state = 0");
    count.bind(1, channel);
    OutboxState state;
    if (count.executeStep()) sql::Columns(count) >> state.pending;
    return next_in_outbox(channel).map([&](const std::optional<OutboxEntry>& next) {
      if (next) state.oldest = next->queued;
      return state;
    });
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

Result<std::uint64_t> CheckStore::count_connection(const std::string& channel) {
  try {
    SQLite::Transaction transaction(database_->handle, SQLite::TransactionBehavior::IMMEDIATE);
    SQLite::Statement count(database_->handle,
                            "INSERT INTO outbox_connections VALUES (?, 1) "
                            "ON CONFLICT (channel) DO UPDATE SET connections = connections + 1");
    count.bind(1, channel);
    count.exec();
    SQLite::Statement read(database_->handle, "SELECT connections FROM outbox_connections WHERE channel = ?");
    read.bind(1, channel);
    read.executeStep();
    std::uint64_t connections = 0;
    sql::Columns(read) >> connections;
    read.reset();
    transaction.commit();
    return connections - 1;
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

}  // namespace clampd
