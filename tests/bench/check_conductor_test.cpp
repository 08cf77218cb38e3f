// What the conductor makes of starts, ends, a slow disk and a sudden end of the station.

#include "clampd/bench/check_conductor.hpp"

#include <cmath>

#include <SQLiteCpp/SQLiteCpp.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/station/verdict.hpp"
#include "support/eventually.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::bench {
namespace {

using support::eventually;
using ::testing::HasSubstr;

PreparedStation with_deadline(double deadline_s) {
  PreparedStation station = prepared();
  station.configuration.check.deadline_s = deadline_s;
  return station;
}

TEST(CheckConductor, RefusesAStartThatAStopOvertook) {
  Bench bench(plant(1), WorkerMode::Synchronous);
  bench.reach(StationState::Idle);
  const rt::StartTicket asked = bench.core.ticket();
  bench.core.requests().stop(bench.now_ns);
  bench.advance();
  const Result<void> begun = bench.conductor.begin(request(1), asked, {bench.now_ns, bench.now_ns});
  ASSERT_FALSE(begun);
  EXPECT_THAT(begun.error().message, HasSubstr("a stop came after the start was asked for"));
  EXPECT_FALSE(bench.conductor.busy());
  EXPECT_TRUE(bench.begin(1)) << "one that is asked for now is taken";
}

TEST(CheckConductor, RefusesAStartThatWaitedTooLong) {
  Bench bench(plant(1), WorkerMode::Synchronous);
  bench.reach(StationState::Idle);
  const rt::StartTicket asked = bench.core.ticket();
  for (int i = 0; i < 302; ++i) bench.advance();
  const Result<void> begun = bench.conductor.begin(request(1), asked, {bench.now_ns, bench.now_ns});
  ASSERT_FALSE(begun);
  EXPECT_THAT(begun.error().message, HasSubstr("300 ms"));
}

TEST(CheckConductor, AStopWithinTheRunAfterTheLastLookIsStillAStop) {
  Bench bench(plant(1), WorkerMode::Synchronous);
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.conductor.begin({.serial = "AUTO", .repeats_auto = true}, {bench.now_ns, bench.now_ns}));
  while (bench.core.requests().enough_runs_in == 0) {
    bench.advance();
    ASSERT_FALSE(bench.pump());
  }
  bench.core.requests().stop(bench.now_ns);
  const CheckRecord record = bench.finish();
  EXPECT_EQ(record.verdict, Verdict::Aborted);
  EXPECT_EQ(record.runs.size(), 4u);
  EXPECT_EQ(record.stopping.value().reason, "the check was ended before its time");
}

TEST(CheckConductor, RecordsThatACheckWasStoppedBeforeItMoved) {
  Bench bench(plant(1), WorkerMode::Synchronous);
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.begin(1));
  bench.core.requests().stop(bench.now_ns);
  const CheckRecord record = bench.finish();
  EXPECT_EQ(record.verdict, Verdict::Aborted);
  EXPECT_THAT(record.reason, HasSubstr("nothing moved"));
  EXPECT_EQ(record.timing.ticks, 0U);
  EXPECT_EQ(bench.core.status().state.load(), StationState::Idle);
}

TEST(CheckConductor, GivesMoreRepeatsMoreTime) {
  Bench bench(plant(1), WorkerMode::Synchronous, nullptr, with_deadline(15.0));
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.begin(40));
  const CheckRecord record = bench.finish();
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  EXPECT_EQ(record.runs.size(), 40U);
  EXPECT_GT(record.duration_s, 15.0) << "or this proves nothing";
}

TEST(CheckConductor, SaysThatTheDeadlineEndedACheck) {
  Bench bench(plant(1), WorkerMode::Synchronous, nullptr, with_deadline(4.0));
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.begin(20));
  const CheckRecord record = bench.finish();
  EXPECT_EQ(record.verdict, Verdict::Timeout);
  EXPECT_EQ(exit_code(record.verdict), 5);
  EXPECT_EQ(record.fault, FaultCause::DeadlinePassed);
  EXPECT_THAT(record.reason, HasSubstr("before its deadline"));
}

TEST(CheckConductor, SaysThatTheStationWasToldToEnd) {
  Bench bench(plant(1), WorkerMode::Synchronous);
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.begin(20));
  for (int i = 0; i < 3'000; ++i) {
    bench.advance();
    ASSERT_FALSE(bench.pump());
  }
  bench.core.shutdown(bench.now_ns);
  const std::optional<CheckRecord> record = bench.pump();
  ASSERT_TRUE(record);
  EXPECT_EQ(record->verdict, Verdict::Aborted);
  EXPECT_EQ(record->fault, FaultCause::StationEnded);
  EXPECT_THAT(record->reason, HasSubstr("stopped or restarted"));
}

TEST(PreparedStation, IsRefusedWhereItsRepeatsCannotEndInTime) {
  StationConfiguration configuration;
  configuration.check.repeats = 200;
  configuration.check.repeats_auto = false;
  const Result<PreparedStation> station = prepare_station(configuration);
  ASSERT_FALSE(station);
  EXPECT_THAT(station.error().message, HasSubstr("check.deadline_s = 60 is too short for 200 repeats"));
}

/// Stopped at the top of a run.
void clamp(Bench& bench) {
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.begin(2));
  while (bench.core.status().force_N < 15e3) {
    bench.advance();
    ASSERT_FALSE(bench.pump());
  }
  bench.core.requests().stop(bench.now_ns);
  EXPECT_EQ(bench.finish().verdict, Verdict::Aborted);
}

TEST(CheckConductor, OpensABrakeThatStayedClamped) {
  Bench bench(plant(1), WorkerMode::Synchronous);
  clamp(bench);
  EXPECT_GT(bench.core.status().force_N, 10e3);
  const auto open = [&] { return bench.conductor.open(bench.core.ticket(), {bench.now_ns, bench.now_ns}); };
  ASSERT_FALSE(open());
  EXPECT_THAT(open().error().message, HasSubstr("FAULT"));
  bench.core.requests().clear = true;
  bench.reach(StationState::Idle);
  ASSERT_TRUE(open());
  EXPECT_TRUE(bench.conductor.opening().under_way);
  EXPECT_THAT(bench.begin(1).error().message, HasSubstr("being opened"));
  while (bench.conductor.busy()) {
    bench.advance();
    ASSERT_FALSE(bench.pump()) << "an opening is no check";
  }
  EXPECT_EQ(bench.conductor.opening().verdict, Verdict::Pass) << bench.conductor.opening().reason;
  EXPECT_LT(std::abs(bench.core.status().force_N), 300.0);
  EXPECT_EQ(bench.core.status().state.load(), StationState::Idle);
  ASSERT_TRUE(bench.begin(1));
  EXPECT_EQ(bench.finish().verdict, Verdict::Pass);
}

TEST(CheckConductor, AnOpeningIsSupervisedAndStopped) {
  for (const bool by_stop : {true, false}) {
    Bench bench(plant(1), WorkerMode::Synchronous);
    clamp(bench);
    bench.core.requests().clear = true;
    bench.reach(StationState::Idle);
    ASSERT_TRUE(bench.conductor.open(bench.core.ticket(), {bench.now_ns, bench.now_ns}));
    bench.reach(StationState::Releasing);
    for (int i = 0; i < 50; ++i) bench.advance();
    if (by_stop)
      bench.core.requests().stop(bench.now_ns);
    else
      bench.core.requests().emergency_stop = true;
    bench.advance();
    EXPECT_EQ(bench.core.status().state.load(), StationState::Fault);
    EXPECT_FALSE(bench.pump());
    EXPECT_FALSE(bench.conductor.busy());
    EXPECT_EQ(bench.conductor.opening().verdict, Verdict::Aborted);
    EXPECT_THAT(bench.conductor.opening().reason, HasSubstr(by_stop ? "stopped by" : "Emergency"));
  }
}

class Recording : public ::testing::Test {
 protected:
  CheckStore open_store() {
    Result<CheckStore> store = CheckStore::open(database_, CheckStore::Access::ReadWrite, 60'000);
    EXPECT_TRUE(store) << store.error().message;
    return std::move(*store);
  }
  support::TemporaryDirectory folder_;
  const std::string database_ = folder_.path("checks.sqlite");
  const std::string journal_ = folder_.path("under-way");
};

using CheckConductorRecording = Recording;

TEST_F(CheckConductorRecording, ACheckThatTheStationDidNotFinishLeavesARecord) {
  CheckStore store = open_store();
  std::string id;
  {
    Bench bench(plant(1), WorkerMode::Background, &store);
    bench.conductor.journal_in(journal_);
    bench.reach(StationState::Idle);
    ASSERT_TRUE(bench.begin(2));
    id = bench.conductor.id();
    for (int i = 0; i < 2'000; ++i) bench.advance();
  }  // as if killed
  const CheckJournal journal(journal_);
  const auto recovered = journal.recover(store);
  ASSERT_TRUE(recovered) << recovered.error().message;
  ASSERT_TRUE(*recovered);
  const Result<CheckRecord> record = store.load(id);
  ASSERT_TRUE(record) << record.error().message;
  EXPECT_EQ(record->verdict, Verdict::Error);
  EXPECT_EQ(record->serial, "TEST-1");
  EXPECT_THAT(record->reason, HasSubstr("The station ended during the check"));
  EXPECT_EQ(record->repeats, 2U);
  EXPECT_FALSE(record->limits_sha256.empty());
  EXPECT_TRUE(record->simulated == prepared().configuration.simulated_brake);
  EXPECT_FALSE(journal.recover(store)->has_value()) << "once";
}

TEST_F(CheckConductorRecording, AFinishedCheckLeavesNothingBehind) {
  CheckStore store = open_store();
  std::optional<CheckRecord> record;
  {
    Bench bench(plant(1), WorkerMode::Background, &store);
    bench.conductor.journal_in(journal_);
    bench.reach(StationState::Idle);
    ASSERT_TRUE(bench.begin(1));
    record = bench.finish();
  }
  EXPECT_EQ(record->verdict, Verdict::Pass) << record->reason;
  EXPECT_FALSE(CheckJournal(journal_).recover(store)->has_value());
  EXPECT_EQ(store.list({})->size(), 1U);
}

TEST_F(CheckConductorRecording, AnEndBetweenSavingAndTheJournalLeavesOneRecord) {
  CheckStore store = open_store();
  CheckRecord record;
  record.id = "20261120T234107123Z-9f3a61c2";
  record.verdict = Verdict::Pass;
  ASSERT_TRUE(store.save(record));
  const CheckJournal journal(journal_);
  ASSERT_TRUE(journal.begin(record));
  EXPECT_FALSE(journal.recover(store)->has_value());
  EXPECT_EQ(store.load(record.id)->verdict, Verdict::Pass);
}

TEST_F(CheckConductorRecording, ADamagedJournalIsNamed) {
  CheckStore store = open_store();
  folder_.write("under-way", "{\"id\":");
  EXPECT_THAT(CheckJournal(journal_).recover(store).error().message, HasSubstr("under-way: is damaged"));
}

/// Another program holds the database, as a disk that stands still would: the ring is emptied all the same.
TEST_F(CheckConductorRecording, ADiskThatStandsStillHoldsUpNothingButItsRecord) {
  CheckStore store = open_store();
  Bench bench(plant(1), WorkerMode::Background, &store);
  bench.reach(StationState::Idle);
  ASSERT_TRUE(bench.begin(1));
  SQLite::Database other(database_, SQLite::OPEN_READWRITE);
  other.exec("BEGIN IMMEDIATE");
  ASSERT_TRUE(eventually([&] {
    for (int i = 0; i < 100; ++i) bench.advance();
    EXPECT_FALSE(bench.pump());
    return bench.conductor.saving();
  }));
  EXPECT_TRUE(bench.conductor.storage_problem().empty());
  for (int i = 0; i < 20'000; ++i) {
    bench.advance();
    ASSERT_FALSE(bench.pump()) << "what is not on record is not shown";
  }
  EXPECT_EQ(bench.core.status().ring_drops, 0U) << "more than the ring holds went by";
  EXPECT_TRUE(bench.conductor.concluding());
  EXPECT_THAT(bench.conductor.storage_problem(), HasSubstr("still being saved"));
  EXPECT_FALSE(bench.begin(1));
  other.exec("ROLLBACK");
  std::optional<CheckRecord> record;
  ASSERT_TRUE(eventually([&] {
    bench.advance();
    record = bench.pump();
    return record.has_value();
  }));
  EXPECT_EQ(record->verdict, Verdict::Pass) << record->reason;
  EXPECT_TRUE(bench.conductor.storage_problem().empty());
  EXPECT_TRUE(store.load(record->id));
}

}  // namespace
}  // namespace clampd::bench
