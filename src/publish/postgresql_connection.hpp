#pragma once

#include <functional>
#include <memory>
#include <string>
#include <utility>

#include <pqxx/pqxx>

#include "clampd/base/result.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/publish/wake_event.hpp"

namespace clampd::publish {

/// Of the database, as this version of clampd makes it.
inline constexpr int kSchemaVersion = 7;

/// One connection to a PostgreSQL server, and its errors in words. Used by one thread.
class PostgresqlConnection {
 public:
  explicit PostgresqlConnection(PostgresqlSettings settings) : settings_(std::move(settings)) {}

  /// Connects anew. Errors: the password cannot be read, nobody listens, the server refuses.
  Result<void> open(const WakeEvent& wake);
  /// Brings the schema up to date; stations of an older version may go on using it.
  Result<void> migrate();
  /// Why this version cannot read the database: its schema is older or newer; empty if it can.
  Result<std::string> schema_refusal();
  /// Calls `work` with the connection; what it throws becomes an error, and so does that there is none.
  Result<void> guarded(const std::function<void(pqxx::connection&)>& work);
  void close() noexcept { connection_.reset(); }
  /// "PostgreSQL: HOST, database NAME".
  std::string where() const;

 private:
  std::string description(const std::string& password) const;

  PostgresqlSettings settings_;
  std::unique_ptr<pqxx::connection> connection_;
};

}  // namespace clampd::publish
