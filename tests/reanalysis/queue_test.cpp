// Claims by hand, and the server's clock by the table: nothing here waits for time to pass.

#include "src/reanalysis/queue.hpp"

#include <gmock/gmock.h>
#include <pqxx/pqxx>

#include "reanalysis/archive_fixture.hpp"

namespace clampd::reanalysis {
namespace {

using namespace std::chrono_literals;
using support::checks_of_a_station;
using ::testing::HasSubstr;

class ArchiveQueue : public support::Archive {
 protected:
  void SetUp() override {
    Archive::SetUp();
    if (IsSkipped()) return;
    publish({checks_of_a_station().front()});
    job = submit(task());
    for (std::unique_ptr<Queue>* queue : {&mine, &other}) {
      *queue = std::make_unique<Queue>(settings());
      ASSERT_TRUE((*queue)->open(wake));
    }
  }
  Claim claimed_by(Queue& queue, const std::string& worker) const {
    const auto claim = queue.claim(worker, 60s);
    if (!claim || !*claim) throw std::runtime_error("nothing to claim");
    return **claim;
  }
  void let_the_lease_end() const {
    ask("UPDATE clampd.queue SET lease_until = clock_timestamp() - interval '1 microsecond'");
  }
  /// Everything that a writer may change.
  std::string queue_and_results() const {
    return ask(
        "SELECT (SELECT json_agg(q) FROM clampd.queue q)::text || (SELECT json_agg(r) FROM clampd.results "
        "r)::text");
  }

  publish::WakeEvent wake;
  std::int64_t job = 0;
  std::unique_ptr<Queue> mine, other;
};

TEST_F(ArchiveQueue, GivesATaskToOneWorkerOnly) {
  const Claim claim = claimed_by(*mine, "mine");
  EXPECT_EQ(claim.job, job);
  EXPECT_EQ(claim.check, checks_of_a_station().front().id);
  const auto nothing = other->claim("other", 60s);
  ASSERT_TRUE(nothing) << nothing.error().message;
  EXPECT_FALSE(nothing->has_value());
  EXPECT_EQ(other->open_tasks().value_or(OpenTasks{-1, -1}).claimed, 1);
}

TEST_F(ArchiveQueue, PassesByARowThatAnotherIsJustClaiming) {
  pqxx::connection server_connection(server->connection());
  pqxx::work transaction(server_connection);
  transaction.exec("SELECT 1 FROM clampd.queue FOR UPDATE");
  const auto nothing = mine->claim("mine", 60s);
  ASSERT_TRUE(nothing) << nothing.error().message;
  EXPECT_FALSE(nothing->has_value());
}

TEST_F(ArchiveQueue, ALateWriterChangesNothing) {
  const Claim late = claimed_by(*mine, "mine");
  let_the_lease_end();
  std::string before = queue_and_results();
  for (const Result<Written>& written : {mine->finish(late, "late", "mine"), mine->fail(late, "late"),
                                         mine->give_back(late), mine->renew(late, 60s)}) {
    ASSERT_TRUE(written) << written.error().message;
    EXPECT_EQ(*written, Written::Lost);
  }
  EXPECT_EQ(queue_and_results(), before);
  EXPECT_EQ(ask("SELECT count(*) FROM clampd.results"), "0");

  // Another one has it now, and then has done it.
  const Claim next = claimed_by(*other, "other");
  EXPECT_EQ(next.id, late.id);
  EXPECT_NE(next.token, late.token);
  EXPECT_EQ(mine->finish(late, "late", "mine").value_or(Written::Yes), Written::Lost);
  EXPECT_EQ(ask("SELECT worker || state FROM clampd.queue"), "otherclaimed");
  EXPECT_EQ(other->finish(next, "in time", "other").value_or(Written::Lost), Written::Yes);
  before = queue_and_results();
  EXPECT_EQ(mine->finish(late, "late", "mine").value_or(Written::Yes), Written::Lost);
  EXPECT_EQ(queue_and_results(), before);
  EXPECT_EQ(ask("SELECT document FROM clampd.results"), "in time");
}

TEST_F(ArchiveQueue, ARenewedLeaseLasts) {
  const Claim claim = claimed_by(*mine, "mine");
  ask("UPDATE clampd.queue SET lease_until = clock_timestamp() + interval '20 s'");
  EXPECT_EQ(mine->renew(claim, 600s).value_or(Written::Lost), Written::Yes);
  EXPECT_EQ(ask("SELECT lease_until > clock_timestamp() + interval '300 s' FROM clampd.queue"), "t");
}

TEST_F(ArchiveQueue, ALostAnswerToACommitIsNoLostTask) {
  const Claim claim = claimed_by(*mine, "mine");
  EXPECT_EQ(mine->finish(claim, "text", "mine").value_or(Written::Lost), Written::Yes);
  EXPECT_EQ(mine->finish(claim, "text", "mine").value_or(Written::Lost), Written::Yes);
  EXPECT_EQ(ask("SELECT count(*) FROM clampd.results"), "1");
}

TEST_F(ArchiveQueue, WhatKillsItsWorkersIsGivenUp) {
  for (int attempt = 0; attempt < Queue::kMostAttempts; ++attempt) {
    claimed_by(*mine, "mine");
    let_the_lease_end();
  }
  const auto nothing = mine->claim("mine", 60s);
  ASSERT_TRUE(nothing);
  EXPECT_FALSE(nothing->has_value());
  EXPECT_EQ(states(), "failed");
  EXPECT_THAT(ask("SELECT reason FROM clampd.queue"), HasSubstr("5 workers began with it"));
  EXPECT_EQ(jobs().retry(job).value_or(-1), 1);
  claimed_by(*mine, "mine");
}

TEST_F(ArchiveQueue, WhatKilledItsWorkersHoldsUpNobodyWhileItIsLocked) {
  for (int attempt = 0; attempt < Queue::kMostAttempts; ++attempt) {
    claimed_by(*mine, "mine");
    let_the_lease_end();
  }
  const std::int64_t second = submit(task());
  pqxx::connection cut_off(server->connection());
  pqxx::work transaction(cut_off);
  transaction.exec_params("SELECT 1 FROM clampd.queue WHERE job_id = $1 FOR UPDATE", job);
  EXPECT_EQ(claimed_by(*mine, "mine").job, second);
  transaction.abort();
  EXPECT_FALSE(mine->claim("mine", 60s).value().has_value());
  EXPECT_EQ(ask(fmt::format("SELECT state FROM clampd.queue WHERE job_id = {}", job)), "failed");
}

TEST_F(ArchiveQueue, WhatIsGivenBackIsThereForTheNext) {
  for (int i = 0; i < 2 * Queue::kMostAttempts; ++i) {
    const Claim claim = claimed_by(*mine, "mine");
    EXPECT_EQ(mine->give_back(claim).value_or(Written::Lost), Written::Yes);
  }
  claimed_by(*other, "other");
}

TEST_F(ArchiveQueue, ACancelledTaskTakesNoResultUntilItIsTriedAgain) {
  const Claim claim = claimed_by(*mine, "mine");
  EXPECT_EQ(jobs().cancel(job).value_or(-1), 1);
  EXPECT_EQ(mine->renew(claim, 60s).value_or(Written::Yes), Written::Lost);
  EXPECT_EQ(mine->finish(claim, "text", "mine").value_or(Written::Yes), Written::Lost);
  EXPECT_EQ(states(), "cancelled");
  EXPECT_EQ(ask("SELECT count(*) FROM clampd.results"), "0");
  EXPECT_EQ(other->open_tasks().value_or(OpenTasks{-1, -1}).claimed, 0);
  EXPECT_EQ(jobs().retry(job).value_or(-1), 1);
  const Claim again = claimed_by(*other, "other");
  EXPECT_EQ(mine->finish(claim, "text", "mine").value_or(Written::Yes), Written::Lost);
  EXPECT_EQ(other->finish(again, "text", "other").value_or(Written::Lost), Written::Yes);
  EXPECT_EQ(jobs().cancel(job).value_or(-1), 0) << "what is done stays done";
}

TEST_F(ArchiveQueue, AResultIsNeverOverwritten) {
  const Claim first = claimed_by(*mine, "mine");
  ASSERT_EQ(mine->finish(first, "one", "mine").value_or(Written::Lost), Written::Yes);
  submit(task());
  const Claim second = claimed_by(*other, "other");
  EXPECT_EQ(other->finish(second, "another", "other").value_or(Written::Lost), Written::Yes);
  EXPECT_EQ(ask("SELECT string_agg(document, ' ') FROM clampd.results"), "one");
  EXPECT_THAT(ask("SELECT reason FROM clampd.queue WHERE state = 'failed'"),
              HasSubstr("says something else"));
  EXPECT_THROW(ask("UPDATE clampd.results SET document = 'two'"), std::exception);
}

}  // namespace
}  // namespace clampd::reanalysis
