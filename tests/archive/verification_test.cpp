// What a database that was changed behind clampd's back says of it, and how a backup brings it back.

#include <filesystem>
#include <string>
#include <vector>

#include <SQLiteCpp/SQLiteCpp.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/json.hpp"
#include "clampd/archive/store.hpp"
#include "support/check_records.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::make_check_record;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using Access = CheckStore::Access;

std::string day_id(int day) {
  return fmt::format("202611{}T000000000Z-00000000", day);
}

class Records : public ::testing::Test {
 protected:
  Records() {
    for (int day = 11; day <= 14; ++day) {
      CheckRecord record = make_check_record(day_id(day));
      record.started = fmt::format("2026-11-{}T08:00:00.000Z", day);
      EXPECT_TRUE(store_.save(record));
    }
  }
  static CheckStore open(const std::string& path, Access access = Access::ReadWrite) {
    auto store = CheckStore::open(path, access);
    EXPECT_TRUE(store) << store.error().message;
    return std::move(*store);
  }
  void change(const std::string& sql) { SQLite::Database(path_, SQLite::OPEN_READWRITE).exec(sql); }
  Verification verified() {
    const auto found = store_.verify();
    EXPECT_TRUE(found) << found.error().message;
    return *found;
  }
  std::vector<std::string> damaged() {
    std::vector<std::string> checks;
    for (const Verification::Damage& damage : verified().damage) checks.push_back(damage.check);
    return checks;
  }

  support::TemporaryDirectory directory_;
  std::string path_ = directory_.path("checks.sqlite");
  CheckStore store_ = open(path_);
};

TEST_F(Records, AreIntactAsTheyWereSaved) {
  const Verification found = verified();
  EXPECT_THAT(found.damage, IsEmpty());
  EXPECT_EQ(found.checks, 4U);
  EXPECT_EQ(found.runs, 8U);
  EXPECT_EQ(found.chain_sha256.size(), 64U);
}

TEST_F(Records, ThatWereChangedAreNamedAndTheRestGoesOn) {
  change(fmt::format("UPDATE checks SET verdict = 0 WHERE id = '{}'", day_id(12)));
  EXPECT_THAT(damaged(), ElementsAre(day_id(12)));
  change(fmt::format("UPDATE runs SET data = x'00' WHERE check_id = '{}' AND position = 1", day_id(14)));
  EXPECT_THAT(damaged(), ElementsAre(day_id(12), day_id(14)));
  EXPECT_EQ(verified().checks, 4U);
}

TEST_F(Records, ThatWereTakenOutOrPutInAreMissed) {
  for (const char* table : {"parameters", "runs", "lateness_histogram", "flight_recorder"})
    change(fmt::format("DELETE FROM {} WHERE check_id = '{}'", table, day_id(12)));
  change(fmt::format("DELETE FROM checks WHERE id = '{}'", day_id(12)));
  EXPECT_THAT(damaged(), ElementsAre(day_id(12)));
  EXPECT_EQ(verified().damage[0].what, "the check is gone");
  change(fmt::format("DELETE FROM chain WHERE check_id = '{}'", day_id(12)));
  EXPECT_THAT(verified().damage[0].what, HasSubstr("entries 2 to 2 of the chain of checksums are missing"));
  change("UPDATE chain SET position = position - 1 WHERE position > 2");
  EXPECT_THAT(damaged(), ElementsAre(day_id(13), day_id(14)))
      << "numbered anew, its entries tell all the same";
  change(
      "CREATE TEMP TABLE forged AS SELECT * FROM checks LIMIT 1; UPDATE forged SET id = 'forged', verdict = "
      "0; "
      "INSERT INTO checks SELECT * FROM forged");
  EXPECT_THAT(damaged(), ::testing::Contains("forged"));
  EXPECT_FALSE(store_.load("forged"));
}

TEST_F(Records, ThatWereExchangedAreNamed) {
  change(fmt::format("UPDATE checks SET rowid = 100 WHERE id = '{}'", day_id(12)));
  EXPECT_THAT(damaged(), ElementsAre(day_id(13))) << "12 is the newest one now, so that 13 comes too early";
  const Verification before = verified();
  ASSERT_TRUE(store_.save(make_check_record(day_id(15))));
  EXPECT_NE(verified().chain_sha256, before.chain_sha256);
}

TEST_F(Records, StayIntactWhenRetentionRemovesRuns) {
  ASSERT_TRUE(store_.apply_retention({.bytes = 1}, 1'795'219'200'000'000'000, 2));
  const Verification found = verified();
  EXPECT_THAT(found.damage, IsEmpty());
  EXPECT_EQ(found.runs, 4U);
  EXPECT_EQ(found.runs_removed, 4U);
  EXPECT_TRUE(store_.load(day_id(11)));
  change(fmt::format(
      "UPDATE runs SET data = NULL, removed = '2026-11-21T00:00:00.000Z' WHERE check_id = '{}'", day_id(14)));
  EXPECT_THAT(damaged(), ElementsAre(day_id(14), day_id(14)))
      << "of which the station's retention knows nothing";
}

TEST_F(Records, ThatAreVoidStayAndSaySo) {
  const auto id =
      store_.mark_void("20261112", {"wrong brake in the fixture", "ada", "2026-11-21T00:00:00.000Z"});
  ASSERT_TRUE(id) << id.error().message;
  EXPECT_EQ(*id, day_id(12));
  const auto loaded = store_.load(*id);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(loaded->voided, (VoidRecord{"wrong brake in the fixture", "ada", "2026-11-21T00:00:00.000Z"}));
  EXPECT_EQ(loaded->verdict, Verdict::Fail) << "what was found stays as it was found";
  EXPECT_EQ(check_json(*loaded).at("void").at("reason"), "wrong brake in the fixture");
  EXPECT_TRUE(store_.list({})->at(2).is_void);
  EXPECT_FALSE(store_.list({})->at(1).is_void);
  EXPECT_THAT(store_.mark_void(*id, {"again", "bo", ""}).error().message, HasSubstr("is void already"));
  EXPECT_THAT(verified().damage, IsEmpty());
  change("UPDATE amendments SET content = replace(content, 'wrong', 'right')");
  EXPECT_THAT(damaged(), ElementsAre(day_id(12)));
  EXPECT_FALSE(store_.load(*id));
  change("DELETE FROM amendments");
  EXPECT_FALSE(store_.load(*id)) << "a mark that was taken out";
}

TEST_F(Records, TakeOverWhatWasSettledLater) {
  const CauseRecord cause{"explained", {"inertia-error"}, "torque-balance", {}, "The inertia is off."};
  ASSERT_TRUE(store_.save_settled_cause(day_id(13), cause, "k2 is off. The inertia is off."));
  EXPECT_EQ(store_.load(day_id(13))->cause, cause);
  EXPECT_EQ(store_.load_result(day_id(13))->reason, "k2 is off. The inertia is off.");
  EXPECT_EQ(store_.list({})->at(1).reason, "k2 is off. The inertia is off.");
  EXPECT_EQ(store_.load_results({})->at(1).cause, cause);
  ASSERT_TRUE(store_.save_settled_cause(day_id(13), std::nullopt, "k2 is off."));
  EXPECT_FALSE(store_.load(day_id(13))->cause);
  EXPECT_FALSE(store_.save_settled_cause("none", cause, ""));
  EXPECT_THAT(verified().damage, IsEmpty());
}

TEST_F(Records, AreBackedUpAndRestoredWhileTheStoreIsOpen) {
  const std::string backup = directory_.path("backup.sqlite");
  const auto backed_up = store_.back_up(backup);
  ASSERT_TRUE(backed_up) << backed_up.error().message;
  EXPECT_THAT(store_.back_up(backup).error().message, HasSubstr("is there already"));
  EXPECT_EQ(open(backup, Access::ReadOnly).verify()->chain_sha256, verified().chain_sha256);
  EXPECT_FALSE(std::filesystem::exists(backup + "-wal")) << "one file";

  ASSERT_TRUE(store_.save(make_check_record(day_id(15))));
  change("UPDATE checks SET verdict = 0");
  const auto kept = restore_backup(backup, path_, 1'795'218'067'123'000'000);
  ASSERT_TRUE(kept) << kept.error().message;
  EXPECT_EQ(*kept, path_ + ".before-20261120T234107123Z");
  EXPECT_THAT(store_.list({}).value(), SizeIs(4)) << "as the store that was open all the time sees it";
  EXPECT_THAT(verified().damage, IsEmpty());
  ASSERT_TRUE(store_.save(make_check_record(day_id(16))));
  EXPECT_THAT(verified().damage, IsEmpty());
  EXPECT_THAT(open(*kept, Access::ReadOnly).list({}).value(), SizeIs(5)) << "nothing is lost";
}

TEST_F(Records, AreNotRestoredFromADamagedBackup) {
  const std::string backup = directory_.path("backup.sqlite");
  ASSERT_TRUE(store_.back_up(backup));
  SQLite::Database(backup, SQLite::OPEN_READWRITE).exec("UPDATE checks SET serial = 'X' WHERE rowid = 2");
  const auto refused = restore_backup(backup, path_, 0);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr(day_id(12)));
  EXPECT_THAT(refused.error().message, HasSubstr("nothing was changed"));
  EXPECT_EQ(store_.load(day_id(12))->serial, "EMB-0042");
  EXPECT_THAT(restore_backup(path_, path_, 0).error().message, HasSubstr("is the database itself"));
  EXPECT_FALSE(restore_backup(directory_.write("text", "no database"), path_, 0));
}

TEST_F(Records, AreRestoredWhereNothingCanBeReadAnyMore) {
  const std::string backup = directory_.path("backup.sqlite");
  ASSERT_TRUE(store_.back_up(backup));
  const std::string other = directory_.write("other.sqlite", std::string(10'000, 'x'));
  const auto kept = restore_backup(backup, other, 0);
  ASSERT_TRUE(kept) << kept.error().message;
  EXPECT_EQ(std::filesystem::file_size(*kept), 10'000U);
  EXPECT_THAT(open(other, Access::ReadOnly).list({}).value(), SizeIs(4));
  EXPECT_EQ(restore_backup(backup, directory_.path("new.sqlite"), 0).value(), "");
}

}  // namespace
}  // namespace clampd
