#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>
#include <set>

#include <SQLiteCpp/SQLiteCpp.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/store.hpp"
#include "publish/servers.hpp"
#include "publish/subscriber.hpp"

namespace clampd {
namespace {

int kills = 100;

/// The station's program: what it says is saved, and its end.
class Station {
 public:
  Station(const std::vector<std::string>& arguments, std::set<std::string>& saved) : saved_(saved) {
    int pipe_ends[2];
    if (::pipe2(pipe_ends, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    std::vector<char*> argv{const_cast<char*>(CLAMPD_PUBLISH_STATION)};
    for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
    argv.push_back(nullptr);
    process_ = ::fork();
    if (process_ == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      ::dup2(pipe_ends[1], 1);
      ::execv(argv[0], argv.data());
      ::_exit(127);
    }
    ::close(pipe_ends[1]);
    output_ = pipe_ends[0];
  }
  ~Station() {
    kill();
    ::close(output_);
  }

  /// Takes what it says until so many checks are saved, or its end.
  void listen(std::size_t checks) {
    char buffer[4096];
    while (checks > 0) {
      const ssize_t size = ::read(output_, buffer, sizeof buffer);
      if (size <= 0) return;
      checks -= std::min(checks, take({buffer, static_cast<std::size_t>(size)}));
    }
  }
  /// Takes what it said up to its death.
  void kill() {
    if (process_ <= 0) return;
    ::kill(process_, SIGKILL);
    listen(static_cast<std::size_t>(-1));
    wait();
  }
  int wait() {
    int status = 0;
    ::waitpid(process_, &status, 0);
    process_ = -1;
    return status;
  }

 private:
  std::size_t take(std::string_view text) {
    std::size_t lines = 0;
    for (const char c : text) {
      if (c != '\n') {
        line_ += c;
        continue;
      }
      saved_.insert(std::exchange(line_, ""));
      ++lines;
    }
    return lines;
  }

  std::set<std::string>& saved_;
  std::string line_;
  pid_t process_ = -1;
  int output_ = -1;
};

TEST(Publishing, SurvivesKillsAtAnyInstant) {
  for (const std::string& missing : {support::Broker::missing(), support::Database::missing()})
    if (!missing.empty()) GTEST_SKIP() << missing;
  support::Broker broker;
  broker.start();
  support::Subscriber line(broker.port());
  support::Database server;
  support::TemporaryDirectory folder;
  const std::string database = folder.path("checks.sqlite");
  std::mt19937_64 random(20261121);
  std::set<std::string> acknowledged;
  unsigned next = 0;
  const auto arguments = [&](unsigned count) {
    std::vector<std::string> list{"--database",   database,
                                  "--mqtt",       std::to_string(broker.port()),
                                  "--postgresql", server.host(),
                                  "--first",      std::to_string(next),
                                  "--count",      std::to_string(count),
                                  "--seed",       std::to_string(random())};
    list.back() = std::to_string(random() % 1'000'000);
    next += count;
    return list;
  };
  for (int kill = 0; kill < kills; ++kill) {
    Station station(arguments(6), acknowledged);
    // An instant: after so many checks, and then anywhere in what happens next.
    station.listen(random() % 7);
    timespec instant{0, static_cast<long>(random() % 25'000'000)};
    ::nanosleep(&instant, nullptr);
    station.kill();
    // The servers go and come too, now and then.
    if (kill % 40 == 20) broker.stop(), broker.start();
    if (kill % 40 == 30) server.crash(), server.start();
  }
  {
    Station last(arguments(1), acknowledged);
    last.listen(static_cast<std::size_t>(-1));
    EXPECT_EQ(last.wait(), 0);
  }

  SQLite::Database file(database);
  EXPECT_EQ(file.execAndGet("PRAGMA integrity_check").getString(), "ok");
  EXPECT_EQ(SQLite::Statement(file, "PRAGMA foreign_key_check").executeStep(), false);
  std::set<std::string> kept;
  std::vector<std::string> queued;
  SQLite::Statement outbox(
      file, "SELECT check_id FROM publication WHERE channel = 'mqtt' AND state = 1 ORDER BY sequence");
  while (outbox.executeStep()) queued.push_back(outbox.getColumn(0).getString());
  SQLite::Statement checks(file, "SELECT id FROM checks");
  while (checks.executeStep()) kept.insert(checks.getColumn(0).getString());
  EXPECT_EQ(queued.size(), kept.size());
  EXPECT_TRUE(std::includes(kept.begin(), kept.end(), acknowledged.begin(), acknowledged.end()))
      << "an acknowledged check is not on record";
  EXPECT_GT(acknowledged.size(), static_cast<std::size_t>(kills));

  std::vector<std::string> arrived;
  std::size_t messages = 0;
  const bool all = support::eventually([&] {
    arrived.clear();
    std::int64_t sequence = 0;
    const auto documents = line.documents("station");
    messages = documents.size();
    for (const nlohmann::json& document : documents) {
      const std::int64_t now = document.at("outbox").at("sequence");
      if (now <= sequence) continue;
      sequence = now;
      arrived.push_back(document.at("record"));
    }
    return arrived.size() >= queued.size();
  });
  EXPECT_TRUE(all) << arrived.size() << " of " << queued.size();
  EXPECT_EQ(arrived, queued) << "MQTT: every check, once repeats are dropped by their sequence, in order";
  EXPECT_EQ(server.column("SELECT id FROM clampd.checks ORDER BY outbox_sequence"), queued)
      << "PostgreSQL: every check, once, in order";
  EXPECT_EQ(server.ask("SELECT count(*) FROM clampd.parameters"), std::to_string(7 * queued.size()));
  fmt::print("{} kills: {} checks saved, {} of them acknowledged to the caller, {} repeated by MQTT\n", kills,
             kept.size(), acknowledged.size(), messages - arrived.size());
}

}  // namespace
}  // namespace clampd

int main(int argc, char** argv) {
  testing::InitGoogleMock(&argc, argv);
  for (int i = 1; i + 1 < argc; ++i)
    if (std::strcmp(argv[i], "--kills") == 0) clampd::kills = std::atoi(argv[i + 1]);
  return RUN_ALL_TESTS();
}
