// What systemd hears of the station and hands over to it.

#include "clampd/daemon/service_manager.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"
#include "support/network.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::daemon {
namespace {

using support::listening_socket;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr std::int64_t kTimeout_ns = 10 * kNanosecondsPerSecond;
constexpr std::int64_t kRound_ns = 5 * kNanosecondsPerMillisecond;

/// When a loop that ticks once a millisecond until `hangs_ns` is fed, looked at every 5 ms up to `until_ns`.
std::vector<std::int64_t> feedings(std::int64_t hangs_ns, std::int64_t until_ns) {
  WatchdogFeed feed(kTimeout_ns);
  std::vector<std::int64_t> fed;
  for (std::int64_t now_ns = 0; now_ns <= until_ns; now_ns += kRound_ns) {
    const auto ticks = static_cast<std::uint64_t>(std::min(now_ns, hangs_ns) / kNanosecondsPerMillisecond);
    if (feed.due(ticks, now_ns)) fed.push_back(now_ns);
  }
  return fed;
}

TEST(WatchdogFeed, FeedsOftenEnoughWhileTheLoopTicks) {
  const std::vector<std::int64_t> fed = feedings(10 * kTimeout_ns, 10 * kTimeout_ns);
  ASSERT_FALSE(fed.empty());
  EXPECT_LT(fed.front(), kTimeout_ns);
  EXPECT_GT(fed.back(), 9 * kTimeout_ns);
  EXPECT_LE(fed.size(), 41U);
  for (std::size_t i = 1; i < fed.size(); ++i) EXPECT_LE(fed[i] - fed[i - 1], kTimeout_ns / 2);
}

TEST(WatchdogFeed, StopsWithTheLoop) {
  for (std::int64_t hangs_ns = kTimeout_ns; hangs_ns < 2 * kTimeout_ns; hangs_ns += 37 * kRound_ns) {
    const std::vector<std::int64_t> fed = feedings(hangs_ns, 20 * kTimeout_ns);
    // A tick that was not yet reported may be, once and in its turn; then never again.
    EXPECT_LE(fed.back(), hangs_ns + kTimeout_ns / 4 + kRound_ns);
  }
}

TEST(WatchdogFeed, NeverFeedsALoopThatNeverTicked) {
  EXPECT_THAT(feedings(0, 5 * kTimeout_ns), IsEmpty());
}

TEST(WatchdogFeed, FeedsNobodyWhereNobodyWatches) {
  WatchdogFeed feed(0);
  EXPECT_FALSE(feed.due(1, 0));
  EXPECT_FALSE(feed.due(2, kTimeout_ns));
}

/// The other end of systemd's notification socket.
class Notifications : public ::testing::Test {
 protected:
  void SetUp() override {
    socket_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    const std::string path = folder_.path("notify");
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    ASSERT_LT(path.size(), sizeof address.sun_path);
    std::strcpy(address.sun_path, path.c_str());
    ASSERT_EQ(bind(socket_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    setenv("NOTIFY_SOCKET", path.c_str(), 1);
    setenv("WATCHDOG_USEC", "10000000", 1);
  }
  void TearDown() override {
    close(socket_);
    unsetenv("NOTIFY_SOCKET");
    unsetenv("WATCHDOG_USEC");
  }
  std::vector<std::string> heard() const {
    std::vector<std::string> messages;
    std::array<char, 4096> buffer;
    for (ssize_t size; (size = recv(socket_, buffer.data(), buffer.size(), 0)) >= 0;)
      messages.emplace_back(buffer.data(), static_cast<std::size_t>(size));
    return messages;
  }

  support::TemporaryDirectory folder_;
  int socket_ = -1;
};

TEST_F(Notifications, ReadyOnceTheLoopTicks) {
  ServiceManager manager;
  manager.round(0, "INIT on can0", 0);
  EXPECT_THAT(heard(), ElementsAre("STATUS=INIT on can0"));
  manager.round(5, "INIT on can0", kRound_ns);
  EXPECT_THAT(heard(), ElementsAre("READY=1", "WATCHDOG=1"));
  manager.round(10, "IDLE on can0", 2 * kRound_ns);
  EXPECT_THAT(heard(), ElementsAre("STATUS=IDLE on can0"));
}

TEST_F(Notifications, AHungLoopIsNotFedAndAStoppingOneIs) {
  ServiceManager manager;
  manager.round(5, "IDLE", 0);
  heard();
  manager.round(5, "IDLE", kTimeout_ns);
  EXPECT_THAT(heard(), IsEmpty());
  manager.stopping();
  manager.round(5, "IDLE", 2 * kTimeout_ns);
  EXPECT_THAT(heard(), ElementsAre("STOPPING=1", "WATCHDOG=1"));
}

/// What a process that systemd hands `socket` makes of it: the number it serves on, or the error.
std::string inherits(int socket, int count, const std::string& address, int port) {
  std::array<int, 2> answer{};
  EXPECT_EQ(pipe(answer.data()), 0);
  const pid_t child = fork();
  if (child == 0) {
    const int out = fcntl(answer[1], F_DUPFD, 100);
    dup2(socket, 3);
    setenv("LISTEN_PID", std::to_string(getpid()).c_str(), 1);
    setenv("LISTEN_FDS", std::to_string(count).c_str(), 1);
    if (count > 1) dup2(socket, 4);
    const Result<int> inherited = ServiceManager::inherited_socket(address, port);
    const std::string text = inherited ? std::to_string(*inherited) : inherited.error().message;
    _exit(write(out, text.data(), text.size()) == static_cast<ssize_t>(text.size()) ? 0 : 1);
  }
  close(answer[1]);
  std::array<char, 1024> buffer{};
  std::string text;
  for (ssize_t size; (size = read(answer[0], buffer.data(), buffer.size())) > 0;)
    text.append(buffer.data(), static_cast<std::size_t>(size));
  close(answer[0]);
  int status = 0;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  return text;
}

TEST(InheritedSocket, IsTakenWhereTheConfigurationSaysSo) {
  int port = 0;
  const int listening = listening_socket(port);
  EXPECT_EQ(inherits(listening, 1, "127.0.0.1", port), "3");
  close(listening);
}

TEST(InheritedSocket, IsRefusedElsewhere) {
  int port = 0;
  const int listening = listening_socket(port);
  EXPECT_THAT(inherits(listening, 1, "127.0.0.1", port == 1 ? 2 : port - 1), HasSubstr("make them the same"));
  EXPECT_THAT(inherits(listening, 1, "0.0.0.0", port), HasSubstr("listens on 127.0.0.1:"));
  EXPECT_THAT(inherits(listening, 1, "::1", port), HasSubstr("says [::1]:"));
  EXPECT_THAT(inherits(listening, 2, "127.0.0.1", port), HasSubstr("2 sockets"));
  close(listening);
}

TEST(InheritedSocket, MustListenOnTcp) {
  const int deaf = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  EXPECT_THAT(inherits(deaf, 1, "127.0.0.1", 8371), HasSubstr("listening TCP"));
  close(deaf);
  std::array<int, 2> pair{};
  ASSERT_EQ(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair.data()), 0);
  EXPECT_THAT(inherits(pair[0], 1, "127.0.0.1", 8371), HasSubstr("listening TCP"));
  for (const int end : pair) close(end);
}

TEST(InheritedSocket, NoneWithoutSystemd) {
  const Result<int> none = ServiceManager::inherited_socket("127.0.0.1", 8371);
  ASSERT_TRUE(none);
  EXPECT_EQ(*none, -1);
}

}  // namespace
}  // namespace clampd::daemon
