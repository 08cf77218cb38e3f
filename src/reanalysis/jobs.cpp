#include "clampd/reanalysis/jobs.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/base/version.hpp"
#include "clampd/publish/wake_event.hpp"
#include "clampd/record/checksum.hpp"
#include "src/publish/postgresql_connection.hpp"

namespace clampd::reanalysis {
namespace {

using nlohmann::ordered_json;

/// $2: serials (JSON), part number, batch, station, since, until. Checks without runs have nothing to
/// identify.
constexpr const char* kChosen = R"sql(
SELECT c.id, NOT EXISTS (SELECT FROM clampd.runs r WHERE r.check_id = c.id AND NOT EXISTS (
    SELECT FROM clampd.raw_runs w WHERE w.sha256 = r.sha256 AND w.recorded = c.started)) AS has_raw_runs
FROM clampd.checks c
WHERE EXISTS (SELECT FROM clampd.runs r WHERE r.check_id = c.id)
  AND (jsonb_array_length($1::jsonb) = 0 OR c.serial IN (SELECT jsonb_array_elements_text($1::jsonb)))
  AND ($2 = '' OR c.part_number = $2) AND ($3 = '' OR c.batch = $3) AND ($4 = '' OR c.station = $4)
  AND ($5 = '' OR c.started >= NULLIF($5, '')::timestamptz)
  AND ($6 = '' OR c.started <= NULLIF($6, '')::timestamptz))sql";

constexpr const char* kInsertJob =
    "INSERT INTO clampd.jobs (name, task_sha256, selection) VALUES ($1, $2, $3::jsonb) RETURNING id";

/// Rates by the server's clock, over ten minutes or since the first claim of them.
constexpr const char* kStatus = R"sql(
SELECT j.id, j.name, to_char(j.submitted AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS"Z"'), j.submitted_by,
  j.task_sha256, q.waiting, q.claimed, q.done, q.failed, q.cancelled, q.workers,
  CASE WHEN q.seconds > 0 THEN q.recent / q.seconds ELSE 0 END AS rate,
  to_char((clock_timestamp() + make_interval(secs => (q.waiting + q.claimed) * q.seconds / NULLIF(q.recent, 0)))
    AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS"Z"')
FROM clampd.jobs j CROSS JOIN LATERAL (
  SELECT count(*) FILTER (WHERE state = 'waiting') AS waiting, count(*) FILTER (WHERE state = 'claimed') AS claimed,
    count(*) FILTER (WHERE state = 'done') AS done, count(*) FILTER (WHERE state = 'failed') AS failed,
    count(*) FILTER (WHERE state = 'cancelled') AS cancelled,
    count(DISTINCT worker) FILTER (WHERE state = 'claimed' AND lease_until > clock_timestamp()) AS workers,
    count(*) FILTER (WHERE state = 'done' AND finished > clock_timestamp() - interval '10 minutes')
      ::double precision AS recent,
    extract(epoch FROM clock_timestamp() - min(claimed) FILTER (WHERE state = 'done' AND
      finished > clock_timestamp() - interval '10 minutes'))::double precision AS seconds
  FROM clampd.queue WHERE job_id = j.id) q
WHERE $1::bigint IS NULL OR j.id = $1::bigint
ORDER BY j.id DESC LIMIT $2)sql";

/// Reasons name their check; without it, those of one kind are one.
constexpr const char* kFailures = R"sql(
SELECT min(reason), count(*) FROM clampd.queue WHERE job_id = $1 AND state = 'failed'
GROUP BY replace(reason, check_id, '') ORDER BY count(*) DESC, min(reason) LIMIT 20)sql";

constexpr const char* kResults = R"sql(
SELECT q.check_id, q.state, COALESCE(q.reason, ''), COALESCE(r.document, '')
FROM clampd.queue q LEFT JOIN clampd.results r ON r.id = q.result_id
WHERE q.job_id = $1 ORDER BY q.check_id)sql";

constexpr const char* kWithRecorded = R"sql(
SELECT q.check_id, c.serial, r.document, json_build_object('verdict', c.verdict, 'parameters', COALESCE((
    SELECT json_agg(json_build_object('name', p.name, 'unit', p.unit, 'value', p.value, 'sd', p.sd)
      ORDER BY p.position) FROM clampd.parameters p WHERE p.check_id = c.id), '[]'::json),
  'stopping', c.stopping, 'sheet', c.sheet)::text
FROM clampd.queue q JOIN clampd.results r ON r.id = q.result_id JOIN clampd.checks c ON c.id = q.check_id
WHERE q.job_id = $1 ORDER BY q.check_id)sql";

constexpr const char* kWithJob = R"sql(
SELECT q.check_id, c.serial, r.document, b.document
FROM clampd.queue q JOIN clampd.results r ON r.id = q.result_id JOIN clampd.checks c ON c.id = q.check_id
JOIN clampd.queue o ON o.check_id = q.check_id AND o.job_id = $2 JOIN clampd.results b ON b.id = o.result_id
WHERE q.job_id = $1 ORDER BY q.check_id)sql";

constexpr const char* kScored = R"sql(
SELECT q.check_id, c.serial, c.station, COALESCE(c.fixture, ''), COALESCE(c.batch, ''), r.document
FROM clampd.queue q JOIN clampd.results r ON r.id = q.result_id JOIN clampd.checks c ON c.id = q.check_id
WHERE q.job_id = $1 ORDER BY c.started, q.check_id)sql";

constexpr std::size_t kDate = 10;  // YYYY-MM-DD

ordered_json selection_json(const Selection& selection) {
  return {{"serials", selection.serials}, {"part_number", selection.part_number},
          {"batch", selection.batch},     {"station", selection.station},
          {"since", selection.since},     {"until", selection.until}};
}

JobStatus status_of(const pqxx::row& row) {
  JobStatus status;
  status.id = row[0].as<std::int64_t>();
  status.name = row[1].as<std::string>();
  status.submitted = row[2].as<std::string>();
  status.submitted_by = row[3].as<std::string>();
  status.task_sha256 = row[4].as<std::string>();
  int column = 5;
  for (std::int64_t* count :
       {&status.waiting, &status.claimed, &status.done, &status.failed, &status.cancelled, &status.workers})
    *count = row[column++].as<std::int64_t>();
  status.done_per_s = row[column++].as<double>();
  const std::int64_t left = status.waiting + status.claimed;
  if (status.done_per_s > 0.0 && left > 0) {
    status.left_s = static_cast<double>(left) / status.done_per_s;
    status.end = row[column].as<std::string>("");
  }
  return status;
}

std::vector<std::pair<std::string, std::int64_t>> failures_of(pqxx::work& transaction, std::int64_t job) {
  std::vector<std::pair<std::string, std::int64_t>> failures;
  for (const pqxx::row& row : transaction.exec_params(kFailures, job))
    failures.emplace_back(row[0].as<std::string>(), row[1].as<std::int64_t>());
  return failures;
}

}  // namespace

class Jobs::Connection {
 public:
  explicit Connection(publish::PostgresqlSettings settings) : connection_(std::move(settings)) {}

  Result<void> open(bool may_migrate) {
    const publish::WakeEvent wake;
    if (Result<void> opened = connection_.open(wake); !opened) return opened;
    if (may_migrate)
      if (Result<void> migrated = connection_.migrate(); !migrated) return migrated;
    const Result<std::string> refusal = connection_.schema_refusal();
    if (!refusal) return tl::unexpected(refusal.error());
    if (!refusal->empty()) return failure(*refusal);
    return {};
  }

  /// In one transaction.
  template <class Work>
  Result<void> transact(const Work& work) {
    return connection_.guarded([&](pqxx::connection& connection) {
      pqxx::work transaction(connection);
      work(transaction);
      transaction.commit();
    });
  }
  std::string where() const { return connection_.where(); }

 private:
  publish::PostgresqlConnection connection_;
};

Jobs::Jobs(std::unique_ptr<Connection> connection) : connection_(std::move(connection)) {}
Jobs::~Jobs() = default;
Jobs::Jobs(Jobs&&) noexcept = default;

Result<Jobs> Jobs::open(const publish::PostgresqlSettings& settings, bool may_migrate) {
  auto connection = std::make_unique<Connection>(settings);
  return connection->open(may_migrate).map([&] { return Jobs(std::move(connection)); });
}

Result<SubmittedJob> Jobs::submit(const std::string& name, const Task& task, const Selection& selection) {
  const std::string document = format_task(task);
  const std::string sha256 = sha256_hex(document);
  const std::string serials = ordered_json(selection.serials).dump();
  const std::string since = selection.since + (selection.since.size() == kDate ? "Z" : "");
  const std::string until = selection.until + (selection.until.size() == kDate ? " 23:59:59.999999Z" : "");
  SubmittedJob job;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        const pqxx::result chosen = transaction.exec_params(kChosen, serials, selection.part_number,
                                                            selection.batch, selection.station, since, until);
        ordered_json checks = ordered_json::array();
        for (const pqxx::row& row : chosen) {
          if (row[1].as<bool>())
            checks.push_back(row[0].c_str());
          else
            ++job.without_runs;
        }
        job.tasks = static_cast<std::int64_t>(checks.size());
        if (checks.empty()) return;  // no job that would have nothing to do
        transaction.exec_params(
            "INSERT INTO clampd.tasks (sha256, document) VALUES ($1, $2) ON CONFLICT DO NOTHING", sha256,
            document);
        job.id = transaction.exec_params1(kInsertJob, name, sha256, selection_json(selection).dump())[0]
                     .as<std::int64_t>();
        transaction.exec_params(
            "INSERT INTO clampd.queue (job_id, check_id) SELECT $1, c FROM "
            "jsonb_array_elements_text($2::jsonb) c",
            job.id, checks.dump());
        job.known = transaction
                        .exec_params1(
                            "SELECT count(*) FROM clampd.queue q JOIN clampd.results r ON r.check_id = "
                            "q.check_id WHERE q.job_id = $1 AND r.task_sha256 = $2 AND "
                            "r.software_version = $3",
                            job.id, sha256, std::string(kVersion))[0]
                        .as<std::int64_t>();
      })
      .map([&] { return job; });
}

Result<std::int64_t> Jobs::find(const std::string& job) {
  const bool is_number =
      !job.empty() && job.size() < 19 && job.find_first_not_of("0123456789") == std::string::npos;
  if (!is_number && job != "last")
    return failure(
        fmt::format("'{}' is no job: give its number, or `last`; `clampctl archive status` lists them", job));
  std::int64_t id = 0;
  const Result<void> found = connection_->transact([&](pqxx::work& transaction) {
    const pqxx::result rows =
        is_number ? transaction.exec_params("SELECT id FROM clampd.jobs WHERE id = $1", std::stoll(job))
                  : transaction.exec("SELECT id FROM clampd.jobs ORDER BY id DESC LIMIT 1");
    if (!rows.empty()) id = rows[0][0].as<std::int64_t>();
  });
  if (!found) return tl::unexpected(found.error());
  if (id == 0)
    return failure(is_number ? fmt::format("{}: there is no job {}; `clampctl archive status` lists them",
                                           connection_->where(), job)
                             : fmt::format("{}: there is no job yet; `clampctl archive submit` makes one",
                                           connection_->where()));
  return id;
}

Result<std::vector<JobStatus>> Jobs::list(int most) {
  std::vector<JobStatus> list;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        for (const pqxx::row& row : transaction.exec_params(kStatus, static_cast<const char*>(nullptr), most))
          list.push_back(status_of(row));
        for (JobStatus& status : list) status.failures = failures_of(transaction, status.id);
      })
      .map([&] { return std::move(list); });
}

Result<JobStatus> Jobs::status(std::int64_t job) {
  JobStatus status;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        status = status_of(transaction.exec_params1(kStatus, job, 1));
        status.failures = failures_of(transaction, job);
      })
      .map([&] { return std::move(status); });
}

Result<std::vector<JobResult>> Jobs::results(std::int64_t job) {
  std::vector<JobResult> results;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        for (const pqxx::row& row : transaction.exec_params(kResults, job))
          results.push_back({row[0].c_str(), row[1].c_str(), row[2].c_str(), row[3].c_str()});
      })
      .map([&] { return std::move(results); });
}

Result<std::vector<ComparedCheck>> Jobs::compared(std::int64_t job, std::optional<std::int64_t> with) {
  std::vector<ComparedCheck> checks;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        const pqxx::result rows = with ? transaction.exec_params(kWithJob, job, *with)
                                       : transaction.exec_params(kWithRecorded, job);
        for (const pqxx::row& row : rows)
          checks.push_back({row[0].c_str(), row[1].c_str(), row[2].c_str(), row[3].c_str()});
      })
      .map([&] { return std::move(checks); });
}

Result<std::vector<ScoredCheck>> Jobs::scored(std::int64_t job) {
  std::vector<ScoredCheck> checks;
  std::string wrong;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        for (const pqxx::row& row : transaction.exec_params(kScored, job)) {
          Result<EffectScores> scores = parse_scores(row[5].c_str());
          if (!scores) {
            wrong = fmt::format("check {}: {}", row[0].c_str(), scores.error().message);
            return;
          }
          checks.push_back({row[0].c_str(), row[1].c_str(), row[2].c_str(), row[3].c_str(), row[4].c_str(),
                            std::move(*scores)});
        }
      })
      .and_then([&]() -> Result<std::vector<ScoredCheck>> {
        if (!wrong.empty()) return failure(wrong);
        return std::move(checks);
      });
}

Result<std::int64_t> Jobs::retry(std::int64_t job) {
  std::int64_t rows = 0;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        rows = static_cast<std::int64_t>(
            transaction
                .exec_params("UPDATE clampd.queue SET state = 'waiting', attempts = 0, finished = NULL, "
                             "reason = NULL, claim_token = NULL WHERE job_id = $1 AND state IN ('failed', "
                             "'cancelled')",
                             job)
                .affected_rows());
      })
      .map([&] { return rows; });
}

Result<std::int64_t> Jobs::cancel(std::int64_t job) {
  std::int64_t rows = 0;
  return connection_
      ->transact([&](pqxx::work& transaction) {
        rows = static_cast<std::int64_t>(
            transaction
                .exec_params(
                    "UPDATE clampd.queue SET state = 'cancelled', finished = clock_timestamp(), "
                    "lease_until = NULL, claim_token = NULL WHERE job_id = $1 AND state IN ('waiting', "
                    "'claimed')",
                    job)
                .affected_rows());
      })
      .map([&] { return rows; });
}

}  // namespace clampd::reanalysis
