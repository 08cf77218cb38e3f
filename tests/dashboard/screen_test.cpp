// The screen in real Chromium, in front of the daemon with a simulated brake. Pictures of what was seen go to
// the build folder's screenshots/ (CLAMPD_SCREENSHOTS names another), from where the README's come.

#include <signal.h>
#include <sys/resource.h>

#include <array>
#include <filesystem>
#include <optional>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/experiment/manoeuvres.hpp"
#include "dashboard/browser.hpp"
#include "dashboard/program.hpp"
#include "support/eventually.hpp"
#include "support/network.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::screen {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

std::string pictures_folder() {
  const char* wanted = std::getenv("CLAMPD_SCREENSHOTS");
  const std::string folder = wanted != nullptr ? wanted : std::string(CLAMPD_BINARY_DIR) + "/screenshots";
  std::filesystem::create_directories(folder);
  return folder + "/";
}

class Screen : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!Browser::is_installed())
      GTEST_SKIP() << "needs Debian's packages chromium and chromium-driver; `tools/dev test` installs them";
  }

  /// The daemon with this simulated brake, and the browser in front of it.
  void start(const std::string& brake, int repeats, bool with_token = true,
             const std::string& further_tables = "", const std::string& further_check = "") {
    port_ = support::free_port();
    folder_.write("station.toml",
                  fmt::format("[station]\nname = \"bench-1\"\n[check]\nrepeats = {}\n{}[control]\nport = {}\n"
                              "token_file = \"token\"\n{}",
                              repeats, further_check, port_, further_tables));
    folder_.write("brake.toml", brake);
    daemon_.emplace(std::vector<std::string>{CLAMPD, "--simulated", "--config", folder_.path("station.toml"),
                                             "--simulated-brake", folder_.path("brake.toml")},
                    folder_.path("daemon.log"),
                    std::vector<std::string>{"STATE_DIRECTORY=" + folder_.path("state")});
    browser_.emplace(1440, 900);
    browser_->open("about:blank");
    const std::string address = fmt::format("http://127.0.0.1:{}/", port_);
    ASSERT_TRUE(support::eventually([&] {
      return folder_.read("daemon.log").find("station is IDLE") != std::string::npos;
    })) << folder_.read("daemon.log");
    std::string token = folder_.read("token");
    browser_->open(with_token ? address + "#token=" + token.substr(0, token.size() - 1) : address);
  }

  void picture(const std::string& name) { browser_->save_picture(pictures_folder() + name + ".png"); }

  ::testing::AssertionResult shows(const std::string& word, int seconds = 60) {
    if (browser_->becomes(fmt::format("document.getElementById('verdict-word').textContent === '{}'", word),
                          seconds))
      return ::testing::AssertionSuccess();
    return ::testing::AssertionFailure()
           << "the page says " << browser_->text("#verdict") << "; state " << browser_->text("#state")
           << "; fault " << browser_->text("#fault") << "; beside it " << browser_->text("#aside");
  }

  /// The notices come with the daemon's next look at its records, some time after the verdict.
  bool notices_say(const std::string& text) {
    return browser_->becomes(
        fmt::format("document.getElementById('notices').textContent.includes('{}')", text));
  }

  support::TemporaryDirectory folder_;
  int port_ = 0;
  std::optional<Program> daemon_;
  std::optional<Browser> browser_;
};

constexpr const char* kGoodBrake = "[plant]\nseed = 3\n";

/// What a request without a token gets from the station, as JSON text; {} where it refuses.
std::string asked(const std::string& path) {
  return "(() => { const r = new XMLHttpRequest(); r.open('GET', '" + path +
         "', false); r.send(); return r.status === 200 ? r.responseText : '{}'; })()";
}

constexpr const char* kBeyondTheScreen =
    "[...document.querySelectorAll('body *')].filter((node) => { const box = node.getBoundingClientRect();"
    "return box.width > 0 && box.right > document.documentElement.clientWidth + 1 &&"
    "!node.closest('.wide-table'); }).map((node) => `${node.tagName} ${node.id} ${node.className}`).join()";

TEST_F(Screen, AKeyboardAloneChecksABrakeAndBrowsesTheHistory) {
  start(kGoodBrake, 6);
  ASSERT_TRUE(shows("READY", 15)) << browser_->text("body");
  picture("ready");
  browser_->type(std::string("EMB-2026-0001") + kEnter);
  ASSERT_TRUE(shows("RUNNING"));
  ASSERT_TRUE(
      browser_->becomes("document.getElementById('run-name').textContent >= '3' && "
                        "document.querySelector('#live-force .measured').getAttribute('d').length > 2500"));
  picture("running");
  ASSERT_TRUE(shows("PASS"));
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('#parameters .mark').length === 7"));
  picture("pass");
  EXPECT_EQ(browser_->text("#verdict-serial"), "EMB-2026-0001");
  EXPECT_THAT(browser_->text("#parameters"),
              AllOf(HasSubstr("stiffness k2"), HasSubstr("ws"), HasSubstr("±")));
  // What is said to be two standard deviations is two.
  const nlohmann::json k2 =
      nlohmann::json::parse(browser_->value(asked("/v1/results/last")).get<std::string>())
          .at("parameters")
          .at(1);
  const std::string shown = browser_->value("document.querySelectorAll('#parameters .value')[1].textContent");
  EXPECT_NEAR(std::stod(shown.substr(shown.find("±") + 3)), 2.0 * k2.at("sd").get<double>(),
              0.3 * k2.at("sd").get<double>())
      << shown;
  EXPECT_THAT(browser_->text("#timing-text"), HasSubstr("skipped"));
  EXPECT_EQ(browser_->value("document.getElementById('serial').value"), "") << "ready for the next scan";

  browser_->prefer_dark(true);
  picture("pass-dark");
  browser_->prefer_dark(false);

  // A second one: the statistics need two brakes; a script in a serial number is text.
  const std::string script = "<img src=x onerror=\"document.title='owned'\">";
  browser_->type(script + kEnter);
  ASSERT_TRUE(shows("RUNNING"));
  ASSERT_TRUE(shows("PASS"));
  EXPECT_EQ(browser_->text("#verdict-serial"), script);

  browser_->type(kF3);
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('#history-list button').length === 2"));
  browser_->type(kDown);
  ASSERT_TRUE(browser_->becomes("document.querySelector('#past-force .measured')"));
  EXPECT_THAT(browser_->text("#history-detail"),
              AllOf(HasSubstr("EMB-2026-0001"), HasSubstr("PASS"), HasSubstr("k2"), HasSubstr("UTC")));
  EXPECT_THAT(browser_->text("#history-list"), HasSubstr(" UTC"));
  const std::string table =
      browser_->value("decodeURIComponent(document.getElementById('export-csv').href)").get<std::string>();
  EXPECT_THAT(table, AllOf(HasSubstr("record,serial,started"), HasSubstr("\"EMB-2026-0001\"")));
  picture("history");
  EXPECT_EQ(browser_->value("document.images.length"), 0);
  EXPECT_NE(browser_->value("document.title"), "owned");

  browser_->type(kF4);
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('#chart-individuals .point').length === 2"));
  EXPECT_THAT(browser_->text("#capability"), AllOf(HasSubstr("Cpk"), HasSubstr("mus")));
  picture("statistics");

  EXPECT_EQ(browser_->value("performance.getEntriesByType('resource')"
                            ".filter((entry) => !entry.name.startsWith(location.origin + '/')).length"),
            0)
      << "no request leaves the station";
  EXPECT_THAT(browser_->complaints(), IsEmpty());
}

TEST_F(Screen, TheSheetStandsBelowTheParameters) {
  folder_.write(
      "sheet.toml",
      "revision = \"1\"\n"
      "[[characteristic]]\nkind = \"apply-time\"\nunit = \"s\"\nforce_N = 20000\nshare = 0.9\n"
      "clearance_rad = 6\nupper = 0.1\n"
      "[[characteristic]]\nkind = \"stiffness\"\nunit = \"N/rad\"\nforce_N = 20000\nlower = 800\n"
      "[[characteristic]]\nname = \"drag <b>\"\nkind = \"drag\"\nunit = \"N m\"\nspeed_rad_s = 50\n");
  start(kGoodBrake, 4, true, "[sheet]\nfile = \"sheet.toml\"\n");
  ASSERT_TRUE(shows("READY", 15));
  EXPECT_TRUE(browser_->value("document.getElementById('sheet').hidden").get<bool>())
      << "nothing was checked yet";
  browser_->type(std::string("EMB-2026-0003") + kEnter);
  ASSERT_TRUE(shows("FAIL"));
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('#sheet .characteristic').length === 3"));
  picture("sheet");
  const std::string text = browser_->text("#sheet");
  EXPECT_THAT(text, AllOf(HasSubstr("apply-time at force_N 20000"), HasSubstr("… 0.1 s"), HasSubstr("FAIL")));
  // The noise of the readings differs from check to check, and with it the last digits.
  EXPECT_NEAR(std::stod(browser_->text("#sheet .characteristic b")), 0.1459, 0.0005);
  EXPECT_THAT(text, AllOf(HasSubstr("800 …"), HasSubstr("drag <b>"), HasSubstr("no limits")));
  EXPECT_EQ(browser_->value(kBeyondTheScreen), "");
  EXPECT_THAT(browser_->complaints(), IsEmpty());
}

TEST_F(Screen, ASoftBrakeFailsInFullSize) {
  start("[parameters_normalised]\nk2 = 0.7\n", 6);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(std::string("EMB-2026-0002") + kEnter);
  ASSERT_TRUE(shows("FAIL"));
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('#parameters .word.fail').length === 1"));
  picture("fail");
  EXPECT_THAT(browser_->text("#verdict-reason"), HasSubstr("k2"));
  EXPECT_EQ(browser_->text("#parameters .word.fail"), "FAIL");
  // "In full size": a word that fills most of its panel, and a start button that a glove hits.
  EXPECT_GT(
      browser_->value("document.getElementById('verdict-word').getBoundingClientRect().height").get<double>(),
      150.0);
  EXPECT_GT(browser_->value("document.getElementById('start').getBoundingClientRect().height").get<double>(),
            100.0);
  EXPECT_GT(browser_->value("document.getElementById('start').getBoundingClientRect().width").get<double>(),
            300.0);
  EXPECT_THAT(browser_->complaints(), IsEmpty());
}

TEST_F(Screen, AnErrorNamesItsCause) {
  start("[effects]\nforce-lag = 0.01\n", 6);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(std::string("EMB-2026-0003") + kEnter);
  ASSERT_TRUE(shows("ERROR", 120)) << browser_->text("#verdict");
  picture("error-with-cause");
  EXPECT_THAT(browser_->text("#verdict-cause"), HasSubstr("the force reading comes late (force-lag)"));
  EXPECT_THAT(browser_->text("#verdict-action"), HasSubstr("force sensor"));
}

TEST_F(Screen, EscapeStopsTheBrakeAndCClearsButAScannerClearsNothing) {
  start(kGoodBrake, 50);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(std::string("EMB-2026-0004") + kEnter);
  ASSERT_TRUE(browser_->becomes("document.getElementById('run-name').textContent === '1'"));
  browser_->type(std::string("EMB-2026-0005") + kEnter);
  EXPECT_TRUE(browser_->becomes("document.getElementById('aside').textContent.includes('under way')"));
  browser_->type(kEscape);
  ASSERT_TRUE(shows("ABORTED"));
  ASSERT_TRUE(browser_->becomes(
      "!document.getElementById('fault').hidden && !document.getElementById('clear').disabled"));
  picture("aborted");
  EXPECT_THAT(browser_->text("#fault-name"), HasSubstr("operator-stop"));
  browser_->type("c-4711");
  // It is no command but a serial number, which may wait for the station in its field.
  EXPECT_TRUE(browser_->becomes("document.getElementById('serial').value === 'c-4711'"));
  browser_->type(kEnter);
  EXPECT_TRUE(
      browser_->becomes("document.getElementById('aside-text').textContent.startsWith('c-4711 was not')"));
  EXPECT_EQ(browser_->text("#state"), "FAULT");
  browser_->type("c");
  EXPECT_TRUE(browser_->becomes("document.getElementById('state').textContent === 'IDLE'"));
  EXPECT_EQ(browser_->text("#verdict-word"), "ABORTED") << "stays until the next start";
}

TEST_F(Screen, WithoutTheTokenItMayOnlyLook) {
  start(kGoodBrake, 3, false);
  ASSERT_TRUE(shows("READY", 15));
  ASSERT_TRUE(browser_->becomes(
      "!document.getElementById('unlock').hidden && document.getElementById('entry').hidden"));
  EXPECT_GT(browser_->value("document.getElementById('stop').getBoundingClientRect().height").get<double>(),
            50.0)
      << "a stop asks for no token, the station decides";
  picture("locked");
  const std::string post =
      "(() => { const r = new XMLHttpRequest(); r.open('POST', '/v1/checks', false);"
      "r.setRequestHeader('Content-Type', 'application/json'); r.send('{\"serial\":\"X\"}');"
      "return r.status; })()";
  EXPECT_EQ(browser_->value(post), 401);
  browser_->value("document.getElementById('token').focus()");
  browser_->type(folder_.read("token").substr(0, 64) + kEnter);
  EXPECT_TRUE(browser_->becomes("!document.getElementById('entry').hidden"));
  browser_->type(std::string("EMB-2026-0006") + kEnter);
  EXPECT_TRUE(shows("PASS"));
}

TEST_F(Screen, AHungDaemonIsSaidInFullSizeUntilItAnswersAgain) {
  start(kGoodBrake, 2);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(std::string("EMB-2026-0010") + kEnter);
  ASSERT_TRUE(shows("PASS"));
  daemon_->send(SIGSTOP);
  EXPECT_TRUE(shows("NO ANSWER"));
  EXPECT_THAT(browser_->text("#verdict"), AllOf(Not(HasSubstr("PASS")), Not(HasSubstr("EMB-2026-0010"))));
  EXPECT_EQ(browser_->text("#state"), "NO ANSWER");
  EXPECT_GT(
      browser_->value("document.getElementById('verdict-word').getBoundingClientRect().height").get<double>(),
      80.0);
  picture("no-answer");
  daemon_->send(SIGCONT);
  EXPECT_TRUE(shows("PASS"));
  EXPECT_EQ(browser_->text("#state"), "IDLE");
}

TEST_F(Screen, WhatWasNotStartedIsNotStartedByTheNextEnter) {
  start(kGoodBrake, 6);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(std::string("EMB-A") + kEnter);
  ASSERT_TRUE(shows("RUNNING"));
  browser_->type(std::string("EMB-B") + kEnter);
  ASSERT_TRUE(browser_->becomes("!document.getElementById('aside').hidden"));
  EXPECT_THAT(browser_->text("#aside"), HasSubstr("EMB-B was not started: a check of EMB-A is under way"));
  EXPECT_EQ(browser_->value("document.getElementById('serial').value"), "");
  browser_->type("EMB-C");  // by a scanner that sends no Enter
  ASSERT_TRUE(shows("PASS"));
  EXPECT_EQ(browser_->text("#verdict-serial"), "EMB-A");
  browser_->type(kEnter);
  EXPECT_TRUE(
      browser_->becomes("document.getElementById('aside-text').textContent.startsWith('EMB-C was not')"));
  EXPECT_EQ(browser_->value("document.getElementById('serial').value"), "");
  browser_->type(kEnter);
  EXPECT_TRUE(browser_->becomes("document.getElementById('message').textContent.includes('Scan or type')"));
  EXPECT_EQ(nlohmann::json::parse(browser_->value(asked("/v1/status")).get<std::string>()).at("serial"),
            "EMB-A");
  picture("not-started");
  // Asked for by name it is.
  browser_->value("document.getElementById('aside-use').click()");
  EXPECT_EQ(browser_->value("document.getElementById('serial').value"), "EMB-C");
  browser_->type(kEnter);
  EXPECT_TRUE(browser_->becomes("document.getElementById('verdict-serial').textContent === 'EMB-C'"));
}

TEST_F(Screen, OnASlowNetworkNoBrakeIsTakenForThePreviousOne) {
  start(kGoodBrake, 2);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(std::string("EMB-A") + kEnter);
  ASSERT_TRUE(shows("PASS"));
  browser_->delay_network(400);
  browser_->value(
      "(window.shown = [], new MutationObserver(() => window.shown.push("
      "document.getElementById('verdict-word').textContent + ' ' + "
      "document.getElementById('verdict-serial').textContent)).observe(document.getElementById('verdict'), "
      "{childList: true, subtree: true, characterData: true}), 1)");
  browser_->type(std::string("EMB-B") + kEnter);
  ASSERT_TRUE(browser_->becomes("window.shown.includes('PASS EMB-B')", 60));
  const std::string shown = browser_->value("window.shown.join()").get<std::string>();
  EXPECT_THAT(shown, HasSubstr("RUNNING EMB-B"));
  EXPECT_THAT(shown, Not(HasSubstr("ING EMB-A"))) << "STARTING, RUNNING or JUDGING";
}

TEST_F(Screen, AScanInTheHistoryGoesToTheField) {
  start(kGoodBrake, 2);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(kF3);
  ASSERT_TRUE(browser_->becomes("!document.getElementById('view-history').hidden"));
  browser_->type(std::string("EMB-2026-0011") + kEnter);
  EXPECT_TRUE(browser_->becomes("document.getElementById('message').textContent.includes('EMB-2026-0011')"));
  EXPECT_EQ(browser_->value("document.getElementById('view-station').hidden"), false);
  EXPECT_EQ(browser_->value("document.getElementById('serial').value"), "EMB-2026-0011");
  EXPECT_EQ(browser_->text("#verdict-word"), "READY") << "a scan that was meant to search starts nothing";
  browser_->type(kEnter);
  EXPECT_TRUE(shows("PASS"));
  EXPECT_EQ(browser_->text("#verdict-serial"), "EMB-2026-0011");
}

TEST_F(Screen, ABrakeThatStaysClampedIsSaidInFullSize) {
  constexpr std::array kHold{ManoeuvreSegment{.duration_s = 0.5, .force_N = 20e3},
                             ManoeuvreSegment{.duration_s = 5.0, .force_N = 20e3},
                             ManoeuvreSegment{.duration_s = 0.5, .force_N = 2e3}};
  const auto hold = follow_segments("hold", kHold, BrakeParameters{});
  ASSERT_TRUE(hold) << hold.error().message;
  ASSERT_TRUE(write_run(folder_.path("hold.csv"), *hold));
  start(kGoodBrake, 1, true, "", "trajectory = \"hold.csv\"\n");
  ASSERT_TRUE(shows("READY", 15));
  EXPECT_EQ(browser_->value("document.getElementById('clamped').hidden"), true);
  browser_->type(std::string("EMB-2026-0012") + kEnter);
  ASSERT_TRUE(browser_->becomes("/1[89]\\.|2[01]\\./.test(document.getElementById('link').textContent)"));
  browser_->type(kEscape);
  ASSERT_TRUE(shows("ABORTED"));
  ASSERT_TRUE(browser_->becomes("!document.getElementById('clamped').hidden"));
  EXPECT_THAT(browser_->text("#clamped"), AllOf(HasSubstr("CLAMPED"), HasSubstr("kN"), HasSubstr("OPEN")));
  EXPECT_GT(browser_->value("document.getElementById('clamped-force').getBoundingClientRect().height")
                .get<double>(),
            50.0);
  picture("clamped");
  browser_->type("c");
  ASSERT_TRUE(browser_->becomes("document.getElementById('state').textContent === 'IDLE'"));
  EXPECT_EQ(browser_->value("document.getElementById('clamped').hidden"), false) << "cleared is not opened";
  browser_->type(kF3);
  EXPECT_GT(
      browser_->value("document.getElementById('clamped').getBoundingClientRect().height").get<double>(),
      50.0);
}

TEST_F(Screen, OnAPhoneNothingRunsOffTheScreen) {
  start(kGoodBrake, 2);
  browser_->resize(390, 844);
  ASSERT_TRUE(shows("READY", 15));
  browser_->type(std::string("EMB-2026-0013-with-a-long-number-0123456789") + kEnter);
  ASSERT_TRUE(shows("PASS"));
  ASSERT_TRUE(browser_->becomes("document.querySelectorAll('#parameters .mark').length === 7"));
  EXPECT_EQ(browser_->value(kBeyondTheScreen), "");
  picture("phone");
  browser_->type(kF3);
  ASSERT_TRUE(browser_->becomes("document.querySelector('#history-list button')"));
  browser_->type(kDown);
  ASSERT_TRUE(browser_->becomes("document.querySelector('#past-force .measured')"));
  EXPECT_EQ(browser_->value(kBeyondTheScreen), "");
  picture("phone-history");
  browser_->type(kF4);
  EXPECT_EQ(browser_->value(kBeyondTheScreen), "");
}

TEST_F(Screen, APageOfAnotherOriginMovesNothing) {
  start(kGoodBrake, 3);
  ASSERT_TRUE(shows("READY", 15));
  browser_->open("data:text/html,<p>elsewhere</p>");
  // What a page can send to anybody without being asked: a simple request, its answer unread.
  const std::string send = fmt::format(
      "(window.sent = '', fetch('http://127.0.0.1:{}/v1/checks', {{method: 'POST', mode: 'no-cors', body: "
      "'{{\"serial\":\"X\"}}'}}).then(() => window.sent = 'yes', () => window.sent = 'no'), 1)",
      port_);
  browser_->value(send);
  EXPECT_TRUE(browser_->becomes("window.sent !== ''"));
  browser_->open(fmt::format("http://127.0.0.1:{}/", port_));
  EXPECT_TRUE(shows("READY", 15));
  EXPECT_THAT(folder_.read("daemon.log"), Not(HasSubstr("begins")));
}

TEST_F(Screen, ADiskThatIsFullAndABrokerThatIsAwayShow) {
  ::signal(SIGXFSZ, SIG_IGN);  // inherited: a write beyond the limit fails, as on a full disk
  start(kGoodBrake, 2, true, fmt::format("[mqtt]\nhost = \"127.0.0.1\"\nport = {}\n", support::free_port()));
  ASSERT_TRUE(shows("READY", 15)) << browser_->text("body");
  const auto allow = [&](rlim_t bytes) {
    const rlimit limit{bytes, RLIM_INFINITY};
    ASSERT_EQ(::prlimit(daemon_->process(), RLIMIT_FSIZE, &limit, nullptr), 0);
  };
  browser_->type(std::string("EMB-FULL") + kEnter);
  ASSERT_TRUE(shows("RUNNING"));
  allow(4096);
  ASSERT_TRUE(shows("ERROR"));
  EXPECT_THAT(browser_->text("#verdict"), HasSubstr("could not be saved"));
  for (const char* notice : {"the result of EMB-FULL could not be saved", "disk", "mqtt (127.0.0.1:"})
    EXPECT_TRUE(notices_say(notice)) << notice << " is not in: " << browser_->text("#notices");
  picture("disk-full");
  allow(RLIM_INFINITY);
  ASSERT_TRUE(shows("PASS")) << "the same check, once it is on record";
  ASSERT_TRUE(browser_->becomes("!document.getElementById('notices').textContent.includes('saved:')"));
  EXPECT_TRUE(notices_say("1 check waits to be published")) << browser_->text("#notices");
}

TEST_F(Screen, ADaemonThatIsGoneShows) {
  start(kGoodBrake, 3);
  ASSERT_TRUE(shows("READY", 15));
  EXPECT_EQ(daemon_->end(), 0);
  EXPECT_TRUE(browser_->becomes("document.getElementById('state').textContent === 'NO DAEMON'"));
  EXPECT_EQ(browser_->text("#verdict-word"), "NO DAEMON");
  EXPECT_EQ(browser_->value("document.getElementById('start').getAttribute('aria-disabled')"), "true");
  picture("no-daemon");
}

}  // namespace
}  // namespace clampd::screen
