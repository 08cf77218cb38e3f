#include <algorithm>
#include <csignal>
#include <future>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <pqxx/pqxx>

#include "clampd/http/client.hpp"
#include "clampd/record/file.hpp"
#include "reanalysis/archive_fixture.hpp"
#include "support/command.hpp"
#include "support/eventually.hpp"
#include "support/network.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::reanalysis {
namespace {

using support::checks_of_a_station;
using support::eventually;
using ::testing::HasSubstr;

class ArchivePrograms : public support::Archive {
 protected:
  void SetUp() override {
    Archive::SetUp();
    if (IsSkipped()) return;
    publish(checks_of_a_station());
    config = folder.write(
        "station.toml",
        support::Database::section(server->host()));
    // Servers, and the workers that are killed, run as another user where the test is root.
    support::give_to_server(folder.path("."));
  }
  support::Outcome clampctl(const std::string& words) const {
    return support::run_command(fmt::format("{} --config {} archive {}", CLAMPCTL, config, words));
  }
  support::Outcome worker_until_empty() const {
    return support::run_command(
        fmt::format("{} --config {} --until-empty --name second", CLAMPD_WORKER, config));
  }
  /// A worker that has claimed a task and cannot read its runs before `held` is over.
  void start_held_worker(support::ServerProcess& process) const {
    process.start({CLAMPD_WORKER, "--config", config, "--name", "first"}, folder.path("worker.log"));
    ASSERT_TRUE(eventually([&] { return states().find("claimed") != std::string::npos; }))
        << folder.read("worker.log");
  }

  support::TemporaryDirectory folder;
  std::string config;
};

TEST_F(ArchivePrograms, TheTaskOfAKilledWorkerIsDoneByAnother) {
  submit(task());
  {
    pqxx::connection holder(server->connection());
    pqxx::work held(holder);
    held.exec("LOCK TABLE clampd.raw_runs IN ACCESS EXCLUSIVE MODE");
    support::ServerProcess first;
    start_held_worker(first);
    first.end(SIGKILL);
  }
  EXPECT_EQ(ask("SELECT worker FROM clampd.queue WHERE state = 'claimed'"), "first");
  EXPECT_EQ(ask("SELECT lease_until > clock_timestamp() FROM clampd.queue WHERE state = 'claimed'"), "t");
  ask("UPDATE clampd.queue SET lease_until = clock_timestamp() WHERE state = 'claimed'");
  const support::Outcome outcome = worker_until_empty();
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("4 done (0 of them known before), 0 failed, 0 lost"));
  EXPECT_EQ(states(), "done done done done");
  EXPECT_EQ(ask("SELECT string_agg(attempts::text, '' ORDER BY attempts) FROM clampd.queue"), "1112");
  EXPECT_EQ(ask("SELECT count(*) FROM clampd.results"), "4");
}

TEST_F(ArchivePrograms, AWorkerSaysWhatItDoes) {
  submit(task());
  const int port = support::free_port();
  const auto scraped = [&](const std::string& line) {
    http::Call call;
    call.path = "/metrics";
    const auto answer = http::exchange("127.0.0.1", port, call);
    return answer && answer->body.find("\n" + line + "\n") != std::string::npos;
  };
  support::ServerProcess worker;
  {
    pqxx::connection holder(server->connection());
    pqxx::work held(holder);
    held.exec("LOCK TABLE clampd.raw_runs IN ACCESS EXCLUSIVE MODE");
    worker.start({CLAMPD_WORKER, "--config", config, "--name", "say \"me\"", "--serve",
                  fmt::format("127.0.0.1:{}", port)},
                 folder.path("worker.log"));
    EXPECT_TRUE(eventually([&] { return scraped("clampd_worker_connected 1"); }))
        << folder.read("worker.log");
    EXPECT_TRUE(scraped("clampd_queue_tasks{state=\"waiting\"} 4"));
    EXPECT_TRUE(scraped("clampd_worker_tasks_total{result=\"done\"} 0"));
  }
  EXPECT_TRUE(eventually([&] { return scraped("clampd_worker_tasks_total{result=\"done\"} 4"); }));
  const support::Outcome second = support::run_command(
      fmt::format("{} --config {} --until-empty --metrics 127.0.0.1:{}", CLAMPD_WORKER, config, port));
  EXPECT_EQ(second.exit_code, 2);
  EXPECT_THAT(second.output, HasSubstr(fmt::format("--serve 127.0.0.1:{}: ", port)));
  for (const char* wrong : {"8372", ":8372", "127.0.0.1:", "127.0.0.1:99999", "127.0.0.1:83x"})
    EXPECT_THAT(support::run_command(
                    fmt::format("{} --config {} --until-empty --metrics {}", CLAMPD_WORKER, config, wrong))
                    .output,
                HasSubstr("give an address and a port"));
  EXPECT_EQ(worker.end(SIGTERM), 0);
}

TEST_F(ArchivePrograms, AWorkerAnswersWhileTheDatabaseKeepsThePageOfTheLineWaiting) {
  ask("UPDATE clampd.checks SET started = started + (clock_timestamp() - (SELECT max(started) FROM clampd.checks))");
  const int port = support::free_port();
  support::ServerProcess worker;
  worker.start({CLAMPD_WORKER, "--config", config, "--name", "page", "--serve", fmt::format("127.0.0.1:{}", port)},
               folder.path("worker.log"));
  const auto answer = [port](const std::string& path) {
    http::Call call{"GET", path};
    call.answer_within = std::chrono::seconds(60);
    return http::exchange("127.0.0.1", port, call).value_or(http::Answer{});
  };
  ASSERT_TRUE(eventually([&] {
    return answer("/metrics").body.find("\nclampd_worker_connected 1\n") != std::string::npos;
  })) << folder.read("worker.log");
  std::future<http::Answer> document;
  {
    pqxx::connection holder(server->connection());
    pqxx::work held(holder);
    held.exec("LOCK TABLE clampd.checks IN ACCESS EXCLUSIVE MODE");
    document = std::async(std::launch::async, [&] { return answer("/line.json?days=90"); });
    EXPECT_TRUE(eventually([&] {
      return ask("SELECT count(*) FROM pg_stat_activity WHERE wait_event_type = 'Lock'") == "1";
    }));
    EXPECT_THAT(answer("/metrics").body, HasSubstr("clampd_worker_connected 1"));
    EXPECT_THAT(answer("/").body, HasSubstr("<title>clampd line</title>"));
    EXPECT_EQ(document.wait_for(std::chrono::seconds(0)), std::future_status::timeout);
  }
  const http::Answer page = document.get();
  ASSERT_EQ(page.status, 200) << page.body;
  const auto line = nlohmann::json::parse(page.body);
  EXPECT_EQ(line["schema"], "clampd.line_page/1");
  EXPECT_EQ(line["worker"], "page");
  EXPECT_EQ(line["checks"], 4);
  EXPECT_EQ(line["stations"][1]["station"], "south");
  EXPECT_EQ(answer("/line.json?days=31").status, 400);
  EXPECT_EQ(answer("/line.json?part_number=" + std::string(201, 'x')).status, 400);
  EXPECT_EQ(answer("/lines").status, 404);
  ask("ALTER TABLE clampd.parameters RENAME TO elsewhere");
  const http::Answer refused = answer("/line.json?days=1");
  EXPECT_EQ(refused.status, 503);
  EXPECT_THAT(nlohmann::json::parse(refused.body)["error"], HasSubstr("clampd.parameters"));
  EXPECT_EQ(worker.end(SIGTERM), 0);
}

TEST_F(ArchivePrograms, AStoppedWorkerGivesItsTaskBack) {
  submit(task());
  support::ServerProcess first;
  {
    pqxx::connection holder(server->connection());
    pqxx::work held(holder);
    held.exec("LOCK TABLE clampd.raw_runs IN ACCESS EXCLUSIVE MODE");
    start_held_worker(first);
    first.signal(SIGTERM);
  }
  first.end(0);
  EXPECT_THAT(folder.read("worker.log"),
              HasSubstr("0 done (0 of them known before), 0 failed, 0 lost, 1 given back"));
  EXPECT_EQ(states(), "waiting waiting waiting waiting");
  EXPECT_EQ(ask("SELECT max(attempts) FROM clampd.queue"), "0");
}

TEST_F(ArchivePrograms, AJobFromItsSubmissionToWhatChanged) {
  // Limits that the brake that rubs keeps too.
  std::string text = support::shipped_limits().contents;
  const std::string narrow = "TC  = {lower = 0.50, upper = 2.00}";
  const std::string::size_type place = text.find(narrow);
  ASSERT_NE(place, std::string::npos);
  text.replace(place, narrow.size(), "TC  = {lower = 0.50, upper = 4.00}");
  const std::string limits = folder.write("wide.toml", text);

  support::Outcome said = clampctl("submit --json --name wider --limits " + limits);
  ASSERT_EQ(said.exit_code, 0) << said.output;
  EXPECT_EQ(nlohmann::json::parse(said.output)["tasks"], 4);
  EXPECT_EQ(worker_until_empty().exit_code, 0);

  said = clampctl("status last --json");
  ASSERT_EQ(said.exit_code, 0) << said.output;
  EXPECT_EQ(nlohmann::json::parse(said.output)["jobs"][0]["done"], 4);
  EXPECT_THAT(clampctl("status").output, HasSubstr("(wider): 4 of 4 done"));

  said = clampctl("results last --json");
  ASSERT_EQ(said.exit_code, 0) << said.output;
  const auto results = nlohmann::json::parse(said.output)["results"];
  ASSERT_EQ(results.size(), 4U);
  EXPECT_EQ(results[0]["result"]["serial"], "EMB-0001");
  said = clampctl("results last --csv -");
  EXPECT_EQ(std::count(said.output.begin(), said.output.end(), '\n'), 5) << said.output;
  EXPECT_THAT(said.output, HasSubstr("k2 (N/rad^2),k2 sd (N/rad^2)"));

  said = clampctl("compare last --json");
  ASSERT_EQ(said.exit_code, 0) << said.output;
  const auto comparison = nlohmann::json::parse(said.output);
  EXPECT_EQ(comparison["checks"], 4);
  ASSERT_EQ(comparison["verdicts_changed"].size(), 1U) << said.output;
  EXPECT_EQ(comparison["verdicts_changed"][0]["serial"], "EMB-0003");
  EXPECT_EQ(comparison["verdicts_changed"][0]["before"], "FAIL");
  EXPECT_EQ(comparison["verdicts_changed"][0]["after"], "PASS");
  for (const auto& parameter : comparison["parameters"]) EXPECT_EQ(parameter["largest"], 0.0) << parameter;

  said = clampctl("submit --method pem --serial EMB-0001 --serial EMB-0002");
  EXPECT_THAT(said.output, HasSubstr("job 2: 2 checks"));
  EXPECT_THAT(clampctl("cancel 2").output, HasSubstr("job 2: 2 tasks cancelled"));
  EXPECT_EQ(worker_until_empty().exit_code, 0);
  EXPECT_EQ(ask("SELECT count(*) FROM clampd.results"), "4");
  EXPECT_THAT(clampctl("retry 2").output, HasSubstr("job 2: 2 tasks wait again"));
  EXPECT_EQ(worker_until_empty().exit_code, 0);
  const auto other = nlohmann::json::parse(clampctl("compare 2 --with 1 --json").output);
  EXPECT_EQ(other["checks"], 2);
  EXPECT_EQ(other["parameters"].size(), 7U);
  EXPECT_NE(other["parameters"][0]["largest"], 0.0) << "two methods";
}

TEST_F(ArchivePrograms, AJobWithASheetAndOneWithAnotherLimitInIt) {
  const std::string shipped = CLAMPD_SOURCE_DIR "/configs/sheet.toml";
  std::string text = read_file(shipped).value();
  text.replace(text.find("upper = 1.40"), 12, "upper = 0.10");
  const std::string stricter = folder.write("stricter.toml", text);
  ASSERT_EQ(clampctl("submit --serial EMB-0001 --sheet " + shipped).exit_code, 0);
  ASSERT_EQ(clampctl("submit --serial EMB-0001 --sheet " + stricter).exit_code, 0);
  EXPECT_EQ(worker_until_empty().exit_code, 0);
  const auto results = nlohmann::json::parse(clampctl("results 1 --json").output)["results"];
  EXPECT_EQ(results[0]["result"]["sheet"]["characteristics"].size(), 11U);
  EXPECT_THAT(clampctl("compare 2 --with 1").output,
              HasSubstr("EMB-0001         hysteresis at force_N 15000, speed_rad_s 20: pass -> fail\n"));
  const auto comparison = nlohmann::json::parse(clampctl("compare 2 --with 1 --json").output);
  ASSERT_EQ(comparison["sheet_lines_changed"].size(), 1U);
  EXPECT_EQ(comparison["sheet_lines_changed"][0]["after"], "fail");
  EXPECT_EQ(comparison["verdicts_changed"][0]["after"], "FAIL");
  EXPECT_EQ(comparison["other_guard_bands"], 0);
  EXPECT_EQ(comparison["unknown_stopping"], 0);
  EXPECT_EQ(nlohmann::json::parse(clampctl("compare 1 --json").output)["sheet_lines_changed"].size(), 0U)
      << "no line was judged before";
  EXPECT_EQ(clampctl("submit --diagnose --sheet " + shipped).exit_code, 2);
  EXPECT_EQ(clampctl("submit --model x.toml --sheet " + shipped).exit_code, 2);
  EXPECT_THAT(clampctl("submit --sheet " + folder.write("odd.toml", "revision = 3")).output, HasSubstr("odd.toml"));
}

TEST_F(ArchivePrograms, AJobOfScoresIsReadAsAPopulation) {
  support::Outcome said = clampctl("submit --score-effects --json");
  ASSERT_EQ(said.exit_code, 0) << said.output;
  said = clampctl("population last");
  EXPECT_EQ(said.exit_code, 2);
  EXPECT_THAT(said.output, HasSubstr("no check is done yet"));
  EXPECT_EQ(worker_until_empty().exit_code, 0);
  said = clampctl("population last --json");
  ASSERT_EQ(said.exit_code, 0) << said.output;
  const auto found = nlohmann::json::parse(said.output);
  EXPECT_EQ(found["schema"], "clampd.population/2");
  EXPECT_EQ(found["checks"], 4);
  EXPECT_TRUE(found["findings"].empty()) << "four checks tell nothing";
  EXPECT_THAT(clampctl("population last").output, HasSubstr("Neither the line nor any station"));
  EXPECT_THAT(clampctl("results last").output, HasSubstr("EMB-0002"));
  said = clampctl("compare last");
  EXPECT_EQ(said.exit_code, 2);
  EXPECT_THAT(said.output, HasSubstr("identifies no parameters"));
  EXPECT_EQ(clampctl("submit --score-effects --diagnose").exit_code, 2);
  EXPECT_EQ(clampctl("submit --diagnose --limits x.toml").exit_code, 2);
}

TEST_F(ArchivePrograms, SayWhatIsWrong) {
  support::Outcome said = clampctl("results last");
  EXPECT_EQ(said.exit_code, 2);
  EXPECT_THAT(said.output, HasSubstr("there is no"));
  said = clampctl("submit --serial nobody");
  EXPECT_EQ(said.exit_code, 2);
  EXPECT_THAT(said.output, HasSubstr("no check was chosen"));
  said = clampctl("submit --since yesterday");
  EXPECT_EQ(said.exit_code, 2);
  EXPECT_THAT(said.output, HasSubstr("is no date"));
  EXPECT_EQ(clampctl("submit --limits /nowhere.toml").exit_code, 2);
  const std::string empty = folder.write("empty.toml", "");
  said = support::run_command(fmt::format("{} --config {} --until-empty", CLAMPD_WORKER, empty));
  EXPECT_EQ(said.exit_code, 2);
  EXPECT_THAT(said.output, HasSubstr("no [postgresql] host"));
  ask("INSERT INTO clampd.migrations (version) VALUES (8)");
  said = worker_until_empty();
  EXPECT_EQ(said.exit_code, 2);
  EXPECT_THAT(said.output, HasSubstr("newer than the 7"));
}

}  // namespace
}  // namespace clampd::reanalysis
