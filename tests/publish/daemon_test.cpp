#include <cstdio>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "publish/servers.hpp"
#include "publish/subscriber.hpp"
#include "support/command.hpp"

namespace clampd {
namespace {

using support::eventually;
using ::testing::HasSubstr;

class PublishingDaemon : public ::testing::Test {
 protected:
  void SetUp() override {
    for (const std::string& missing : {support::Broker::missing(), support::Database::missing()})
      if (!missing.empty()) GTEST_SKIP() << missing;
    support::give_to_server(folder.path("."));
    configuration =
        folder.write("station.toml", fmt::format(R"([station]
name = "line 3/a"
[can]
interface = "simulated"
[archive]
database = "checks.sqlite"
[control]
port = {}
token_file = "token"
[mqtt]
host = "127.0.0.1"
port = {}
topic_prefix = "plant/clampd"
[postgresql]
host = "{}"
database = "line"
user = "line"
)",
                                                 support::free_port(), broker.port(), server.host()));
  }

  void start() {
    daemon.start({CLAMPD, "--simulated", "--config", configuration}, folder.path("log"));
    ASSERT_TRUE(eventually([&] { return !channel("mqtt").is_null(); })) << folder.read("log");
  }
  std::string clampctl(const std::string& arguments) const {
    return support::run_command(fmt::format("{} --config {} {}", CLAMPCTL, configuration, arguments)).output;
  }
  /// What the station's status says of a channel; null while there is no daemon.
  nlohmann::json channel(const std::string& name) const {
    const auto status = nlohmann::json::parse(clampctl("status --json"), nullptr, false);
    if (status.is_object())
      for (const auto& one : status.at("publishing"))
        if (one.at("channel") == name) return one;
    return nullptr;
  }
  nlohmann::json check(const std::string& serial) const {
    return nlohmann::json::parse(clampctl("run --repeats 1 --json - --serial " + serial), nullptr, false);
  }

  support::Broker broker;
  support::Database server;
  support::TemporaryDirectory folder;
  std::string configuration;
  support::ServerProcess daemon;
};

TEST_F(PublishingDaemon, PublishesItsChecksAndSaysWhatWaits) {
  start();
  ASSERT_TRUE(eventually([&] { return clampctl("status").find("IDLE") != std::string::npos; }));
  const nlohmann::json first = check("EMB-1");
  ASSERT_TRUE(first.is_object() && first.contains("record")) << first << folder.read("log");
  ASSERT_TRUE(eventually([&] { return channel("postgresql").at("pending") == 0; }));
  EXPECT_EQ(server.ask("SELECT id || ' ' || serial || ' ' || station FROM clampd.checks"),
            first.at("record").get<std::string>() + " EMB-1 line 3/a");
  const nlohmann::json waiting = channel("mqtt");
  EXPECT_EQ(waiting.at("pending"), 1);
  EXPECT_FALSE(waiting.at("connected"));
  EXPECT_THAT(waiting.at("error").get<std::string>(), HasSubstr("nothing listens"));
  EXPECT_THAT(clampctl("status"), HasSubstr("not connected, 1 check waits, for "));

  // The daemon is killed with the check still in its outbox; the broker comes while it is away.
  daemon.end(9);
  broker.start();
  support::Subscriber line(broker.port());
  start();
  constexpr const char* kTopic = "plant/clampd/line 3_a/checks";
  ASSERT_TRUE(eventually([&] { return line.messages(kTopic).size() == 1; })) << folder.read("log");
  EXPECT_EQ(line.documents(kTopic)[0].at("record"), first.at("record"));
  EXPECT_EQ(line.documents(kTopic)[0].at("verdict"), first.at("verdict"));
  EXPECT_TRUE(eventually([&] { return channel("mqtt").at("pending") == 0; }));
  const std::string doctor = clampctl("doctor --seconds 0.5");
  EXPECT_THAT(doctor, HasSubstr("answers, nothing waits"));
  EXPECT_THAT(doctor, HasSubstr("publishing, mqtt"));
  EXPECT_TRUE(channel("mqtt").at("connected")) << "the doctor does not end the daemon's connection";
  daemon.end(15);
}

}  // namespace
}  // namespace clampd
