// The control API over real sockets on the loopback interface, in front of a toy station.

#include "tools/clampd/control_server.hpp"

#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/temporary_directory.hpp"

#include <httplib.h>  // last: its <resolv.h> breaks Eigen's headers

namespace clampd::daemon {
namespace {

using ::testing::HasSubstr;

class ToyStation final : public ControlTarget {
 public:
  control::StationStatus status() override {
    control::StationStatus status;
    status.state = "IDLE";
    status.next_serial = next_serial;
    status.panel = {{"gpiochip0 line 4 (emergency stop)", "emergency stop", "closed"}};
    return status;
  }
  Result<std::uint64_t> start(const CheckRequest& request) override {
    if (request.serial == "BUSY") return failure("a check is under way");
    serial = request.serial;
    return 7;
  }
  Result<void> next(const CheckRequest& request) override {
    next_serial = request.serial;
    return {};
  }
  control::CheckProgress progress(bool) override {
    control::CheckProgress progress;
    progress.check = 7;
    progress.repeats = 20;
    return progress;
  }
  Result<void> stop() override {
    stopped = true;
    return {};
  }
  Result<void> clear() override { return failure("its cause is still there"); }
  Result<nlohmann::ordered_json> results(const std::string&, const std::string&, std::uint32_t) override {
    return nlohmann::ordered_json::array();
  }
  Result<nlohmann::ordered_json> result(const std::string& id) override { return failure("no check " + id); }
  Result<nlohmann::ordered_json> run(const std::string& id, std::size_t number) override {
    return nlohmann::ordered_json{{"of", id}, {"run", number}};
  }
  Result<nlohmann::ordered_json> statistics(std::uint32_t limit) override {
    return nlohmann::ordered_json{{"limit", limit}};
  }
  nlohmann::ordered_json reference() override { return nlohmann::ordered_json::object(); }
  nlohmann::ordered_json live(std::uint64_t run, std::size_t row) override {
    return {{"run", run}, {"row", row}};
  }

  std::string serial;
  std::string next_serial;
  bool stopped = false;
};

class ControlApi : public ::testing::Test {
 protected:
  void SetUp() override {
    auto started = ControlServer::start(station_, "127.0.0.1", 0, token_file_);
    ASSERT_TRUE(started) << started.error().message;
    server_ = std::move(*started);
  }
  httplib::Client http() { return httplib::Client("127.0.0.1", server_->port()); }
  control::Client client() { return control::Client("127.0.0.1", server_->port(), token_file_); }

  support::TemporaryDirectory folder_;
  std::string token_file_ = folder_.path("token");
  ToyStation station_;
  std::unique_ptr<ControlServer> server_;
};

TEST_F(ControlApi, CarriesACheckFromRequestToProgress) {
  CheckRequest request;
  request.serial = "S-1";
  const auto check = client().start(request);
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_EQ(*check, 7U);
  EXPECT_EQ(station_.serial, "S-1");
  const auto progress = client().progress(false);
  ASSERT_TRUE(progress) << progress.error().message;
  EXPECT_EQ(progress->repeats, 20U);
  EXPECT_FALSE(progress->finished);
  const auto status = client().status();
  ASSERT_TRUE(status) << status.error().message;
  EXPECT_EQ(status->state, "IDLE");
}

TEST_F(ControlApi, TellsTheStationWhatTheStartButtonChecks) {
  CheckRequest request;
  request.serial = "S-2";
  const auto taken = client().next(request);
  ASSERT_TRUE(taken) << taken.error().message;
  const auto status = client().status();
  ASSERT_TRUE(status) << status.error().message;
  EXPECT_EQ(status->next_serial, "S-2");
  ASSERT_EQ(status->panel.size(), 1U);
  EXPECT_EQ(status->panel[0].state, "closed");
  EXPECT_TRUE(station_.serial.empty()) << "nothing moves yet";
  request.serial = "";
  EXPECT_FALSE(client().next(request));
  EXPECT_EQ(station_.next_serial, "S-2");
}

TEST_F(ControlApi, GivesRefusalsInTheStationsWords) {
  CheckRequest request;
  request.serial = "BUSY";
  EXPECT_THAT(client().start(request).error().message, HasSubstr("under way"));
  EXPECT_THAT(client().clear().error().message, HasSubstr("still there"));
}

TEST_F(ControlApi, MovesNothingWithoutTheToken) {
  httplib::Client http = this->http();
  for (const char* path : {"/v1/checks", "/v1/next", "/v1/stop", "/v1/clear"}) {
    const auto none = http.Post(path, R"({"serial":"X"})", "application/json");
    ASSERT_TRUE(none);
    EXPECT_EQ(none->status, 401) << path;
    const auto wrong =
        http.Post(path, {{"Authorization", "Bearer 0123"}}, R"({"serial":"X"})", "application/json");
    ASSERT_TRUE(wrong);
    EXPECT_EQ(wrong->status, 401) << path;
  }
  EXPECT_TRUE(station_.serial.empty());
  EXPECT_TRUE(station_.next_serial.empty());
  EXPECT_FALSE(station_.stopped);
}

TEST_F(ControlApi, RefusesPagesOfOtherOrigins) {
  std::string token;
  std::ifstream(token_file_) >> token;
  const auto answer =
      http().Post("/v1/stop", {{"Authorization", "Bearer " + token}, {"Origin", "http://evil.example"}}, "{}",
                  "application/json");
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->status, 403);
  EXPECT_FALSE(station_.stopped);
}

TEST_F(ControlApi, RefusesNonsense) {
  std::string token;
  std::ifstream(token_file_) >> token;
  httplib::Client http = this->http();
  const httplib::Headers headers{{"Authorization", "Bearer " + token}};
  for (const char* body :
       {"", "{", "[]", R"({"serial":5})", R"({"serial":""})", R"({"serial":"X","repeats":100000})"}) {
    const auto answer = http.Post("/v1/checks", headers, body, "application/json");
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->status, 400) << body << ": " << answer->body;
  }
  const auto large = http.Post("/v1/checks", headers, std::string(1 << 20, ' '), "application/json");
  if (large) {
    EXPECT_EQ(large->status, 413);
  }
  EXPECT_TRUE(station_.serial.empty());
  const auto limit = http.Get("/v1/results?limit=-3");
  ASSERT_TRUE(limit);
  EXPECT_EQ(limit->status, 400);
  const auto missing = http.Get("/v1/results/nothing");
  ASSERT_TRUE(missing);
  EXPECT_EQ(missing->status, 404);
}

TEST_F(ControlApi, APortInUseIsAnErrorThatSaysSo) {
  ToyStation other;
  const auto second = ControlServer::start(other, "127.0.0.1", server_->port(), "");
  ASSERT_FALSE(second);
  EXPECT_THAT(second.error().message, HasSubstr("has the port"));
}

TEST(ControlClient, SaysThatNoDaemonAnswers) {
  const control::Client client("127.0.0.1", 1, "");
  EXPECT_THAT(client.status().error().message, HasSubstr("no daemon answers"));
}

}  // namespace
}  // namespace clampd::daemon
