#include "src/reanalysis/queue.hpp"

#include <fmt/format.h>

#include "clampd/base/version.hpp"

namespace clampd::reanalysis {
namespace {

/// Of the row with this id, if it is still the claim's: $1 id, $2 token.
constexpr const char* kHeld =
    "id = $1 AND state = 'claimed' AND claim_token = $2::uuid AND lease_until > clock_timestamp()";

/// The oldest row that nobody has. Rows that others have locked are passed by.
constexpr const char* kNext = R"sql(SELECT id FROM clampd.queue
  WHERE state = 'waiting' OR (state = 'claimed' AND lease_until <= clock_timestamp())
  ORDER BY id LIMIT 1 FOR UPDATE SKIP LOCKED)sql";

/// A row whose workers all died is what killed them, most likely. Only the row that is next is looked at, so
/// that a claim takes no longer the more rows wait. Of this and the next, {}: kNext, a choice made once and
/// apart, so that no plan makes it again for each row.
constexpr const char* kGiveUp = R"sql(
WITH next AS MATERIALIZED ({})
UPDATE clampd.queue q SET state = 'failed', finished = clock_timestamp(), lease_until = NULL,
  reason = q.attempts || ' workers began with it and none came to an end; the last was ' || q.worker ||
    ': see its log, then clampctl archive retry'
FROM next WHERE q.id = next.id AND q.state = 'claimed' AND q.attempts >= $1)sql";

/// $1: worker, $2: seconds.
constexpr const char* kClaim = R"sql(
WITH next AS MATERIALIZED ({})
UPDATE clampd.queue q SET state = 'claimed', attempts = q.attempts + 1, claim_token = gen_random_uuid(),
  worker = $1, claimed = clock_timestamp(), lease_until = clock_timestamp() + make_interval(secs => $2),
  reason = NULL
FROM next, clampd.jobs j
WHERE q.id = next.id AND j.id = q.job_id
RETURNING q.id, q.claim_token, q.job_id, q.check_id, j.task_sha256)sql";

constexpr const char* kCheck = R"sql(
SELECT serial, verdict, reason, fault, repeats, COALESCE((timing->>'skipped')::bigint, 0),
  COALESCE((timing->>'lost_samples')::bigint, 0), COALESCE(tracking_rms_n, 0),
  (tare->>'force_sd_N')::double precision, (tare->>'velocity_sd_rad_s')::double precision,
  stopping IS NOT NULL, (stopping->>'most')::bigint, (stopping->>'coverage_factor')::double precision,
  sheet->>'file', sheet->>'revision', sheet->>'sha256', COALESCE(stopping->'trajectories', '[]') <> '[]', found_rad
FROM clampd.checks WHERE id = $1)sql";

constexpr const char* kSheet = R"sql(
SELECT line->>'name', line->>'kind', line->>'unit', COALESCE(line->>'circumstances', ''),
  COALESCE((line->>'lower')::double precision, '-infinity'), COALESCE((line->>'upper')::double precision, 'infinity')
FROM clampd.checks, jsonb_array_elements(sheet->'characteristics') WITH ORDINALITY AS list (line, position)
WHERE id = $1 ORDER BY position)sql";

/// Raw runs stand in the partition of their check's start.
constexpr const char* kRuns = R"sql(
SELECT r.name, r.sha256, COALESCE(r.tracking_rms_n, 0), COALESCE(r.tracking_max_n, 0), w.data,
  COALESCE((c.stopping->'followed'->>r.position::int)::int, 0)
FROM clampd.runs r JOIN clampd.checks c ON c.id = r.check_id
LEFT JOIN clampd.raw_runs w ON w.sha256 = r.sha256 AND w.recorded = c.started
WHERE r.check_id = $1 ORDER BY r.position)sql";

constexpr const char* kRights = R"sql(
SELECT has_table_privilege('clampd.checks', 'SELECT') AND has_table_privilege('clampd.runs', 'SELECT') AND
  has_table_privilege('clampd.raw_runs', 'SELECT') AND has_table_privilege('clampd.jobs', 'SELECT') AND
  has_table_privilege('clampd.tasks', 'SELECT') AND has_table_privilege('clampd.queue', 'SELECT') AND
  has_table_privilege('clampd.queue', 'UPDATE') AND has_table_privilege('clampd.results', 'SELECT') AND
  has_table_privilege('clampd.results', 'INSERT'))sql";

/// `row`: of kCheck.
SheetRecord recorded_sheet(pqxx::work& transaction, const std::string& id, const pqxx::row& row) {
  SheetRecord sheet{row[13].as<std::string>(), row[14].as<std::string>(), row[15].as<std::string>(), false, {}};
  for (const pqxx::row& recorded : transaction.exec_params(kSheet, id)) {
    CharacteristicRecord& line = sheet.characteristics.emplace_back();
    line.name = recorded[0].as<std::string>();
    line.kind = recorded[1].as<std::string>();
    line.unit = recorded[2].as<std::string>();
    line.circumstances = recorded[3].as<std::string>();
    line.lower = recorded[4].as<double>();
    line.upper = recorded[5].as<double>();
  }
  return sheet;
}

bool is_done(pqxx::work& transaction, const Claim& claim) {
  return !transaction
              .exec_params(
                  "SELECT 1 FROM clampd.queue WHERE id = $1 AND state = 'done' AND claim_token = $2::uuid",
                  claim.id, claim.token)
              .empty();
}

/// Writes a row that is still the claim's, and nothing otherwise. `values`: what to set, with $3.
Written write_row(pqxx::work& transaction, const Claim& claim, const char* values, const std::string& value) {
  const std::string update = fmt::format("UPDATE clampd.queue SET {} WHERE {}", values, kHeld);
  const pqxx::result written = transaction.exec_params(update, claim.id, claim.token, value);
  return written.affected_rows() == 1 ? Written::Yes : Written::Lost;
}

constexpr const char* kDone =
    "state = 'done', finished = clock_timestamp(), lease_until = NULL, result_id = $3::bigint";
constexpr const char* kFailed =
    "state = 'failed', finished = clock_timestamp(), lease_until = NULL, reason = $3";

Written finish_row(pqxx::work& transaction, const Claim& claim, const std::string& document,
                   const std::string& worker) {
  // Held until the end of the transaction: nobody claims it in between.
  const std::string lock = fmt::format("SELECT 1 FROM clampd.queue WHERE {} FOR UPDATE", kHeld);
  if (transaction.exec_params(lock, claim.id, claim.token).empty())
    return is_done(transaction, claim) ? Written::Yes : Written::Lost;  // the commit's answer had been lost
  const std::string version(kVersion);
  transaction.exec_params(
      "INSERT INTO clampd.results (check_id, task_sha256, software_version, document, worker) "
      "VALUES ($1, $2, $3, $4, $5) ON CONFLICT DO NOTHING",
      claim.check, claim.task_sha256, version, document, worker);
  const pqxx::row kept = transaction.exec_params1(
      "SELECT id, document = $4 FROM clampd.results WHERE check_id = $1 AND task_sha256 = $2 AND "
      "software_version = $3",
      claim.check, claim.task_sha256, version, document);
  if (kept[1].as<bool>()) return write_row(transaction, claim, kDone, kept[0].c_str());
  return write_row(
      transaction, claim, kFailed,
      fmt::format("result {} of the same software says something else of this check; it stays as "
                  "it is: the two machines compute differently",
                  kept[0].c_str()));
}

}  // namespace

Result<std::string> Queue::refusal() {
  Result<std::string> of_schema = connection_.schema_refusal();
  if (!of_schema || !of_schema->empty()) return of_schema;
  std::string refused;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        if (!transaction.exec1("SELECT has_schema_privilege('clampd', 'USAGE')")[0].as<bool>() ||
            !transaction.exec1(kRights)[0].as<bool>())
          refused = fmt::format(
              "{}: the user lacks rights: a worker needs USAGE on schema clampd, SELECT on all of its "
              "tables, "
              "INSERT on clampd.results and UPDATE on clampd.queue",
              where());
      })
      .map([&] { return refused; });
}

Result<std::optional<Claim>> Queue::claim(const std::string& worker, std::chrono::seconds lease) {
  std::optional<Claim> claim;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        static const std::string give_up = fmt::format(kGiveUp, kNext), take = fmt::format(kClaim, kNext);
        while (transaction.exec_params(give_up, kMostAttempts).affected_rows() > 0) continue;
        const pqxx::result rows = transaction.exec_params(take, worker, static_cast<double>(lease.count()));
        transaction.commit();
        if (rows.empty()) return;
        const pqxx::row row = rows[0];
        claim = Claim{row[0].as<std::int64_t>(), row[1].as<std::string>(), row[2].as<std::int64_t>(),
                      row[3].as<std::string>(), row[4].as<std::string>()};
      })
      .map([&] { return claim; });
}

Result<std::string> Queue::task(const std::string& sha256) {
  std::string document;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        document = transaction.exec_params1("SELECT document FROM clampd.tasks WHERE sha256 = $1", sha256)[0]
                       .as<std::string>();
      })
      .map([&] { return document; });
}

Result<ArchivedCheck> Queue::check(const std::string& id) {
  ArchivedCheck check;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        const pqxx::row row = transaction.exec_params1(kCheck, id);
        check.id = id;
        check.serial = row[0].as<std::string>();
        check.verdict = parse_verdict(row[1].as<std::string>()).value_or(Verdict::Error);
        check.reason = row[2].as<std::string>();
        check.fault = row[3].as<std::string>();
        check.repeats = row[4].as<std::uint32_t>();
        check.ticks_skipped = row[5].as<std::uint64_t>();
        check.samples_lost = row[6].as<std::uint64_t>();
        check.tracking_rms_N = row[7].as<double>();
        if (!row[8].is_null()) check.tare_force_sd_N = row[8].as<double>();
        if (!row[9].is_null()) check.tare_velocity_sd_rad_s = row[9].as<double>();
        check.is_stopping_known = row[10].as<bool>();
        if (!row[11].is_null()) check.stopping = {row[11].as<std::uint32_t>(), row[12].as<double>(0.0), {}};
        check.chose_runs = row[16].as<bool>();
        if (!row[17].is_null()) check.found_rad = row[17].as<double>();
        if (!row[13].is_null()) check.sheet = recorded_sheet(transaction, id, row);
        for (const pqxx::row& run : transaction.exec_params(kRuns, id)) {
          ArchivedRun& archived = check.runs.emplace_back();
          archived.name = run[0].as<std::string>();
          archived.sha256 = run[1].as<std::string>();
          archived.tracking_rms_N = run[2].as<double>();
          archived.tracking_max_N = run[3].as<double>();
          if (!run[4].is_null()) archived.data = pqxx::binarystring(run[4]).str();
          archived.trajectory = static_cast<std::uint8_t>(run[5].as<int>());
        }
      })
      .map([&] { return std::move(check); });
}

Result<bool> Queue::finish_with_known(const Claim& claim) {
  bool known = false;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        const pqxx::result found = transaction.exec_params(
            "SELECT id FROM clampd.results WHERE check_id = $1 AND task_sha256 = $2 AND software_version = "
            "$3",
            claim.check, claim.task_sha256, std::string(kVersion));
        if (found.empty()) return;
        known = write_row(transaction, claim, kDone, found[0][0].c_str()) == Written::Yes;
        transaction.commit();
      })
      .map([&] { return known; });
}

Result<Written> Queue::renew(const Claim& claim, std::chrono::seconds lease) {
  Written written = Written::Lost;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        written = write_row(transaction, claim,
                            "lease_until = clock_timestamp() + make_interval(secs => $3::double precision)",
                            std::to_string(lease.count()));
        transaction.commit();
      })
      .map([&] { return written; });
}

Result<Written> Queue::finish(const Claim& claim, const std::string& document, const std::string& worker) {
  Written written = Written::Lost;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        written = finish_row(transaction, claim, document, worker);
        if (written == Written::Yes) transaction.commit();  // otherwise the result is taken back, too
      })
      .map([&] { return written; });
}

Result<Written> Queue::fail(const Claim& claim, const std::string& reason) {
  Written written = Written::Lost;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        written = write_row(transaction, claim, kFailed, reason);
        transaction.commit();
      })
      .map([&] { return written; });
}

Result<Written> Queue::give_back(const Claim& claim) {
  Written written = Written::Lost;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        written =
            write_row(transaction, claim,
                      "state = 'waiting', attempts = attempts - 1, lease_until = NULL, claim_token = NULL, "
                      "worker = NULLIF($3, '')",
                      "");
        transaction.commit();
      })
      .map([&] { return written; });
}

Result<OpenTasks> Queue::open_tasks() {
  OpenTasks open;
  return connection_
      .guarded([&](pqxx::connection& connection) {
        pqxx::work transaction(connection);
        const pqxx::row row = transaction.exec1(
            "SELECT count(*) FILTER (WHERE state = 'waiting'), count(*) FILTER (WHERE state = 'claimed') "
            "FROM clampd.queue WHERE state IN ('waiting', 'claimed')");
        open = {row[0].as<std::int64_t>(), row[1].as<std::int64_t>()};
      })
      .map([&] { return open; });
}

}  // namespace clampd::reanalysis
