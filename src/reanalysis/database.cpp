#include "clampd/reanalysis/database.hpp"

#include <fmt/format.h>

namespace clampd::reanalysis {

Result<publish::PostgresqlSettings> archive_of(const StationConfiguration& configuration) {
  const PostgresqlConfiguration& postgresql = configuration.postgresql;
  if (!postgresql.used())
    return failure(
        fmt::format("{}: no [postgresql] host: name the database that the stations publish their runs to "
                    "(raw_runs = true), "
                    "in a file that --config names",
                    configuration.file.empty() ? "no configuration" : configuration.file));
  return publish::PostgresqlSettings{postgresql.host, postgresql.port,          postgresql.database,
                                     postgresql.user, postgresql.password_file, postgresql.tls_ca_file};
}

}  // namespace clampd::reanalysis
