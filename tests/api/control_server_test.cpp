// The control API over real sockets on the loopback interface, in front of a toy station.

#include "clampd/api/control_server.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/api/messages.hpp"
#include "clampd/api/metrics.hpp"
#include "clampd/api/secret_file.hpp"
#include "clampd/http/client.hpp"
#include "support/command.hpp"
#include "support/connection.hpp"
#include "support/network.hpp"
#include "support/temporary_directory.hpp"
#include "tools/dashboard/assets.hpp"

namespace clampd::api {
namespace {

using support::Connection;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

class ToyStation final : public ControlTarget {
 public:
  api::StationStatus status() override {
    wait_where_held();
    api::StationStatus status;
    status.state = "IDLE";
    status.next_serial = next_serial;
    status.panel = {{"gpiochip0 line 4 (emergency stop)", "emergency stop", "closed"}};
    return status;
  }
  std::string metrics() override {
    api::StationStatus status;
    status.state = "IDLE";
    return station_metrics(status, {});
  }
  rt::StartTicket ticket() const override { return {}; }
  Result<api::StartedCheck> start(const CheckRequest& request, const rt::StartTicket&,
                                  std::optional<std::uint64_t> stops_seen) override {
    wait_where_held();
    if (request.serial == "BUSY") return failure("a check is under way");
    serial = request.serial;
    asked_for = request;
    seen = stops_seen;
    return api::StartedCheck{7, "id-7"};
  }
  Result<std::string> open(const rt::StartTicket&, std::optional<std::uint64_t> stops_seen) override {
    seen = stops_seen;
    opened = true;
    return std::string("open-1");
  }
  Result<void> next(const CheckRequest& request) override {
    next_serial = request.serial;
    return {};
  }
  api::CheckProgress progress(bool) override {
    const std::lock_guard lock(mutex_);
    api::CheckProgress progress;
    progress.check = 7;
    progress.id = id_;
    progress.repeats = 20;
    progress.finished = !finished_.empty();
    if (progress.finished) progress.record = nlohmann::ordered_json::parse(finished_);
    return progress;
  }
  Result<void> stop() override {
    stopped = true;
    return {};
  }
  Result<void> clear() override { return failure("its cause is still there"); }
  Result<nlohmann::ordered_json> results(const CheckFilter& filter) override {
    wait_where_held();
    const std::lock_guard lock(mutex_);
    asked = filter;
    return nlohmann::ordered_json::array();
  }
  Result<nlohmann::ordered_json> result(const std::string& wanted) override {
    if (wanted == "falls") throw std::runtime_error("the archive fell");
    if (wanted == "memory") throw std::bad_alloc();
    return failure("no check " + wanted);
  }
  Result<nlohmann::ordered_json> run(const std::string& wanted, std::size_t number) override {
    return nlohmann::ordered_json{{"of", wanted}, {"run", number}};
  }
  Result<nlohmann::ordered_json> statistics(const CheckFilter& filter) override {
    const std::lock_guard lock(mutex_);
    asked = filter;
    return nlohmann::ordered_json::object();
  }
  nlohmann::ordered_json reference() override { return nlohmann::ordered_json::object(); }
  nlohmann::ordered_json live(std::uint64_t run, std::size_t row) override {
    return {{"run", run}, {"row", row}};
  }

  /// The check under way is this one from now on, and has ended with this record.
  void finish(const std::string& id, const std::string& record) {
    const std::lock_guard lock(mutex_);
    id_ = id;
    finished_ = record;
  }

  /// As a disk or a lock that somebody else has: whoever asks for something waits until it is let go.
  void hold() {
    const std::lock_guard lock(mutex_);
    held_ = true;
  }
  void let_go() {
    const std::lock_guard lock(mutex_);
    held_ = false;
    changed_.notify_all();
  }
  void wait_for_waiting(int count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return waiting_ >= count; });
  }

  std::string serial;
  std::string next_serial;
  CheckRequest asked_for;
  CheckFilter asked;
  std::atomic<bool> stopped{false};
  bool opened = false;
  std::optional<std::uint64_t> seen;

 private:
  void wait_where_held() {
    std::unique_lock lock(mutex_);
    ++waiting_;
    changed_.notify_all();
    changed_.wait(lock, [this] { return !held_; });
    --waiting_;
  }

  std::mutex mutex_;
  std::string id_ = "id-7";
  std::string finished_;
  std::condition_variable changed_;
  bool held_ = false;
  int waiting_ = 0;
};

class ControlApi : public ::testing::Test {
 protected:
  void SetUp() override { restart(); }
  void TearDown() override { station_.let_go(); }

  void restart() {
    server_.reset();
    auto started = ControlServer::start(station_, settings_, dashboard::assets());
    ASSERT_TRUE(started) << started.error().message;
    server_ = std::move(*started);
  }
  api::Client client() const { return api::Client("127.0.0.1", server_->port(), settings_.token_file); }

  std::string token() const {
    std::string text;
    std::ifstream(settings_.token_file) >> text;
    return text;
  }
  http::Fields bearer() const { return {{"Authorization", "Bearer " + token()}}; }

  http::Answer ask(const http::Call& call) const {
    const auto answer = http::exchange("127.0.0.1", server_->port(), call);
    EXPECT_TRUE(answer) << call.method << " " << call.path << ": " << answer.error().message;
    return answer.value_or(http::Answer{});
  }
  http::Answer get(const std::string& path, http::Fields headers = {}) const {
    return ask({"GET", path, std::move(headers)});
  }
  http::Answer post(const std::string& path, const std::string& body, http::Fields headers = {}) const {
    return ask({"POST", path, std::move(headers), body});
  }
  /// Readers of records until nobody is left who could answer another one.
  std::vector<Connection> occupy_the_archive() {
    station_.hold();
    std::vector<Connection> waiting;
    for (int i = 0; i < 2; ++i) {
      waiting.emplace_back(server_->port());
      waiting.back().send("GET /v1/results HTTP/1.1\r\nHost: localhost\r\n\r\n");
    }
    station_.wait_for_waiting(2);
    return waiting;
  }
  std::string exchange(const std::string& bytes) const { return support::answer_to(server_->port(), bytes); }

  support::TemporaryDirectory folder_;
  ControlSettings settings_{"127.0.0.1", 0, folder_.path("token"), {}};
  ToyStation station_;
  std::unique_ptr<ControlServer> server_;
};

TEST_F(ControlApi, CarriesACheckFromRequestToProgress) {
  CheckRequest request;
  request.serial = "S-1";
  const auto check = client().start(request);
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_EQ(check->check, 7U);
  EXPECT_EQ(check->id, "id-7");
  EXPECT_FALSE(station_.seen);
  ASSERT_TRUE(client().start(request, 3));
  EXPECT_EQ(station_.seen, 3U);
  EXPECT_EQ(station_.serial, "S-1");
  const auto progress = client().progress(false);
  ASSERT_TRUE(progress) << progress.error().message;
  EXPECT_EQ(progress->repeats, 20U);
  EXPECT_EQ(progress->id, "id-7");
  EXPECT_FALSE(progress->finished);
  const auto status = client().status();
  ASSERT_TRUE(status) << status.error().message;
  EXPECT_EQ(status->state, "IDLE");
}

TEST_F(ControlApi, OpensABrakeThatStaysClamped) {
  const auto opening = client().open();
  ASSERT_TRUE(opening) << opening.error().message;
  EXPECT_EQ(*opening, "open-1");
  EXPECT_TRUE(station_.opened);
}

/// A daemon that was restarted, and works on another brake under the same number.
TEST_F(ControlApi, NoOtherBrakesVerdictIsTakenForTheOneThatWasAskedFor) {
  const std::string configuration = folder_.write(
      "station.toml", "[can]\ninterface = \"vcan9\"\n[control]\nport = " + std::to_string(server_->port()) +
                          "\ntoken_file = \"token\"\n");
  const auto run = [&] {
    return support::run_command(std::string(CLAMPCTL) + " --config " + configuration + " run --serial A");
  };
  station_.finish("id-7", R"({"serial":"A","record":"id-7","verdict":"PASS"})");
  EXPECT_EQ(run().exit_code, 0) << "or this proves nothing";
  station_.finish("id-8", R"({"serial":"B","record":"id-8","verdict":"PASS"})");
  const support::Outcome other = run();
  EXPECT_EQ(other.exit_code, 3) << other.output;
  EXPECT_THAT(other.output, HasSubstr("restarted or works on another check"));
  station_.finish("id-7", R"({"serial":"B","record":"id-7","verdict":"PASS"})");
  EXPECT_EQ(run().exit_code, 3);
}

TEST_F(ControlApi, AClientsRequestArrivesAsItWasMade) {
  const CheckRequest request{"S-1", 3, "Jo Müller", "P-1", "B-1"};
  ASSERT_TRUE(client().start(request));
  const CheckRequest& taken = station_.asked_for;
  EXPECT_EQ(taken.serial + "|" + taken.operator_name + "|" + taken.part_number + "|" + taken.batch,
            "S-1|Jo Müller|P-1|B-1");
  EXPECT_EQ(taken.repeats, 3U);
  ASSERT_TRUE(client().start({"S-2"}));
  EXPECT_EQ(station_.asked_for.repeats, 0U) << "as the station is set to";
  EXPECT_FALSE(station_.asked_for.repeats_auto);
  ASSERT_TRUE(client().start({.serial = "S-3", .repeats_auto = true}));
  EXPECT_TRUE(station_.asked_for.repeats_auto);
  const auto spoiled = client().start({"S\xff"});
  ASSERT_FALSE(spoiled);
  EXPECT_THAT(spoiled.error().message, HasSubstr("UTF-8"));
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

// Who may.

TEST_F(ControlApi, MovesNothingWithoutTheToken) {
  for (const char* path : {"/v1/checks", "/v1/open", "/v1/next", "/v1/clear"}) {
    EXPECT_EQ(post(path, R"({"serial":"X"})").status, 401) << path;
    EXPECT_EQ(post(path, R"({"serial":"X"})", {{"Authorization", "Bearer 0123"}}).status, 401) << path;
  }
  EXPECT_TRUE(station_.serial.empty());
  EXPECT_TRUE(station_.next_serial.empty());
}

TEST_F(ControlApi, AStopFromThisMachineNeedsNoToken) {
  EXPECT_EQ(post("/v1/stop", "{}").status, 200);
  EXPECT_TRUE(station_.stopped);
  station_.stopped = false;
  const api::Client without("127.0.0.1", server_->port(), folder_.path("no-such-token"));
  EXPECT_TRUE(without.stop());
  EXPECT_TRUE(station_.stopped);
  EXPECT_FALSE(without.clear());
  const auto session = nlohmann::json::parse(get("/v1/session").body);
  EXPECT_EQ(session.at("may_stop"), true);
  EXPECT_EQ(session.at("may_command"), false);
}

TEST_F(ControlApi, AStopThatAProxyPassesOnNeedsIt) {
  settings_.origins = {"https://station7.example"};
  restart();
  for (const http::Fields& passed_on :
       {http::Fields{{"X-Forwarded-For", "192.0.2.7"}}, http::Fields{{"Forwarded", "for=192.0.2.7"}},
        http::Fields{{"Via", "1.1 proxy"}}, http::Fields{{"Host", "station7.example"}},
        http::Fields{{"Origin", "https://station7.example"}}}) {
    EXPECT_EQ(post("/v1/stop", "{}", passed_on).status, 401) << passed_on[0].first;
    EXPECT_FALSE(station_.stopped);
  }
}

TEST_F(ControlApi, RefusesPagesOfOtherOrigins) {
  for (const char* origin : {"http://evil.example", "null", "https://127.0.0.1", ""}) {
    EXPECT_EQ(post("/v1/stop", "{}", {{"Origin", origin}}).status, 403) << origin;
    http::Fields headers = bearer();
    headers.emplace_back("Origin", origin);
    EXPECT_EQ(post("/v1/stop", "{}", headers).status, 403) << origin;
  }
  EXPECT_FALSE(station_.stopped);
}

TEST_F(ControlApi, ItsOwnPageMayCommandWithTheToken) {
  http::Fields headers = bearer();
  headers.emplace_back("Origin", "http://127.0.0.1:" + std::to_string(server_->port()));
  EXPECT_EQ(post("/v1/next", R"({"serial":"X"})", headers).status, 200);
  EXPECT_EQ(station_.next_serial, "X");
}

TEST_F(ControlApi, ThePageBehindAProxyMayTooOnceTheProxyIsNamed) {
  http::Fields headers = bearer();
  headers.emplace_back("Host", "station7.example");
  headers.emplace_back("Origin", "https://station7.example");
  EXPECT_EQ(post("/v1/next", R"({"serial":"X"})", headers).status, 421);
  headers[1].second = "localhost:8371";
  EXPECT_EQ(post("/v1/next", R"({"serial":"X"})", headers).status, 403);
  settings_.origins = {"https://station7.example", "https://station7.example:8443"};
  restart();
  headers[0] = bearer()[0];
  EXPECT_EQ(post("/v1/next", R"({"serial":"A"})", headers).status, 200) << "the proxy says its own host";
  headers[1].second = "Station7.example";
  EXPECT_EQ(post("/v1/next", R"({"serial":"B"})", headers).status, 200)
      << "the proxy passes the page's host on";
  EXPECT_EQ(get("/", {{"Host", "station7.example:8443"}}).status, 200);
  headers[2].second = "http://station7.example";
  EXPECT_EQ(post("/v1/next", R"({"serial":"C"})", headers).status, 403) << "only as it is named";
  EXPECT_EQ(get("/", {{"Host", "station8.example"}}).status, 421);
  EXPECT_EQ(station_.next_serial, "B");
}

TEST_F(ControlApi, AnswersToItsOwnNamesOnly) {
  for (const char* host : {"evil.example", "evil.example:8371", "127.0.0.1.evil.example", "", "[::1"})
    EXPECT_EQ(get("/v1/status", {{"Host", host}}).status, 421) << host;
  for (const char* host : {"localhost", "LocalHost:8371", "127.0.0.1:1", "[::1]:8371", "192.0.2.7"})
    EXPECT_EQ(get("/v1/status", {{"Host", host}}).status, 200) << host;
  EXPECT_THAT(exchange("GET /v1/status HTTP/1.1\r\n\r\n"), HasSubstr("421"));
  EXPECT_THAT(exchange("GET /v1/status HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n"),
              HasSubstr("421"));
}

TEST_F(ControlApi, RefusesWhatAnotherPageCanSendUnasked) {
  http::Call form{"POST", "/v1/stop", bearer(), "{}"};
  form.headers.emplace_back("Content-Type", "text/plain");
  EXPECT_EQ(ask(form).status, 415);
  EXPECT_EQ(ask({"OPTIONS", "/v1/stop", {{"Origin", "http://evil.example"}}}).status, 403);
  EXPECT_EQ(ask({"PUT", "/v1/stop", bearer(), "{}"}).status, 405);
  const http::Answer read = get("/v1/results", {{"Sec-Fetch-Site", "cross-site"}});
  EXPECT_EQ(read.status, 403);
  EXPECT_EQ(read.header("Access-Control-Allow-Origin"), "");
  EXPECT_FALSE(station_.stopped);
}

TEST_F(ControlApi, ServesTheScreenUnderAPolicyThatLetsNothingElseIn) {
  for (const char* path : {"/", "/screen.js", "/charts.js", "/screen.css", "/icon.svg"}) {
    const http::Answer answer = get(path);
    EXPECT_EQ(answer.status, 200) << path;
    EXPECT_THAT(answer.header("Content-Security-Policy"), HasSubstr("default-src 'self'"));
    EXPECT_EQ(answer.header("X-Content-Type-Options"), "nosniff");
    EXPECT_EQ(answer.body.find("//cdn"), std::string::npos);
  }
  for (const char* path :
       {"/../etc/passwd", "/%2e%2e/etc/passwd", "/token", "/v1/results/..%2ftoken", "/v1/results/",
        "/v1/results/a/runs", "/v1/results/a/runs/", "/v1/results/a/runs/1/2", "/v1", "//"})
    EXPECT_EQ(get(path).status, 404) << path;
}

// What is understood, and what is not.

TEST_F(ControlApi, RefusesForms) {
  const std::string head =
      "POST /v1/stop HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
      "Authorization: Bearer " +
      token() + "\r\n";
  EXPECT_THAT(exchange(head + "Content-Length: 1000000\r\n\r\n" + std::string(1'000'000, ' ')),
              HasSubstr("413"));
  EXPECT_THAT(exchange(head + "Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n"), HasSubstr("411"));
  EXPECT_THAT(exchange(head + "Expect: 100-continue\r\nContent-Length: 2\r\n\r\n"), HasSubstr("417"));
  std::string headers;
  for (int i = 0; i < 20'000; ++i) headers += "X-" + std::to_string(i) + ": y\r\n";
  EXPECT_THAT(exchange(head + headers + "\r\n"), HasSubstr("431"));
  EXPECT_FALSE(station_.stopped);
}

TEST_F(ControlApi, NothingIsDecompressed) {
  for (const char* coding : {"br", "gzip", "deflate", "identity, br", ""}) {
    http::Call call{"POST", "/v1/checks", bearer(), std::string(835, '\x5b')};
    call.headers.emplace_back("Content-Encoding", coding);
    EXPECT_EQ(ask(call).status, 415) << coding;
  }
}

TEST_F(ControlApi, AnswersAreWholeAndOnceWhateverRangesAreAskedFor) {
  std::string ranges = "bytes=0-";
  while (ranges.size() < 8'000) ranges += ",0-";
  const http::Answer whole = get("/screen.js");
  const http::Answer answer = get("/screen.js", {{"Range", ranges}});
  EXPECT_EQ(answer.status, 200);
  EXPECT_EQ(answer.body.size(), whole.body.size());
}

TEST_F(ControlApi, RefusesCheckRequestsThatItDoesNotUnderstand) {
  const std::vector<std::pair<const char*, const char*>> refused{
      {"", "JSON"},
      {"{", "JSON"},
      {"{\"serial\":\"\xff\"}", "UTF-8"},
      {R"({"serial":"\ud800"})", "UTF-8"},
      {"[]", "object"},
      {R"({"serial":5})", "serial must be a text"},
      {R"({"serial":null})", "serial must be a text"},
      {R"({"serial":""})", "serial number is empty"},
      {R"({"serial":" \t "})", "serial number is empty"},
      {R"({})", "serial number is empty"},
      {R"({"serial":"a\u0000b"})", "control characters"},
      {R"({"serial":"X","repeats":0})", "repeats must be a whole number from 1 to 200"},
      {R"({"serial":"X","repeats":-1})", "repeats must be"},
      {R"({"serial":"X","repeats":201})", "repeats must be"},
      {R"({"serial":"X","repeats":4294967297})", "repeats must be"},
      {R"({"serial":"X","repeats":1e99})", "repeats must be"},
      {R"({"serial":"X","repeats":3.5})", "repeats must be"},
      {R"({"serial":"X","repeats":true})", "repeats must be"},
      {R"({"serial":"X","repeats":"3"})", "repeats must be"},
      {R"({"serial":"X","repeats":null})", "repeats must be"},
      {R"({"serial":"X","repeats":"Auto"})", R"(or "auto" for as many as the brake needs)"},
      {R"({"serial":"X","Operator":"Jo"})", R"(no "Operator"; it has serial, repeats, operator)"},
      {R"({"serial":"X","operator":"Jo","operator_name":"Jo"})", "the same"}};
  for (const auto& [body, says] : refused)
    for (const char* path : {"/v1/checks", "/v1/next"}) {
      const http::Answer answer = post(path, body, bearer());
      EXPECT_EQ(answer.status, 400) << body;
      const auto error = nlohmann::json::parse(answer.body).at("error").get<std::string>();
      EXPECT_THAT(error, HasSubstr(says)) << body;
    }
  EXPECT_TRUE(station_.serial.empty());
  EXPECT_TRUE(station_.next_serial.empty());
}

TEST_F(ControlApi, TakesCheckRequestsAsPeopleWriteThem) {
  ASSERT_EQ(post("/v1/checks", R"({"serial":"  S-1\n","operator":" Jo ","repeats":200})", bearer()).status,
            200);
  EXPECT_EQ(station_.asked_for.serial, "S-1");
  EXPECT_EQ(station_.asked_for.operator_name, "Jo");
  EXPECT_EQ(station_.asked_for.repeats, 200U);
  ASSERT_EQ(post("/v1/checks", R"({"serial":"S-1","operator_name":"Jo","repeats":1})", bearer()).status, 200);
  EXPECT_EQ(station_.asked_for.operator_name, "Jo");
}

TEST_F(ControlApi, ListsAndStatisticsTakeTheSameFilters) {
  for (const std::string path : {"/v1/results?", "/v1/statistics?"}) {
    for (const char* query :
         {"since=yesterday", "until=2026-11-21T14%3A30%2B02%3A00", "verdict=GOOD", "limit=-3", "limit=0",
          "limit=1001", "limit=4294967297", "limit=7x", "limit=", "limit=1&limit=2", "serial=%ff"})
      EXPECT_EQ(get(path + query).status, 400) << path << query;
    ASSERT_EQ(get(path + "serial=S&part_number=P&batch=B&operator=Jo&verdict=FAIL&since=2026-11-20&"
                         "until=2026-11-21T14%3A30Z&limit=7")
                  .status,
              200);
    const CheckFilter asked = std::exchange(station_.asked, {});
    EXPECT_EQ(asked.serial + asked.part_number + asked.batch + asked.operator_name, "SPBJo");
    EXPECT_EQ(asked.verdict, Verdict::Fail);
    EXPECT_EQ(asked.since + " " + asked.until, "2026-11-20 2026-11-21T14:30Z");
    EXPECT_EQ(asked.limit, 7U);
  }
}

TEST_F(ControlApi, RefusesParametersThatARouteHasNot) {
  const http::Answer answer = get("/v1/statistics?part=P-17");
  EXPECT_EQ(answer.status, 400);
  EXPECT_THAT(answer.body, AllOf(HasSubstr("no parameter \\\"part\\\""), HasSubstr("part_number, batch")));
  for (const char* path :
       {"/?x=1", "/v1/status?x", "/v1/results/A?x=1", "/v1/live?colour=1", "/v1/checks/current?colour=2",
        "/v1/live?run=-1", "/v1/live?row=4294967296", "/v1/session?token=1"})
    EXPECT_EQ(get(path).status, 400) << path;
  EXPECT_EQ(post("/v1/stop?x=1", "{}").status, 400);
  EXPECT_FALSE(station_.stopped);
}

TEST_F(ControlApi, SaysWhatAPathTakes) {
  const http::Answer wrong = get("/v1/stop");
  EXPECT_EQ(wrong.status, 405);
  EXPECT_EQ(wrong.header("Allow"), "POST");
  EXPECT_EQ(post("/v1/status", "{}", bearer()).status, 405);
  EXPECT_EQ(post("/v1/nothing", "{}", bearer()).status, 404);
  EXPECT_EQ(get("/v1/results/nothing").status, 404);
  EXPECT_EQ(get("/v1/results/A/runs/x").status, 404);
  EXPECT_EQ(get("/v1/results/A/runs/99999999").status, 404);
  EXPECT_EQ(get("/v1/results/2026%3AA/runs/3").body, R"({"of":"2026:A","run":3})");
  EXPECT_EQ(ask({"HEAD", "/v1/status"}).status, 200);
}

// What others do to the server.

TEST_F(ControlApi, AHandlerThatThrowsEndsItsRequestOnly) {
  EXPECT_EQ(get("/v1/results/falls").status, 500);
  EXPECT_EQ(get("/v1/results/memory").status, 500);
  EXPECT_TRUE(client().status());
}

TEST_F(ControlApi, AStopIsAnsweredWhileEverythingElseWaits) {
  station_.hold();
  const std::string starting =
      "POST /v1/checks HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
      "Authorization: Bearer " +
      token() + "\r\nContent-Length: 14\r\n\r\n{\"serial\":\"A\"}";
  std::vector<Connection> waiting;
  for (int i = 0; i < 80; ++i)
    for (const std::string& request :
         {std::string("GET /v1/status HTTP/1.1\r\nHost: localhost\r\n\r\n"),
          std::string("GET /v1/results HTTP/1.1\r\nHost: localhost\r\n\r\n"), starting}) {
      waiting.emplace_back(server_->port());
      waiting.back().send(request);
    }
  station_.wait_for_waiting(4);  // every worker
  EXPECT_EQ(get("/v1/session").status, 200);
  EXPECT_TRUE(client().stop());
  EXPECT_TRUE(station_.stopped);
  station_.let_go();
  int answered = 0;
  int refused = 0;
  for (const Connection& connection : waiting) {
    const std::string answer = connection.receive();
    answered += answer.starts_with("HTTP/1.1 200") ? 1 : 0;
    refused += answer.starts_with("HTTP/1.1 503") ? 1 : 0;
  }
  EXPECT_EQ(answered + refused, 240) << "and nobody is forgotten";
  EXPECT_GT(refused, 100);
  EXPECT_GT(answered, 20);
}

TEST_F(ControlApi, StatusIsAnsweredWhileTheArchiveWaits) {
  const std::vector<Connection> waiting = occupy_the_archive();
  EXPECT_EQ(get("/v1/reference").status, 200) << "by the worker that also says what the station does now";
  EXPECT_EQ(post("/v1/next", R"({"serial":"X"})", bearer()).status, 200);
}

TEST_F(ControlApi, MetricsNeedNoTokenAndDoNotWaitForTheArchive) {
  const std::vector<Connection> waiting = occupy_the_archive();
  const http::Answer scrape = get("/metrics");
  EXPECT_EQ(scrape.status, 200);
  EXPECT_THAT(scrape.header("Content-Type"), StartsWith("text/plain; version=0.0.4"));
  EXPECT_THAT(scrape.body, HasSubstr("\nclampd_state{state=\"IDLE\"} 1\n"));
  EXPECT_EQ(post("/metrics", "{}", bearer()).status, 405);
  EXPECT_EQ(get("/metrics?x=1").status, 400);
}

TEST_F(ControlApi, AStopIsAnsweredUnderAThousandSilentAndSlowClients) {
  support::allow_open_files(4096);
  std::vector<Connection> clients;
  const std::vector<std::string> beginnings{"", "P", "POST /v1/stop HTTP/1.1\r\nHost: localhost\r\nX-Slow: ",
                                            "POST /v1/checks HTTP/1.1\r\nHost: localhost\r\nContent-Type: "
                                            "application/json\r\nAuthorization: Bearer " +
                                                token() + "\r\nContent-Length: 60000\r\n\r\n{",
                                            "GET /screen.js HTTP/1.1\r\nHost: localhost\r\n\r\n"};
  for (std::size_t i = 0; i < 1000; ++i) {
    clients.emplace_back(server_->port());
    clients.back().take_little();
    clients.back().send(beginnings[i % beginnings.size()]);
  }
  EXPECT_TRUE(client().stop());
  EXPECT_TRUE(station_.stopped);
  EXPECT_TRUE(client().status());
  EXPECT_EQ(clients.size(), 1000U) << "all of them are connected still, as far as they know";
}

TEST_F(ControlApi, APortInUseIsAnErrorThatSaysSo) {
  ToyStation other;
  const auto second =
      ControlServer::start(other, {"127.0.0.1", static_cast<std::uint16_t>(server_->port()), "", {}}, {});
  ASSERT_FALSE(second);
  EXPECT_THAT(second.error().message, HasSubstr("has the port"));
}

// The token and its file.

TEST_F(ControlApi, KeepsItsTokenOverARestart) {
  const std::string before = token();
  EXPECT_EQ(before.size(), 64U);
  restart();
  EXPECT_EQ(token(), before);
}

TEST_F(ControlApi, TakesNoTokenThatOthersCouldHaveWrittenOrRead) {
  for (const mode_t loose : {0666U, 0660U, 0644U, 0604U, 0602U}) {
    const std::string before = token();
    ASSERT_EQ(chmod(settings_.token_file.c_str(), loose), 0);
    restart();
    EXPECT_NE(token(), before);
    EXPECT_EQ(token().size(), 64U);
    EXPECT_EQ(std::filesystem::status(settings_.token_file).permissions(), std::filesystem::perms{0640})
        << loose;
  }
}

TEST_F(ControlApi, ReplacesWhatIsNoTokenFile) {
  const std::string good = token();
  for (const std::string content :
       {"short\n", "", "not hexadecimal, but as long as a token has to be to pass for one!!!!\n"}) {
    std::ofstream(settings_.token_file) << content;
    restart();
    EXPECT_EQ(token().size(), 64U);
    EXPECT_NE(token(), good);
  }
  std::filesystem::create_hard_link(settings_.token_file, folder_.path("second-name"));
  const std::string linked = token();
  restart();
  EXPECT_NE(token(), linked);
}

TEST_F(ControlApi, FollowsNoSymbolicLink) {
  const std::string elsewhere = folder_.write("elsewhere", token() + "\n");
  ASSERT_EQ(chmod(elsewhere.c_str(), 0640), 0);
  const std::string before = folder_.read("elsewhere");
  std::filesystem::remove(settings_.token_file);
  std::filesystem::create_symlink(elsewhere, settings_.token_file);
  restart();
  EXPECT_FALSE(std::filesystem::is_symlink(settings_.token_file));
  EXPECT_NE(token() + "\n", before);
  EXPECT_EQ(folder_.read("elsewhere"), before);
}

TEST_F(ControlApi, ATokenThatCannotBeWrittenIsAnError) {
  ControlSettings settings = settings_;
  settings.token_file = folder_.path("no/such/folder/token");
  const auto started = ControlServer::start(station_, settings, {});
  ASSERT_FALSE(started);
  EXPECT_THAT(started.error().message,
              AllOf(HasSubstr("no/such/folder/token"), HasSubstr("control.token_file")));
}

TEST(SecretFile, HasItsPermissionsWhateverStoodThere) {
  const support::TemporaryDirectory folder;
  const std::string file = folder.write("secret", "old");
  ASSERT_EQ(chmod(file.c_str(), 0666), 0);
  ASSERT_TRUE(api::write_secret_file(file, "new", 0600));
  EXPECT_EQ(std::filesystem::status(file).permissions(), std::filesystem::perms{0600});
  EXPECT_EQ(folder.read("secret"), "new");
  EXPECT_EQ(folder.entries(), 1U);
}

TEST(ControlClient, SaysThatNoDaemonAnswers) {
  const api::Client client("127.0.0.1", 1, "");
  EXPECT_THAT(client.status().error().message, HasSubstr("no daemon answers"));
}

/// As systemd's: the socket is another's too, and has to outlive each server that it is lent to.
TEST(InheritedControlSocket, ServesAgainAfterARestart) {
  int port = 0;
  const int shared = support::listening_socket(port);
  ToyStation station;
  for (int start = 0; start < 3; ++start) {
    const auto server = ControlServer::start(station, {"127.0.0.1", static_cast<std::uint16_t>(port), "", {}},
                                             {}, dup(shared));
    ASSERT_TRUE(server) << server.error().message;
    const auto status = api::Client("127.0.0.1", port, "").status();
    ASSERT_TRUE(status) << status.error().message;
    EXPECT_EQ(status->state, "IDLE");
  }
  close(shared);
}

}  // namespace
}  // namespace clampd::api
