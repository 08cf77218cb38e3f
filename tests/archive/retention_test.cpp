#include <optional>
#include <string>
#include <vector>

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
using ::testing::IsEmpty;
using ::testing::Pair;

constexpr std::int64_t kDay_ns = 86'400'000'000'000;
constexpr std::int64_t kNow_ns = 1'795'219'200'000'000'000;  // 2026-11-21T00:00:00Z

std::string id_of(int day) {
  return "202611" + std::to_string(day) + "T000000000Z-00000000";
}

class Retention : public ::testing::Test {
 protected:
  void SetUp() override {
    auto opened = CheckStore::open(directory_.path("checks.sqlite"));
    ASSERT_TRUE(opened) << opened.error().message;
    store_.emplace(std::move(*opened));
    for (int day = 11; day <= 14; ++day) {
      CheckRecord record = make_check_record(id_of(day));
      record.started = "2026-11-" + std::to_string(day) + "T08:00:00.000Z";
      ASSERT_TRUE(store_->save(record));
    }
    size_ = store_->plan_retention({}, kNow_ns)->kept_bytes / 4;
  }

  std::vector<std::string> planned(const RetentionPolicy& policy) {
    const auto plan = store_->plan_retention(policy, kNow_ns);
    EXPECT_TRUE(plan) << plan.error().message;
    return plan->checks;
  }
  void publish(int day, const std::string& channel, PublicationState state = PublicationState::Published) {
    const auto marked = store_->mark_publication(id_of(day), channel, state);
    ASSERT_TRUE(marked) << marked.error().message;
  }

  support::TemporaryDirectory directory_;
  std::optional<CheckStore> store_;
  std::uint64_t size_ = 0;  ///< of one check's raw runs
};

TEST_F(Retention, KeepsAllUnlessToldOtherwise) {
  EXPECT_TRUE(RetentionPolicy{}.keeps_all());
  EXPECT_THAT(planned({}), IsEmpty());
}

TEST_F(Retention, LetsTheOldGo) {
  EXPECT_THAT(planned({.days = 8}), ElementsAre(id_of(11), id_of(12)));
  EXPECT_THAT(planned({.days = 20}), IsEmpty());
}

TEST_F(Retention, LetsTheOldestGoWhereThereIsTooMuch) {
  EXPECT_THAT(planned({.bytes = 4 * size_}), IsEmpty());
  EXPECT_THAT(planned({.bytes = 4 * size_ - 1}), ElementsAre(id_of(11)));
  EXPECT_THAT(planned({.bytes = size_}), ElementsAre(id_of(11), id_of(12), id_of(13)));
}

TEST_F(Retention, NeverDeletesWhatWasNotPublished) {
  const RetentionPolicy policy{.days = 1, .published = {"mqtt", "postgresql"}};
  EXPECT_THAT(planned(policy), IsEmpty());
  publish(12, "mqtt");
  publish(12, "postgresql");
  publish(13, "mqtt");
  EXPECT_THAT(planned(policy), ElementsAre(id_of(12)));
  const auto plan = store_->plan_retention(policy, kNow_ns);
  EXPECT_THAT(plan->waiting, ElementsAre(Pair("mqtt", 2u), Pair("postgresql", 1u)));
  publish(12, "mqtt", PublicationState::Pending);  // it is to be sent again
  EXPECT_THAT(planned(policy), IsEmpty());
}

TEST_F(Retention, WaitsForWhatIsPendingThoughItIsNotConfigured) {
  publish(11, "forgotten", PublicationState::Pending);
  EXPECT_THAT(planned({.days = 8}), ElementsAre(id_of(12)));
  publish(11, "forgotten");
  EXPECT_THAT(planned({.days = 8}), ElementsAre(id_of(11), id_of(12)));
}

TEST_F(Retention, RemovesRawRunsAndNothingElse) {
  const auto done = store_->apply_retention({.days = 8}, kNow_ns, 1);
  ASSERT_TRUE(done) << done.error().message;
  EXPECT_THAT(done->checks, ElementsAre(id_of(11))) << "so many at a time";
  EXPECT_EQ(done->bytes, size_);
  EXPECT_EQ(done->kept_bytes, 3 * size_);

  const auto pruned = store_->load(id_of(11));
  ASSERT_TRUE(pruned) << pruned.error().message;
  ASSERT_EQ(pruned->runs.size(), 2u);
  EXPECT_EQ(pruned->runs[0].run.size(), 0u);
  EXPECT_EQ(pruned->runs[0].removed, "2026-11-21T00:00:00.000Z");
  CheckRecord expected = make_check_record(id_of(11));
  EXPECT_EQ(pruned->runs[0].checksum_sha256, expected.runs[0].checksum_sha256);
  EXPECT_EQ(pruned->runs[1].estimate, expected.runs[1].estimate);
  EXPECT_EQ(check_json(*pruned).at("parameters"), check_json(expected).at("parameters"));
  EXPECT_EQ(pruned->flight_recorder.size(), 3u);
  EXPECT_EQ(store_->load(id_of(12))->runs[0].run.size(), 300u);

  EXPECT_THAT(planned({.days = 8}), ElementsAre(id_of(12))) << "what is gone does not go again";
}

TEST_F(Retention, PublishesOnlyWhatIsThere) {
  const auto marked = store_->mark_publication("nothing", "mqtt", PublicationState::Published);
  ASSERT_FALSE(marked);
  EXPECT_THAT(marked.error().message, ::testing::HasSubstr("no check nothing"));
}

static_assert(kNow_ns % kDay_ns == 0);

}  // namespace
}  // namespace clampd
