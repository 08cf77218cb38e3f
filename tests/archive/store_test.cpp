#include "clampd/archive/store.hpp"

#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <limits>
#include <string>

#include <SQLiteCpp/SQLiteCpp.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/json.hpp"
#include "src/archive/chain.hpp"
#include "support/check_records.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::make_check_record;
using support::TemporaryDirectory;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using Access = CheckStore::Access;

class Store : public ::testing::Test {
 protected:
  CheckStore open() {
    auto store = CheckStore::open(path);
    EXPECT_TRUE(store) << store.error().message;
    return std::move(*store);
  }
  /// A database with one check as an older version left it: sealed in its format, without later columns.
  void make_older(int format, const char* alterations) {
    const std::string id = make_check_record().id;
    {
      CheckStore store = open();
      ASSERT_TRUE(store.save(make_check_record()));
    }
    SQLite::Database old(path, SQLite::OPEN_READWRITE);
    ChainLink link{.position = 1,
                   .check_id = id,
                   .amendment = {},
                   .format = format,
                   .content_sha256 = {},
                   .chain_sha256 = {}};
    link.content_sha256 = ContentDigest(old).of_check(id, format).value();
    SQLite::Statement seal(old, "UPDATE chain SET format = ?, content_sha256 = ?, chain_sha256 = ?");
    seal.bind(1, format);
    seal.bind(2, link.content_sha256);
    seal.bind(3, link_sha256(link, ""));
    seal.exec();
    old.exec(alterations);
  }
  TemporaryDirectory directory;
  std::string path = directory.path("deep/folder/checks.sqlite");
};

TEST_F(Store, GivesBackWhatItKept) {
  const CheckRecord saved = make_check_record();
  {
    CheckStore store = open();
    const auto done = store.save(saved);
    ASSERT_TRUE(done) << done.error().message;
  }
  const auto store = CheckStore::open(path, Access::ReadOnly);
  ASSERT_TRUE(store) << store.error().message;
  const auto loaded = store->load(saved.id);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(check_json(*loaded), check_json(saved)) << "which holds every field but these:";
  ASSERT_EQ(loaded->runs.size(), 2u);
  EXPECT_EQ(loaded->runs[1].run.name, "repeat 2");
  EXPECT_EQ(loaded->runs[1].run.time_s, saved.runs[1].run.time_s);
  EXPECT_EQ(loaded->runs[1].run.torque_Nm, saved.runs[1].run.torque_Nm);
  EXPECT_EQ(loaded->runs[1].run.velocity_rad_s, saved.runs[1].run.velocity_rad_s);
  EXPECT_EQ(loaded->runs[1].run.force_N, saved.runs[1].run.force_N);
  EXPECT_EQ(loaded->runs[1].run.position_rad, saved.runs[1].run.position_rad);
  EXPECT_EQ(loaded->timing.lateness_histogram, saved.timing.lateness_histogram);
  ASSERT_EQ(loaded->flight_recorder.size(), 3u);
  const Sample& a = loaded->flight_recorder[2];
  const Sample& b = saved.flight_recorder[2];
  EXPECT_EQ(a.sample_index, b.sample_index);
  EXPECT_EQ(a.brake_time_ns, b.brake_time_ns);
  EXPECT_EQ(a.host_time_ns, b.host_time_ns);
  EXPECT_EQ(a.torque_Nm, b.torque_Nm);
  EXPECT_EQ(a.velocity_rad_s, b.velocity_rad_s);
  EXPECT_EQ(a.force_N, b.force_N);
  EXPECT_EQ(a.position_rad, b.position_rad);
  EXPECT_EQ(a.torque_command_Nm, b.torque_command_Nm);
  EXPECT_EQ(a.force_reference_N, b.force_reference_N);
  EXPECT_EQ(a.lateness_ns, b.lateness_ns);
  EXPECT_EQ(a.trajectory_index, b.trajectory_index);
  EXPECT_EQ(a.repeat, b.repeat);
  EXPECT_EQ(a.state, b.state);
  EXPECT_EQ(a.phase, b.phase);
  EXPECT_EQ(a.fault, b.fault);
}

TEST_F(Store, KeepsNumbersThatAreNone) {
  CheckRecord saved = make_check_record();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  saved.tracking_rms_N = nan;
  saved.parameters[0].sd = nan;
  saved.runs[0].estimate[3] = nan;
  CheckStore store = open();
  ASSERT_TRUE(store.save(saved));
  const auto loaded = store.load(saved.id);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_TRUE(std::isnan(loaded->tracking_rms_N));
  EXPECT_TRUE(std::isnan(loaded->parameters[0].sd));
  EXPECT_TRUE(std::isnan(loaded->runs[0].estimate[3]));
}

TEST_F(Store, KeepsTheCause) {
  CheckRecord saved = make_check_record();
  saved.verdict = Verdict::Error;
  saved.cause =
      CauseRecord{"ambiguous", {"force-lag"}, "force-reading", {{"force-lag", "pad-damping"}}, "Late."};
  CheckStore store = open();
  ASSERT_TRUE(store.save(saved));
  const auto loaded = store.load(saved.id);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(loaded->cause, saved.cause);
}

TEST_F(Store, WhatIsKnownOfTheZerosReadsBackTheSame) {
  CheckRecord saved = make_check_record();
  saved.torque_while_off = TorqueWhileOff{0.1 / 3.0, 1e-4 / 3.0, 3000};
  saved.tare_force_N = -200.0 / 3.0;
  saved.tare_velocity_rad_s = 1.0 / 3.0;
  saved.tare_force_sd_N = 4.0 / 3.0;
  saved.tare_velocity_sd_rad_s = 0.01 / 3.0;
  CheckRecord unknown = make_check_record();
  unknown.id += "-unknown";
  CheckStore store = open();
  ASSERT_TRUE(store.save(saved));
  ASSERT_TRUE(store.save(unknown));
  EXPECT_EQ(store.load(saved.id)->torque_while_off, saved.torque_while_off);
  EXPECT_EQ(store.load(saved.id)->tare_force_N, saved.tare_force_N);
  EXPECT_EQ(store.load(saved.id)->tare_velocity_rad_s, saved.tare_velocity_rad_s);
  EXPECT_EQ(store.load(saved.id)->tare_force_sd_N, saved.tare_force_sd_N);
  EXPECT_EQ(store.load(saved.id)->tare_velocity_sd_rad_s, saved.tare_velocity_sd_rad_s);
  EXPECT_EQ(store.load(unknown.id)->torque_while_off, std::nullopt);
}

/// Takes a database of such records back to schema 6: runs as text, no chain, no mark of whose it is.
void undo_steps_7_and_8(SQLite::Database& database) {
  SQLite::Statement plain(database, "UPDATE runs SET csv = ?, bytes = ? WHERE position = ?");
  const CheckRecord record = make_check_record();
  for (std::size_t i = 0; i < record.runs.size(); ++i) {
    const std::string csv = format_run(record.runs[i].run);
    plain.reset();
    plain.bind(1, csv);
    plain.bind(2, static_cast<std::int64_t>(csv.size()));
    plain.bind(3, static_cast<std::int64_t>(i));
    plain.exec();
  }
  database.exec(
      "DROP TABLE chain; DROP TABLE amendments; ALTER TABLE runs DROP COLUMN data; ALTER TABLE checks DROP "
      "COLUMN "
      "systematic; ALTER TABLE checks DROP COLUMN stopping; ALTER TABLE checks DROP COLUMN sheet; ALTER "
      "TABLE checks DROP COLUMN recipe; ALTER TABLE checks DROP COLUMN found_rad; PRAGMA "
      "application_id = "
      "0; "
      "PRAGMA user_version = 6");
}

/// Takes a database back to schema 3.
void undo_steps_4_to_8(SQLite::Database& database) {
  undo_steps_7_and_8(database);
  database.exec(
      "DROP TABLE outbox_connections; DROP INDEX checks_by_part; DROP INDEX checks_by_batch; DROP INDEX "
      "checks_by_operator; "
      "DROP TABLE limits_revisions; DROP TABLE publication; DROP INDEX runs_kept; "
      "ALTER TABLE runs DROP COLUMN bytes; ALTER TABLE runs DROP COLUMN removed; "
      "ALTER TABLE checks DROP COLUMN torque_while_off; ALTER TABLE checks DROP COLUMN tare_force_N; ALTER "
      "TABLE checks DROP COLUMN tare_force_sd_N; ALTER TABLE checks DROP COLUMN tare_velocity_rad_s; "
      "ALTER TABLE checks DROP COLUMN tare_velocity_sd_rad_s; PRAGMA user_version = 3");
}

TEST_F(Store, BringsResultsFromBeforeCausesUpToDate) {
  {
    CheckStore store = open();
    ASSERT_TRUE(store.save(make_check_record()));
  }
  {
    SQLite::Database old(path, SQLite::OPEN_READWRITE);
    undo_steps_4_to_8(old);
    old.exec("ALTER TABLE checks DROP COLUMN cause");
    old.exec("PRAGMA user_version = 2");
  }
  EXPECT_THAT(CheckStore::open(path, Access::ReadOnly).error().message, HasSubstr("schema 2 instead of 18"));
  CheckStore store = open();
  const auto loaded = store.load("last");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_FALSE(loaded->cause);
  EXPECT_EQ(check_json(*loaded), check_json(make_check_record()));
  CheckRecord next = make_check_record("20261121T000000000Z-00000000");
  next.cause = CauseRecord{"unexplained", {}, "stiffness", {}, "Something is wrong."};
  ASSERT_TRUE(store.save(next));
  EXPECT_EQ(store.load("20261121")->cause, next.cause);
}

TEST_F(Store, BringsResultsFromBeforeRetentionUpToDate) {
  {
    CheckStore store = open();
    ASSERT_TRUE(store.save(make_check_record()));
  }
  {
    SQLite::Database old(path, SQLite::OPEN_READWRITE);
    undo_steps_4_to_8(old);
  }
  CheckStore store = open();
  const auto loaded = store.load("last");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(check_json(*loaded), check_json(make_check_record()));
  const auto plan = store.plan_retention({.bytes = 1}, 0);
  ASSERT_TRUE(plan) << plan.error().message;
  std::size_t bytes = 0;
  for (const RunRecord& run : make_check_record().runs) bytes += format_run(run.run).size();
  EXPECT_EQ(plan->bytes, bytes) << "old runs count too";
}

TEST_F(Store, SealsWhatAnOlderVersionSaved) {
  {
    CheckStore store = open();
    for (int day = 10; day < 20; ++day)
      ASSERT_TRUE(store.save(make_check_record(fmt::format("202611{}T000000000Z-00000000", day))));
    ASSERT_TRUE(store.apply_retention({.bytes = 1}, 0, 3)) << "also by its retention";
  }
  {
    SQLite::Database old(path, SQLite::OPEN_READWRITE);
    undo_steps_7_and_8(old);
    old.exec("UPDATE runs SET csv = '' WHERE removed <> ''");
  }
  CheckStore store = open();
  const auto found = store.verify();
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_THAT(found->damage, ::testing::IsEmpty());
  EXPECT_EQ(found->checks, 10U);
  EXPECT_EQ(found->runs, 14U);
  EXPECT_EQ(found->runs_removed, 6U);
  EXPECT_EQ(store.load("20261119")->runs[1].run.force_N, make_check_record().runs[1].run.force_N);
}

TEST_F(Store, KeepsWhatSchema8SealedVerifiable) {
  const std::string id = make_check_record().id;
  make_older(1,
             "ALTER TABLE checks DROP COLUMN systematic; ALTER TABLE checks DROP COLUMN stopping; "
             "ALTER TABLE checks DROP COLUMN sheet; ALTER TABLE checks DROP COLUMN recipe; "
             "ALTER TABLE checks DROP COLUMN found_rad; PRAGMA user_version = 8");
  CheckStore store = open();
  CheckRecord later = make_check_record("20261121T000000000Z-00000000");
  later.systematic = SystematicRecord{1e-9, 0.6, 3.5, true};
  ASSERT_TRUE(store.save(later));
  EXPECT_EQ(store.load(later.id)->systematic, later.systematic);
  EXPECT_FALSE(store.load(id)->systematic);
  EXPECT_THAT(store.verify()->damage, ::testing::IsEmpty());
  for (const std::string& changed : {id, later.id}) {
    SQLite::Database database(path, SQLite::OPEN_READWRITE);
    SQLite::Statement change(database, "UPDATE checks SET systematic = '{}' WHERE id = ?");
    change.bind(1, changed);
    change.exec();
  }
  EXPECT_EQ(store.verify()->damage.size(), 2U)
      << "what came later is sealed too, and none of it is put into old checks";
}

TEST_F(Store, KeepsWhatSchema10SealedVerifiable) {
  const std::string id = make_check_record().id;
  make_older(2,
             "ALTER TABLE checks DROP COLUMN stopping; ALTER TABLE checks DROP COLUMN sheet; ALTER TABLE "
             "checks DROP COLUMN recipe; ALTER TABLE checks DROP COLUMN found_rad; PRAGMA "
             "user_version = 10");
  CheckStore store = open();
  CheckRecord later = make_check_record("20261121T000000000Z-00000000");
  later.stopping = StoppingRecord{21, 2.608, "every limit decided after 4 runs", {"aa", "bb"}, {0, 1}};
  ASSERT_GE(later.runs.size(), 2U);
  ASSERT_TRUE(store.save(later));
  EXPECT_EQ(store.load(later.id)->runs[1].trajectory, 1);
  EXPECT_EQ(store.load(later.id)->stopping, later.stopping);
  EXPECT_FALSE(store.load(id)->stopping);
  EXPECT_THAT(store.verify()->damage, ::testing::IsEmpty());
  for (const std::string& changed : {id, later.id}) {
    SQLite::Database database(path, SQLite::OPEN_READWRITE);
    SQLite::Statement change(database, "UPDATE checks SET stopping = '{}' WHERE id = ?");
    change.bind(1, changed);
    change.exec();
  }
  EXPECT_EQ(store.verify()->damage.size(), 2U)
      << "what came later is sealed too, and none of it is put into old checks";
}

TEST_F(Store, KeepsWhatSchema12SealedVerifiable) {
  const std::string id = make_check_record().id;
  make_older(
      3,
      "ALTER TABLE checks DROP COLUMN sheet; ALTER TABLE checks DROP COLUMN recipe; ALTER TABLE checks "
      "DROP COLUMN found_rad; PRAGMA user_version = 12");
  CheckStore store = open();
  CheckRecord later = make_check_record("20261121T000000000Z-00000000");
  later.sheet = support::make_sheet_record();
  ASSERT_TRUE(store.save(later));
  EXPECT_EQ(check_json(*store.load(later.id)), check_json(later));
  EXPECT_FALSE(store.load(id)->sheet);
  EXPECT_THAT(store.verify()->damage, ::testing::IsEmpty());
  for (const std::string& changed : {id, later.id}) {
    SQLite::Database database(path, SQLite::OPEN_READWRITE);
    SQLite::Statement change(database, "UPDATE checks SET sheet = '{}' WHERE id = ?");
    change.bind(1, changed);
    change.exec();
  }
  EXPECT_EQ(store.verify()->damage.size(), 2U)
      << "what came later is sealed too, and none of it is put into old checks";
}

TEST_F(Store, KeepsWhatSchema14SealedVerifiable) {
  const std::string id = make_check_record().id;
  make_older(4,
             "ALTER TABLE checks DROP COLUMN recipe; ALTER TABLE checks DROP COLUMN found_rad; PRAGMA "
             "user_version = 14");
  CheckStore store = open();
  CheckRecord later = make_check_record("20261121T000000000Z-00000000");
  later.recipe = RecipeRecord{"recipes/p-17.toml", "3", std::string(64, 'd')};
  ASSERT_TRUE(store.save(later));
  EXPECT_EQ(store.load(later.id)->recipe, later.recipe);
  EXPECT_FALSE(store.load(id)->recipe);
  EXPECT_THAT(store.verify()->damage, ::testing::IsEmpty());
  for (const std::string& changed : {id, later.id}) {
    SQLite::Database database(path, SQLite::OPEN_READWRITE);
    SQLite::Statement change(database, "UPDATE checks SET recipe = '{}' WHERE id = ?");
    change.bind(1, changed);
    change.exec();
  }
  EXPECT_EQ(store.verify()->damage.size(), 2U) << "the recipe is sealed too, and none is put into old checks";
}

TEST_F(Store, KeepsWhatSchema16SealedVerifiable) {
  const std::string id = make_check_record().id;
  make_older(5, "ALTER TABLE checks DROP COLUMN found_rad; PRAGMA user_version = 16");
  CheckStore store = open();
  CheckRecord later = make_check_record("20261121T000000000Z-00000000");
  later.found_rad = 1e4 + 1.0 / 3.0;
  ASSERT_TRUE(store.save(later));
  EXPECT_EQ(store.load(later.id)->found_rad, later.found_rad);
  EXPECT_FALSE(store.load(id)->found_rad);
  EXPECT_TRUE(check_json(*store.load(id)).at("found_rad").is_null());
  EXPECT_EQ(check_json(*store.load(later.id)).at("found_rad"), *later.found_rad);
  EXPECT_THAT(store.verify()->damage, ::testing::IsEmpty());
  for (const std::string& changed : {id, later.id}) {
    SQLite::Database database(path, SQLite::OPEN_READWRITE);
    SQLite::Statement change(database, "UPDATE checks SET found_rad = '11.3' WHERE id = ?");
    change.bind(1, changed);
    change.exec();
  }
  EXPECT_EQ(store.verify()->damage.size(), 2U)
      << "where it was found is sealed too, and none is put into old checks";
}

TEST_F(Store, NumbersOutboxesOfOldInTimeThatGrowsWithTheirLength) {
  open();
  {
    SQLite::Database old(path, SQLite::OPEN_READWRITE);
    undo_steps_7_and_8(old);
    old.exec(
        "DROP TABLE outbox_connections; DROP INDEX publication_order; DROP INDEX publication_next; "
        "ALTER TABLE publication DROP COLUMN sequence; ALTER TABLE publication DROP COLUMN queued; "
        "CREATE INDEX publication_pending ON publication (channel, check_id) WHERE state = 0; "
        "ALTER TABLE checks DROP COLUMN torque_while_off; ALTER TABLE checks DROP COLUMN tare_force_N; ALTER "
        "TABLE checks DROP COLUMN tare_force_sd_N; ALTER TABLE checks DROP COLUMN tare_velocity_rad_s; "
        "ALTER TABLE checks DROP COLUMN tare_velocity_sd_rad_s; PRAGMA user_version = 4");
    // The square of these would take minutes. They belong to no check, so that nothing else grows with them.
    old.exec(
        "PRAGMA foreign_keys = OFF; WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i "
        "< 50000) "
        "INSERT INTO publication (check_id, channel, state) SELECT printf('%06d', i), channel, i > 40000 "
        "FROM n, "
        "(SELECT 'mqtt' AS channel UNION ALL SELECT 'postgresql')");
  }
  open();
  SQLite::Database file(path, SQLite::OPEN_READONLY);
  EXPECT_EQ(
      file.execAndGet("SELECT COUNT(*) FROM publication WHERE sequence = CAST(check_id AS INTEGER)").getInt(),
      100'000);
}

TEST_F(Store, KeepsACheckWithoutRuns) {
  CheckRecord saved;
  saved.id = "20261120T000000000Z-00000000";
  saved.instruments = "[]";
  CheckStore store = open();
  ASSERT_TRUE(store.save(saved));
  const auto loaded = store.load("last");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(check_json(*loaded), check_json(saved));
}

TEST_F(Store, ListsTheNewestFirstAndFilters) {
  CheckStore store = open();
  for (int i = 0; i < 4; ++i) {
    CheckRecord record = make_check_record("2026112" + std::to_string(i) + "T000000000Z-00000000");
    record.started = "2026-11-2" + std::to_string(i) + "T00:00:00.000Z";
    record.serial = i % 2 == 0 ? "even" : "odd";
    record.verdict = i == 3 ? Verdict::Error : Verdict::Pass;
    ASSERT_TRUE(store.save(record));
  }
  const auto days = [&](const CheckFilter& filter) {
    std::vector<std::string> found;
    const auto checks = store.list(filter);
    for (const CheckSummary& check : *checks) found.push_back(check.id.substr(6, 2));
    return found;
  };
  EXPECT_THAT(days({}), ElementsAre("23", "22", "21", "20"));
  EXPECT_THAT(days({.serial = "even"}), ElementsAre("22", "20"));
  EXPECT_THAT(days({.serial = "ev%n"}), ElementsAre());
  EXPECT_THAT(days({.verdict = Verdict::Error}), ElementsAre("23"));
  EXPECT_THAT(days({.verdict = Verdict::Pass}), ElementsAre("22", "21", "20"));
  EXPECT_THAT(days({.since = "2026-11-22"}), ElementsAre("23", "22"));
  EXPECT_THAT(days({.limit = 1}), ElementsAre("23"));
  EXPECT_THAT(days({.until = "2026-11-21"}), ElementsAre("21", "20")) << "the whole day";
  EXPECT_THAT(days({.since = "2026-11-22T00:00Z", .until = "2026-11-22T00:00:00Z"}), ElementsAre("22"));
  EXPECT_THAT(days({.part_number = "P-17", .batch = "B-3", .operator_name = "Jo Müller"}),
              ElementsAre("23", "22", "21", "20"));
  EXPECT_THAT(days({.part_number = "P-1"}), ElementsAre());
  EXPECT_THAT(days({.batch = "B-4"}), ElementsAre());
  EXPECT_THAT(days({.operator_name = "' OR 1=1 --"}), ElementsAre());
  EXPECT_EQ(store.load("last")->id, "20261123T000000000Z-00000000");
}

TEST_F(Store, KeepsTheOrderOfSavingWhenTheClockIsSetBack) {
  CheckStore store = open();
  for (const char* hour : {"10", "09", "11"}) {
    CheckRecord record = make_check_record(fmt::format("20261121T{}0000000Z-00000000", hour));
    record.started = fmt::format("2026-11-21T{}:00:00.000Z", hour);
    ASSERT_TRUE(store.save(record));
    EXPECT_EQ(store.load("last")->id, record.id);
  }
  std::vector<std::string> hours;
  const auto checks = store.list({});
  for (const CheckSummary& check : *checks) hours.push_back(check.started.substr(11, 2));
  EXPECT_THAT(hours, ElementsAre("11", "09", "10"));
}

TEST_F(Store, LoadsResultsWithoutRuns) {
  CheckStore store = open();
  const CheckRecord saved = make_check_record();
  ASSERT_TRUE(store.save(saved));
  const auto results = store.load_results({.serial = saved.serial});
  ASSERT_TRUE(results) << results.error().message;
  ASSERT_EQ(results->size(), 1u);
  CheckRecord expected = saved;
  expected.runs.clear();
  expected.timing.lateness_histogram.clear();
  EXPECT_EQ(check_json(results->front()), check_json(expected));
}

TEST_F(Store, KeepsLimitsAsTheyWereFirstUsed) {
  CheckStore store = open();
  const LimitsRevision first{"aa", "1", "Ada", "2026-11-20", "limits.toml", "revision = 1", "2026-11-20T00"};
  LimitsRevision again = first;
  again.first_used = "2026-11-21T00";
  const LimitsRevision second{"bb", "2", "Bo", "2026-11-21", "limits.toml", "revision = 2", "2026-11-21T00"};
  for (const LimitsRevision& limits : {first, again, second}) ASSERT_TRUE(store.save_limits(limits));
  const auto history = store.limits_history();
  ASSERT_TRUE(history) << history.error().message;
  ASSERT_EQ(history->size(), 2u);
  EXPECT_EQ(history->at(0).first_used, "2026-11-20T00");
  EXPECT_EQ(history->at(0).contents, "revision = 1");
  EXPECT_EQ(history->at(1).author, "Bo");
}

TEST_F(Store, FindsAShortenedIdIfItIsUnambiguous) {
  CheckStore store = open();
  ASSERT_TRUE(store.save(make_check_record("20261120T000000000Z-aaaaaaaa")));
  ASSERT_TRUE(store.save(make_check_record("20261121T000000000Z-bbbbbbbb")));
  EXPECT_EQ(store.load("20261121")->id, "20261121T000000000Z-bbbbbbbb");
  EXPECT_THAT(store.load("2026112").error().message, HasSubstr("more than one check"));
  EXPECT_THAT(store.load("2027").error().message, HasSubstr("no check 2027"));
  EXPECT_THAT(store.load("%").error().message, HasSubstr("no check %"));
}

TEST_F(Store, RefusesAnIdTwiceAndKeepsTheFirstWhole) {
  CheckStore store = open();
  ASSERT_TRUE(store.save(make_check_record()));
  CheckRecord again = make_check_record();
  again.serial = "other";
  const auto refused = store.save(again);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("is already there"));
  EXPECT_EQ(store.load("last")->serial, "EMB-0042");
  EXPECT_EQ(store.load("last")->runs.size(), 2u);
}

TEST_F(Store, SavesAllOrNothing) {
  CheckStore store = open();
  CheckRecord record = make_check_record();
  // A row of the flight recorder that is in the way makes the save fail in its last statement.
  {
    SQLite::Database other(path, SQLite::OPEN_READWRITE);
    other.exec("PRAGMA foreign_keys = OFF");
    other.exec("INSERT INTO flight_recorder SELECT '" + record.id +
               "', 2, 0,0,0, 0,0,0,0,0, 0, 0,0,0, 0,0,0");
  }
  ASSERT_FALSE(store.save(record));
  EXPECT_TRUE(store.list({})->empty());
  SQLite::Database other(path, SQLite::OPEN_READONLY);
  EXPECT_EQ(other.execAndGet("SELECT count(*) FROM runs").getInt(), 0);
}

TEST_F(Store, NoticesAChangedRun) {
  CheckStore store = open();
  ASSERT_TRUE(store.save(make_check_record()));
  SQLite::Database(path, SQLite::OPEN_READWRITE)
      .exec("UPDATE runs SET data = (SELECT data FROM runs WHERE position = 0) WHERE position = 1");
  const auto loaded = store.load("last");
  ASSERT_FALSE(loaded);
  EXPECT_THAT(loaded.error().message, HasSubstr("repeat 2 of check"));
  EXPECT_THAT(loaded.error().message, HasSubstr("checksum does not match"));
}

TEST_F(Store, NoticesAChangedFigure) {
  CheckStore store = open();
  const CheckRecord record = make_check_record();
  ASSERT_TRUE(store.save(record));
  for (const char* change :
       {"UPDATE checks SET verdict = 0", "UPDATE parameters SET value = 35.2 WHERE name = 'k2'",
        "UPDATE runs SET converged = 1", "UPDATE lateness_histogram SET ticks = ticks + 1",
        "UPDATE flight_recorder SET force_N = 0 WHERE position = 2",
        "DELETE FROM parameters WHERE position = 6"}) {
    SQLite::Database other(path, SQLite::OPEN_READWRITE);
    other.exec(change);
    for (const auto& loaded : {store.load("last"), store.load_result(record.id)}) {
      ASSERT_FALSE(loaded) << change;
      EXPECT_THAT(loaded.error().message, HasSubstr("was changed after it was recorded"));
    }
    other.exec(
        "DELETE FROM chain; DELETE FROM parameters; DELETE FROM runs; DELETE FROM lateness_histogram; "
        "DELETE FROM flight_recorder; DELETE FROM checks");
    ASSERT_TRUE(store.save(record));
    ASSERT_TRUE(store.load("last"));
  }
}

TEST_F(Store, ListsWhatClampdNeverWritesAsDamaged) {
  CheckStore store = open();
  for (const char* id : {"20261120T000000000Z-00000000", "20261121T000000000Z-00000000"})
    ASSERT_TRUE(store.save(make_check_record(id)));
  SQLite::Database other(path, SQLite::OPEN_READWRITE);
  for (const char* stored :
       {"verdict = 256", "verdict = -1", "verdict = 5", "marginal = 2", "repeats = -1", "fault = 4711",
        "cause = '{'", "covariance_normalised = '[\"x\"]'", "repeats = 4294967296", "ticks = -1"}) {
    SCOPED_TRACE(stored);
    other.exec(
        fmt::format("UPDATE checks SET verdict = 1, marginal = 0, repeats = 2, fault = 0, cause = '', "
                    "covariance_normalised = '[]', ticks = 1; "
                    "UPDATE checks SET {} WHERE id LIKE '20261121%'",
                    stored));
    const auto results = store.load_results({});
    ASSERT_TRUE(results) << results.error().message;
    ASSERT_EQ(results->size(), 2U);
    EXPECT_EQ(results->front().verdict, Verdict::Error);
    EXPECT_EQ(results->front().serial, "EMB-0042");
    EXPECT_THAT(results->front().reason, HasSubstr("This record is damaged"));
    EXPECT_EQ(results->back().verdict, Verdict::Fail) << "the rest goes on";
    const auto listed = store.list({});
    ASSERT_TRUE(listed) << listed.error().message;
    EXPECT_EQ(listed->size(), 2U);
    EXPECT_FALSE(store.load("last"));
  }
}

TEST_F(Store, ReadsNoHistogramThatIsNone) {
  CheckStore store = open();
  ASSERT_TRUE(store.save(make_check_record()));
  for (const char* bin : {"-1", "9223372036854775807", "1000000"}) {
    SQLite::Database(path, SQLite::OPEN_READWRITE)
        .exec(fmt::format("UPDATE lateness_histogram SET bin_us = {} WHERE ticks = 9", bin));
    EXPECT_FALSE(store.load("last")) << bin;
  }
}

TEST_F(Store, ShowsTextsThatAreNoUtf8WithMarks) {
  CheckStore store = open();
  ASSERT_TRUE(store.save(make_check_record()));
  SQLite::Database(path, SQLite::OPEN_READWRITE).exec("UPDATE checks SET serial = CAST(x'41ff42' AS TEXT)");
  const auto listed = store.list({});
  ASSERT_TRUE(listed) << listed.error().message;
  EXPECT_EQ(listed->front().serial,
            "A\xEF\xBF\xBD"
            "B");
  EXPECT_NO_THROW(summaries_json(*listed).dump());
}

TEST_F(Store, NoticesThatItsFileIsGone) {
  CheckStore store = open();
  ASSERT_TRUE(store.save(make_check_record("20261120T000000000Z-00000000")));
  const std::string moved = path + ".moved";
  const auto move = [](const std::string& from, const std::string& to) {
    for (const char* suffix : {"", "-wal", "-shm"}) std::filesystem::rename(from + suffix, to + suffix);
  };
  move(path, moved);
  const CheckRecord second = make_check_record("20261121T000000000Z-00000000");
  auto saved = store.save(second);
  ASSERT_FALSE(saved);
  EXPECT_THAT(saved.error().message, HasSubstr("was deleted, moved or replaced"));
  directory.write("deep/folder/checks.sqlite", "another file");
  EXPECT_FALSE(store.save(second)) << "in its place";
  move(moved, path);
  saved = store.save(second);
  ASSERT_TRUE(saved) << saved.error().message;
  EXPECT_EQ(CheckStore::open(path, Access::ReadOnly)->list({})->size(), 2U);
  std::filesystem::remove(path);
  EXPECT_FALSE(store.save(make_check_record("20261122T000000000Z-00000000")));
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST_F(Store, ReadsWhatMayOnlyBeRead) {
  {
    CheckStore store = open();
    ASSERT_TRUE(store.save(make_check_record()));
  }
  const std::string folder = directory.path("deep/folder");
  namespace fs = std::filesystem;
  fs::permissions(directory.path("."), fs::perms(0755));
  fs::permissions(path, fs::perms(0444));
  fs::permissions(folder, fs::perms(0555));
  constexpr uid_t kNobody = 65534;
  const uid_t user = ::geteuid();
  if (user == 0) {
    ASSERT_EQ(::seteuid(kNobody), 0);
  }
  const auto store = CheckStore::open(path, Access::ReadOnly);
  const auto listed = store.and_then([](const CheckStore& opened) { return opened.list({}); });
  const auto loaded = store.and_then([](const CheckStore& opened) { return opened.load("last"); });
  if (user == 0) {
    ASSERT_EQ(::seteuid(user), 0);
  }
  fs::permissions(folder, fs::perms(0755));
  ASSERT_TRUE(listed) << listed.error().message;
  EXPECT_EQ(listed->size(), 1U);
  EXPECT_TRUE(loaded);
}

TEST_F(Store, AdoptsNoDatabaseOfAnotherProgram) {
  const std::string foreign = directory.path("foreign.sqlite");
  for (const char* contents :
       {"CREATE TABLE notes (text TEXT)", "CREATE TABLE notes (text TEXT); PRAGMA user_version = 3",
        "PRAGMA user_version = 3", "PRAGMA application_id = 77",
        "CREATE TABLE checks (id TEXT); PRAGMA user_version = 6"}) {
    std::filesystem::remove(foreign);
    SQLite::Database(foreign, SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE).exec(contents);
    const std::string before = directory.read("foreign.sqlite");
    for (const Access access : {Access::ReadWrite, Access::ReadOnly}) {
      const auto store = CheckStore::open(foreign, access);
      ASSERT_FALSE(store) << contents;
      EXPECT_THAT(store.error().message, HasSubstr("not one of clampd's results"));
    }
    EXPECT_EQ(directory.read("foreign.sqlite"), before);
  }
}

TEST_F(Store, IsWriteAheadLoggedAndSynced) {
  CheckStore store = open();
  EXPECT_EQ(SQLite::Database(path).execAndGet("PRAGMA journal_mode").getString(), "wal");
  EXPECT_EQ(SQLite::Database(path).execAndGet("PRAGMA user_version").getInt(), 18);
}

TEST_F(Store, ReadsWhileAnotherWrites) {
  CheckStore writer = open();
  ASSERT_TRUE(writer.save(make_check_record()));
  SQLite::Database other(path, SQLite::OPEN_READWRITE);
  other.exec("BEGIN IMMEDIATE");
  const auto reader = CheckStore::open(path, Access::ReadOnly);
  ASSERT_TRUE(reader) << reader.error().message;
  EXPECT_EQ(reader->list({})->size(), 1u);
}

TEST_F(Store, SaysWhoIsInTheWay) {
  open();
  auto store = CheckStore::open(path, Access::ReadWrite, 1);
  ASSERT_TRUE(store);
  SQLite::Database other(path, SQLite::OPEN_READWRITE);
  other.exec("BEGIN IMMEDIATE");
  const auto saved = store->save(make_check_record());
  ASSERT_FALSE(saved);
  EXPECT_THAT(saved.error().message, HasSubstr("another process is writing"));
}

TEST_F(Store, RefusesWhatIsNoDatabaseOfResults) {
  const std::string garbage = directory.write("garbage.sqlite", std::string(5000, 'x'));
  for (const Access access : {Access::ReadWrite, Access::ReadOnly}) {
    const auto store = CheckStore::open(garbage, access);
    ASSERT_FALSE(store);
    EXPECT_THAT(store.error().message, HasSubstr("damaged or no database"));
  }
  EXPECT_EQ(directory.read("garbage.sqlite"), std::string(5000, 'x')) << "and leaves it alone";

  EXPECT_THAT(CheckStore::open(directory.path(".")).error().message, HasSubstr("is a directory"));
  EXPECT_THAT(CheckStore::open(garbage + "/x").error().message, HasSubstr("cannot make its folder"));
  EXPECT_THAT(CheckStore::open(directory.path("none"), Access::ReadOnly).error().message,
              HasSubstr("no check was saved yet"));
  EXPECT_FALSE(std::filesystem::exists(directory.path("none")));
}

TEST_F(Store, RefusesADamagedDatabase) {
  {
    CheckStore store = open();
    ASSERT_TRUE(store.save(make_check_record()));
  }
  std::filesystem::resize_file(path, 4096 * 3);
  const auto store = CheckStore::open(path, Access::ReadOnly);
  const std::string message = store ? store->load("last").error().message : store.error().message;
  EXPECT_THAT(message, HasSubstr("damaged"));
}

TEST_F(Store, RefusesANewerSchema) {
  open();
  SQLite::Database(path, SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 99");
  const auto store = CheckStore::open(path);
  ASSERT_FALSE(store);
  EXPECT_THAT(store.error().message, HasSubstr("newer version of clampd (schema 99"));
}

}  // namespace
}  // namespace clampd
