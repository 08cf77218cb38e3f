#include "clampd/reanalysis/worker.hpp"

#include <algorithm>
#include <atomic>
#include <mutex>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "clampd/reanalysis/population.hpp"
#include "reanalysis/archive_fixture.hpp"
#include "support/eventually.hpp"
#include "support/socket_relay.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::reanalysis {
namespace {

using support::checks_of_a_station;
using ::testing::HasSubstr;

class ArchiveWorkers : public support::Archive {
 protected:
  WorkerSummary run(const WorkerOptions& options) const {
    publish::WakeEvent wake;
    const Result<WorkerSummary> summary = work(options, wake);
    if (!summary) throw std::runtime_error(summary.error().message);
    return *summary;
  }
  std::vector<std::string> documents() const {
    return server->column("SELECT document FROM clampd.results ORDER BY check_id");
  }
};

/// The archive loses nothing that the verdict rests on: the same software says the same of the same runs.
TEST_F(ArchiveWorkers, FindWhatTheStationFound) {
  publish(checks_of_a_station());
  const std::int64_t job = submit(task());
  EXPECT_EQ(run(worker("one")).done, 4);
  const auto results = jobs().results(job);
  ASSERT_TRUE(results) << results.error().message;
  ASSERT_EQ(results->size(), 4U);
  bool has_failed_brake = false;
  for (std::size_t i = 0; i < 4; ++i) {
    const CheckRecord& check = checks_of_a_station()[i];
    const auto found = nlohmann::json::parse(results->at(i).document);
    EXPECT_EQ(found["record"], check.id);
    EXPECT_EQ(found["verdict"], to_string(check.verdict)) << found["reason"];
    EXPECT_EQ(found["marginal"], check.marginal);
    has_failed_brake = has_failed_brake || check.verdict == Verdict::Fail;
    ASSERT_EQ(found["parameters"].size(), check.parameters.size());
    for (std::size_t k = 0; k < check.parameters.size(); ++k) {
      EXPECT_EQ(found["parameters"][k]["value"], check.parameters[k].value) << check.parameters[k].name;
      EXPECT_NEAR(found["parameters"][k]["sd"], check.parameters[k].sd, 1e-12 * check.parameters[k].sd);
    }
    for (std::size_t k = 0; k < check.runs.size(); ++k)
      EXPECT_EQ(found["runs"][k]["sha256"], check.runs[k].checksum_sha256);
  }
  EXPECT_TRUE(has_failed_brake);
}

/// The rubbing brake is one of the same model: its friction explains it. What a diagnosis says does not depend on its time.
TEST_F(ArchiveWorkers, DiagnoseChecks) {
  publish(checks_of_a_station());
  Task diagnoses;
  diagnoses.kind = Task::Kind::Diagnose;
  submit(diagnoses, {.serials = {"EMB-0003"}});
  EXPECT_EQ(run(worker("one")).done, 1);
  const auto found = nlohmann::json::parse(documents().at(0));
  EXPECT_EQ(found["schema"], "clampd.archived_diagnosis/1");
  EXPECT_EQ(found["serial"], "EMB-0003");
  EXPECT_EQ(found["diagnosis"]["verdict"], "adequate");
  EXPECT_FALSE(found["diagnosis"].contains("wall_s"));
}

TEST_F(ArchiveWorkers, AskEachCheckAboutEveryEffect) {
  publish(checks_of_a_station());
  Task scores;
  scores.kind = Task::Kind::ScoreEffects;
  const std::int64_t job = submit(scores);
  EXPECT_EQ(run(worker("one")).done, 4);
  auto checks = jobs().scored(job);
  ASSERT_TRUE(checks) << checks.error().message;
  ASSERT_EQ(checks->size(), 4U);
  EXPECT_EQ(checks->at(2).serial, "EMB-0003");
  EXPECT_EQ(checks->at(2).station, "south");
  checks->push_back(checks->front());
  const auto population = population_of(*checks);
  ASSERT_TRUE(population) << population.error().message;
  EXPECT_EQ(population->repeated, 1) << "a brake counts once at each station";
  EXPECT_EQ(population->directions.size(), effects_with_strengths().size());
  EXPECT_EQ(population->table.score.rows(), 4);
  ASSERT_EQ(population->table.information.size(), 4U);
  for (const Eigen::MatrixXf& information : population->table.information) {
    EXPECT_EQ(information.cols(), static_cast<Eigen::Index>(population->table.directions.size()));
    EXPECT_GT(information(0, 0), 0.0F);
    EXPECT_EQ(information, information.transpose());
  }
  ASSERT_EQ(population->table.groups.size(), 3U);
  EXPECT_EQ(population->table.groups[2].name, "south");
  EXPECT_EQ(population->table.groups[2].checks, (std::vector<int>{2, 3}));
  for (const attribution::Direction& direction : population->table.directions)
    EXPECT_EQ(std::count_if(population->table.directions.begin(), population->table.directions.end(),
                            [&](const auto& other) { return other.name == direction.name; }),
              1)
        << direction.name;
}

TEST(ArchivedPopulation, IsOfOneVersionAndOfScoresOnly) {
  const auto error = [](const std::vector<std::string>& documents) {
    std::vector<ScoredCheck> checks;
    for (const std::string& document : documents) {
      const auto scores = parse_scores(document);
      if (!scores) return scores.error().message;
      checks.push_back({fmt::format("check-{}", checks.size()), fmt::format("EMB-{}", checks.size()), "north", "", "", *scores});
    }
    const auto population = population_of(checks);
    return population ? std::string("none") : population.error().message;
  };
  const auto of = [](const char* effect, const char* parameter) {
    return fmt::format(R"({{"schema":"clampd.effect_scores/2","scores":{{"directions":[{{"effect":"{}","parameter":"{}","at":[0]}}],"score":[1],"information":[[4]]}}}})",
                       effect, parameter);
  };
  EXPECT_EQ(error({of("backlash", "play")}), "none");
  EXPECT_THAT(error({of("backlash", "play"), of("force-lag", "time_constant")}), HasSubstr("check check-1: its result is of a version"));
  EXPECT_THAT(error({of("levitation", "height")}), HasSubstr("there is no effect levitation"));
  EXPECT_THAT(error({of("backlash", "colour")}), HasSubstr("has no colour"));
  EXPECT_THAT(error({R"({"schema":"clampd.reanalysis/1"})"}), HasSubstr("submit a job with --score-effects"));
  EXPECT_THAT(error({R"({"schema":"clampd.effect_scores/2","scores":{"score":[]}})"}), HasSubstr("cannot be read"));
  std::string without_row = of("backlash", "play");
  without_row.replace(without_row.find("[[4]]"), 5, "[[]]");
  EXPECT_THAT(error({without_row}), HasSubstr("is no triangle"));
  EXPECT_THAT(error({"{"}), HasSubstr("cannot be read"));
}

TEST_F(ArchiveWorkers, ShareTheTasksAndWriteTheSameTexts) {
  publish(checks_of_a_station());
  submit(task());
  EXPECT_EQ(run(worker("alone")).done, 4);
  const std::vector<std::string> alone = documents();
  ASSERT_EQ(alone.size(), 4U);
  ask("UPDATE clampd.queue SET result_id = NULL");
  ask("DELETE FROM clampd.results");

  submit(task());
  WorkerSummary first, second;
  std::thread other([&] { second = run(worker("second")); });
  first = run(worker("first"));
  other.join();
  EXPECT_EQ(first.done + second.done, 4);
  EXPECT_EQ(first.known + second.known, 0);
  EXPECT_EQ(first.lost + second.lost, 0);
  EXPECT_EQ(ask("SELECT max(attempts) FROM clampd.queue"), "1");
  EXPECT_EQ(documents(), alone);
}

TEST_F(ArchiveWorkers, ComputeNothingTwice) {
  publish(checks_of_a_station());
  submit(task());
  EXPECT_EQ(run(worker("one")).known, 0);
  submit(task());
  const WorkerSummary again = run(worker("two"));
  EXPECT_EQ(again.done, 4);
  EXPECT_EQ(again.known, 4);
  Task other = task();
  other.method = Method::PredictionError;
  submit(other);
  EXPECT_EQ(run(worker("three")).known, 0);
  EXPECT_EQ(ask("SELECT count(*) FROM clampd.results"), "8");
}

TEST_F(ArchiveWorkers, FailATaskWhoseRunsAreNotThoseOfTheCheckAndDoItOnceTheyAre) {
  publish(checks_of_a_station());
  const std::int64_t job = submit(task());
  const std::string sha256 = checks_of_a_station()[1].runs[2].checksum_sha256;
  ask("CREATE TABLE kept AS SELECT * FROM clampd.raw_runs WHERE sha256 = '" + sha256 + "'");
  ask("UPDATE clampd.raw_runs SET data = (SELECT data FROM clampd.raw_runs WHERE sha256 <> '" + sha256 +
      "' LIMIT 1) WHERE sha256 = '" + sha256 + "'");
  ask("DELETE FROM clampd.raw_runs WHERE sha256 = '" + checks_of_a_station()[3].runs[0].checksum_sha256 +
      "'");
  const WorkerSummary summary = run(worker("one"));
  EXPECT_EQ(summary.done, 2);
  EXPECT_EQ(summary.failed, 2);
  EXPECT_EQ(states(), "done failed done failed");
  EXPECT_THAT(ask("SELECT reason FROM clampd.queue WHERE state = 'failed' ORDER BY check_id LIMIT 1"),
              HasSubstr("not those of the check"));
  EXPECT_THAT(ask("SELECT reason FROM clampd.queue WHERE state = 'failed' ORDER BY check_id DESC LIMIT 1"),
              HasSubstr("are not in the database"));
  const auto status = jobs().status(job);
  ASSERT_TRUE(status);
  EXPECT_EQ(status->failures.size(), 2U);

  ask("UPDATE clampd.raw_runs w SET data = k.data FROM kept k WHERE w.sha256 = k.sha256");
  EXPECT_EQ(jobs().retry(job).value_or(-1), 2);
  run(worker("two"));
  EXPECT_EQ(states(), "done done done failed");
}

TEST_F(ArchiveWorkers, WaitForAServerThatIsAway) {
  publish(checks_of_a_station());
  submit(task());
  server->stop();
  std::mutex mutex;
  std::string said;
  WorkerOptions options = worker("patient");
  options.say = [&](const std::string& words) {
    const std::lock_guard lock(mutex);
    said += words + "\n";
  };
  WorkerSummary summary;
  std::thread thread([&] { summary = run(options); });
  EXPECT_TRUE(support::eventually([&] {
    const std::lock_guard lock(mutex);
    return said.find("trying again in") != std::string::npos;
  }));
  server->start();
  thread.join();
  EXPECT_EQ(summary.done, 4);
  EXPECT_THAT(said, HasSubstr("no connection"));
  EXPECT_THAT(said, HasSubstr("connected\n"));
}

// Between the work and its result: while the lease lasts, the work is not lost.
TEST_F(ArchiveWorkers, WriteTheirResultOnceAServerThatWentAwayIsBack) {
  publish(checks_of_a_station());
  submit(task());
  const support::TemporaryDirectory network;
  support::SocketRelay relay(network.path("."), server->host());
  relay.cut_at("clock_timestamp() FOR UPDATE");
  WorkerOptions options = worker("patient");
  options.database.host = network.path(".");
  std::atomic<int> tries{0};
  options.say = [&](const std::string& words) {
    if (relay.is_cut() && words.find("trying again in") != std::string::npos && ++tries == 3) relay.mend();
  };
  const WorkerSummary summary = run(options);
  EXPECT_GE(tries, 3);
  EXPECT_EQ(summary.done, 4);
  EXPECT_EQ(summary.lost, 0);
  EXPECT_EQ(ask("SELECT sum(attempts) FROM clampd.queue"), "4") << "nothing is done twice";
}

TEST_F(ArchiveWorkers, RefuseAnOlderAndANewerSchema) {
  publish(checks_of_a_station());
  submit(task());
  publish::WakeEvent wake;
  const auto refusal = [&] {
    const Result<WorkerSummary> summary = work(worker("one"), wake);
    return summary ? std::string("none") : summary.error().message;
  };
  ask("INSERT INTO clampd.migrations (version) VALUES (8)");
  EXPECT_THAT(refusal(), HasSubstr("its schema is 8, newer than the 7"));
  const auto newer = Jobs::open(settings(), true);
  ASSERT_FALSE(newer);
  EXPECT_THAT(newer.error().message, HasSubstr("install the newer version here"));
  ask("DELETE FROM clampd.migrations WHERE version >= 7");
  EXPECT_THAT(refusal(), HasSubstr("its schema is 6, and this version"));
  const auto older = Jobs::open(settings(), false);
  ASSERT_FALSE(older);
  EXPECT_THAT(older.error().message, HasSubstr("needs 7"));
  EXPECT_EQ(states(), "waiting waiting waiting waiting");
}

TEST_F(ArchiveWorkers, NeedNoMoreRightsThanTheySay) {
  publish(checks_of_a_station());
  submit(task());
  server->column("CREATE ROLE helper LOGIN");
  WorkerOptions options = worker("helper");
  options.database.user = "helper";
  publish::WakeEvent wake;
  const auto refusal = [&] {
    const Result<WorkerSummary> summary = work(options, wake);
    return summary ? std::string("none") : summary.error().message;
  };
  EXPECT_THAT(refusal(), HasSubstr("USAGE on schema clampd"));
  ask("GRANT USAGE ON SCHEMA clampd TO helper");
  ask("GRANT SELECT ON ALL TABLES IN SCHEMA clampd TO helper");
  EXPECT_THAT(refusal(), HasSubstr("UPDATE on clampd.queue"));
  ask("GRANT INSERT ON clampd.results TO helper");
  ask("GRANT UPDATE ON clampd.queue TO helper");
  EXPECT_EQ(run(options).done, 4);
}

}  // namespace
}  // namespace clampd::reanalysis
