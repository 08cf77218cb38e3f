#include "clampd/archive/store.hpp"

#include <sys/stat.h>

#include <filesystem>
#include <optional>
#include <regex>
#include <utility>

#include <nlohmann/json.hpp>

#include "src/archive/amendments.hpp"
#include "src/archive/chain.hpp"
#include "src/archive/database.hpp"
#include "src/archive/record_rows.hpp"
#include "src/archive/schema.hpp"

namespace clampd {
namespace {

using sql::Columns;
using sql::explained;

/// "2026-11-21T10:00Z" as a prefix of stored times, which are all in UTC.
std::string without_zone(std::string time) {
  if (!time.empty() && time.back() == 'Z') time.pop_back();
  return time;
}

/// Conditions only for what is asked, so that the indices serve. Newest first is the order of saving: the
/// clock may have been set back in between.
SQLite::Statement select_checks(SQLite::Database& database, std::string_view columns,
                                const CheckFilter& filter) {
  std::vector<std::string> conditions;
  std::vector<std::string> texts;
  const auto where = [&](const char* condition, const std::string& value) {
    if (value.empty()) return;
    conditions.emplace_back(condition);
    texts.push_back(value);
  };
  where("serial = ?", filter.serial);
  where("part_number = ?", filter.part_number);
  where("batch = ?", filter.batch);
  where("operator = ?", filter.operator_name);
  where("started >= ?", without_zone(filter.since));
  // A bound of less than full precision includes all that begins with it.
  where("started <= ? || '~'", without_zone(filter.until));
  if (filter.verdict) conditions.push_back(fmt::format("verdict = {}", static_cast<int>(*filter.verdict)));
  SQLite::Statement statement(database, fmt::format("SELECT {} FROM checks {}{} ORDER BY rowid DESC LIMIT {}",
                                                    columns, conditions.empty() ? "" : "WHERE ",
                                                    fmt::join(conditions, " AND "), filter.limit));
  for (std::size_t i = 0; i < texts.size(); ++i) statement.bind(static_cast<int>(i + 1), texts[i]);
  return statement;
}

/// The text with LIKE's own characters taken literally, by ESCAPE '\'.
std::string like_prefix(const std::string& text) {
  std::string pattern;
  for (const char c : text) {
    if (c == '%' || c == '_' || c == '\\') pattern += '\\';
    pattern += c;
  }
  return pattern + '%';
}

/// In words that a list or a table of statistics can hold in the place of the record.
std::string damaged_reason(const std::exception& what) {
  return fmt::format("This record is damaged ({}); `clampctl records verify` names all that are.",
                     what.what());
}

/// Calls `read(row)` for each row of the statement. A record that holds what clampd never writes becomes an
/// ERROR that says so, and the rest goes on.
template <class Listed, class Read>
std::vector<Listed> read_rows(SQLite::Statement& statement, Read read) {
  std::vector<Listed> rows;
  while (statement.executeStep()) {
    Listed& row = rows.emplace_back();
    std::string reason;
    try {
      read(row);
      continue;
    } catch (const sql::Damaged& damaged) {
      reason = damaged_reason(damaged);
    } catch (const nlohmann::json::exception& damaged) {
      reason = damaged_reason(damaged);
    }
    row = Listed{};
    Columns(statement) >> row.id >> row.serial;
    row.verdict = Verdict::Error;
    row.reason = std::move(reason);
  }
  return rows;
}

/// Reading needs the file of shared memory that goes with a write-ahead log, and so the right to write beside
/// the database. Where there is no log, nothing but the file itself is needed.
SQLite::Database open_to_read(const std::string& path, int busy_timeout_ms) {
  SQLite::Database database(path, SQLite::OPEN_READONLY, busy_timeout_ms);
  try {
    database.execAndGet("SELECT COUNT(*) FROM sqlite_master");
    return database;
  } catch (const SQLite::Exception& exception) {
    std::error_code absent;
    const auto log_bytes = std::filesystem::file_size(path + "-wal", absent);
    const int code = exception.getErrorCode();
    const bool not_permitted = code == SQLITE_CANTOPEN || code == SQLITE_READONLY;
    if (!not_permitted || (!absent && log_bytes > 0)) throw;
  }
  std::string uri = "file:";
  for (const char c : path) {
    if (c == '%' || c == '?' || c == '#')
      uri += fmt::format("%{:02x}", static_cast<unsigned char>(c));
    else
      uri += c;
  }
  return {uri + "?immutable=1", SQLite::OPEN_READONLY | SQLite::OPEN_URI, busy_timeout_ms};
}

}  // namespace

std::optional<sql::FileIdentity> sql::identity_of(const std::string& path) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) return std::nullopt;
  return FileIdentity{status.st_dev, status.st_ino};
}

void CheckStore::Database::remember_files() {
  file = sql::identity_of(path);
  log = sql::identity_of(path + "-wal");
}

Result<void> CheckStore::Database::in_place() const {
  if (sql::identity_of(path) == file && sql::identity_of(path + "-wal") == log) return {};
  return failure(fmt::format(
      "{}: the database was deleted, moved or replaced while it was in use, so that nothing can be saved "
      "to it: put it back, or restart clampd, which begins a new one",
      path));
}

bool is_filter_time(const std::string& text) {
  static const std::regex kPattern(R"(\d{4}-\d\d-\d\d(T\d\d:\d\d(:\d\d(\.\d{1,9})?)?Z?)?)");
  return text.size() <= 40 && std::regex_match(text, kPattern);
}

CheckStore::CheckStore(std::unique_ptr<Database> database) : database_(std::move(database)) {}
CheckStore::CheckStore(CheckStore&&) noexcept = default;
CheckStore& CheckStore::operator=(CheckStore&&) noexcept = default;
CheckStore::~CheckStore() = default;

Result<CheckStore> CheckStore::open(const std::string& path, Access access, int busy_timeout_ms) {
  namespace fs = std::filesystem;
  std::error_code error;
  const bool writing = access == Access::ReadWrite;
  if (fs::is_directory(path, error))
    return failure(fmt::format("{}: is a directory, not a database of results", path));
  if (!writing && !fs::exists(path, error))
    return failure(fmt::format("{}: there is no such database of results: no check was saved yet", path));
  if (writing && fs::path(path).has_parent_path()) {
    fs::create_directories(fs::path(path).parent_path(), error);
    if (error) return failure(fmt::format("{}: cannot make its folder: {}", path, error.message()));
  }
  try {
    auto database = std::make_unique<Database>(Database{
        path, writing ? SQLite::Database(path, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE, busy_timeout_ms)
                      : open_to_read(path, busy_timeout_ms)});
    SQLite::Database& handle = database->handle;
    // A file that somebody else made or changed: its schema runs no functions, its pages are looked at twice.
    handle.exec("PRAGMA trusted_schema = OFF");
    handle.exec("PRAGMA cell_size_check = ON");
    const Result<int> version = schema_version(handle, path);
    if (!version) return tl::unexpected(version.error());
    if (!writing && *version < kSchemaVersion)
      return failure(
          fmt::format("{}: holds no results of this version (schema {} instead of {}); a check brings it up "
                      "to date",
                      path, *version, kSchemaVersion));
    if (!writing) return CheckStore(std::move(database));
    if (sqlite3_db_readonly(handle.getHandle(), "main") != 0)
      return failure(
          fmt::format("{}: may only be read, and every check has to be saved: check who owns it and "
                      "whether its disk is mounted read-only",
                      path));
    handle.exec("PRAGMA journal_mode = WAL");
    handle.exec("PRAGMA synchronous = FULL");
    handle.exec("PRAGMA foreign_keys = ON");
    migrate(handle, *version);
    database->remember_files();
    return CheckStore(std::move(database));
  } catch (const SQLite::Exception& exception) {
    return explained(path, exception);
  } catch (const sql::Damaged& damaged) {
    return failure(fmt::format("{}: cannot be brought up to date: {}", path, damaged.what()));
  }
}

Result<void> CheckStore::save(const CheckRecord& record) {
  SQLite::Database& handle = database_->handle;
  if (Result<void> there = database_->in_place(); !there) return there;
  try {
    if (database_->unconfirmed == record.id) {  // committed before, and now its file is back in its place
      SQLite::Statement known(handle, "SELECT 1 FROM checks WHERE id = ?");
      known.bind(1, record.id);
      if (known.executeStep()) return {};
    }
    SQLite::Transaction transaction(handle, SQLite::TransactionBehavior::IMMEDIATE);
    insert_record(handle, record);
    Chain(handle).append_check(record.id);
    for (const std::string& channel : outbox_channels_)
      sql::put_into_outbox(handle, record.id, channel, PublicationState::Pending);
    transaction.commit();
  } catch (const SQLite::Exception& exception) {
    if (exception.getErrorCode() == SQLITE_CONSTRAINT)
      return failure(
          fmt::format("{}: check {} is already there: {}", database_->path, record.id, exception.what()));
    return explained(database_->path, exception);
  } catch (const sql::Damaged& damaged) {
    return failure(fmt::format("{}: {}", database_->path, damaged.what()));
  }
  Result<void> there = database_->in_place();
  if (!there) database_->unconfirmed = record.id;
  return there;
}

Result<std::vector<CheckSummary>> CheckStore::list(const CheckFilter& filter) const {
  try {
    SQLite::Statement statement = select_checks(
        database_->handle, "id, serial, started, verdict, marginal, simulated, repeats, duration_s, reason, part_number",
        filter);
    Amendments amendments(database_->handle);
    return read_rows<CheckSummary>(statement, [&](CheckSummary& check) {
      Columns(statement) >> check.id >> check.serial >> check.started >> check.verdict >> check.marginal >>
          check.simulated >> check.repeats >> check.duration_s >> check.reason >> check.part_number;
      amendments.apply_to(check);
    });
  } catch (const SQLite::Exception& exception) {
    return explained(database_->path, exception);
  }
}

Result<std::vector<CheckRecord>> CheckStore::load_results(const CheckFilter& filter) const {
  try {
    SQLite::Statement statement = select_checks(database_->handle, "*", filter);
    Amendments amendments(database_->handle);
    return read_rows<CheckRecord>(statement, [&](CheckRecord& check) {
      read_check(statement, check);
      read_parameters(database_->handle, check);
      amendments.apply_to(check);
    });
  } catch (const SQLite::Exception& exception) {
    return explained(database_->path, exception);
  }
}

Result<CheckRecord> CheckStore::load_result(const std::string& id) const {
  return load_whole(id, [this](CheckRecord& record) -> Result<void> {
    read_parameters(database_->handle, record);
    read_run_figures(database_->handle, record);
    return {};
  });
}

Result<CheckRecord> CheckStore::load(const std::string& id) const {
  return whole_id(id).and_then([&](const std::string& found) {
    return load_whole(found, [this](CheckRecord& record) {
      return read_details(database_->handle, database_->path, record);
    });
  });
}

Result<std::string> CheckStore::whole_id(const std::string& id) const {
  const std::string& path = database_->path;
  try {
    SQLite::Statement statement(
        database_->handle, id == "last"
                               ? "SELECT id FROM checks ORDER BY rowid DESC LIMIT 1"
                               : R"(SELECT id FROM checks WHERE id LIKE ? ESCAPE '\' ORDER BY id LIMIT 2)");
    if (id != "last") statement.bind(1, like_prefix(id));
    if (!statement.executeStep())
      return failure(fmt::format("{}: no check {}; `clampctl results` lists them", path, id));
    std::string found = statement.getColumn(0).getString();
    if (id != "last" && found != id && statement.executeStep())
      return failure(fmt::format("{}: {} stands for more than one check: give more of its id", path, id));
    return found;
  } catch (const SQLite::Exception& exception) {
    return explained(path, exception);
  }
}

Result<CheckRecord> CheckStore::load_whole(
    const std::string& id, const std::function<Result<void>(CheckRecord&)>& read_the_rest) const {
  const std::string& path = database_->path;
  const auto damaged = [&](const std::exception& what) {
    return failure(fmt::format("{}: check {} is damaged: {}; `clampctl records verify` names all that are",
                               path, id, what.what()));
  };
  try {
    SQLite::Transaction snapshot(database_->handle);  // what is read and what is verified are one state
    SQLite::Statement statement(database_->handle, "SELECT * FROM checks WHERE id = ?");
    statement.bind(1, id);
    if (!statement.executeStep()) return failure(fmt::format("{}: no check {}", path, id));
    if (const Result<void> same = unchanged(database_->handle, path, id); !same)
      return tl::unexpected(same.error());
    CheckRecord record;
    read_check(statement, record);
    if (const Result<void> rest = read_the_rest(record); !rest) return tl::unexpected(rest.error());
    Amendments(database_->handle).apply_to(record);
    return record;
  } catch (const SQLite::Exception& exception) {
    return explained(path, exception);
  } catch (const sql::Damaged& exception) {
    return damaged(exception);
  } catch (const nlohmann::json::exception& exception) {
    return damaged(exception);
  }
}

}  // namespace clampd
