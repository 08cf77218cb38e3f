// The page of the line in real Chromium, in front of a worker with a database of its own.

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/http/client.hpp"
#include "dashboard/browser.hpp"
#include "reanalysis/archive_fixture.hpp"
#include "support/line_of_stations.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::screen {
namespace {

using support::LineStation;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr const char* kHostile = "<script>window.hostile = 1</script>";

class LineScreen : public support::Archive {
 protected:
  void SetUp() override {
    if (!Browser::is_installed())
      GTEST_SKIP() << "needs Debian's packages chromium and chromium-driver; `tools/dev test` installs them";
    Archive::SetUp();
  }

  /// A worker that serves the page, and a browser in front of it.
  void start() {
    port_ = support::free_port();
    const std::string config = folder_.write(
        "station.toml",
        support::Database::section(server->host()));
    support::give_to_server(folder_.path("."));
    jobs();  // brings the schema up to date
    worker_.start({CLAMPD_WORKER, "--config", config, "--name", "line-server:1", "--serve",
                   fmt::format("127.0.0.1:{}", port_)},
                  folder_.path("worker.log"));
    ASSERT_TRUE(support::eventually([&] {
      return http::exchange("127.0.0.1", port_, {"GET", "/metrics"}).has_value();
    })) << folder_.read("worker.log");
    browser_.emplace(1920, 1080);
    browser_->open(fmt::format("http://127.0.0.1:{}/", port_));
  }

  /// Tasks that other workers have done, failed and hold.
  void hold_tasks() const {
    ask("INSERT INTO clampd.tasks VALUES ('0', '{}')");
    ask("INSERT INTO clampd.jobs (name, task_sha256, selection) VALUES ('TC 20 % tighter?', '0', '{}')");
    ask("INSERT INTO clampd.queue (job_id, check_id, state, finished, reason) SELECT 1, id, "
        "CASE WHEN n % 80 = 0 THEN 'failed' ELSE 'done' END, clock_timestamp(), "
        "CASE WHEN n % 80 = 0 THEN 'check ' || id || ': its raw runs are not in the database' END "
        "FROM (SELECT id, row_number() OVER (ORDER BY id) AS n FROM clampd.checks) c WHERE n <= 400");
    ask("INSERT INTO clampd.queue (job_id, check_id, state, worker, attempts, claimed, lease_until) SELECT "
        "1, id, "
        "'claimed', 'compute-' || n - 400 || ':811', 1, clock_timestamp() - make_interval(secs => n - 395), "
        "clock_timestamp() + interval '1 hour' "
        "FROM (SELECT id, row_number() OVER (ORDER BY id) AS n FROM clampd.checks) c WHERE n BETWEEN 401 AND "
        "403");
  }

  void picture(const std::string& name, int width) {
    // As high as the page: the whole of it is seen.
    browser_->resize(width, 1000);
    const int height = browser_->value("document.documentElement.scrollHeight").get<int>();
    browser_->resize(width, height);
    EXPECT_EQ(browser_->value("document.documentElement.scrollWidth"), width)
        << name << " is wider than its screen";
    const char* wanted = std::getenv("CLAMPD_SCREENSHOTS");
    const std::string folder = wanted != nullptr ? wanted : std::string(CLAMPD_BINARY_DIR) + "/screenshots";
    std::filesystem::create_directories(folder);
    browser_->save_picture(folder + "/" + name + ".png");
  }

  bool shows(const std::string& selector, const std::string& text) {
    return browser_->becomes(
        fmt::format("document.querySelector('{}')?.textContent.includes('{}')", selector, text));
  }

  support::TemporaryDirectory folder_;
  support::ServerProcess worker_;
  int port_ = 0;
  std::optional<Browser> browser_;
};

TEST_F(LineScreen, ShowsStationsParametersFindingsAndWhoDoesWhat) {
  publish(support::checks_of_a_line({{.name = "north-1"},
                                     {.name = "north-2", .drifts = TC, .drift = 0.35},
                                     {.name = "south-1", .checks_per_day = 5.0},
                                     {.name = "south-2", .steps = k2, .step = -0.06},
                                     {.name = "west-1", .silent_days = 6.0},
                                     {.name = "west-2"}},
                                    1));
  hold_tasks();
  start();
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('.station').length === 6"))
      << browser_->text("body");
  EXPECT_EQ(
      browser_->value("[...document.querySelectorAll('.silent h2')].map((node) => node.textContent).join()"),
      "west-1");
  EXPECT_THAT(browser_->text(".silent .alarm"), HasSubstr("SILENT for 6 days"));
  EXPECT_EQ(browser_->value("document.querySelectorAll('.parameter-card').length"), 7);
  EXPECT_EQ(browser_->value("document.querySelectorAll('.parameter-card .drift .points').length"), 42);
  EXPECT_THAT(browser_->text("#findings"),
              AllOf(HasSubstr("station north-2: TC"), HasSubstr("station south-2: k2 changed by -")));
  EXPECT_EQ(browser_->value("[...document.querySelectorAll('[data-name=\"k2\"] .found .name')].map((node) => "
                            "node.textContent).join()"),
            "south-2");
  EXPECT_THAT(browser_->text("#jobs"), AllOf(HasSubstr("job 1 (TC 20 % tighter?) 395 of 403 done"),
                                             HasSubstr("its raw runs are not in the database")));
  EXPECT_THAT(browser_->text("#claims"), AllOf(HasSubstr("compute-1:811"), HasSubstr("EMB-")));
  picture("line", 1920);
  browser_->prefer_dark(true);
  picture("line_dark", 1280);
  browser_->prefer_dark(false);
  picture("line_phone", 390);
  browser_->value(
      "document.querySelector('#part').value = 'EMB-45/R', "
      "document.querySelector('#part').dispatchEvent(new Event('change'))");
  EXPECT_TRUE(shows("#findings", "of part number EMB-45/R"));
  EXPECT_EQ(browser_->value("location.search"), "?part_number=EMB-45%2FR");
  EXPECT_THAT(browser_->complaints(), IsEmpty());
}

TEST_F(LineScreen, NamesAreTextWhateverStandsInThem) {
  std::vector<CheckRecord> checks = support::checks_of_a_line({{.name = kHostile}, {.name = "south"}}, 2);
  for (CheckRecord& check : checks) {
    check.serial = kHostile + check.serial;
    check.part_number = kHostile;
    check.reason = kHostile;
  }
  publish(checks);
  hold_tasks();
  ask(fmt::format("UPDATE clampd.queue SET worker = '{0}', reason = '{0}'", kHostile));
  ask(fmt::format("UPDATE clampd.jobs SET name = '{0}'", kHostile));
  start();
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('.station').length === 2"))
      << browser_->text("body");
  EXPECT_EQ(browser_->text(".station h2"), kHostile);
  EXPECT_THAT(browser_->text(".station .last"), HasSubstr(kHostile));
  EXPECT_THAT(browser_->text(".parameter-card .name"), kHostile);
  EXPECT_THAT(browser_->text("#claims"), HasSubstr(kHostile));
  EXPECT_THAT(browser_->text("#jobs"), HasSubstr(kHostile));
  EXPECT_EQ(browser_->value("document.scripts.length"), 1);
  EXPECT_EQ(browser_->value("'hostile' in window"), false);
  const auto page = http::exchange("127.0.0.1", port_, {"GET", "/line"});
  ASSERT_TRUE(page);
  EXPECT_THAT(page->header("content-security-policy"), HasSubstr("default-src 'self'"));
}

TEST_F(LineScreen, SaysInWordsWhatIsMissing) {
  start();
  EXPECT_TRUE(shows("#about", "There is no check in the archive yet")) << browser_->text("body");
  publish(support::checks_of_a_line({{.name = "north"}, {.name = "south"}}, 3));
  const auto choose = [&](const std::string& words) {
    browser_->value("[...document.querySelectorAll('#spans button')].find((node) => node.textContent === '" +
                    words + "').click()");
  };
  choose("7 days");
  EXPECT_TRUE(browser_->becomes("document.querySelectorAll('.station').length === 2"))
      << browser_->text("body");
  server->stop();
  choose("90 days");
  EXPECT_TRUE(shows("#notices", "PostgreSQL")) << browser_->text("body");
  EXPECT_THAT(browser_->text("#notices"),
              AllOf(HasSubstr("no connection"), HasSubstr("What is shown is of")));
  EXPECT_EQ(browser_->value("document.querySelectorAll('.station').length"), 2);
  EXPECT_EQ(browser_->value("document.body.className"), "stale");
  server->start();
  choose("24 h");
  EXPECT_TRUE(browser_->becomes("document.getElementById('notices').textContent === ''"))
      << browser_->text("#notices");
  EXPECT_EQ(worker_.end(SIGTERM), 0);
  choose("1 year");
  EXPECT_TRUE(shows("#notices", "No answer from the worker")) << browser_->text("#notices");
}

}  // namespace
}  // namespace clampd::screen
