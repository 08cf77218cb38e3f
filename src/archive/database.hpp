#pragma once

// What the store's files share: its database, how rows are bound and read, and what SQLite's errors mean.

#include <sys/types.h>

#include <cmath>
#include <concepts>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include <SQLiteCpp/SQLiteCpp.h>
#include <fmt/format.h>
#include <sqlite3.h>

#include "clampd/archive/store.hpp"
#include "clampd/record/text.hpp"

namespace clampd {

namespace sql {

/// Which file a path leads to.
struct FileIdentity {
  dev_t device = 0;
  ino_t inode = 0;

  bool operator==(const FileIdentity&) const = default;
};

/// Nothing if there is no file.
std::optional<FileIdentity> identity_of(const std::string& path);

}  // namespace sql

struct CheckStore::Database {
  std::string path;
  SQLite::Database handle;
  std::optional<sql::FileIdentity> file =
      {};  ///< of the database and of its write-ahead log when it was opened
  std::optional<sql::FileIdentity> log = {};
  std::string unconfirmed =
      {};  ///< id of a check that was committed to a file that was not in its place any more

  void remember_files();
  /// Whether what is saved now is still found under `path` later.
  Result<void> in_place() const;
};

namespace sql {

/// Something stored that clampd cannot have written.
class Damaged : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

inline tl::unexpected<Error> explained(const std::string& path, const SQLite::Exception& error) {
  const char* advice = "";
  switch (error.getErrorCode()) {
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      advice = "; another process is writing to it: try again, or stop that process";
      break;
    case SQLITE_NOTADB:
    case SQLITE_CORRUPT:
      advice =
          "; it is damaged or no database of results: `clampctl records verify` names what is damaged, "
          "`clampctl records restore` brings a backup back";
      break;
    case SQLITE_READONLY:
    case SQLITE_PERM:
    case SQLITE_CANTOPEN:
      advice = "; check that the folder exists and may be written to";
      break;
    case SQLITE_FULL:
      advice = "; the disk is full: make room";
      break;
    case SQLITE_IOERR:
      advice = "; the disk may be full, over its quota, gone or broken";
      break;
    default:
      break;
  }
  return failure(fmt::format("{}: {}{}", path, error.what(), advice));
}

/// An entry at the end of the channel's outbox; one that is there keeps its place.
void put_into_outbox(SQLite::Database& database, const std::string& check_id, const std::string& channel,
                     PublicationState state);

/// SQLite has no NaN: it is NULL there.
inline void bind_number(SQLite::Statement& statement, int index, double value) {
  if (std::isnan(value)) {
    statement.bind(index);
  } else {
    statement.bind(index, value);
  }
}

inline double number(const SQLite::Column& column) {
  return column.isNull() ? std::numeric_limits<double>::quiet_NaN() : column.getDouble();
}

/// Bytes that are no text.
struct Blob {
  std::string bytes;
};

/// Binds values in the order of a statement's question marks.
class Row {
 public:
  Row(SQLite::Database& database, const std::string& table, int values)
      : statement_(database, fmt::format("INSERT INTO {} VALUES ({}?)", table, placeholders(values - 1))) {}

  Row& operator<<(double value) {
    bind_number(statement_, ++index_, value);
    return *this;
  }
  Row& operator<<(const std::string& value) {
    statement_.bind(++index_, value);
    return *this;
  }
  Row& operator<<(const Blob& value) {
    statement_.bind(++index_, value.bytes.data(), static_cast<int>(value.bytes.size()));
    return *this;
  }
  template <std::integral T>
  Row& operator<<(T value) {
    statement_.bind(++index_, static_cast<std::int64_t>(value));
    return *this;
  }
  void insert() {
    statement_.exec();
    statement_.reset();
    index_ = 0;
  }

 private:
  static std::string placeholders(int count) {
    std::string text;
    for (int i = 0; i < count; ++i) text += "?,";
    return text;
  }

  SQLite::Statement statement_;
  int index_ = 0;
};

/// Takes the columns of a row in their order. What its type cannot hold is Damaged; bytes that are no UTF-8
/// are replaced by marks, so that no table, report or JSON document fails on them.
class Columns {
 public:
  explicit Columns(SQLite::Statement& statement) : statement_(statement) {}

  Columns& operator>>(double& value) {
    value = number(next());
    return *this;
  }
  Columns& operator>>(std::string& value) {
    value = with_replacement_marks(next().getString());
    return *this;
  }
  Columns& operator>>(Blob& value) {
    const SQLite::Column column = next();
    value.bytes.assign(static_cast<const char*>(column.getBlob()),
                       static_cast<std::size_t>(column.getBytes()));
    return *this;
  }
  Columns& operator>>(bool& value) {
    value = whole_number(0, 1) != 0;
    return *this;
  }
  template <std::integral T>
  Columns& operator>>(T& value) {
    constexpr auto kLargest = std::numeric_limits<T>::max();
    value = static_cast<T>(whole_number(static_cast<std::int64_t>(std::numeric_limits<T>::min()),
                                        std::in_range<std::int64_t>(kLargest)
                                            ? static_cast<std::int64_t>(kLargest)
                                            : std::numeric_limits<std::int64_t>::max()));
    return *this;
  }
  /// An enumeration whose to_string() answers "?" to what it does not have.
  template <class T>
  requires std::is_enum_v<T> Columns& operator>>(T& value) {
    const std::int64_t stored = whole_number(0, std::numeric_limits<std::underlying_type_t<T>>::max());
    value = static_cast<T>(stored);
    if (to_string(value) == "?") refuse(stored);
    return *this;
  }

 private:
  SQLite::Column next() { return statement_.getColumn(index_++); }

  std::int64_t whole_number(std::int64_t least, std::int64_t most) {
    const std::int64_t stored = next().getInt64();
    if (stored < least || stored > most) refuse(stored);
    return stored;
  }

  [[noreturn]] void refuse(std::int64_t stored) {
    throw Damaged(fmt::format("{} is {}, which clampd never writes",
                              statement_.getColumn(index_ - 1).getName(), stored));
  }

  SQLite::Statement& statement_;
  int index_ = 0;
};

}  // namespace sql
}  // namespace clampd
