#include <array>

#include <fmt/format.h>

#include "clampd/base/version.hpp"
#include "src/publish/password.hpp"
#include "src/publish/postgresql_connection.hpp"
#include "src/publish/reachable.hpp"

namespace clampd::publish {
namespace {

/// Step i brings the schema from version i to i + 1. Steps only add, so that stations of different versions
/// may share a database; they are never changed.
constexpr std::array<const char*, kSchemaVersion> kMigrations{
    R"sql(
CREATE TABLE clampd.checks (
  id text PRIMARY KEY,
  serial text NOT NULL, part_number text NOT NULL, batch text NOT NULL,
  station text NOT NULL, fixture text NOT NULL, operator text NOT NULL, software_version text NOT NULL,
  limits_file text NOT NULL, limits_revision text NOT NULL, limits_sha256 text NOT NULL,
  trajectory_sha256 text NOT NULL, instruments jsonb NOT NULL, simulated boolean NOT NULL,
  started timestamptz, stopped timestamptz, duration_s double precision, repeats integer NOT NULL,
  verdict text NOT NULL, marginal boolean NOT NULL, reason text NOT NULL, fault text NOT NULL, cause jsonb,
  method text NOT NULL, noise_force_n double precision, noise_velocity_rad_s double precision,
  noise_torque_nm double precision, tracking_rms_n double precision, timing jsonb NOT NULL,
  covariance_normalised jsonb NOT NULL,
  outbox_sequence bigint NOT NULL, published timestamptz NOT NULL DEFAULT now());
CREATE INDEX checks_by_serial ON clampd.checks (serial, started);
CREATE INDEX checks_by_station ON clampd.checks (station, started);
CREATE INDEX checks_by_time ON clampd.checks (started);
CREATE TABLE clampd.parameters (
  check_id text NOT NULL REFERENCES clampd.checks (id) ON DELETE CASCADE, position integer NOT NULL,
  name text NOT NULL, unit text NOT NULL, value double precision, sd double precision,
  lower double precision, upper double precision, verdict text NOT NULL, PRIMARY KEY (check_id, position));
CREATE INDEX parameters_by_name ON clampd.parameters (name, check_id);
CREATE TABLE clampd.runs (
  check_id text NOT NULL REFERENCES clampd.checks (id) ON DELETE CASCADE, position integer NOT NULL,
  name text NOT NULL, sha256 text NOT NULL, tracking_rms_n double precision, tracking_max_n double precision,
  fit_force_rms_n double precision, fit_velocity_rms_rad_s double precision, converged boolean NOT NULL,
  estimate jsonb NOT NULL, PRIMARY KEY (check_id, position));
)sql",
    R"sql(
ALTER TABLE clampd.checks ADD COLUMN sheet jsonb;
)sql",
    // The runs themselves: a partition a month, made by whoever sends the
    // first run of that month, and dropped as a whole. The functions act
    // with their owner's rights, so that a station needs none to make tables.
    R"sql(
CREATE TABLE clampd.raw_runs (
  sha256 text NOT NULL, recorded timestamptz NOT NULL, data bytea NOT NULL,
  PRIMARY KEY (sha256, recorded)) PARTITION BY RANGE (recorded);
ALTER TABLE clampd.raw_runs ALTER COLUMN data SET STORAGE EXTERNAL;
ALTER TABLE clampd.checks ADD COLUMN tare jsonb;
CREATE FUNCTION clampd.prepare_raw_runs(moment timestamptz) RETURNS void
LANGUAGE plpgsql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
DECLARE
  first timestamp := date_trunc('month', moment AT TIME ZONE 'UTC');
  partition text := 'raw_runs_' || to_char(first, 'YYYY_MM');
BEGIN
  IF to_regclass('clampd.' || partition) IS NOT NULL THEN RETURN; END IF;
  PERFORM pg_advisory_xact_lock(4093081970);
  EXECUTE format('CREATE TABLE IF NOT EXISTS clampd.%I PARTITION OF clampd.raw_runs FOR VALUES FROM (%L) TO (%L)',
    partition, first AT TIME ZONE 'UTC', (first + interval '1 month') AT TIME ZONE 'UTC');
END $$;
CREATE FUNCTION clampd.drop_raw_runs(before timestamptz) RETURNS integer
LANGUAGE plpgsql SECURITY DEFINER SET search_path = pg_catalog, pg_temp AS $$
DECLARE
  old record;
  dropped integer := 0;
BEGIN
  FOR old IN SELECT c.relname FROM pg_inherits i JOIN pg_class c ON c.oid = i.inhrelid
      WHERE i.inhparent = 'clampd.raw_runs'::regclass
        AND c.relname < 'raw_runs_' || to_char(before AT TIME ZONE 'UTC', 'YYYY_MM') LOOP
    EXECUTE format('DROP TABLE clampd.%I', old.relname);
    dropped := dropped + 1;
  END LOOP;
  RETURN dropped;
END $$;
REVOKE ALL ON FUNCTION clampd.drop_raw_runs(timestamptz) FROM PUBLIC;
)sql",
    // The archive identified anew. A job is one task for many checks; its
    // queue has a row for each of them. What a task says of a check is kept
    // by check, task and software, so that no two jobs compute it twice.
    R"sql(
CREATE TABLE clampd.tasks (sha256 text PRIMARY KEY, document text NOT NULL);
CREATE TABLE clampd.jobs (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY, name text NOT NULL,
  task_sha256 text NOT NULL REFERENCES clampd.tasks (sha256), selection jsonb NOT NULL,
  submitted timestamptz NOT NULL DEFAULT now(), submitted_by text NOT NULL DEFAULT session_user);
CREATE TABLE clampd.results (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY, check_id text NOT NULL,
  task_sha256 text NOT NULL REFERENCES clampd.tasks (sha256), software_version text NOT NULL,
  document text NOT NULL, worker text NOT NULL, computed timestamptz NOT NULL DEFAULT clock_timestamp(),
  UNIQUE (check_id, task_sha256, software_version));
CREATE FUNCTION clampd.keep_results() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  RAISE EXCEPTION 'a result is never changed: it says what one version of the software made of the runs';
END $$;
CREATE TRIGGER keep_results BEFORE UPDATE ON clampd.results FOR EACH ROW EXECUTE FUNCTION clampd.keep_results();
CREATE TABLE clampd.queue (
  id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  job_id bigint NOT NULL REFERENCES clampd.jobs (id) ON DELETE CASCADE,
  check_id text NOT NULL REFERENCES clampd.checks (id) ON DELETE CASCADE,
  state text NOT NULL DEFAULT 'waiting'
    CHECK (state IN ('waiting', 'claimed', 'done', 'failed', 'cancelled')),
  attempts integer NOT NULL DEFAULT 0, claim_token uuid, worker text, claimed timestamptz,
  lease_until timestamptz, finished timestamptz, reason text,
  result_id bigint REFERENCES clampd.results (id), UNIQUE (job_id, check_id));
CREATE INDEX queue_open ON clampd.queue (id) WHERE state IN ('waiting', 'claimed');
CREATE INDEX queue_by_check ON clampd.queue (check_id);
)sql",
    R"sql(
ALTER TABLE clampd.checks ADD COLUMN recipe jsonb;
)sql",
    // JSON's null: a fixed number of repeats; SQL's NULL: published by a version that did not say it.
    R"sql(
ALTER TABLE clampd.checks ADD COLUMN stopping jsonb;
)sql",
    R"sql(
ALTER TABLE clampd.checks ADD COLUMN found_rad double precision;
)sql"};

/// A value of a connection string.
std::string quoted(const std::string& text) {
  std::string value = "'";
  for (const char c : text) {
    if (c == '\'' || c == '\\') value += '\\';
    value += c;
  }
  return value + "'";
}

std::string first_line(std::string_view text) {
  return std::string(text.substr(0, text.find('\n')));
}

void bring_up_to_date(pqxx::connection& connection) {
  pqxx::work transaction(connection);
  // Only one station at a time; the number is ours alone.
  transaction.exec("SELECT pg_advisory_xact_lock(4093081970)");
  int version = 0;
  if (transaction.exec1("SELECT to_regclass('clampd.migrations') IS NULL")[0].as<bool>()) {
    transaction.exec("CREATE SCHEMA IF NOT EXISTS clampd");
    transaction.exec(
        "CREATE TABLE clampd.migrations (version integer PRIMARY KEY, applied timestamptz NOT NULL DEFAULT "
        "now())");
  } else {
    version = transaction.exec1("SELECT COALESCE(MAX(version), 0) FROM clampd.migrations")[0].as<int>();
  }
  for (std::size_t step = static_cast<std::size_t>(version); step < kMigrations.size(); ++step) {
    transaction.exec(kMigrations[step]);
    transaction.exec_params("INSERT INTO clampd.migrations (version) VALUES ($1)",
                            static_cast<int>(step + 1));
  }
  transaction.commit();
}

}  // namespace

std::string PostgresqlConnection::where() const {
  return fmt::format("PostgreSQL: {}, database {}", settings_.host, settings_.database);
}

Result<void> PostgresqlConnection::open(const WakeEvent& wake) {
  close();
  if (settings_.host.rfind('/', 0) != 0)
    if (Result<void> there = reachable(settings_.host, settings_.port, wake); !there)
      return failure("PostgreSQL: " + there.error().message + " ([postgresql] host, port)");
  const Result<std::string> password = read_password(settings_.password_file);
  if (!password) return failure("PostgreSQL: " + password.error().message + " ([postgresql] password_file)");
  try {
    connection_ = std::make_unique<pqxx::connection>(description(*password));
  } catch (const std::exception& refused) {
    return failure(fmt::format(
        "{}: no connection: {} ([postgresql] host, port, database, user, password_file, tls_ca_file)",
        where(), first_line(refused.what())));
  }
  return guarded([](pqxx::connection& connection) {
    // A server that hangs must not hang the station's end.
    connection.set_variable("statement_timeout", "'10s'");
    connection.set_variable("lock_timeout", "'10s'");
    // A client that is cut off in the middle of a transaction must not keep others from its rows: by itself
    // the server hears of it after hours.
    connection.set_variable("idle_in_transaction_session_timeout", "'10s'");
  });
}

Result<void> PostgresqlConnection::migrate() {
  return guarded(bring_up_to_date);
}

Result<std::string> PostgresqlConnection::schema_refusal() {
  int version = 0;
  bool may_look = false;
  const Result<void> read = guarded([&](pqxx::connection& connection) {
    pqxx::work transaction(connection);
    may_look = transaction
                   .exec1(
                       "SELECT COALESCE((SELECT has_schema_privilege(oid, 'USAGE') FROM pg_namespace WHERE "
                       "nspname = "
                       "'clampd'), true)")[0]
                   .as<bool>();
    if (!may_look) return;
    if (transaction.exec1("SELECT to_regclass('clampd.migrations') IS NOT NULL")[0].as<bool>())
      version = transaction.exec1("SELECT COALESCE(MAX(version), 0) FROM clampd.migrations")[0].as<int>();
  });
  if (!read) return tl::unexpected(read.error());
  if (!may_look)
    return fmt::format("{}: the user lacks rights: it needs USAGE on schema clampd and SELECT on its tables",
                       where());
  if (version < kSchemaVersion)
    return fmt::format(
        "{}: its schema is {}, and this version ({}) needs {}: `clampctl archive submit` of this version, or "
        "a "
        "station of it, brings it up to date",
        where(), version, kVersion, kSchemaVersion);
  if (version > kSchemaVersion)
    return fmt::format(
        "{}: its schema is {}, newer than the {} that this version ({}) knows: install the newer version "
        "here",
        where(), version, kSchemaVersion, kVersion);
  return std::string();
}

std::string PostgresqlConnection::description(const std::string& password) const {
  std::string text = fmt::format(
      "host={} port={} dbname={} connect_timeout=5 tcp_user_timeout=15000 keepalives_idle=15 "
      "keepalives_interval=5 keepalives_count=3 client_encoding=UTF8 application_name=clampd",
      quoted(settings_.host), settings_.port, quoted(settings_.database));
  if (!settings_.user.empty()) text += " user=" + quoted(settings_.user);
  if (!password.empty()) text += " password=" + quoted(password);
  if (!settings_.tls_ca_file.empty())
    text += " sslmode=verify-full sslrootcert=" + quoted(settings_.tls_ca_file);
  return text;
}

Result<void> PostgresqlConnection::guarded(const std::function<void(pqxx::connection&)>& work) {
  if (connection_ == nullptr) return failure(fmt::format("{}: no connection", where()));
  try {
    work(*connection_);
    return {};
  } catch (const pqxx::insufficient_privilege& refused) {
    return failure(
        fmt::format("{}: {}: the user lacks rights. Who makes the tables first, or of a newer version, needs "
                    "CREATE on the database; a station from then on USAGE on schema clampd, SELECT on "
                    "migrations and on checks (id), INSERT on checks, parameters, runs and raw_runs",
                    where(), first_line(refused.what())));
  } catch (const pqxx::broken_connection& broken) {
    return failure(
        fmt::format("{}: no connection: {} ([postgresql] host, port, database, user, password_file, "
                    "tls_ca_file)",
                    where(), first_line(broken.what())));
  } catch (const std::exception& refused) {
    return failure(fmt::format("{}: {}: look at the server's log", where(), first_line(refused.what())));
  }
}

}  // namespace clampd::publish
