#include <poll.h>

#include <utility>

#include "clampd/archive/compression.hpp"
#include "clampd/publish/document.hpp"
#include "src/publish/postgresql_connection.hpp"

namespace clampd::publish {
namespace {

/// $1: the check's document. A check that is there is the same check: it was sent before, and its
/// acknowledgement was lost.
constexpr const char* kInsertCheck = R"sql(
INSERT INTO clampd.checks (id, serial, part_number, batch, station, fixture, operator, software_version,
  limits_file, limits_revision, limits_sha256, trajectory_sha256, instruments, simulated, started, stopped,
  duration_s, repeats, verdict, marginal, reason, fault, cause, method, noise_force_n, noise_velocity_rad_s,
  noise_torque_nm, tracking_rms_n, timing, covariance_normalised, sheet, outbox_sequence, tare,
  recipe, stopping, found_rad)
SELECT d->>'record', d->>'serial', d->>'part_number', d->>'batch', d->>'station', d->>'fixture',
  d->>'operator', d->>'software_version', d->'limits'->>'file', d->'limits'->>'revision', d->'limits'->>'sha256',
  d->>'trajectory_sha256', d->'instruments', (d->>'simulated')::boolean, NULLIF(d->>'started', '')::timestamptz,
  NULLIF(d->>'stopped', '')::timestamptz, (d->>'duration_s')::double precision, (d->>'repeats')::integer,
  d->>'verdict', (d->>'marginal')::boolean, d->>'reason', d->>'fault', NULLIF(d->'cause', 'null'), d->>'method',
  (d->'noise'->>'force_N')::double precision, (d->'noise'->>'velocity_rad_s')::double precision,
  (d->'noise'->>'torque_Nm')::double precision, (d->>'tracking_rms_N')::double precision, d->'timing',
  d->'covariance_normalised', NULLIF(d->'sheet', 'null'), (d->'outbox'->>'sequence')::bigint, d->'tare',
  NULLIF(d->'recipe', 'null'), d->'stopping', (d->>'found_rad')::double precision
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

/// $1: checksum, $2: start of the check, $3: the run's file, compressed.
constexpr const char* kInsertRawRun =
    "INSERT INTO clampd.raw_runs (sha256, recorded, data) VALUES ($1, $2::timestamptz, $3) "
    "ON CONFLICT DO NOTHING";

void insert_raw_runs(pqxx::work& transaction, const CheckRecord& record) {
  if (record.started.empty() || record.runs.empty()) return;
  transaction.exec_params("SELECT clampd.prepare_raw_runs($1::timestamptz)", record.started);
  for (const RunRecord& run : record.runs)
    if (run.run.size() > 0)  // else retention removed it before raw runs were published, or it is damaged
      transaction.exec_params(kInsertRawRun, run.checksum_sha256, record.started,
                              pqxx::binarystring(compressed_smaller(format_run(run.run))));
}

class PostgresqlChannel final : public Channel {
 public:
  explicit PostgresqlChannel(PostgresqlSettings settings)
      : raw_runs_(settings.raw_runs), connection_(std::move(settings)) {}

  bool wants_raw_runs() const override { return raw_runs_; }

  Result<void> connect(const ConnectionContext&, const WakeEvent& wake) override {
    if (Result<void> open = connection_.open(wake); !open) return open;
    return connection_.migrate();
  }

  Result<void> send(const Publication& publication, const WakeEvent&) override {
    const std::string document = publication_document(publication.record, publication.sequence);
    return connection_.guarded([&](pqxx::connection& connection) {
      pqxx::work transaction(connection);
      for (const char* insert : {kInsertCheck, kInsertParameters, kInsertRuns})
        transaction.exec_params(insert, document);
      if (raw_runs_) insert_raw_runs(transaction, publication.record);
      transaction.commit();
    });
  }

  Result<void> attend(const WakeEvent& wake, std::chrono::milliseconds longest) override {
    return connection_.guarded([&](pqxx::connection& connection) {
      pollfd descriptors[]{{connection.sock(), POLLIN, 0}, {wake.descriptor(), POLLIN, 0}};
      if (::poll(descriptors, 2, static_cast<int>(longest.count())) > 0 && descriptors[0].revents != 0)
        connection.get_notifs();  // an idle server has one thing to say: that it goes
    });
  }

  void close() noexcept override { connection_.close(); }

 private:
  bool raw_runs_;
  PostgresqlConnection connection_;
};

}  // namespace

std::unique_ptr<Channel> make_postgresql_channel(PostgresqlSettings settings) {
  return std::make_unique<PostgresqlChannel>(std::move(settings));
}

}  // namespace clampd::publish
