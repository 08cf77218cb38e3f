// What clients without good intentions can make of the daemon: its memory, its end, its deafness to a stop.

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/store.hpp"
#include "clampd/http/client.hpp"
#include "faults/station.hpp"
#include "support/check_records.hpp"
#include "support/connection.hpp"

namespace clampd::faults {
namespace {

using support::Connection;
using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr std::size_t kMegabyte = 1024 * 1024;
constexpr std::size_t kMaxGrowth = 64 * kMegabyte;
constexpr int kChecksOnRecord = 200;

class Hostile : public ::testing::Test {
 protected:
  Hostile() {
    support::allow_open_files(4096);
    std::filesystem::create_directories(station_.folder().path("state"));
    auto store = CheckStore::open(station_.database());
    for (int i = 0; store && i < kChecksOnRecord; ++i)
      EXPECT_TRUE(store->save(support::make_check_record(fmt::format("20261120T234107123Z-{:08x}", i))));
  }
  void SetUp() override {
    station_.start();
    ASSERT_TRUE(station_.wait_for_idle()) << station_.log();
    idle_ = memory("VmRSS:");
    ASSERT_GT(idle_, 0U);
  }
  void TearDown() override {
    EXPECT_TRUE(station_.client().status()) << "it goes on: " << station_.log();
    const std::size_t most = memory("VmHWM:");
    EXPECT_LT(most, idle_ + kMaxGrowth) << "idle: " << idle_ / kMegabyte << " MB";
    RecordProperty("growth_MB", static_cast<int>((most - std::min(most, idle_)) / kMegabyte));
  }

  std::size_t memory(const std::string& what) const {
    std::ifstream status(fmt::format("/proc/{}/status", station_.process()));
    for (std::string name; status >> name;)
      if (std::size_t kilobytes = 0; name == what && status >> kilobytes) return kilobytes * 1024;
    return 0;
  }

  std::string answer_to(const std::string& bytes) const {
    const Connection connection(station_.port());
    connection.send(bytes);
    connection.finish();
    return connection.receive();
  }
  std::string authorised(const std::string& path, const std::string& body) const {
    return fmt::format(
        "POST {} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nAuthorization: Bearer "
        "{}\r\n"
        "Content-Length: {}\r\n\r\n{}",
        path, station_.token(), body.size(), body);
  }

  Station station_;
  std::size_t idle_ = 0;
};

TEST_F(Hostile, CompressedBodiesAndManyRanges) {
  std::string ranges = "bytes=0-";
  while (ranges.size() < 8'000) ranges += ",0-";
  for (int i = 0; i < 50; ++i) {
    EXPECT_THAT(answer_to("POST /v1/checks HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
                          "Content-Encoding: br\r\nContent-Length: 835\r\n\r\n" +
                          std::string(835, '\x1b')),
                StartsWith("HTTP/1.1 415"));
    const std::string whole =
        answer_to("GET /screen.js HTTP/1.1\r\nHost: localhost\r\nRange: " + ranges + "\r\n\r\n");
    EXPECT_THAT(whole, StartsWith("HTTP/1.1 200"));
    EXPECT_LT(whole.size(), kMegabyte);
  }
}

TEST_F(Hostile, LargeAndDeepDocumentsOfWhoHasTheToken) {
  constexpr std::size_t kLargest = 64 * 1024;
  std::string keys = "{";
  for (int i = 0; keys.size() < kLargest - 20; ++i) keys += fmt::format("\"k{}\":1,", i);
  keys += "\"k\":1}";
  const std::vector<std::string> bodies{std::string(kLargest, '['),
                                        std::string(kLargest / 2, '[') + std::string(kLargest / 2, ']'), keys,
                                        "{\"serial\":\"" + std::string(kLargest - 20, 'x') + "\"}",
                                        "[" + std::string(kLargest - 4, ' ') + "0]"};
  for (int i = 0; i < 20; ++i)
    for (const std::string& body : bodies)
      EXPECT_THAT(answer_to(authorised("/v1/next", body)), StartsWith("HTTP/1.1 400"));
}

TEST_F(Hostile, AThousandWhoDoNotReadOrDoNotSpeakAndAStop) {
  std::vector<std::string> beginnings{
      "", "POST /v1/stop HTTP/1.1\r\nHost: localhost\r\nX-Slow: " + std::string(15'000, 'x'),
      authorised("/v1/checks", std::string(60'000, ' ')).substr(0, 50'000)};
  for (const char* path : {"/screen.js", "/v1/results?limit=1000", "/v1/statistics?limit=1000", "/v1/status"})
    beginnings.push_back(fmt::format("GET {} HTTP/1.1\r\nHost: localhost\r\n\r\n", path));
  std::vector<Connection> clients;
  for (std::size_t i = 0; i < 1000; ++i) {
    clients.emplace_back(station_.port());
    clients.back().take_little();
    clients.back().send(beginnings[i % beginnings.size()]);
  }
  const auto stopped = station_.client().stop();
  EXPECT_TRUE(stopped) << stopped.error().message;
  const auto status = station_.client().status();
  ASSERT_TRUE(status) << status.error().message;
  EXPECT_EQ(clients.size(), 1000U) << "none of them has gone";
}

/// What the fuzz target's corpus holds, spoiled in a few places.
TEST_F(Hostile, ThousandsOfGeneratedRequests) {
  std::vector<std::string> seeds;
  for (const auto& entry : std::filesystem::directory_iterator(CLAMPD_SOURCE_DIR "/tests/fuzz/corpus/http")) {
    std::ifstream file(entry.path(), std::ios::binary);
    seeds.emplace_back(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
  }
  std::sort(seeds.begin(), seeds.end());
  std::mt19937 random(21);
  const auto below = [&](std::size_t count) {
    return static_cast<std::size_t>(random() % std::max<std::size_t>(count, 1));
  };
  const char* asked = std::getenv("CLAMPD_HOSTILE_REQUESTS");
  const int requests = asked == nullptr ? 10'000 : std::atoi(asked);
  for (int i = 0; i < requests; ++i) {
    std::string request = seeds[below(seeds.size())];
    for (std::size_t spoiled = below(6); spoiled > 0; --spoiled) {
      const std::string& other = seeds[below(seeds.size())];
      const std::size_t at = below(request.size());
      const std::size_t from = below(other.size());
      if (below(3) == 0 && !request.empty())
        request[at] = static_cast<char>(random());
      else if (below(2) == 0)
        request.insert(at, other.substr(from, below(40)));
      else
        request.replace(at, below(20), other.substr(from, below(2000)));
    }
    const std::string answer = answer_to(request);
    if (!answer.empty()) {
      EXPECT_THAT(answer, StartsWith("HTTP/1.1 ")) << request;
      EXPECT_FALSE(answer.starts_with("HTTP/1.1 500")) << request << "\n" << answer;
    }
  }
}

}  // namespace
}  // namespace clampd::faults
