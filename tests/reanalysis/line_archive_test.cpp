#include "clampd/reanalysis/line_archive.hpp"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>

#include "reanalysis/archive_fixture.hpp"
#include "support/line_of_stations.hpp"

namespace clampd::reanalysis {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

class LineInArchive : public support::Archive {
 protected:
  void SetUp() override {
    Archive::SetUp();
    if (IsSkipped()) return;
    checks = support::checks_of_a_line({{.name = "north", .checks_per_day = 1.0},
                                        {.name = "south", .checks_per_day = 0.5, .silent_days = 10.0}},
                                       1);
    publish(checks);
  }
  Result<LineRows> read(const LineQuestion& question = {}, const std::string& user = "line") const {
    publish::PostgresqlSettings as = settings();
    as.user = user;
    return read_line(as, question, publish::WakeEvent());
  }
  /// The station's check that began last.
  const CheckRecord& last_of(const std::string& station) const {
    const CheckRecord* last = nullptr;
    for (const CheckRecord& check : checks)
      if (check.station == station && (last == nullptr || check.started > last->started)) last = &check;
    return *last;
  }
  std::size_t valid_of(const std::string& part) const {
    return static_cast<std::size_t>(
        std::count_if(checks.begin(), checks.end(), [&](const CheckRecord& check) {
          return check.part_number == part && is_about_the_brake(check.verdict);
        }));
  }

  std::vector<CheckRecord> checks;
};

TEST_F(LineInArchive, IsReadWithTheLastCheckOfEachStationAndTheUsualPart) {
  const LineQuestion question{.span = kLineSpans[3]};
  const Result<LineRows> rows = read(question);
  ASSERT_TRUE(rows) << rows.error().message;
  ASSERT_EQ(rows->stations.size(), 2U);
  EXPECT_EQ(rows->stations[0].station, "north");
  EXPECT_EQ(rows->stations[0].serial, last_of("north").serial);
  EXPECT_EQ(rows->stations[1].serial, last_of("south").serial);
  EXPECT_NEAR(rows->now_s - rows->stations[1].started_s, 10.0 * 86'400.0, 4.0 * 86'400.0);
  EXPECT_EQ(rows->checks.size(), checks.size());
  EXPECT_FALSE(rows->more_checks);
  EXPECT_TRUE(std::is_sorted(rows->checks.begin(), rows->checks.end(),
                             [](const auto& a, const auto& b) { return a.started_s > b.started_s; }));
  EXPECT_EQ(rows->part_number, "EMB-40/F");
  ASSERT_EQ(rows->measured.size(), valid_of("EMB-40/F"));
  const auto found =
      std::find_if(rows->measured.begin(), rows->measured.end(),
                   [&](const MeasuredCheck& check) { return check.serial == checks.front().serial; });
  ASSERT_NE(found, rows->measured.end());
  EXPECT_EQ(found->batch, checks.front().batch);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const ParameterRecord& expected = checks.front().parameters[i];
    EXPECT_EQ(found->readings[i], std::pair(expected.value, expected.sd));
    EXPECT_EQ(found->limits[i], std::pair(expected.lower, expected.upper));
  }
  EXPECT_EQ(read({.span = kLineSpans[3], .part_number = "EMB-45/R"})->measured.size(), valid_of("EMB-45/R"));
  EXPECT_THAT(read({.part_number = "O'Brien"})->measured, IsEmpty());
}

TEST_F(LineInArchive, IsReadWithoutWhatLacksAParameterOrATime) {
  ask("UPDATE clampd.checks SET started = NULL WHERE id = '" + last_of("north").id + "'");
  const CheckRecord& south = last_of("south");
  ask("DELETE FROM clampd.parameters WHERE name = 'ws' AND check_id = '" + south.id + "'");
  const Result<LineRows> rows = read({.span = kLineSpans[3], .part_number = south.part_number});
  ASSERT_TRUE(rows) << rows.error().message;
  EXPECT_EQ(rows->checks.size(), checks.size() - 1);
  for (const MeasuredCheck& check : rows->measured) EXPECT_NE(check.serial, south.serial);
}

TEST_F(LineInArchive, NoMoreIsReadThanWasAskedForAndItIsSaid) {
  const Result<LineRows> rows = read({.span = kLineSpans[3], .most_checks = 7, .most_stations = 1});
  ASSERT_TRUE(rows) << rows.error().message;
  EXPECT_EQ(rows->checks.size(), 7U);
  EXPECT_TRUE(rows->more_checks);
  EXPECT_EQ(rows->measured.size(), 7U);
  EXPECT_TRUE(rows->more_measured);
  ASSERT_EQ(rows->stations.size(), 1U);
  EXPECT_EQ(rows->stations[0].station, "north") << "the one at work";
  EXPECT_TRUE(rows->more_stations);
}

TEST_F(LineInArchive, ClaimsAndTheNewestJobsAreRead) {
  ask("INSERT INTO clampd.tasks VALUES ('0', '{}')");
  ask("INSERT INTO clampd.jobs (name, task_sha256, selection) SELECT 'job ' || n, '0', '{}' FROM "
      "generate_series(1, 12) n");
  ask("INSERT INTO clampd.queue (job_id, check_id, state, worker, attempts, claimed, lease_until) SELECT 12, "
      "id, 'claimed', "
      "'host:1', 2, clock_timestamp(), clock_timestamp() - interval '1 second' FROM clampd.checks LIMIT 1");
  const Result<LineRows> rows = read();
  ASSERT_TRUE(rows) << rows.error().message;
  ASSERT_EQ(rows->jobs.size(), 10U);
  EXPECT_EQ(rows->jobs[0].name, "job 12");
  ASSERT_EQ(rows->claims.size(), 1U);
  EXPECT_EQ(rows->claims[0].worker, "host:1");
  EXPECT_EQ(rows->claims[0].job_name, "job 12");
  EXPECT_EQ(rows->claims[0].attempts, 2);
  EXPECT_FALSE(rows->claims[0].alive);
}

TEST_F(LineInArchive, TheRightToSelectIsEnoughAndNeeded) {
  ask("CREATE ROLE looker LOGIN");
  EXPECT_THAT(read({}, "looker").error().message, HasSubstr("USAGE on schema clampd"));
  ask("GRANT USAGE ON SCHEMA clampd TO looker");
  ask("GRANT SELECT ON clampd.migrations, clampd.checks, clampd.jobs, clampd.queue TO looker");
  EXPECT_THAT(read({}, "looker").error().message, HasSubstr("SELECT on its tables"));
  ask("GRANT SELECT ON clampd.parameters TO looker");
  const Result<LineRows> rows = read({}, "looker");
  EXPECT_TRUE(rows) << rows.error().message;
}

TEST_F(LineInArchive, ErrorsSayWhatToDo) {
  ask("INSERT INTO clampd.migrations (version) VALUES (99)");
  EXPECT_THAT(read().error().message, HasSubstr("install the newer version"));
  ask("DELETE FROM clampd.migrations WHERE version > 4");
  EXPECT_THAT(read().error().message, HasSubstr("brings it up to date"));
  server->stop();
  EXPECT_THAT(read().error().message, HasSubstr("no connection"));
}

TEST(LineSpans, EndWithThePeriodThatHasBegun) {
  for (const LineSpan& span : kLineSpans) {
    EXPECT_GE(span.period_s * span.periods, span.days * 86'400.0);
    const double now_s = 1'796'040'123.0;
    const double since_s = span.since_s(now_s);
    EXPECT_EQ(std::fmod(since_s, span.period_s), 0.0);
    EXPECT_LE(since_s + (span.periods - 1) * span.period_s, now_s);
    EXPECT_GT(since_s + span.periods * span.period_s, now_s);
  }
}

}  // namespace
}  // namespace clampd::reanalysis
