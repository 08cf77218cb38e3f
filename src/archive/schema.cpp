#include "src/archive/schema.hpp"

#include <array>

#include "src/archive/amendments.hpp"
#include "src/archive/chain.hpp"

namespace clampd {
namespace {

/// "clmp": in the header of every database of results.
constexpr int kApplicationId = 0x636c6d70;
/// Databases of this version and later have it.
constexpr int kFirstWithApplicationId = 7;

/// Step i brings a database of version i to i + 1 (PRAGMA user_version). Steps are never changed, only added.
constexpr std::array<const char*, 17> kMigrations{
    R"sql(
CREATE TABLE checks (
  id TEXT PRIMARY KEY NOT NULL,
  serial TEXT NOT NULL, part_number TEXT NOT NULL, batch TEXT NOT NULL,
  station TEXT NOT NULL, fixture TEXT NOT NULL, operator TEXT NOT NULL, software_version TEXT NOT NULL,
  limits_file TEXT NOT NULL, limits_revision TEXT NOT NULL, limits_sha256 TEXT NOT NULL,
  trajectory_sha256 TEXT NOT NULL, instruments TEXT NOT NULL, simulated INTEGER NOT NULL,
  started TEXT NOT NULL, stopped TEXT NOT NULL, duration_s REAL, repeats INTEGER NOT NULL,
  verdict INTEGER NOT NULL, marginal INTEGER NOT NULL, reason TEXT NOT NULL, fault INTEGER NOT NULL,
  covariance_normalised TEXT NOT NULL, noise_force_N REAL, noise_velocity_rad_s REAL, tracking_rms_N REAL,
  ticks INTEGER NOT NULL, skipped INTEGER NOT NULL, lost_samples INTEGER NOT NULL,
  lateness_min_us REAL, lateness_avg_us REAL, lateness_max_us REAL, bus_load REAL) STRICT;
CREATE INDEX checks_by_serial ON checks (serial, started);
CREATE INDEX checks_by_time ON checks (started);
CREATE TABLE parameters (
  check_id TEXT NOT NULL REFERENCES checks (id), position INTEGER NOT NULL,
  name TEXT NOT NULL, unit TEXT NOT NULL, value REAL, sd REAL, lower REAL, upper REAL, verdict INTEGER NOT NULL,
  PRIMARY KEY (check_id, position)) STRICT;
CREATE TABLE runs (
  check_id TEXT NOT NULL REFERENCES checks (id), position INTEGER NOT NULL,
  name TEXT NOT NULL, csv TEXT NOT NULL, sha256 TEXT NOT NULL, tracking_rms_N REAL, tracking_max_N REAL,
  fit_force_rms_N REAL, fit_velocity_rms_rad_s REAL, estimate TEXT NOT NULL, converged INTEGER NOT NULL,
  PRIMARY KEY (check_id, position)) STRICT;
CREATE TABLE lateness_histogram (
  check_id TEXT NOT NULL REFERENCES checks (id), bin_us INTEGER NOT NULL, ticks INTEGER NOT NULL,
  PRIMARY KEY (check_id, bin_us)) STRICT;
CREATE TABLE flight_recorder (
  check_id TEXT NOT NULL REFERENCES checks (id), position INTEGER NOT NULL,
  sample_index INTEGER NOT NULL, brake_time_ns INTEGER NOT NULL, host_time_ns INTEGER NOT NULL,
  torque_Nm REAL, velocity_rad_s REAL, force_N REAL, position_rad REAL, torque_command_Nm REAL,
  force_reference_N REAL, lateness_ns INTEGER NOT NULL, trajectory_index INTEGER NOT NULL, repeat INTEGER NOT NULL,
  state INTEGER NOT NULL, phase INTEGER NOT NULL, fault INTEGER NOT NULL,
  PRIMARY KEY (check_id, position)) STRICT;
)sql",
    R"sql(
ALTER TABLE checks ADD COLUMN method TEXT NOT NULL DEFAULT 'oem';
ALTER TABLE checks ADD COLUMN noise_torque_Nm REAL;
)sql",
    R"sql(
ALTER TABLE checks ADD COLUMN cause TEXT NOT NULL DEFAULT '';
)sql",
    R"sql(
CREATE INDEX checks_by_part ON checks (part_number, started);
CREATE INDEX checks_by_batch ON checks (batch, started);
CREATE INDEX checks_by_operator ON checks (operator, started);
CREATE TABLE limits_revisions (
  sha256 TEXT PRIMARY KEY NOT NULL, revision TEXT NOT NULL, author TEXT NOT NULL, changed TEXT NOT NULL,
  file TEXT NOT NULL, contents TEXT NOT NULL, first_used TEXT NOT NULL) STRICT;
CREATE TABLE publication (
  check_id TEXT NOT NULL REFERENCES checks (id), channel TEXT NOT NULL, state INTEGER NOT NULL,
  PRIMARY KEY (check_id, channel)) STRICT;
CREATE INDEX publication_pending ON publication (channel, check_id) WHERE state = 0;
ALTER TABLE runs ADD COLUMN bytes INTEGER NOT NULL DEFAULT 0;
ALTER TABLE runs ADD COLUMN removed TEXT NOT NULL DEFAULT '';
UPDATE runs SET bytes = length(csv);
CREATE INDEX runs_kept ON runs (check_id, bytes) WHERE removed = '';
)sql",
    R"sql(
ALTER TABLE publication ADD COLUMN sequence INTEGER NOT NULL DEFAULT 0;
ALTER TABLE publication ADD COLUMN queued TEXT NOT NULL DEFAULT '';
CREATE TEMPORARY TABLE numbered (check_id TEXT, channel TEXT, sequence INTEGER, PRIMARY KEY (check_id, channel));
INSERT INTO numbered SELECT check_id, channel, ROW_NUMBER() OVER (PARTITION BY channel ORDER BY check_id) FROM publication;
UPDATE publication SET sequence = numbered.sequence FROM numbered
  WHERE numbered.check_id = publication.check_id AND numbered.channel = publication.channel;
DROP TABLE numbered;
CREATE UNIQUE INDEX publication_order ON publication (channel, sequence);
DROP INDEX publication_pending;
CREATE INDEX publication_next ON publication (channel, sequence) WHERE state = 0;
CREATE TABLE outbox_connections (channel TEXT PRIMARY KEY NOT NULL, connections INTEGER NOT NULL) STRICT;
)sql",
    R"sql(
ALTER TABLE checks ADD COLUMN torque_while_off TEXT NOT NULL DEFAULT '';
ALTER TABLE checks ADD COLUMN tare_force_N REAL NOT NULL DEFAULT 0;
ALTER TABLE checks ADD COLUMN tare_force_sd_N REAL NOT NULL DEFAULT 0;
ALTER TABLE checks ADD COLUMN tare_velocity_rad_s REAL NOT NULL DEFAULT 0;
ALTER TABLE checks ADD COLUMN tare_velocity_sd_rad_s REAL NOT NULL DEFAULT 0;
)sql",
    R"sql(
CREATE TABLE amendments (
  id INTEGER PRIMARY KEY, check_id TEXT NOT NULL REFERENCES checks (id), kind TEXT NOT NULL, made TEXT NOT NULL,
  content TEXT NOT NULL) STRICT;
CREATE INDEX amendments_by_check ON amendments (check_id);
CREATE TABLE chain (
  position INTEGER PRIMARY KEY, check_id TEXT NOT NULL, amendment INTEGER, format INTEGER NOT NULL,
  content_sha256 TEXT NOT NULL, chain_sha256 TEXT NOT NULL) STRICT;
CREATE INDEX chain_by_check ON chain (check_id);
ALTER TABLE runs ADD COLUMN data BLOB;
PRAGMA application_id = 1668050288;
)sql",
    // Version 8 was: all checks of older versions are in the chain.
    "",
    R"sql(
ALTER TABLE checks ADD COLUMN systematic TEXT NOT NULL DEFAULT '';
)sql",
    // Version 10 was the same.
    "",
    R"sql(
ALTER TABLE checks ADD COLUMN stopping TEXT NOT NULL DEFAULT '';
)sql",
    // Version 12 was the same.
    "",
    R"sql(
ALTER TABLE checks ADD COLUMN sheet TEXT NOT NULL DEFAULT '';
)sql",
    // Version 14 was the same.
    "",
    R"sql(
ALTER TABLE checks ADD COLUMN recipe TEXT NOT NULL DEFAULT '';
)sql",
    // Version 16 was the same.
    "",
    R"sql(
ALTER TABLE checks ADD COLUMN found_rad TEXT NOT NULL DEFAULT '';
)sql"};

/// All tables are there, but checks of an older version are not all in the chain yet.
constexpr int kSealing = static_cast<int>(kMigrations.size());
static_assert(kSchemaVersion == kSealing + 1);

int version_of(SQLite::Database& database) {
  return database.execAndGet("PRAGMA user_version").getInt();
}

/// What an older version removed by its retention was rightly removed.
void seal(SQLite::Database& database, const std::string& id) {
  Chain(database).append_check(id);
  SQLite::Statement removed(database,
                            "SELECT removed FROM runs WHERE check_id = ? AND removed <> '' LIMIT 1");
  removed.bind(1, id);
  if (removed.executeStep()) amend(database, id, kRunsRemoved, removed.getColumn(0).getString(), "");
}

/// One transaction each, so that a station that is stopped meanwhile goes on where it was.
void seal_older_checks(SQLite::Database& database) {
  constexpr int kChecksAtOnce = 500;
  while (true) {
    SQLite::Transaction transaction(database, SQLite::TransactionBehavior::IMMEDIATE);
    if (version_of(database) > kSealing) return;  // another process was faster
    std::vector<std::string> ids;
    {
      SQLite::Statement unsealed(
          database,
          "SELECT id FROM checks WHERE rowid > COALESCE((SELECT rowid FROM checks WHERE id = "
          "(SELECT check_id FROM chain ORDER BY position DESC LIMIT 1)), 0) ORDER BY rowid LIMIT ?");
      unsealed.bind(1, kChecksAtOnce);
      while (unsealed.executeStep()) ids.push_back(unsealed.getColumn(0).getString());
    }
    if (ids.empty()) database.exec(fmt::format("PRAGMA user_version = {}", kSchemaVersion));
    for (const std::string& id : ids) seal(database, id);
    transaction.commit();
    if (ids.empty()) return;
  }
}

}  // namespace

Result<int> schema_version(SQLite::Database& database, const std::string& path) {
  SQLite::Transaction snapshot(database);  // while another process may just be making the database
  const int application = database.execAndGet("PRAGMA application_id").getInt();
  const int version = version_of(database);
  const bool blank = database.execAndGet("SELECT COUNT(*) FROM sqlite_master").getInt() == 0;
  if (application == 0 && version == 0 && blank) return 0;
  const bool before_application_ids = application == 0 && version > 0 && version < kFirstWithApplicationId &&
                                      database.tableExists("checks") && database.tableExists("parameters") &&
                                      database.tableExists("runs");
  const bool ours = application == kApplicationId && version >= kFirstWithApplicationId;
  if (!ours && !before_application_ids)
    return failure(fmt::format(
        "{}: is a SQLite database, but not one of clampd's results; name another file in [archive] database",
        path));
  if (version > kSchemaVersion)
    return failure(fmt::format("{}: was written by a newer version of clampd (schema {}, this one knows {})",
                               path, version, kSchemaVersion));
  return version;
}

void migrate(SQLite::Database& database, int version) {
  for (std::size_t step = static_cast<std::size_t>(version); step < kMigrations.size(); ++step) {
    SQLite::Transaction transaction(database, SQLite::TransactionBehavior::IMMEDIATE);
    // Another process may have been faster while this one waited for the lock.
    if (version_of(database) > static_cast<int>(step)) continue;
    database.exec(kMigrations[step]);
    database.exec(fmt::format("PRAGMA user_version = {}", step + 1));
    transaction.commit();
  }
  if (version < kSchemaVersion) seal_older_checks(database);
}

}  // namespace clampd
