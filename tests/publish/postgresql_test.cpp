#include <SQLiteCpp/SQLiteCpp.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/compression.hpp"
#include "clampd/record/checksum.hpp"
#include "publish/servers.hpp"
#include "publish/station_fixture.hpp"

namespace clampd::publish {
namespace {

using support::eventually;
using support::PublishingStation;
using ::testing::HasSubstr;

class Postgresql : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string missing = support::Database::missing(); !missing.empty()) GTEST_SKIP() << missing;
    server = std::make_unique<support::Database>();
  }

  PostgresqlSettings settings() const { return server->settings(); }
  std::string arrived() const {
    return server->ask(
        "SELECT string_agg(outbox_sequence::text, ' ' ORDER BY published, outbox_sequence) FROM "
        "clampd.checks");
  }
  static std::string up_to(int last) {
    std::string numbers = "1";
    for (int i = 2; i <= last; ++i) numbers += " " + std::to_string(i);
    return numbers;
  }

  std::unique_ptr<support::Database> server;
  PublishingStation station{"postgresql"};
};

TEST_F(Postgresql, KeepsEveryCheckOnceAndInOrder) {
  CheckRecord odd = PublishingStation::check(9'000);
  odd.serial = "O'Brien \\\" \xff x";
  odd.reason = std::string("nul\0 inside", 11);
  odd.noise_torque_Nm = std::nan("");
  odd.cause =
      CauseRecord{"ambiguous", {"force-lag"}, "force-reading", {{"force-lag", "pad-damping"}}, "Late."};
  odd.sheet = support::make_sheet_record();
  odd.recipe = RecipeRecord{"recipes/p-17.toml", "3", std::string(64, 'd')};
  odd.stopping = StoppingRecord{21, 2.609, "every limit decided after 4 runs"};
  odd.found_rad = 1e4 + 0.125;
  odd.stopped.clear();
  station.save_up_to(3);
  station.start(make_postgresql_channel(settings()));
  station.save_up_to(20);
  ASSERT_TRUE(station.store().save(odd));
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  EXPECT_EQ(arrived(), up_to(21));
  EXPECT_EQ(server->ask("SELECT value FROM clampd.parameters WHERE name = 'k2' AND check_id = '" +
                        PublishingStation::id(7) + "'"),
            "24.64");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.parameters"), std::to_string(21 * 7));
  EXPECT_EQ(server->ask("SELECT sha256 FROM clampd.runs WHERE position = 1 LIMIT 1"),
            support::make_check_record().runs[1].checksum_sha256);
  EXPECT_EQ(server->ask("SELECT started AT TIME ZONE 'UTC' FROM clampd.checks LIMIT 1"),
            "2026-11-20 23:41:07.123");
  const std::string where = " FROM clampd.checks WHERE id = '" + PublishingStation::id(9'000) + "'";
  EXPECT_EQ(server->ask("SELECT serial" + where), "O'Brien \\\" \xEF\xBF\xBD x");
  EXPECT_EQ(server->ask("SELECT reason" + where), "nul inside");
  EXPECT_EQ(server->ask("SELECT noise_torque_nm IS NULL AND stopped IS NULL" + where), "t");
  EXPECT_EQ(server->ask("SELECT cause->'rivals'->0->>1" + where), "pad-damping");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks WHERE cause IS NULL"), "20");
  EXPECT_EQ(server->ask("SELECT sheet->'characteristics'->1->>'value'" + where), "951.25");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks WHERE sheet IS NULL"), "20");
  EXPECT_EQ(server->ask("SELECT recipe->>'version'" + where), "3");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks WHERE recipe IS NULL"), "20");
  EXPECT_EQ(server->ask("SELECT found_rad" + where), "10000.125");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks WHERE found_rad IS NULL"), "20");
  EXPECT_EQ(server->ask("SELECT stopping->>'coverage_factor'" + where), "2.609");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks WHERE stopping = 'null'"), "20")
      << "a fixed number, and not unknown";

  // The mark was lost, as by a kill between commit and mark.
  ASSERT_TRUE(
      station.store().mark_publication(PublishingStation::id(5), "postgresql", PublicationState::Pending));
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  EXPECT_EQ(arrived(), up_to(21));
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.runs"), std::to_string(21 * 2));
}

TEST_F(Postgresql, KeepsRawRunsOnceBesideTheirCheck) {
  PostgresqlSettings with_runs = settings();
  with_runs.raw_runs = true;
  station.start(make_postgresql_channel(with_runs));
  std::vector<CheckRecord> checks;
  for (int number = 1; number <= 3; ++number) {
    CheckRecord& check = checks.emplace_back(PublishingStation::check(number));
    for (RunRecord& run : check.runs) {
      run.run.force_N[0] = number;  // each check has runs of its own
      run.checksum_sha256 = sha256_hex(format_run(run.run));
    }
    check.started = number < 3 ? "2026-11-30T23:59:59.999Z" : "2026-12-01T00:00:00.000Z";
    ASSERT_TRUE(station.store().save(check));
  }
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.raw_runs"), "6");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.runs r JOIN clampd.raw_runs w USING (sha256)"), "6");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.raw_runs_2026_12"), "2");
  const std::string hex = server->ask("SELECT encode(data, 'hex') FROM clampd.raw_runs WHERE sha256 = '" +
                                      checks[2].runs[1].checksum_sha256 + "'");
  std::string data;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    data += static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16));
  EXPECT_EQ(decompressed(data).value_or(""), format_run(checks[2].runs[1].run));

  // Sent again as after a lost mark: the same rows.
  ASSERT_TRUE(
      station.store().mark_publication(PublishingStation::id(2), "postgresql", PublicationState::Pending));
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.raw_runs"), "6");

  // Retention drops whole months, and only before the given one.
  EXPECT_EQ(server->ask("SELECT clampd.drop_raw_runs('2026-12-31Z')"), "1");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.raw_runs"), "2");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks"), "3");
}

TEST_F(Postgresql, ADamagedRunHoldsUpNoVerdict) {
  station.save_up_to(3);
  SQLite::Database(station.database(), SQLite::OPEN_READWRITE)
      .exec("UPDATE runs SET csv = '', data = x'00' WHERE position = 1 AND check_id = '" +
            PublishingStation::id(2) + "'");
  PostgresqlSettings with_runs = settings();
  with_runs.raw_runs = true;
  station.start(make_postgresql_channel(with_runs));
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks"), "3");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.runs"), "6");
}

TEST_F(Postgresql, NothingIsLostWhileTheServerComesAndGoes) {
  station.start(make_postgresql_channel(settings()));
  for (int round = 1; round <= 4; ++round) {
    station.save_up_to(10 * round - 4);
    if (round % 2 == 0)
      server->stop();
    else
      server->crash();
    station.save_up_to(10 * round);
    ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
    EXPECT_FALSE(station.status().connected);
    server->start();
  }
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  EXPECT_EQ(arrived(), up_to(40));
}

TEST_F(Postgresql, StationsShareADatabaseAndLaterOnesNeedFewRights) {
  PublishingStation other{"postgresql"};
  station.save_up_to(1);
  station.start(make_postgresql_channel(settings()));
  other.start(make_postgresql_channel(settings()));
  ASSERT_TRUE(eventually([&] { return station.pending() == 0 && other.status().connected; }))
      << other.status().error;
  EXPECT_EQ(server->ask("SELECT max(version) FROM clampd.migrations"), "7");
  other.stop();
  server->column("CREATE ROLE bench LOGIN");
  PostgresqlSettings poor = settings();
  poor.user = "bench";
  other.start(make_postgresql_channel(poor));
  ASSERT_TRUE(eventually([&] { return !other.status().error.empty(); }));
  EXPECT_THAT(other.status().error, HasSubstr("the user lacks rights"));
  server->column("GRANT USAGE ON SCHEMA clampd TO bench");
  server->column("GRANT SELECT, INSERT ON ALL TABLES IN SCHEMA clampd TO bench");
  ASSERT_TRUE(eventually([&] { return other.status().connected; })) << other.status().error;
  ASSERT_TRUE(other.store().save(PublishingStation::check(77)));
  ASSERT_TRUE(eventually([&] { return other.pending() == 0; })) << other.status().error;
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks"), "2");
}

// docs/line.md lists them: each is needed, and nothing else. Sent twice, as after a lost answer.
TEST_F(Postgresql, AStationNeedsTheseRightsAndNoOthers) {
  const std::vector<std::string> rights{"USAGE ON SCHEMA clampd",        "SELECT ON clampd.migrations",
                                        "INSERT ON clampd.checks",       "SELECT (id) ON clampd.checks",
                                        "INSERT ON clampd.parameters",   "INSERT ON clampd.runs",
                                        "INSERT ON clampd.raw_runs"};
  PostgresqlSettings settings = this->settings();
  settings.raw_runs = true;
  WakeEvent wake;
  ASSERT_TRUE(make_postgresql_channel(settings)->connect({}, wake));  // makes the tables
  server->column("CREATE ROLE bench LOGIN");
  settings.user = "bench";
  int number = 0;
  const auto problem = [&]() -> std::string {
    const auto channel = make_postgresql_channel(settings);
    if (const Result<void> connected = channel->connect({}, wake); !connected)
      return connected.error().message;
    CheckRecord check = PublishingStation::check(++number);
    for (int time = 0; time < 2; ++time)
      if (const Result<void> sent = channel->send({check, number, false}, wake); !sent)
        return sent.error().message;
    return "";
  };
  for (const std::string& right : rights) server->column("GRANT " + right + " TO bench");
  EXPECT_EQ(problem(), "");
  for (const std::string& right : rights) {
    server->column("REVOKE " + right + " FROM bench");
    EXPECT_THAT(problem(), HasSubstr("the user lacks rights")) << right;
    server->column("GRANT " + right + " TO bench");
  }
  EXPECT_EQ(problem(), "");
  EXPECT_EQ(server->ask("SELECT count(*) FROM clampd.checks"), "2");
  EXPECT_EQ(server->ask("SELECT count(DISTINCT check_id) FROM clampd.runs"), "2");
}

TEST_F(Postgresql, SaysWhatIsWrong) {
  PostgresqlSettings nowhere = settings();
  nowhere.host = "127.0.0.1";
  nowhere.port = support::free_port();
  station.start(make_postgresql_channel(nowhere));
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  EXPECT_THAT(station.status().error, HasSubstr("nothing listens at 127.0.0.1"));
  PostgresqlSettings wrong = settings();
  wrong.database = "none";
  station.start(make_postgresql_channel(wrong));
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  EXPECT_THAT(station.status().error, HasSubstr("\"none\" does not exist"));
}

}  // namespace
}  // namespace clampd::publish
