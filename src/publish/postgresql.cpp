#include <poll.h>

#include <array>
#include <utility>

#include <fmt/format.h>
#include <pqxx/pqxx>

#include "clampd/publish/channel.hpp"
#include "clampd/publish/document.hpp"
#include "src/publish/password.hpp"
#include "src/publish/reachable.hpp"

namespace clampd::publish {
namespace {

/// Step i brings the schema from version i to i + 1. Steps only add, so that stations of different versions
/// may share a database; they are never changed.
constexpr std::array<const char*, 2> kMigrations{R"sql(
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
)sql"};

/// $1: the check's document. A check that is there is the same check: it was sent before, and its
/// acknowledgement was lost.
constexpr const char* kInsertCheck = R"sql(
INSERT INTO clampd.checks (id, serial, part_number, batch, station, fixture, operator, software_version,
  limits_file, limits_revision, limits_sha256, trajectory_sha256, instruments, simulated, started, stopped,
  duration_s, repeats, verdict, marginal, reason, fault, cause, method, noise_force_n, noise_velocity_rad_s,
  noise_torque_nm, tracking_rms_n, timing, covariance_normalised, sheet, outbox_sequence)
SELECT d->>'record', d->>'serial', d->>'part_number', d->>'batch', d->>'station', d->>'fixture',
  d->>'operator', d->>'software_version', d->'limits'->>'file', d->'limits'->>'revision', d->'limits'->>'sha256',
  d->>'trajectory_sha256', d->'instruments', (d->>'simulated')::boolean, NULLIF(d->>'started', '')::timestamptz,
  NULLIF(d->>'stopped', '')::timestamptz, (d->>'duration_s')::double precision, (d->>'repeats')::integer,
  d->>'verdict', (d->>'marginal')::boolean, d->>'reason', d->>'fault', NULLIF(d->'cause', 'null'), d->>'method',
  (d->'noise'->>'force_N')::double precision, (d->'noise'->>'velocity_rad_s')::double precision,
  (d->'noise'->>'torque_Nm')::double precision, (d->>'tracking_rms_N')::double precision, d->'timing',
  d->'covariance_normalised', NULLIF(d->'sheet', 'null'), (d->'outbox'->>'sequence')::bigint
FROM (SELECT $1::jsonb AS d) AS document
ON CONFLICT (id) DO NOTHING)sql";

constexpr const char* kInsertParameters = R"sql(
INSERT INTO clampd.parameters (check_id, position, name, unit, value, sd, lower, upper, verdict)
SELECT d->>'record', n - 1, p->>'name', p->>'unit', (p->>'value')::double precision, (p->>'sd')::double precision,
  (p->>'lower')::double precision, (p->>'upper')::double precision, p->>'verdict'
FROM (SELECT $1::jsonb AS d) AS document, jsonb_array_elements(d->'parameters') WITH ORDINALITY AS list (p, n)
ON CONFLICT DO NOTHING)sql";

constexpr const char* kInsertRuns = R"sql(
INSERT INTO clampd.runs (check_id, position, name, sha256, tracking_rms_n, tracking_max_n, fit_force_rms_n,
  fit_velocity_rms_rad_s, converged, estimate)
SELECT d->>'record', n - 1, r->>'name', r->>'sha256', (r->>'tracking_rms_N')::double precision,
  (r->>'tracking_max_N')::double precision, (r->'fit'->>'force_rms_N')::double precision,
  (r->'fit'->>'velocity_rms_rad_s')::double precision, (r->>'converged')::boolean, r->'estimate'
FROM (SELECT $1::jsonb AS d) AS document, jsonb_array_elements(d->'runs') WITH ORDINALITY AS list (r, n)
ON CONFLICT DO NOTHING)sql";

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

void migrate(pqxx::connection& connection) {
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

class PostgresqlChannel final : public Channel {
 public:
  explicit PostgresqlChannel(PostgresqlSettings settings) : settings_(std::move(settings)) {}

  Result<void> connect(const ConnectionContext&, const WakeEvent& wake) override {
    close();
    if (settings_.host.rfind('/', 0) != 0)
      if (Result<void> there = reachable(settings_.host, settings_.port, wake); !there)
        return failure("PostgreSQL: " + there.error().message + " ([postgresql] host, port)");
    const Result<std::string> password = read_password(settings_.password_file);
    if (!password)
      return failure("PostgreSQL: " + password.error().message + " ([postgresql] password_file)");
    return guarded([&] {
      connection_ = std::make_unique<pqxx::connection>(description(*password));
      // A server that hangs must not hang the station's end.
      connection_->set_variable("statement_timeout", "'10s'");
      connection_->set_variable("lock_timeout", "'10s'");
      migrate(*connection_);
    });
  }

  Result<void> send(const Publication& publication, const WakeEvent&) override {
    const std::string document = publication_document(publication.record, publication.sequence);
    return guarded([&] {
      pqxx::work transaction(*connection_);
      for (const char* insert : {kInsertCheck, kInsertParameters, kInsertRuns})
        transaction.exec_params(insert, document);
      transaction.commit();
    });
  }

  Result<void> attend(const WakeEvent& wake, std::chrono::milliseconds longest) override {
    return guarded([&] {
      pollfd descriptors[]{{connection_->sock(), POLLIN, 0}, {wake.descriptor(), POLLIN, 0}};
      if (::poll(descriptors, 2, static_cast<int>(longest.count())) > 0 && descriptors[0].revents != 0)
        connection_->get_notifs();  // an idle server has one thing to say: that it goes
    });
  }

  void close() noexcept override { connection_.reset(); }

 private:
  std::string description(const std::string& password) const {
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

  template <class Work>
  Result<void> guarded(Work work) {
    const auto where = fmt::format("PostgreSQL: {}, database {}", settings_.host, settings_.database);
    try {
      work();
      return {};
    } catch (const pqxx::insufficient_privilege& refused) {
      return failure(
          fmt::format("{}: {}: the user needs CREATE on the database once, and then INSERT and SELECT in "
                      "schema clampd",
                      where, first_line(refused.what())));
    } catch (const pqxx::broken_connection& broken) {
      return failure(
          fmt::format("{}: no connection: {} ([postgresql] host, port, database, user, password_file, "
                      "tls_ca_file)",
                      where, first_line(broken.what())));
    } catch (const std::exception& refused) {
      return failure(fmt::format("{}: {}: look at the server's log", where, first_line(refused.what())));
    }
  }

  PostgresqlSettings settings_;
  std::unique_ptr<pqxx::connection> connection_;
};

}  // namespace

std::unique_ptr<Channel> make_postgresql_channel(PostgresqlSettings settings) {
  return std::make_unique<PostgresqlChannel>(std::move(settings));
}

}  // namespace clampd::publish
