#include "src/archive/amendments.hpp"

#include <nlohmann/json.hpp>

#include "clampd/record/utc.hpp"
#include "src/archive/chain.hpp"
#include "src/archive/record_rows.hpp"

namespace clampd {

void amend(SQLite::Database& database, const std::string& check_id, const std::string& kind,
           const std::string& made, const std::string& content) {
  SQLite::Statement insert(database,
                           "INSERT INTO amendments (check_id, kind, made, content) VALUES (?, ?, ?, ?)");
  int index = 0;
  for (const std::string* text : {&check_id, &kind, &made, &content}) insert.bind(++index, *text);
  insert.exec();
  Chain(database).append_amendment(check_id, database.getLastInsertRowid());
}

Amendments::Amendments(SQLite::Database& database)
    : rows_(database, "SELECT kind, made, content FROM amendments WHERE check_id = ? ORDER BY id") {}

void Amendments::apply_to(CheckRecord& record) {
  rows_.reset();
  rows_.bind(1, record.id);
  std::string removal;
  while (rows_.executeStep()) {
    std::string kind, made, content;
    sql::Columns(rows_) >> kind >> made >> content;
    if (kind == kRunsRemoved) removal = made;
    if (kind != kVoided && kind != kSettled) continue;
    const nlohmann::json said = nlohmann::json::parse(content);
    if (kind == kVoided) {
      record.voided =
          VoidRecord{said.at("reason").get<std::string>(), said.at("by").get<std::string>(), made};
    } else {
      record.cause = cause_from(said.at("cause").get<std::string>());
      record.reason = said.at("reason").get<std::string>();
    }
  }
  for (const RunRecord& run : record.runs)
    if (!run.removed.empty() && run.removed != removal)
      throw sql::Damaged(
          fmt::format("the data of {} were not removed by the station's retention", run.run.name));
}

void Amendments::apply_to(CheckSummary& summary) {
  CheckRecord record;
  record.id = summary.id;
  record.reason = std::move(summary.reason);
  apply_to(record);
  summary.reason = std::move(record.reason);
  summary.is_void = record.voided.has_value();
}

Result<std::string> CheckStore::mark_void(const std::string& id, const VoidRecord& why) {
  Result<CheckRecord> record = load(id);
  if (!record) return tl::unexpected(record.error());
  if (record->voided)
    return failure(fmt::format("check {} is void already, since {}: {}", record->id, record->voided->when,
                               record->voided->reason));
  if (Result<void> there = database_->in_place(); !there) return tl::unexpected(there.error());
  try {
    SQLite::Transaction transaction(database_->handle, SQLite::TransactionBehavior::IMMEDIATE);
    amend(
        database_->handle, record->id, kVoided, why.when,
        nlohmann::json{{"reason", with_replacement_marks(why.reason)}, {"by", with_replacement_marks(why.by)}}
            .dump());
    transaction.commit();
    return record->id;
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

Result<void> CheckStore::save_settled_cause(const std::string& id, const std::optional<CauseRecord>& cause,
                                            const std::string& reason) {
  if (Result<void> there = database_->in_place(); !there) return there;
  try {
    SQLite::Transaction transaction(database_->handle, SQLite::TransactionBehavior::IMMEDIATE);
    amend(database_->handle, id, kSettled, format_utc(utc_now_ns()),
          nlohmann::json{{"cause", cause_text(cause)}, {"reason", with_replacement_marks(reason)}}.dump());
    transaction.commit();
    return {};
  } catch (const SQLite::Exception& exception) {
    return sql::explained(database_->path, exception);
  }
}

}  // namespace clampd
