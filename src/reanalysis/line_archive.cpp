#include "clampd/reanalysis/line_archive.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <map>
#include <string_view>

#include <fmt/format.h>

#include "src/publish/postgresql_connection.hpp"

namespace clampd::reanalysis {
namespace {

constexpr int kMostClaims = 200;
constexpr int kMostJobs = 10;

constexpr const char* kLineRights = R"sql(
SELECT has_table_privilege('clampd.checks', 'SELECT') AND has_table_privilege('clampd.parameters', 'SELECT') AND
  has_table_privilege('clampd.jobs', 'SELECT') AND has_table_privilege('clampd.queue', 'SELECT'))sql";

/// $1: how many. The names come from the index of stations one after another, so that it takes no longer the
/// more checks there are.
constexpr const char* kLastChecks = R"sql(
WITH RECURSIVE names AS (
  (SELECT station FROM clampd.checks ORDER BY station LIMIT 1)
  UNION ALL
  SELECT (SELECT c.station FROM clampd.checks c WHERE c.station > n.station ORDER BY c.station LIMIT 1)
  FROM names n WHERE n.station IS NOT NULL)
SELECT n.station, extract(epoch FROM last.started)::double precision, last.serial, last.part_number, last.verdict,
  last.reason
FROM names n CROSS JOIN LATERAL (SELECT c.started, c.serial, c.part_number, c.verdict, c.reason FROM clampd.checks c
  WHERE c.station = n.station AND c.started IS NOT NULL ORDER BY c.started DESC LIMIT 1) last
ORDER BY last.started DESC LIMIT $1)sql";

/// $1: since, seconds since 1970; $2: how many.
constexpr const char* kListed = R"sql(
SELECT extract(epoch FROM started)::double precision, station, part_number, verdict, simulated
FROM clampd.checks WHERE started >= to_timestamp($1) ORDER BY started DESC LIMIT $2)sql";

/// $1: since, $2: part number, $3: how many, $4: parameters, which stand first in a check. What lacks one is
/// left out.
constexpr const char* kMeasured = R"sql(
SELECT extract(epoch FROM c.started)::double precision, c.station, c.fixture, c.serial, c.batch, c.simulated,
  p.value, p.sd, p.lower, p.upper
FROM (SELECT * FROM clampd.checks WHERE started >= to_timestamp($1) AND part_number = $2 AND
    verdict IN ('PASS', 'FAIL') AND station <> '' AND serial <> '' ORDER BY started DESC LIMIT $3) c
CROSS JOIN LATERAL (SELECT array_agg(value ORDER BY position) AS value, array_agg(sd ORDER BY position) AS sd,
    array_agg(lower ORDER BY position) AS lower, array_agg(upper ORDER BY position) AS upper
  FROM clampd.parameters WHERE check_id = c.id AND position < $4
  HAVING count(value) = $4 AND count(sd) = $4) p
ORDER BY c.started DESC)sql";

/// $1: how many.
constexpr const char* kHeldClaims = R"sql(
SELECT COALESCE(q.worker, ''), q.job_id, j.name, q.check_id, COALESCE(c.serial, ''),
  extract(epoch FROM q.claimed)::double precision, q.attempts, q.lease_until > clock_timestamp()
FROM clampd.queue q JOIN clampd.jobs j ON j.id = q.job_id LEFT JOIN clampd.checks c ON c.id = q.check_id
WHERE q.state = 'claimed' ORDER BY q.claimed, q.id LIMIT $1)sql";

Verdict verdict_of(const pqxx::field& field) {
  return parse_verdict(field.c_str()).value_or(Verdict::Error);
}

/// The numbers of an array of double precision, NaN where one is missing.
std::array<double, kParameterCount> numbers(const pqxx::field& array) {
  std::array<double, kParameterCount> values;
  values.fill(std::numeric_limits<double>::quiet_NaN());
  std::string_view text(array.c_str());
  if (text.size() < 2) return values;
  text = text.substr(1, text.size() - 2);  // {1,NULL,-Infinity}
  for (double& value : values) {
    const std::string_view cell = text.substr(0, text.find(','));
    std::from_chars(cell.data(), cell.data() + cell.size(), value);
    text.remove_prefix(std::min(text.size(), cell.size() + 1));
  }
  return values;
}

MeasuredCheck measured_check(const pqxx::row& row) {
  MeasuredCheck check{row[0].as<double>(),
                      row[1].as<std::string>(),
                      row[2].as<std::string>(),
                      row[3].as<std::string>(),
                      row[4].as<std::string>(),
                      row[5].as<bool>(),
                      {},
                      {}};
  const auto values = numbers(row[6]), deviations = numbers(row[7]), lower = numbers(row[8]),
             upper = numbers(row[9]);
  constexpr double kNone = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    check.readings[i] = {values[i], deviations[i]};
    check.limits[i] = {std::isnan(lower[i]) ? -kNone : lower[i], std::isnan(upper[i]) ? kNone : upper[i]};
  }
  return check;
}

bool is_finite(const MeasuredCheck& check) {
  return std::all_of(check.readings.begin(), check.readings.end(), [](const auto& reading) {
    return std::isfinite(reading.first) && std::isfinite(reading.second) && reading.second >= 0.0;
  });
}

std::string usual_part(const std::vector<ListedCheck>& checks) {
  std::map<std::string, std::size_t> counts;
  for (const ListedCheck& check : checks) ++counts[check.part_number];
  const auto most = std::max_element(counts.begin(), counts.end(),
                                     [](const auto& a, const auto& b) { return a.second < b.second; });
  return most == counts.end() ? std::string() : most->first;
}

// Of everything one row more than is wanted is asked for, to tell whether there are more.

void read_stations(pqxx::work& transaction, const LineQuestion& question, LineRows& rows) {
  for (const pqxx::row& row : transaction.exec_params(kLastChecks, question.most_stations + 1))
    rows.stations.push_back({row[0].as<std::string>(), row[1].as<double>(), row[2].as<std::string>(),
                             row[3].as<std::string>(), verdict_of(row[4]), row[5].as<std::string>()});
  rows.more_stations = rows.stations.size() > question.most_stations;
  if (rows.more_stations) rows.stations.pop_back();
}

void read_checks(pqxx::work& transaction, const LineQuestion& question, LineRows& rows) {
  const double since_s = question.span.since_s(rows.now_s);
  for (const pqxx::row& row : transaction.exec_params(kListed, since_s, question.most_checks + 1))
    rows.checks.push_back({row[0].as<double>(), row[1].as<std::string>(), row[2].as<std::string>(),
                           verdict_of(row[3]), row[4].as<bool>()});
  rows.more_checks = rows.checks.size() > question.most_checks;
  if (rows.more_checks) rows.checks.pop_back();
  rows.part_number = question.part_number ? *question.part_number : usual_part(rows.checks);
  for (const pqxx::row& row : transaction.exec_params(kMeasured, since_s, rows.part_number,
                                                      question.most_checks + 1, kParameterCount))
    if (MeasuredCheck check = measured_check(row); is_finite(check))
      rows.measured.push_back(std::move(check));
  rows.more_measured = rows.measured.size() > question.most_checks;
  if (rows.more_measured) rows.measured.pop_back();
}

void read_claims(pqxx::work& transaction, LineRows& rows) {
  for (const pqxx::row& row : transaction.exec_params(kHeldClaims, kMostClaims))
    rows.claims.push_back({row[0].as<std::string>(), row[1].as<std::int64_t>(), row[2].as<std::string>(),
                           row[3].as<std::string>(), row[4].as<std::string>(), row[5].as<double>(0.0),
                           row[6].as<int>(), row[7].as<bool>(false)});
}

}  // namespace

double LineSpan::since_s(double now_s) const {
  return (std::floor(now_s / period_s) - (periods - 1)) * period_s;
}

Result<LineRows> read_line(const publish::PostgresqlSettings& settings, const LineQuestion& question,
                           const publish::WakeEvent& wake) {
  publish::PostgresqlConnection connection(settings);
  if (const Result<void> opened = connection.open(wake); !opened) return tl::unexpected(opened.error());
  const Result<std::string> refusal = connection.schema_refusal();
  if (!refusal) return tl::unexpected(refusal.error());
  if (!refusal->empty()) return failure(*refusal);
  LineRows rows;
  rows.where = connection.where();
  rows.span = question.span;
  bool may_read = false;
  const Result<void> read = connection.guarded([&](pqxx::connection& server) {
    pqxx::work transaction(server);
    transaction.exec("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ, READ ONLY");
    may_read = transaction.exec1(kLineRights)[0].as<bool>();
    if (!may_read) return;
    rows.now_s =
        transaction.exec1("SELECT extract(epoch FROM clock_timestamp())::double precision")[0].as<double>();
    read_stations(transaction, question, rows);
    read_checks(transaction, question, rows);
    read_claims(transaction, rows);
  });
  if (!read) return tl::unexpected(read.error());
  if (!may_read)
    return failure(fmt::format(
        "{}: the user lacks rights: it needs USAGE on schema clampd and SELECT on its tables", rows.where));
  return Jobs::open(settings, false)
      .and_then([](Jobs jobs) { return jobs.list(kMostJobs); })
      .map([&](std::vector<JobStatus> jobs) {
        rows.jobs = std::move(jobs);
        return std::move(rows);
      });
}

}  // namespace clampd::reanalysis
