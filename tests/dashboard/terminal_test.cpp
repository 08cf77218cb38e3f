// The same station from a terminal: `clampctl watch` and `clampctl run` through a daemon with a simulated
// brake.

#include <signal.h>

#include <filesystem>
#include <optional>
#include <set>
#include <sstream>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/http/client.hpp"
#include "dashboard/program.hpp"
#include "support/eventually.hpp"
#include "support/network.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::screen {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class Terminal : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_.write("station.toml",
                  fmt::format("[station]\nname = \"bench-1\"\n[can]\ninterface = \"simulated\"\n"
                              "[check]\nrepeats = 40\n[control]\nport = {}\ntoken_file = \"token\"\n",
                              port_));
    std::filesystem::create_directories(folder_.path("home"));
    daemon_.emplace(
        std::vector<std::string>{CLAMPD, "--simulated", "--config", folder_.path("station.toml")},
        folder_.path("daemon.log"),
        std::vector<std::string>{"STATE_DIRECTORY=" + folder_.path("state"), "HOME=" + folder_.path("home"),
                                 "TMPDIR=" + folder_.path("home")});
    ASSERT_TRUE(support::eventually([&] {
      return folder_.read("daemon.log").find("station is IDLE") != std::string::npos;
    })) << folder_.read("daemon.log");
  }

  nlohmann::json status() const {
    const auto answer = http::exchange("127.0.0.1", port_, {"GET", "/v1/status"});
    return answer ? nlohmann::json::parse(answer->body) : nlohmann::json();
  }

  std::unique_ptr<Program> clampctl(std::vector<std::string> arguments, const std::string& log) {
    arguments.insert(arguments.begin(), {CLAMPCTL, "--config", folder_.path("station.toml")});
    return std::make_unique<Program>(arguments, folder_.path(log));
  }

  support::TemporaryDirectory folder_;
  int port_ = support::free_port();
  std::optional<Program> daemon_;
};

TEST_F(Terminal, CtrlCStopsTheBrakeFirst) {
  const auto run = clampctl({"run", "--serial", "S-1"}, "run.log");
  ASSERT_TRUE(support::eventually([&] { return status().at("phase") == "trajectory"; }));
  run->send(SIGINT);
  EXPECT_EQ(run->wait(), 4) << folder_.read("run.log");
  // When the command ends, the brake has long stopped.
  const nlohmann::json now = status();
  EXPECT_EQ(now.at("state"), "FAULT");
  EXPECT_EQ(now.at("fault"), "operator-stop");
  EXPECT_NEAR(now.at("torque_Nm").get<double>(), 0.0, 0.02);
  EXPECT_THAT(folder_.read("run.log"), HasSubstr("ABORTED"));
}

TEST_F(Terminal, WatchWritesALineForEachChangeAndEndsWithCtrlC) {
  const auto lines = clampctl({"watch"}, "watch.log");
  const auto documents = clampctl({"watch", "--json"}, "watch.json");
  ASSERT_TRUE(
      support::eventually([&] { return folder_.read("watch.log").find("IDLE") != std::string::npos; }));
  const auto run = clampctl({"run", "--serial", "S-2", "--repeats", "2"}, "run.log");
  EXPECT_EQ(run->wait(), 0) << folder_.read("run.log");
  ASSERT_TRUE(support::eventually([&] {
    return folder_.read("watch.log").find("S-2: PASS") != std::string::npos &&
           folder_.read("watch.json").find("PASS") != std::string::npos;
  }));
  lines->send(SIGINT);
  documents->send(SIGINT);
  EXPECT_EQ(lines->wait(), 0);
  EXPECT_EQ(documents->wait(), 0);
  EXPECT_THAT(folder_.read("watch.log"), AllOf(HasSubstr("RUNNING"), HasSubstr("run 1 of 2")));
  std::istringstream stream(folder_.read("watch.json"));
  int count = 0;
  for (std::string line; std::getline(stream, line); ++count)
    EXPECT_EQ(nlohmann::json::parse(line).at("station"), "bench-1");
  EXPECT_GT(count, 2);
}

TEST_F(Terminal, WatchSaysThatTheDaemonWentAway) {
  const auto lines = clampctl({"watch"}, "watch.log");
  ASSERT_TRUE(
      support::eventually([&] { return folder_.read("watch.log").find("IDLE") != std::string::npos; }));
  daemon_->end();
  EXPECT_EQ(lines->wait(), 3);
  EXPECT_THAT(folder_.read("watch.log"), HasSubstr("no daemon answers"));
}

TEST_F(Terminal, WatchSaysThatTheDaemonHangsAndGoesOnWhenItAnswers) {
  const auto lines = clampctl({"watch"}, "watch.log");
  ASSERT_TRUE(
      support::eventually([&] { return folder_.read("watch.log").find("IDLE") != std::string::npos; }));
  daemon_->send(SIGSTOP);
  EXPECT_TRUE(
      support::eventually([&] { return folder_.read("watch.log").find("NO ANSWER") != std::string::npos; }));
  daemon_->send(SIGCONT);
  EXPECT_TRUE(support::eventually([&] {
    const std::string log = folder_.read("watch.log");
    return log.find("IDLE", log.find("NO ANSWER")) != std::string::npos;
  })) << folder_.read("watch.log");
  lines->send(SIGINT);
  EXPECT_EQ(lines->wait(), 0);
}

TEST_F(Terminal, ADaemonOnASimulatedBrakeIsTheStationOfWhoeverHasNoBus) {
  folder_.write("embedded.toml", fmt::format("[control]\nport = {}\ntoken_file = \"token\"\n", port_));
  Program run(
      {CLAMPCTL, "--config", folder_.path("embedded.toml"), "run", "--serial", "S-9", "--repeats", "1"},
      folder_.path("run.log"), {"STATE_DIRECTORY=" + folder_.path("other")});
  EXPECT_EQ(run.wait(), 0) << folder_.read("run.log");
  EXPECT_EQ(status().at("serial"), "S-9");
  EXPECT_FALSE(std::filesystem::exists(folder_.path("other"))) << "no second station in this process";
}

TEST_F(Terminal, TheScreensAddressHasTheToken) {
  EXPECT_EQ(clampctl({"screen"}, "screen.log")->wait(), 0);
  EXPECT_EQ(folder_.read("screen.log"),
            fmt::format("http://127.0.0.1:{}/#token={}", port_, folder_.read("token")));
}

TEST_F(Terminal, ADaemonWritesItsStateAndTokenAndNothingElse) {
  EXPECT_EQ(clampctl({"run", "--serial", "../../S-3", "--repeats", "1"}, "run.log")->wait(), 0);
  daemon_->end();
  std::set<std::string> found;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder_.path("")))
    found.insert(std::filesystem::relative(entry.path(), folder_.path("")).string());
  for (const char* expected :
       {"station.toml", "daemon.log", "run.log", "token", "home", "state", "state/simulated.sqlite"})
    EXPECT_EQ(found.erase(expected), 1U) << expected;
  for (const std::string& other : found) EXPECT_THAT(other, ::testing::StartsWith("state/"));
}

}  // namespace
}  // namespace clampd::screen
