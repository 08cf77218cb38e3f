#include <cmath>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <map>
#include <mutex>
#include <random>
#include <set>
#include <thread>

#include <SQLiteCpp/SQLiteCpp.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/store.hpp"
#include "faults/station.hpp"

namespace clampd::faults {
namespace {

using Clock = std::chrono::steady_clock;

int kills = 60;
int stations = 4;

/// What all stations together went through.
struct Tally {
  std::mutex mutex;
  std::map<std::string, int> phases;  ///< where the station was seen last before it was killed
  std::size_t acknowledged = 0;
  std::size_t kept = 0;
  std::size_t interrupted = 0;  ///< of those, on record as not finished
  std::size_t started = 0;
};

/// One station, killed again and again on the same state directory.
class Victim {
 public:
  Victim(int number, Tally& tally) : number_(number), tally_(tally), random_(20261121U + number) {}

  void live(int lives) {
    for (int life = 0; life < lives && !::testing::Test::HasFailure(); ++life) {
      begin();
      watch_until_the_end(fmt::format("S{}-{}", number_, life));
      EXPECT_EQ(station_.end(SIGKILL), -SIGKILL) << station_.log();
      const std::lock_guard lock(tally_.mutex);
      ++tally_.phases[seen_];
    }
    begin();
    ASSERT_TRUE(station_.client().start({.serial = fmt::format("S{}-last", number_)}));
    ++started_;
    acknowledged_[station_.finished().at("record")] = "PASS";
    EXPECT_EQ(station_.end(SIGTERM), 0) << station_.log();
    judge();
  }

 private:
  /// A restart never goes on with anything: no check, no torque, and IDLE by itself.
  void begin() {
    const api::StationStatus first = station_.start();
    EXPECT_TRUE(first.state == "INIT" || first.state == "IDLE") << first.state;
    EXPECT_EQ(first.check, 0U);
    EXPECT_EQ(first.last_verdict, "");
    EXPECT_LT(std::abs(first.torque_Nm), 0.02) << "but for the reading's noise";
    EXPECT_EQ(first.fault, "none");
    ASSERT_TRUE(station_.wait_for_idle()) << station_.log();
  }

  /// Some die at any time, some once the verdict is being made, some once it is seen.
  void watch_until_the_end(const std::string& serial) {
    const auto accepted = station_.client().start({.serial = serial});
    ASSERT_TRUE(accepted) << accepted.error().message;
    ++started_;
    enum class Death { Anytime, Judging, Finished };
    const auto death =
        std::array{Death::Anytime, Death::Anytime, Death::Judging, Death::Finished}[random_() % 4];
    // Beside the questions: those wait while a result is being saved.
    std::thread killer;
    const auto die_within = [&](int longest_us) {
      const auto end = Clock::now() + std::chrono::microseconds(random_() % longest_us);
      killer = std::thread([this, end] {
        std::this_thread::sleep_until(end);
        ::kill(station_.process(), SIGKILL);
      });
    };
    if (death == Death::Anytime) die_within(1'500'000);
    seen_ = "begin";
    while (true) {
      const auto status = station_.client().status();
      const auto progress = station_.client().progress(false);
      if (!status || !progress) break;
      seen_ = progress->finished ? "finished" : status->judging ? "judging" : progress->phase;
      // A disk that stands still is told as an ERROR for the time being, which promises no result.
      const bool is_kept =
          progress->finished &&
          progress->record.at("reason").get<std::string>().find("could not be saved") == std::string::npos;
      if (is_kept) acknowledged_[progress->record.at("record")] = progress->record.at("verdict");
      if (!killer.joinable() && (progress->finished || (death == Death::Judging && status->judging)))
        die_within(death == Death::Finished ? 20'000 : 40'000);  // estimation and saving take 15 ms or more
    }
    if (killer.joinable()) killer.join();
  }

  void judge() {
    SQLite::Database file(station_.database());
    EXPECT_EQ(file.execAndGet("PRAGMA integrity_check").getString(), "ok");
    EXPECT_FALSE(SQLite::Statement(file, "PRAGMA foreign_key_check").executeStep());
    EXPECT_EQ(file.execAndGet("SELECT COUNT(*) - COUNT(DISTINCT serial) FROM checks").getInt(), 0)
        << "doubled";
    std::set<std::string> kept;
    SQLite::Statement checks(file, "SELECT id FROM checks");
    while (checks.executeStep()) kept.insert(checks.getColumn(0).getString());
    for (const auto& [id, verdict] : acknowledged_) {
      EXPECT_TRUE(kept.contains(id)) << "an acknowledged check is not on record: " << id;
      EXPECT_EQ(verdict, "PASS");
    }
    std::size_t interrupted = 0;
    const Result<CheckStore> store = CheckStore::open(station_.database(), CheckStore::Access::ReadOnly);
    ASSERT_TRUE(store) << store.error().message;
    for (const std::string& id : kept) {
      const Result<CheckRecord> record = store->load(id);  // with the checksums of its runs
      ASSERT_TRUE(record) << record.error().message;
      if (record->verdict == Verdict::Error) {
        // Killed half way: known by its journal, and never by a verdict that anybody was told.
        EXPECT_THAT(record->reason, ::testing::HasSubstr("The station ended during the check"));
        EXPECT_FALSE(acknowledged_.contains(id));
        ++interrupted;
        continue;
      }
      EXPECT_EQ(record->verdict, Verdict::Pass) << record->reason;
      EXPECT_EQ(record->parameters.size(), 7U);
      EXPECT_EQ(record->runs.size(), 1U);
      EXPECT_GT(record->timing.ticks, 0U);
    }
    const Result<Verification> verified = store->verify();
    ASSERT_TRUE(verified) << verified.error().message;
    EXPECT_TRUE(verified->damage.empty()) << verified->damage.front().check << verified->damage.front().what;
    EXPECT_EQ(verified->checks, kept.size());
    std::vector<std::string> queued;
    std::int64_t sequence = 0;
    SQLite::Statement outbox(
        file, "SELECT check_id, sequence FROM publication WHERE channel = 'mqtt' ORDER BY sequence");
    while (outbox.executeStep()) {
      queued.push_back(outbox.getColumn(0).getString());
      EXPECT_EQ(outbox.getColumn(1).getInt64(), ++sequence);
    }
    EXPECT_THAT(queued, ::testing::UnorderedElementsAreArray(kept)) << "each once in the outbox";
    const std::lock_guard lock(tally_.mutex);
    tally_.acknowledged += acknowledged_.size();
    tally_.kept += kept.size();
    tally_.interrupted += interrupted;
    tally_.started += started_;
  }

  int number_;
  Tally& tally_;
  std::mt19937 random_;
  Station station_;
  std::map<std::string, std::string> acknowledged_;  ///< id and verdict that somebody was told
  std::string seen_;
  std::size_t started_ = 0;
};

TEST(Kills, LoseAndDoubleNoResult) {
  Tally tally;
  std::vector<std::thread> threads;
  for (int number = 0; number < stations; ++number)
    threads.emplace_back(
        [&, number] { Victim(number, tally).live(kills / stations + (number < kills % stations ? 1 : 0)); });
  for (std::thread& thread : threads) thread.join();
  std::string phases;
  for (const auto& [phase, count] : tally.phases) phases += fmt::format(" {} {},", phase, count);
  fmt::print("{} kills:{} {} of {} checks on record, {} of them acknowledged, {} as not finished\n", kills,
             phases, tally.kept, tally.started, tally.acknowledged, tally.interrupted);
  EXPECT_GE(tally.phases.size(), 4U) << "the kills should fall anywhere in a check";
  EXPECT_GE(tally.acknowledged, static_cast<std::size_t>(kills) / 5);
  EXPECT_GE(tally.interrupted, static_cast<std::size_t>(kills) / 5);
}

}  // namespace
}  // namespace clampd::faults

int main(int argc, char** argv) {
  testing::InitGoogleMock(&argc, argv);
  for (int i = 1; i + 1 < argc; ++i) {
    if (std::strcmp(argv[i], "--kills") == 0) clampd::faults::kills = std::atoi(argv[i + 1]);
    if (std::strcmp(argv[i], "--stations") == 0) clampd::faults::stations = std::atoi(argv[i + 1]);
  }
  return RUN_ALL_TESTS();
}
