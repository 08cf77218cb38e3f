// What the HTTP server gives away to anybody: a connection's time, its memory, a place in the queue. In front
// of handlers that are made for it, with limits so small that they are reached at once.

#include "clampd/http/server.hpp"

#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <condition_variable>
#include <mutex>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/http/client.hpp"
#include "clampd/http/metrics.hpp"
#include "support/connection.hpp"

namespace clampd::http {
namespace {

using support::answer_to;
using support::Connection;
using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

constexpr std::chrono::hours kForEver{1};

/// Closed at first; once opened, everybody who waits may pass.
class Gate {
 public:
  void pass() {
    std::unique_lock lock(mutex_);
    ++waiting_;
    changed_.notify_all();
    changed_.wait(lock, [this] { return open_; });
  }
  void open() {
    const std::lock_guard lock(mutex_);
    open_ = true;
    changed_.notify_all();
  }
  void wait_for(int count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return waiting_ >= count; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  int waiting_ = 0;
  bool open_ = false;
};

class HttpServer : public ::testing::Test {
 protected:
  HttpServer() {
    settings_.address = "127.0.0.1";
    settings_.limits.request = kForEver;
    settings_.limits.response = kForEver;
    settings_.pools = {{1, 2}};
    settings_.report = [this](const std::string& what) {
      const std::lock_guard lock(mutex_);
      reported_.push_back(what);
    };
  }
  ~HttpServer() override { gate_.open(); }

  void start() {
    auto started = Server::start(settings_, [this](const Request& request) { return route(request); });
    if (!started) throw std::runtime_error(started.error().message);
    server_ = std::move(*started);
  }

  std::variant<Response, Job> route(const Request& request) {
    if (request.path == "/refused") return refusal(403, "no");
    if (request.path == "/router") throw std::runtime_error("the router fell");
    if (request.path == "/large")
      return Job{{}, false, [this](const Request&) { return Response{200, std::string(large_, 'x')}; }};
    if (request.path == "/echo")
      return Job{{}, true, [](const Request& whole) { return Response{200, whole.body}; }};
    if (request.path == "/wait")
      return Job{0, false, [this](const Request&) {
                   gate_.pass();
                   return Response{200, "waited"};
                 }};
    if (request.path == "/nice")
      return Job{
          0, false, [](const Request&) {
            return Response{200, std::to_string(getpriority(PRIO_PROCESS, static_cast<id_t>(gettid())))};
          }};
    const std::optional<std::size_t> pool =
        request.has_parameter("worker") ? std::optional(std::size_t{0}) : std::nullopt;
    return Job{pool, false, [](const Request& whole) -> Response {
                 if (whole.path == "/throws") throw std::runtime_error("the handler fell");
                 if (whole.path == "/memory")
                   throw std::bad_alloc();  // as an answer that is too large for the memory does
                 if (whole.path == "/thing") throw 7;
                 return {200, whole.path};
               }};
  }

  std::string get(const std::string& target) const {
    return answer_to(server_->port(), "GET " + target + " HTTP/1.1\r\nHost: a\r\n\r\n");
  }

  Settings settings_;
  Gate gate_;
  std::size_t large_ = 1024 * 1024;
  std::mutex mutex_;
  std::vector<std::string> reported_;
  std::unique_ptr<Server> server_;
};

TEST_F(HttpServer, AnswersOnceAndCloses) {
  start();
  EXPECT_THAT(get("/hello%20there?x=1"), StartsWith("HTTP/1.1 200 OK\r\n"));
  EXPECT_THAT(get("/hello%20there"), HasSubstr("\r\n\r\n/hello there"));
  EXPECT_THAT(get("/refused"), HasSubstr("403 Forbidden"));
  const std::string head = answer_to(server_->port(), "HEAD /large HTTP/1.1\r\n\r\n");
  EXPECT_THAT(head, HasSubstr("Content-Length: 1048576\r\n"));
  EXPECT_TRUE(head.ends_with("\r\n\r\n"));
  const std::string twice = answer_to(server_->port(), "GET /a HTTP/1.1\r\n\r\nGET /b HTTP/1.1\r\n\r\n");
  EXPECT_THAT(twice, HasSubstr("/a"));
  EXPECT_THAT(twice, ::testing::Not(HasSubstr("/b"))) << "one request a connection";
}

TEST_F(HttpServer, BodiesAreReadWhereTheyAreWantedOnly) {
  start();
  const std::string head = "POST /echo HTTP/1.1\r\nContent-Length: 5\r\n\r\n";
  EXPECT_THAT(answer_to(server_->port(), head + "hello"), HasSubstr("\r\n\r\nhello"));
  EXPECT_THAT(answer_to(server_->port(), "POST /x HTTP/1.1\r\nContent-Length: 5\r\n\r\n"),
              HasSubstr("200 OK"))
      << "answered although the body never comes";
}

TEST_F(HttpServer, RefusesWhatIsTooLargeOrNoRequest) {
  settings_.limits.body = 100;
  start();
  const int port = server_->port();
  EXPECT_THAT(answer_to(port, "POST /echo HTTP/1.1\r\nContent-Length: 101\r\n\r\n"), HasSubstr("413"));
  EXPECT_THAT(answer_to(port, "POST /echo HTTP/1.1\r\nContent-Length: 99999999999999999999\r\n\r\n"),
              HasSubstr("400"));
  EXPECT_THAT(answer_to(port, "GET /" + std::string(20'000, 'a') + " HTTP/1.1\r\n\r\n"), HasSubstr("431"));
  EXPECT_THAT(answer_to(port, "GET / HTTP/1.1\r\nX: " + std::string(20'000, 'a') + "\r\n\r\n"),
              HasSubstr("431"));
  std::string fields;
  for (int i = 0; i < 101; ++i) fields += "a:\r\n";
  EXPECT_THAT(answer_to(port, "GET / HTTP/1.1\r\n" + fields + "\r\n"), HasSubstr("431"));
  for (const char* nonsense :
       {"\r\n\r\n\r\n", "GET\r\n\r\n", "GET / HTTP/9.9\r\n\r\n", "\x16\x03\x01\x02\x00\r\n\r\n",
        "GET a HTTP/1.1\r\n\r\n", "GET /%zz HTTP/1.1\r\n\r\n", "GET /%ff HTTP/1.1\r\n\r\n",
        "GET /?a=1&a=2 HTTP/1.1\r\n\r\n", "GET /%4 HTTP/1.1\r\n\r\n"})
    EXPECT_THAT(answer_to(port, nonsense), HasSubstr("400 Bad Request")) << nonsense;
  settings_.limits.answer = 1000;
  start();
  EXPECT_THAT(get("/large"), HasSubstr("the answer is too large"));
}

TEST_F(HttpServer, GoesOnWhateverAHandlerThrows) {
  start();
  for (const char* target :
       {"/router", "/throws", "/memory", "/thing", "/throws?worker", "/memory?worker", "/thing?worker"})
    EXPECT_THAT(get(target), HasSubstr("500 Internal Server Error")) << target;
  EXPECT_THAT(get("/throws"), HasSubstr(R"({"error":)"));
  EXPECT_THAT(get("/hello"), HasSubstr("200 OK"));
  const std::lock_guard lock(mutex_);
  ASSERT_EQ(reported_.size(), 8U);
  EXPECT_EQ(reported_[1], "GET /throws: the handler fell");
}

TEST_F(HttpServer, AFullQueueIsSaidAtOnceAndKeepsNobodyElseWaiting) {
  start();
  const std::string request = "GET /wait HTTP/1.1\r\n\r\n";
  std::vector<Connection> waiting;
  waiting.emplace_back(server_->port());
  waiting.back().send(request);
  gate_.wait_for(1);
  for (int i = 0; i < 2; ++i) {  // as many as may wait
    waiting.emplace_back(server_->port());
    waiting.back().send(request);
  }
  std::string refused;
  while (refused.find("503") == std::string::npos) {  // until both have arrived
    refused.clear();
    waiting.emplace_back(server_->port());
    waiting.back().send(request);
    refused = waiting.back().receive();
  }
  EXPECT_THAT(refused, HasSubstr("Retry-After: 1\r\n"));
  EXPECT_THAT(get("/hello"), HasSubstr("200 OK")) << "while all workers wait";
  gate_.open();
  for (std::size_t i = 0; i < 3; ++i) EXPECT_THAT(waiting[i].receive(), HasSubstr("waited"));
}

TEST_F(HttpServer, APoolThatIsNotUrgentGoesAfterTheOtherThreads) {
  settings_.pools = {{1, 2, 19}};
  const int before = getpriority(PRIO_PROCESS, static_cast<id_t>(gettid()));
  start();
  EXPECT_THAT(get("/nice"), EndsWith("\r\n\r\n19"));
  EXPECT_EQ(getpriority(PRIO_PROCESS, static_cast<id_t>(gettid())), before);
}

TEST_F(HttpServer, ForOneMoreConnectionTheOldestThatSaysNothingGoes) {
  settings_.limits.connections = 4;
  start();
  std::vector<Connection> silent;
  for (int i = 0; i < 100; ++i) silent.emplace_back(server_->port());
  EXPECT_THAT(get("/hello"), HasSubstr("200 OK"));
  for (std::size_t i = 0; i < 96; ++i) EXPECT_THAT(silent[i].receive(), IsEmpty()) << "closed: " << i;
}

TEST_F(HttpServer, WhoWaitsForAWorkerIsNotDroppedForOthers) {
  settings_.limits.connections = 4;
  start();
  const Connection patient(server_->port());
  patient.send("GET /wait HTTP/1.1\r\n\r\n");
  gate_.wait_for(1);
  std::vector<Connection> silent;
  for (int i = 0; i < 20; ++i) silent.emplace_back(server_->port());
  EXPECT_THAT(silent[0].receive(), IsEmpty());
  gate_.open();
  EXPECT_THAT(patient.receive(), HasSubstr("waited"));
}

TEST_F(HttpServer, WhoDoesNotReadGivesWayToWhoDoes) {
  settings_.limits.answer = 8 * 1024 * 1024;
  settings_.limits.answers = 9 * 1024 * 1024;
  large_ = 6 * 1024 * 1024;  // far more than the kernel takes for who does not read
  start();
  const Connection slow(server_->port());
  slow.send("GET /large HTTP/1.1\r\n\r\n");
  EXPECT_THAT(get("/large"), ::testing::SizeIs(::testing::Gt(large_)));
  EXPECT_THAT(slow.receive(), ::testing::SizeIs(::testing::Lt(large_)));
}

TEST_F(HttpServer, EndsConnectionsThatDawdle) {
  settings_.limits.request = std::chrono::milliseconds(200);
  settings_.limits.response = std::chrono::milliseconds(200);
  settings_.limits.farewell = std::chrono::milliseconds(200);
  large_ = 8 * 1024 * 1024;
  start();
  const Connection unread(server_->port());
  unread.send("GET /large HTTP/1.1\r\n\r\n");
  EXPECT_THAT(get("/hello"), HasSubstr("200 OK"));
  EXPECT_THAT(Connection(server_->port()).receive(), IsEmpty()) << "says nothing";
  EXPECT_THAT(unread.receive(), ::testing::SizeIs(::testing::Lt(large_))) << "its time is over too";
  const Connection dripping(server_->port());
  dripping.send("GET /hello HTTP/1.1\r\nX: ");
  EXPECT_THAT(dripping.receive("x"), IsEmpty()) << "a byte now and then keeps no connection";
  const Connection bodiless(server_->port());
  bodiless.send("POST /echo HTTP/1.1\r\nContent-Length: 5\r\n\r\n");
  EXPECT_THAT(bodiless.receive(), IsEmpty());
}

TEST_F(HttpServer, EndsWhileRequestsWaitAndClientsDawdle) {
  start();
  std::vector<Connection> open;
  for (const char* sent : {"", "GET /", "GET /wait HTTP/1.1\r\n\r\n", "GET /wait HTTP/1.1\r\n\r\n",
                           "GET /large HTTP/1.1\r\n\r\n"}) {
    open.emplace_back(server_->port());
    open.back().send(sent);
  }
  gate_.wait_for(1);
  std::thread opener([this] { gate_.open(); });
  server_.reset();
  opener.join();
}

TEST_F(HttpServer, AnAddressThatIsTakenIsAnError) {
  start();
  settings_.port = server_->port();
  const auto second = Server::start(settings_, [](const Request&) { return refusal(404, ""); });
  ASSERT_FALSE(second);
  EXPECT_THAT(second.error().message, HasSubstr("Address already in use"));
}

TEST(PrometheusText, IsValidWhateverStandsInALabel) {
  Metrics metrics;
  metrics.family("a_total", "counter", "Two\nlines\\.");
  metrics.sample(3.0, {{"station", "say \"hi\"\\\n"}, {"kind", "x"}});
  metrics.sample(0.1);
  metrics.family("b", "gauge", "None.");
  metrics.sample(std::nan(""));
  metrics.sample(-INFINITY);
  metrics.family("c_seconds", "histogram", "Some.");
  metrics.buckets(std::vector<std::pair<double, double>>{{1e-3, 2.0}, {1.0, 5.0}}, 7.5, 6.0);
  EXPECT_EQ(
      metrics.text(),
      "# HELP a_total Two\\nlines\\\\.\n# TYPE a_total counter\n"
      "a_total{station=\"say \\\"hi\\\"\\\\\\n\",kind=\"x\"} 3\na_total 0.1\n"
      "# HELP b None.\n# TYPE b gauge\nb NaN\nb -Inf\n"
      "# HELP c_seconds Some.\n# TYPE c_seconds histogram\n"
      "c_seconds_bucket{le=\"0.001\"} 2\nc_seconds_bucket{le=\"1\"} 5\nc_seconds_bucket{le=\"+Inf\"} 6\n"
      "c_seconds_sum 7.5\nc_seconds_count 6\n");
}

TEST(HttpMessage, TargetsAreDecodedStrictly) {
  const auto target = parse_target("/a%2Fb?serial=a+b%26&x=%C3%A4&empty=&flag");
  ASSERT_TRUE(target);
  EXPECT_EQ(target->path, "/a/b");
  EXPECT_EQ(target->query, (Fields{{"serial", "a b&"}, {"x", "ä"}, {"empty", ""}, {"flag", ""}}));
  for (const char* wrong : {"", "a", "*", "http://a/", "/%", "/%4", "/%+4", "/%g0", "/%c0%80", "/%ed%a0%80",
                            "/%f4%90%80%80", "/?x=1&x=2", "/?x=%ff"})
    EXPECT_FALSE(parse_target(wrong)) << wrong;
}

TEST(HttpMessage, TellsUtf8) {
  for (const char* valid : {"", "a", "ä", "€", "\xf0\x9f\x98\x80", "\xed\x9f\xbf", "\xf4\x8f\xbf\xbf"})
    EXPECT_TRUE(is_utf8(valid)) << valid;
  for (const char* invalid : {"\xff", "\xc3", "\xc3(", "\x80", "\xc1\xbf", "\xe0\x9f\xbf", "\xed\xa0\x80",
                              "\xf0\x8f\xbf\xbf", "\xf4\x90\x80\x80", "\xf5\x80\x80\x80", "\xe2\x82"})
    EXPECT_FALSE(is_utf8(invalid)) << invalid;
}

}  // namespace
}  // namespace clampd::http
