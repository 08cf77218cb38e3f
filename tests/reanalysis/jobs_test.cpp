#include "clampd/reanalysis/jobs.hpp"

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "reanalysis/archive_fixture.hpp"

namespace clampd::reanalysis {
namespace {

using support::checks_of_a_station;
using ::testing::HasSubstr;

class ArchiveJobs : public support::Archive {
 protected:
  void SetUp() override {
    Archive::SetUp();
    if (!IsSkipped()) publish(checks_of_a_station());
  }
  std::string chosen(const Selection& selection) const {
    const auto job = jobs().submit("", task(), selection);
    if (!job) return job.error().message;
    return ask(
        "SELECT string_agg(right(serial, 1), '' ORDER BY check_id) FROM clampd.queue JOIN clampd.checks c ON "
        "c.id = check_id WHERE job_id = " +
        std::to_string(job->id));
  }
};

TEST_F(ArchiveJobs, AreOfTheChecksThatWereChosen) {
  EXPECT_EQ(chosen({}), "1234");
  EXPECT_EQ(chosen({.serials = {"EMB-0003", "EMB-0001", "none"}}), "13");
  EXPECT_EQ(chosen({.station = "south"}), "34");
  EXPECT_EQ(chosen({.since = "2026-11-22"}), "234");
  EXPECT_EQ(chosen({.since = "2026-11-22T08:00:00.001Z"}), "34");
  EXPECT_EQ(chosen({.until = "2026-11-22"}), "12");
  EXPECT_EQ(chosen({.serials = {"EMB-0001", "EMB-0002"}, .station = "north", .since = "2026-11-22"}), "2");
  EXPECT_EQ(chosen({.serials = {"O'Brien \\\""}}), "");
}

TEST_F(ArchiveJobs, LeaveOutChecksWhoseRunsAreNotThere) {
  ask("DELETE FROM clampd.raw_runs WHERE sha256 = '" + checks_of_a_station()[2].runs[4].checksum_sha256 +
      "'");
  const auto job = jobs().submit("", task(), {});
  ASSERT_TRUE(job) << job.error().message;
  EXPECT_EQ(job->tasks, 3);
  EXPECT_EQ(job->without_runs, 1);
  const auto none = jobs().submit("", task(), {.serials = {"EMB-0003"}});
  ASSERT_TRUE(none);
  EXPECT_EQ(none->tasks, 0);
  EXPECT_EQ(none->id, 0) << "nothing to do makes no job";
  EXPECT_EQ(ask("SELECT count(*) FROM clampd.jobs"), "1");
}

TEST_F(ArchiveJobs, TellHowFarTheyAre) {
  const std::int64_t job = submit(task());
  ask("UPDATE clampd.queue SET state = 'done', claimed = clock_timestamp() - interval '100 s', finished = "
      "clock_timestamp() WHERE id = (SELECT min(id) FROM clampd.queue)");
  ask("UPDATE clampd.queue SET state = 'failed', reason = 'check ' || check_id || ': broken' WHERE check_id "
      "IN (SELECT "
      "check_id FROM clampd.queue ORDER BY id OFFSET 1 LIMIT 2)");
  const auto status = jobs().status(job);
  ASSERT_TRUE(status) << status.error().message;
  EXPECT_EQ(status->all(), 4);
  EXPECT_EQ(status->done, 1);
  EXPECT_EQ(status->failed, 2);
  EXPECT_EQ(status->waiting, 1);
  EXPECT_NEAR(status->done_per_s, 0.01, 0.005);
  ASSERT_TRUE(status->left_s);
  EXPECT_GE(*status->left_s, 100.0);
  EXPECT_FALSE(status->end.empty());
  ASSERT_EQ(status->failures.size(), 1U);
  EXPECT_EQ(status->failures[0].second, 2);
  const auto list = jobs().list();
  ASSERT_TRUE(list);
  EXPECT_EQ(list->size(), 1U);
}

TEST_F(ArchiveJobs, AreNamedByTheirNumberOrAsTheLast) {
  EXPECT_THAT(jobs().find("last").error().message, HasSubstr("there is no job yet"));
  const std::int64_t first = submit(task());
  const std::int64_t second = submit(task());
  EXPECT_EQ(jobs().find("last").value_or(0), second);
  EXPECT_EQ(jobs().find(std::to_string(first)).value_or(0), first);
  EXPECT_THAT(jobs().find("77").error().message, HasSubstr("there is no job 77"));
  for (const char* odd : {"", "-1", "one", "1; DROP", "99999999999999999999"})
    EXPECT_THAT(jobs().find(odd).error().message, HasSubstr("is no job"));
}

}  // namespace
}  // namespace clampd::reanalysis
