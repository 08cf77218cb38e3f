#include <SQLiteCpp/SQLiteCpp.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/store.hpp"
#include "clampd/record/utc.hpp"
#include "support/check_records.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::make_check_record;

class Outbox : public ::testing::Test {
 protected:
  CheckStore open() {
    auto opened = CheckStore::open(path);
    EXPECT_TRUE(opened) << opened.error().message;
    return std::move(*opened);
  }
  support::TemporaryDirectory directory;
  std::string path = directory.path("checks.sqlite");
};

TEST_F(Outbox, KeepsTheOrderOfSavingAndItsPlaces) {
  CheckStore store = open();
  ASSERT_TRUE(store.save(make_check_record("before")));
  store.queue_for({"mqtt", "postgresql"});
  for (const char* id : {"z", "a", "m"}) ASSERT_TRUE(store.save(make_check_record(id)));
  EXPECT_EQ(store.outbox("mqtt")->pending, 3u);
  EXPECT_TRUE(parse_utc(store.outbox("mqtt")->oldest));
  for (const char* id : {"z", "a", "m"}) {
    const auto next = store.next_in_outbox("mqtt");
    ASSERT_TRUE(next && *next);
    EXPECT_EQ((*next)->check_id, id);
    ASSERT_TRUE(store.mark_publication(id, "mqtt", PublicationState::Published));
  }
  EXPECT_FALSE(store.next_in_outbox("mqtt")->has_value());
  EXPECT_EQ(store.outbox("mqtt")->oldest, "");
  EXPECT_EQ(store.outbox("postgresql")->pending, 3u);
  ASSERT_TRUE(store.mark_publication("a", "mqtt", PublicationState::Pending));
  EXPECT_EQ((*store.next_in_outbox("mqtt"))->sequence, 2) << "it keeps its number";
  ASSERT_TRUE(store.save(make_check_record("b")));
  EXPECT_EQ((*store.next_in_outbox("mqtt"))->check_id, "a");
}

TEST_F(Outbox, ACheckThatIsNotSavedIsNotQueued) {
  CheckStore store = open();
  store.queue_for({"mqtt"});
  ASSERT_TRUE(store.save(make_check_record("a")));
  ASSERT_FALSE(store.save(make_check_record("a")));
  EXPECT_EQ(store.outbox("mqtt")->pending, 1u);
}

TEST_F(Outbox, CountsConnectionsOverRestarts) {
  EXPECT_EQ(open().count_connection("mqtt"), 0u);
  CheckStore store = open();
  EXPECT_EQ(store.count_connection("mqtt"), 1u);
  EXPECT_EQ(store.count_connection("postgresql"), 0u);
}

TEST_F(Outbox, PutsMarksFromBeforeItInOrder) {
  {
    CheckStore store = open();
    for (const char* id : {"a", "b", "c"}) ASSERT_TRUE(store.save(make_check_record(id)));
    ASSERT_TRUE(store.mark_publication("b", "mqtt", PublicationState::Pending));
    ASSERT_TRUE(store.mark_publication("a", "mqtt", PublicationState::Pending));
    SQLite::Database(path, SQLite::OPEN_READWRITE)
        .exec(
            "DROP TABLE outbox_connections; DROP INDEX publication_next; DROP INDEX publication_order; "
            "CREATE INDEX publication_pending ON publication (channel, check_id) WHERE state = 0; "
            "ALTER TABLE publication DROP COLUMN sequence; ALTER TABLE publication DROP COLUMN queued; "
            "ALTER TABLE checks DROP COLUMN torque_while_off; ALTER TABLE checks DROP COLUMN tare_force_N; "
            "ALTER TABLE checks DROP COLUMN tare_force_sd_N; ALTER TABLE checks DROP COLUMN "
            "tare_velocity_rad_s; "
            "ALTER TABLE checks DROP COLUMN tare_velocity_sd_rad_s; DROP TABLE amendments; DROP TABLE chain; "
            "ALTER TABLE runs DROP COLUMN data; ALTER TABLE checks DROP COLUMN systematic; ALTER TABLE "
            "checks DROP COLUMN stopping; ALTER TABLE checks DROP COLUMN sheet; ALTER TABLE checks DROP "
            "COLUMN recipe; ALTER TABLE checks DROP COLUMN found_rad; PRAGMA "
            "application_id = 0; "
            "PRAGMA user_version = 4");
  }
  CheckStore store = open();
  EXPECT_EQ((*store.next_in_outbox("mqtt"))->check_id, "a");
  EXPECT_EQ((*store.next_in_outbox("mqtt"))->sequence, 1);
  store.queue_for({"mqtt"});
  ASSERT_TRUE(store.save(make_check_record("d")));
  EXPECT_EQ(store.outbox("mqtt")->pending, 3u);
}

TEST_F(Outbox, LoadsAResultWithoutItsRawRuns) {
  CheckStore store = open();
  const CheckRecord saved = make_check_record("a");
  ASSERT_TRUE(store.save(saved));
  const auto loaded = store.load_result("a");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(loaded->parameters.size(), saved.parameters.size());
  ASSERT_EQ(loaded->runs.size(), 2u);
  EXPECT_EQ(loaded->runs[1].checksum_sha256, saved.runs[1].checksum_sha256);
  EXPECT_EQ(loaded->runs[1].run.size(), 0u);
  EXPECT_FALSE(store.load_result(""));
}

}  // namespace
}  // namespace clampd
