// A stop, a clamped brake, and the station's own end, as whoever talks to the real daemon sees them.

#include <csignal>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/store.hpp"
#include "faults/station.hpp"
#include "support/eventually.hpp"

namespace clampd::faults {
namespace {

using support::eventually;
using ::testing::HasSubstr;

api::StationStatus status_of(const Station& station) {
  const Result<api::StationStatus> status = station.client().status();
  EXPECT_TRUE(status) << station.log();
  return status.value_or(api::StationStatus{});
}

CheckRecord on_record(const Station& station, const std::string& id) {
  const auto archive = CheckStore::open(station.database(), CheckStore::Access::ReadOnly);
  EXPECT_TRUE(archive);
  Result<CheckRecord> record = archive->load(id);
  EXPECT_TRUE(record) << station.log();
  return record.value_or(CheckRecord{});
}

/// Twenty runs, so that there is time to meet the brake at the top of one.
api::StartedCheck start_and_clamp(const Station& station) {
  const Result<api::StartedCheck> started = station.client().start({.serial = "CLAMPED", .repeats = 20});
  EXPECT_TRUE(started);
  EXPECT_TRUE(eventually([&] { return status_of(station).force_N > 5'000.0; })) << station.log();
  return started.value_or(api::StartedCheck{});
}

TEST(Stop, LeavesABrakeThatIsSaidToBeClampedUntilItIsOpened) {
  Station station;
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  const api::Client& client = station.client();
  const api::StartedCheck check = start_and_clamp(station);
  ASSERT_TRUE(client.stop());
  ASSERT_TRUE(eventually([&] {
    const api::StationStatus status = status_of(station);
    return status.stops == 1 && status.stops_taken == 1;
  })) << station.log();
  EXPECT_EQ(status_of(station).state, "FAULT");
  ASSERT_TRUE(eventually([&] { return status_of(station).clamped; })) << "also in FAULT";
  EXPECT_FALSE(client.open()) << "not in FAULT";
  EXPECT_EQ(station.finished().at("record"), check.id);
  ASSERT_TRUE(client.clear());
  ASSERT_TRUE(station.wait_for_idle());
  EXPECT_TRUE(status_of(station).clamped) << "a clear opens nothing";
  EXPECT_GT(status_of(station).clamped_N, 300.0);

  const auto opening = client.open();
  ASSERT_TRUE(opening) << opening.error().message;
  ASSERT_TRUE(eventually([&] { return !status_of(station).opening; })) << station.log();
  const api::StationStatus open = status_of(station);
  EXPECT_EQ(open.open_id, *opening);
  EXPECT_EQ(open.open_result, "OPEN") << open.open_reason;
  EXPECT_TRUE(eventually([&] { return !status_of(station).clamped; }));
  ASSERT_TRUE(client.start({.serial = "NEXT"}));
  EXPECT_EQ(station.finished().at("verdict"), "PASS");
}

TEST(Stop, VoidsAStartWhoseAskerHasNotSeenIt) {
  Station station;
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  const api::Client& client = station.client();
  const std::uint64_t seen = status_of(station).stops;
  ASSERT_TRUE(client.stop());
  const auto late = client.start({.serial = "LATE"}, seen);
  ASSERT_FALSE(late);
  EXPECT_THAT(late.error().message, HasSubstr("a stop came after"));
  EXPECT_FALSE(client.start({.serial = "LATE"}, seen + 7)) << "of another daemon";
  EXPECT_EQ(status_of(station).check, 0U);
  ASSERT_TRUE(client.start({.serial = "NOW"}, status_of(station).stops));
  EXPECT_EQ(station.finished().at("verdict"), "PASS");
}

TEST(StationEnd, IsSaidByTheRecordOfTheCheckThatItEnded) {
  Station station;
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  const api::StartedCheck check = start_and_clamp(station);
  EXPECT_EQ(station.end(SIGTERM), 0) << station.log();
  const CheckRecord record = on_record(station, check.id);
  EXPECT_EQ(record.verdict, Verdict::Aborted);
  EXPECT_THAT(record.reason, HasSubstr("program was stopped or restarted"));
}

TEST(StationEnd, ThatWasAKillLeavesARecordAtTheNextStart) {
  Station station;
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  const api::StartedCheck check = start_and_clamp(station);
  EXPECT_EQ(station.end(SIGKILL), -SIGKILL);
  station.start();
  ASSERT_TRUE(eventually([&] {
    const auto archive = CheckStore::open(station.database(), CheckStore::Access::ReadOnly);
    return archive && archive->load_result(check.id).has_value();
  })) << station.log();
  const CheckRecord record = on_record(station, check.id);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_EQ(record.serial, "CLAMPED");
  EXPECT_THAT(record.reason, HasSubstr("The station ended during the check"));
  ASSERT_TRUE(station.wait_for_idle());
  const auto next = station.client().start({.serial = "NEXT"});
  ASSERT_TRUE(next);
  EXPECT_EQ(next->check, check.check) << "numbers begin again";
  EXPECT_NE(next->id, check.id) << "ids do not";
}

}  // namespace
}  // namespace clampd::faults
