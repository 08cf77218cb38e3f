#pragma once

// What the store's files share: its database, how rows are bound and read, and what SQLite's errors mean.

#include <cmath>
#include <concepts>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>

#include <SQLiteCpp/SQLiteCpp.h>
#include <fmt/format.h>
#include <sqlite3.h>

#include "clampd/archive/store.hpp"

namespace clampd {

struct CheckStore::Database {
  std::string path;
  SQLite::Database handle;
};

namespace sql {

inline tl::unexpected<Error> explained(const std::string& path, const SQLite::Exception& error) {
  const char* advice = "";
  switch (error.getErrorCode()) {
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      advice = "; another process is writing to it: try again, or stop that process";
      break;
    case SQLITE_NOTADB:
    case SQLITE_CORRUPT:
      advice = "; it is damaged or no database of results: move it away or restore a copy";
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

/// Takes the columns of a row in their order.
class Columns {
 public:
  explicit Columns(SQLite::Statement& statement) : statement_(statement) {}

  Columns& operator>>(double& value) {
    value = number(statement_.getColumn(index_++));
    return *this;
  }
  Columns& operator>>(std::string& value) {
    value = statement_.getColumn(index_++).getString();
    return *this;
  }
  Columns& operator>>(bool& value) {
    value = statement_.getColumn(index_++).getInt() != 0;
    return *this;
  }
  template <class T>
  requires(std::integral<T> || std::is_enum_v<T>) Columns& operator>>(T& value) {
    value = static_cast<T>(statement_.getColumn(index_++).getInt64());
    return *this;
  }

 private:
  SQLite::Statement& statement_;
  int index_ = 0;
};

}  // namespace sql
}  // namespace clampd
