// The control API over real sockets on the loopback interface, in front of a toy station.

#include "tools/clampd/control_server.hpp"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <fstream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/network.hpp"
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
  Result<nlohmann::ordered_json> results(const CheckFilter& filter) override {
    asked = filter;
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
  CheckFilter asked;
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

  std::string token() const {
    std::string text;
    std::ifstream(token_file_) >> text;
    return text;
  }

  /// A connection to the server, as it is.
  int connect() const {
    const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const sockaddr_in address = support::loopback(server_->port());
    EXPECT_EQ(::connect(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    return socket;
  }

  /// What comes back for these very bytes, until the server closes; `drip`: sent every 50 ms until then.
  std::string exchange(const std::string& bytes, const std::string& drip = "") const {
    const int socket = connect();
    for (std::size_t sent = 0; sent < bytes.size();) {
      const ssize_t count = send(socket, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
      if (count <= 0) break;
      sent += static_cast<std::size_t>(count);
    }
    std::string received;
    std::array<char, 4096> buffer;
    while (true) {
      pollfd waiting{socket, POLLIN, 0};
      if (poll(&waiting, 1, 50) == 0) {
        if (!drip.empty()) send(socket, drip.data(), drip.size(), MSG_NOSIGNAL);
        continue;
      }
      const ssize_t count = recv(socket, buffer.data(), buffer.size(), 0);
      if (count <= 0) break;
      received.append(buffer.data(), static_cast<std::size_t>(count));
    }
    close(socket);
    return received;
  }

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

TEST_F(ControlApi, ItsOwnPageMayCommandWithTheToken) {
  const std::string origin = "http://127.0.0.1:" + std::to_string(server_->port());
  const auto answer = http().Post("/v1/stop", {{"Authorization", "Bearer " + token()}, {"Origin", origin}},
                                  "{}", "application/json");
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->status, 200) << answer->body;
  EXPECT_TRUE(station_.stopped);
}

TEST_F(ControlApi, AnswersToItsOwnNamesOnly) {
  httplib::Client http = this->http();
  for (const char* host : {"evil.example", "evil.example:8371", "127.0.0.1.evil.example", "", "[::1"}) {
    const auto answer = http.Get("/v1/status", {{"Host", host}});
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->status, 421) << host;
  }
  for (const char* host : {"localhost", "localhost:8371", "127.0.0.1:1", "[::1]:8371", "192.0.2.7"}) {
    const auto answer = http.Get("/v1/status", {{"Host", host}});
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->status, 200) << host;
  }
  EXPECT_THAT(exchange("GET /v1/status HTTP/1.1\r\n\r\n"), HasSubstr("421"));
}

TEST_F(ControlApi, RefusesWhatAnotherPageCanSendUnasked) {
  httplib::Client http = this->http();
  const httplib::Headers bearer{{"Authorization", "Bearer " + token()}};
  const auto form = http.Post("/v1/stop", bearer, "{}", "text/plain");
  ASSERT_TRUE(form);
  EXPECT_EQ(form->status, 415);
  const auto probe = http.Options("/v1/stop", {{"Origin", "http://evil.example"}});
  ASSERT_TRUE(probe);
  EXPECT_EQ(probe->status, 403);
  const auto put = http.Put("/v1/stop", bearer, "{}", "application/json");
  ASSERT_TRUE(put);
  EXPECT_EQ(put->status, 405);
  const auto read = http.Get("/v1/results", {{"Sec-Fetch-Site", "cross-site"}});
  ASSERT_TRUE(read);
  EXPECT_EQ(read->status, 403);
  EXPECT_FALSE(read->has_header("Access-Control-Allow-Origin"));
  EXPECT_FALSE(station_.stopped);
}

TEST_F(ControlApi, RefusesOversizedRequests) {
  const std::string head =
      "POST /v1/stop HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
      "Authorization: Bearer " +
      token() + "\r\n";
  EXPECT_THAT(exchange(head + "Content-Length: 1000000\r\n\r\n" + std::string(1'000'000, ' ')),
              HasSubstr("413"));
  EXPECT_THAT(exchange(head + "Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n"), HasSubstr("411"));
  std::string headers;
  for (int i = 0; i < 20'000; ++i) headers += "X-" + std::to_string(i) + ": y\r\n";
  EXPECT_THAT(exchange(head + headers + "\r\n"), ::testing::Not(HasSubstr("200 OK")));
  EXPECT_FALSE(station_.stopped);
  EXPECT_TRUE(client().status()) << "and goes on";
}

TEST_F(ControlApi, CutsOffWhoSendsSlowlyWhileOthersAreServed) {
  std::vector<int> silent;
  for (int i = 0; i < 8; ++i) silent.push_back(connect());
  EXPECT_TRUE(client().status());
  const auto begin = std::chrono::steady_clock::now();
  EXPECT_THAT(exchange("GET /v1/status HTTP/1.1\r\nHost: localhost\r\nX-Slow: ", "s"),
              ::testing::Not(HasSubstr("200 OK")))
      << "a byte now and then keeps no connection";
  EXPECT_GT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(1))
      << "but a slow one has its time";
  for (const int socket : silent) close(socket);
}

TEST_F(ControlApi, ServesTheScreenUnderAPolicyThatLetsNothingElseIn) {
  for (const char* path : {"/", "/screen.js", "/charts.js", "/screen.css", "/icon.svg"}) {
    const auto answer = http().Get(path);
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->status, 200) << path;
    EXPECT_THAT(answer->get_header_value("Content-Security-Policy"), HasSubstr("default-src 'self'"));
    EXPECT_EQ(answer->get_header_value("X-Content-Type-Options"), "nosniff");
    EXPECT_EQ(answer->body.find("//cdn"), std::string::npos);
  }
  for (const char* path : {"/../etc/passwd", "/%2e%2e/etc/passwd", "/token", "/v1/results/..%2ftoken"}) {
    const auto answer = http().Get(path);
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->status, 404) << path;
  }
}

TEST_F(ControlApi, KeepsItsTokenOverARestartButTakesNobodyElses) {
  const std::string before = token();
  server_.reset();
  auto again = ControlServer::start(station_, "127.0.0.1", 0, token_file_);
  ASSERT_TRUE(again);
  EXPECT_EQ(token(), before);
  again->reset();
  ASSERT_EQ(chmod(token_file_.c_str(), 0666), 0);
  again = ControlServer::start(station_, "127.0.0.1", 0, token_file_);
  ASSERT_TRUE(again);
  EXPECT_NE(token(), before) << "a file that anybody could have written";
  again->reset();
  std::ofstream(token_file_) << "short\n";
  again = ControlServer::start(station_, "127.0.0.1", 0, token_file_);
  ASSERT_TRUE(again);
  EXPECT_EQ(token().size(), 64U);
}

TEST_F(ControlApi, RefusesNonsense) {
  httplib::Client http = this->http();
  const httplib::Headers headers{{"Authorization", "Bearer " + token()}};
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
  for (const char* query : {"since=yesterday", "until=2026-11-21T14%3A30%2B02%3A00", "verdict=GOOD"})
    EXPECT_EQ(http.Get(std::string("/v1/results?") + query)->status, 400) << query;
  ASSERT_EQ(http.Get("/v1/results?serial=S&part_number=P&batch=B&operator=Jo&verdict=FAIL&since=2026-11-20&"
                     "until=2026-11-21T14%3A30Z&limit=7")
                ->status,
            200);
  const CheckFilter& asked = station_.asked;
  EXPECT_EQ(asked.serial + asked.part_number + asked.batch + asked.operator_name, "SPBJo");
  EXPECT_EQ(asked.verdict, Verdict::Fail);
  EXPECT_EQ(asked.since + " " + asked.until, "2026-11-20 2026-11-21T14:30Z");
  EXPECT_EQ(asked.limit, 7U);
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

/// As systemd's: the socket is another's too, and has to outlive each server that it is lent to.
TEST(InheritedControlSocket, ServesAgainAfterARestart) {
  int port = 0;
  const int shared = support::listening_socket(port);
  ToyStation station;
  for (int start = 0; start < 3; ++start) {
    const auto server = ControlServer::start(station, "127.0.0.1", port, "", dup(shared));
    ASSERT_TRUE(server) << server.error().message;
    const auto status = control::Client("127.0.0.1", port, "").status();
    ASSERT_TRUE(status) << status.error().message;
    EXPECT_EQ(status->state, "IDLE");
  }
  close(shared);
}

}  // namespace
}  // namespace clampd::daemon
