// Databases with flipped bits: whatever they say is what was recorded, or is named as damaged. More than the
// tests take: CLAMPD_DAMAGED_DATABASES=1000 test_archive --gtest_filter='Damage*'

#include <cstdlib>
#include <filesystem>
#include <map>
#include <random>
#include <string>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "clampd/archive/json.hpp"
#include "clampd/archive/store.hpp"
#include "support/check_records.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

constexpr int kChecks = 6;

/// All that anybody is ever shown of a check.
std::string shown(const CheckRecord& record) {
  std::string text = check_json(record).dump();
  for (const RunRecord& run : record.runs) text += format_run(run.run);
  for (const Sample& sample : record.flight_recorder)
    text += fmt::format("{} {} {} {} {}\n", sample.sample_index, sample.force_N, sample.torque_Nm,
                        sample.lateness_ns, to_string(sample.fault));
  return text;
}

std::string damage_id(int i) {
  return fmt::format("2026112{}T000000000Z-00000000", i);
}

CheckRecord record_of(int i) {
  CheckRecord record = support::make_check_record(damage_id(i));
  record.serial = fmt::format("EMB-{:04}", i);
  record.verdict = i % 2 == 0 ? Verdict::Pass : Verdict::Fail;
  for (RunRecord& run : record.runs) run.run.force_N[0] += i;
  return record;
}

struct Outcome {
  bool refused = false;  ///< the file as a whole
  bool named = false;    ///< as damaged, by verify()
  int unreadable = 0;    ///< checks that load() refuses
  int changed = 0;       ///< checks that it gives, and other than they were
  bool list_changed = false;
};

class Damage : public ::testing::Test {
 protected:
  Damage() {
    auto store = CheckStore::open(path_);
    EXPECT_TRUE(store) << store.error().message;
    for (int i = 0; i < kChecks; ++i) EXPECT_TRUE(store->save(record_of(i)));
    EXPECT_TRUE(store->mark_void(damage_id(2), {"a reason", "ada", "2026-11-27T00:00:00.000Z"}));
    EXPECT_TRUE(store->apply_retention({.bytes = 1}, 1'795'219'200'000'000'000, 1));
    for (int i = 0; i < kChecks; ++i) shown_[damage_id(i)] = shown(*store->load(damage_id(i)));
    listed_ = summaries_json(*store->list({})).dump();
  }

  Outcome look() {
    Outcome outcome;
    const auto store = CheckStore::open(path_, CheckStore::Access::ReadOnly);
    if (!store) {
      outcome.refused = true;
      return outcome;
    }
    for (const auto& [id, text] : shown_) {
      const auto loaded = store->load(id);
      if (!loaded)
        ++outcome.unreadable;
      else if (shown(*loaded) != text)
        ++outcome.changed;
    }
    const auto listed = store->list({});
    outcome.list_changed = !listed || summaries_json(*listed).dump() != listed_;
    (void)store->load_results({});
    const auto verification = store->verify();
    outcome.named = !verification || !verification->damage.empty();
    return outcome;
  }

  support::TemporaryDirectory directory_;
  std::string path_ = directory_.path("checks.sqlite");
  std::map<std::string, std::string> shown_;
  std::string listed_;
};

TEST_F(Damage, ThatChangesARecordIsNoticed) {
  ASSERT_EQ(look().unreadable + look().changed + look().named + look().list_changed, 0);
  const std::string intact = directory_.read("checks.sqlite");
  const char* asked = std::getenv("CLAMPD_DAMAGED_DATABASES");
  const int databases = asked == nullptr ? 300 : std::atoi(asked);
  std::mt19937 random(20261123);
  int refused = 0, named = 0, unreadable = 0, harmless = 0;
  for (int i = 0; i < databases && !HasFailure(); ++i) {
    std::string damaged = intact;
    const int bits = 1 + static_cast<int>(random() % 4);
    for (int bit = 0; bit < bits; ++bit)
      damaged[random() % damaged.size()] ^= static_cast<char>(1U << (random() % 8));
    for (const char* suffix : {"-wal", "-shm"}) std::filesystem::remove(path_ + suffix);
    directory_.write("checks.sqlite", damaged);
    const Outcome outcome = look();
    EXPECT_EQ(outcome.changed, 0) << "database " << i << " gives a record that is not the one that was saved";
    EXPECT_TRUE(outcome.named || outcome.refused || (outcome.unreadable == 0 && !outcome.list_changed))
        << "database " << i << ": what is damaged is not named";
    refused += outcome.refused ? 1 : 0;
    named += outcome.named ? 1 : 0;
    unreadable += outcome.unreadable > 0 ? 1 : 0;
    harmless += outcome.named || outcome.refused ? 0 : 1;
  }
  fmt::print(
      "{} databases with 1 to 4 flipped bits: {} refused as a whole, {} named by verify ({} of them with "
      "checks "
      "that are not shown any more), {} harmless; no changed record shown\n",
      databases, refused, named, unreadable, harmless);
  EXPECT_GT(named, databases / 3) << "the bits should hit what counts";
}

}  // namespace
}  // namespace clampd
