// What must hold of the archive whatever happens to its workers, their connection, its server and its disk.
// More than by default: --checks 10000 --kills 500 --diagnosed 200 (docs/line.md has the figures).

#include <sched.h>
#include <sys/mount.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <random>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "factory/published_factory.hpp"
#include "support/eventually.hpp"
#include "support/socket_relay.hpp"

namespace clampd::factory {
namespace {

using support::eventually;
using ::testing::HasSubstr;

int checks = 60;
int kills = 20;
int disturbances = 3;  ///< of each other kind
int diagnosed = 8;     ///< checks

constexpr int kShortLease_s = 3;  ///< the shortest that there is

void let_pass(std::mt19937_64& random, long longest_ms) {
  const timespec instant{0, static_cast<long>(random() % static_cast<unsigned long>(longest_ms * 1'000'000))};
  ::nanosleep(&instant, nullptr);
}

/// One factory for all tests, whose job is new for each.
class ArchiveFaults : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (!support::Database::missing().empty()) return;
    published = std::make_unique<PublishedFactory>(checks);
    published->make_reference();
  }
  static void TearDownTestSuite() { published.reset(); }
  void SetUp() override {
    if (const std::string missing = support::Database::missing(); !missing.empty()) GTEST_SKIP() << missing;
    published->submit();
  }
  support::Database& server() const { return published->server; }
  std::int64_t open() const { return open_of(*published); }
  static std::int64_t open_of(const PublishedFactory& factory) {
    return std::stoll(
        factory.server.ask("SELECT count(*) FROM clampd.queue WHERE state IN ('waiting', 'claimed')"));
  }
  /// The job is brought to its end by undisturbed workers, and is what it would have been without anything.
  static void expect_nothing_lost_or_doubled(const PublishedFactory& factory, const std::string& what) {
    factory.finish(2);
    const int failed = std::stoi(factory.count("failed"));
    if (failed > 0) {
      EXPECT_EQ(
          factory.server.ask("SELECT count(*) FROM clampd.queue WHERE state = 'failed' AND reason LIKE '5 "
                             "workers began with it and none came to an end%'"),
          std::to_string(failed))
          << factory.server.ask("SELECT reason FROM clampd.queue WHERE state = 'failed' LIMIT 1");
      factory.archive("retry last");
      factory.finish(2);
    }
    EXPECT_EQ(factory.count("done"), std::to_string(factory.checks()));
    EXPECT_EQ(factory.server.ask("SELECT count(*) FROM clampd.results"), std::to_string(factory.checks()));
    EXPECT_EQ(factory.digest(), factory.reference());
    fmt::print("{}: {} checks done, {} results, {} attempts, {} tasks tried again after five deaths\n", what,
               factory.count("done"), factory.server.ask("SELECT count(*) FROM clampd.results"),
               factory.server.ask("SELECT sum(attempts) FROM clampd.queue"), failed);
  }
  void expect_nothing_lost_or_doubled(const std::string& what) const {
    expect_nothing_lost_or_doubled(*published, what);
  }
  static void start(support::ServerProcess& process, const std::string& name, int lease_s) {
    process.start(published->worker(name, lease_s), published->path(name + ".log"));
  }

  static std::unique_ptr<PublishedFactory> published;
};

std::unique_ptr<PublishedFactory> ArchiveFaults::published;

TEST_F(ArchiveFaults, TwoWorkersSayWhatOneSays) {
  published->finish(2);
  EXPECT_EQ(server().ask("SELECT count(DISTINCT worker) FROM clampd.results"), "2");
  EXPECT_EQ(server().ask("SELECT sum(attempts) FROM clampd.queue"), std::to_string(checks));
  expect_nothing_lost_or_doubled("two workers");
}

TEST_F(ArchiveFaults, TwoWorkersDiagnoseAsOneDoes) {
  PublishedFactory factory(diagnosed);
  factory.ask("--diagnose");
  factory.make_reference();
  factory.submit();
  expect_nothing_lost_or_doubled(factory, "diagnosed by two workers");
  EXPECT_EQ(factory.server.ask("SELECT count(DISTINCT worker) FROM clampd.results"), "2");
  EXPECT_EQ(factory.server.ask("SELECT count(*) FROM clampd.results WHERE document LIKE '%clampd.archived_diagnosis/1%'"),
            std::to_string(diagnosed));
}

TEST_F(ArchiveFaults, WorkersKilledAtAnyInstant) {
  std::mt19937_64 random(20261128);
  std::array<support::ServerProcess, 2> workers;
  int killed = 0;
  for (; killed < kills; ++killed) {
    for (std::size_t number = 0; number < workers.size(); ++number)
      if (!workers[number].running()) start(workers[number], fmt::format("killed-{}", number), kShortLease_s);
    let_pass(random, 500);
    workers[random() % workers.size()].end(SIGKILL);
    if (open() == 0) {
      expect_nothing_lost_or_doubled(fmt::format("{} kills", killed + 1));
      published->submit();
    }
  }
  for (support::ServerProcess& worker : workers) worker.end(SIGKILL);
  expect_nothing_lost_or_doubled(fmt::format("{} kills", killed));
}

TEST_F(ArchiveFaults, AWorkerThatSleepsPastItsLeaseWritesNothing) {
  std::mt19937_64 random(20261129);
  support::ServerProcess sleeper, other;
  start(other, "other", kShortLease_s);
  start(sleeper, "sleeper", kShortLease_s);
  for (int stop = 0; stop < disturbances; ++stop) {
    ASSERT_TRUE(eventually([&] {
      if (open() == 0) published->submit();
      return server().ask(
                 "SELECT count(*) FROM clampd.queue WHERE state = 'claimed' AND worker = 'sleeper'") == "1";
    }));
    let_pass(random, 20);
    sleeper.signal(SIGSTOP);
    EXPECT_TRUE(eventually([&] {
      return server().ask(
                 "SELECT count(*) FROM clampd.queue WHERE state = 'claimed' AND worker = 'sleeper'") == "0";
    })) << "nobody takes over what the sleeper has";
    sleeper.signal(SIGCONT);
  }
  EXPECT_EQ(sleeper.end(SIGTERM), 0) << published->read("sleeper.log");
  EXPECT_EQ(other.end(SIGTERM), 0) << published->read("other.log");
  EXPECT_THAT(published->read("sleeper.log"), HasSubstr("this work is discarded"));
  expect_nothing_lost_or_doubled(fmt::format("{} workers suspended past their lease", disturbances));
}

TEST_F(ArchiveFaults, TheServerRestartsAndCrashes) {
  std::mt19937_64 random(20261130);
  std::array<support::ServerProcess, 2> workers;
  for (std::size_t number = 0; number < workers.size(); ++number)
    start(workers[number], fmt::format("restarts-{}", number), 60);
  for (int restart = 0; restart < disturbances; ++restart) {
    let_pass(random, 900);
    if (open() == 0) published->submit();
    restart % 2 == 0 ? server().crash() : server().stop();
    server().start();
  }
  for (support::ServerProcess& worker : workers) EXPECT_EQ(worker.end(SIGTERM), 0);
  EXPECT_THAT(published->read("restarts-0.log"), HasSubstr("trying again in"));
  expect_nothing_lost_or_doubled(
      fmt::format("{} restarts of the server, every other one a crash", disturbances));
}

TEST_F(ArchiveFaults, TheConnectionIsCutOrHeldForLongerThanALease) {
  std::mt19937_64 random(20261201);
  std::filesystem::create_directory(published->path("relay"));
  support::SocketRelay relay(published->path("relay"), server().host());
  support::give_to_server(published->path("relay"));
  support::give_to_server(relay.socket());
  const std::string through = published->configuration_for("relayed.toml", published->path("relay"));
  support::ServerProcess relayed;
  relayed.start(PublishedFactory::worker("relayed", kShortLease_s, through), published->path("relayed.log"));
  for (int cut = 0; cut < disturbances; ++cut) {
    let_pass(random, 500);
    relay.cut();
    let_pass(random, 500);
    relay.mend();
    let_pass(random, 500);
    relay.hold();
    // Whatever the worker has is somebody else's by the time its bytes arrive.
    published->finish(1);
    relay.release();
    published->submit();
  }
  EXPECT_EQ(relayed.end(SIGTERM), 0) << published->read("relayed.log");
  EXPECT_THAT(published->read("relayed.log"), HasSubstr("trying again in"));
  expect_nothing_lost_or_doubled(fmt::format("{0} cuts of the connection, {0} times held", disturbances));
}

TEST_F(ArchiveFaults, AWorkerThatIsCutOffAsItWritesLetsItsRowGo) {
  std::filesystem::create_directory(published->path("writing"));
  support::SocketRelay relay(published->path("writing"), server().host());
  support::give_to_server(published->path("writing"));
  support::give_to_server(relay.socket());
  const std::string through = published->configuration_for("writing.toml", published->path("writing"));
  // The row is locked, and nobody says any more what is to become of it.
  relay.hold_after("clock_timestamp() FOR UPDATE");
  support::ServerProcess writing;
  writing.start(PublishedFactory::worker("writing", kShortLease_s, through), published->path("writing.log"));
  ASSERT_TRUE(eventually([&] { return relay.holds_one(); }));
  writing.signal(SIGSTOP);
  expect_nothing_lost_or_doubled("a worker that was cut off as it wrote");
  writing.end(SIGKILL);
}

/// A small disk of its own for what this process makes from now on; gone with this process.
class SmallDisk {
 public:
  explicit SmallDisk(const std::string& size) {
    if (::unshare(CLONE_NEWNS) != 0 || ::mount(nullptr, "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        ::mount("none", folder_.path(".").c_str(), "tmpfs", 0, ("mode=755,size=" + size).c_str()) != 0) {
      problem_ = fmt::format("no disk of its own here (mount: {})", std::strerror(errno));
      return;
    }
    previous_ = std::getenv("TMPDIR") == nullptr ? "" : std::getenv("TMPDIR");
    ::setenv("TMPDIR", folder_.path(".").c_str(), 1);
  }
  ~SmallDisk() {
    if (!problem_.empty()) return;
    previous_.empty() ? ::unsetenv("TMPDIR") : ::setenv("TMPDIR", previous_.c_str(), 1);
    ::umount2(folder_.path(".").c_str(), MNT_DETACH);
  }
  const std::string& problem() const { return problem_; }
  void fill() {
    std::ofstream ballast(folder_.path("ballast"), std::ios::binary);
    const std::string block(4096, '.');
    while (ballast.write(block.data(), static_cast<std::streamsize>(block.size())).flush()) continue;
  }
  void empty() { std::filesystem::remove(folder_.path("ballast")); }
  /// Bytes that are free.
  std::uint64_t free() const {
    struct statvfs space {};
    ::statvfs(folder_.path(".").c_str(), &space);
    return space.f_bavail * space.f_bsize;
  }

 private:
  support::TemporaryDirectory folder_;
  std::string problem_, previous_;
};

TEST_F(ArchiveFaults, TheServersDiskIsFull) {
  SmallDisk disk("192m");
  if (!disk.problem().empty()) GTEST_SKIP() << disk.problem();
  PublishedFactory small(std::min(checks, 100));  // that fit onto it
  small.make_reference();
  small.submit();
  std::array<support::ServerProcess, 2> workers;
  for (std::size_t number = 0; number < workers.size(); ++number)
    workers[number].start(small.worker(fmt::format("full-{}", number), kShortLease_s),
                          published->path(fmt::format("full-{}.log", number)));
  disk.fill();
  EXPECT_LT(disk.free(), 4096U);
  const auto says = [&](const char* words) {
    return published->read("full-0.log").find(words) != std::string::npos ||
           published->read("full-1.log").find(words) != std::string::npos;
  };
  EXPECT_TRUE(eventually([&] { return says("No space left on device") || says("no connection"); }))
      << published->read("full-0.log") << published->read("full-1.log");
  disk.empty();
  // Without room for its write-ahead log the server has ended: whoever looks after it starts it again.
  small.server.stop();
  small.server.start();
  EXPECT_TRUE(eventually([&] { return open_of(small) == 0; })) << "the workers go on by themselves";
  for (support::ServerProcess& worker : workers) EXPECT_EQ(worker.end(SIGTERM), 0);
  expect_nothing_lost_or_doubled(small, "a full disk");
}

}  // namespace
}  // namespace clampd::factory

int main(int argc, char** argv) {
  testing::InitGoogleMock(&argc, argv);
  for (int i = 1; i + 1 < argc; ++i) {
    if (std::strcmp(argv[i], "--checks") == 0) clampd::factory::checks = std::atoi(argv[i + 1]);
    if (std::strcmp(argv[i], "--kills") == 0) clampd::factory::kills = std::atoi(argv[i + 1]);
    if (std::strcmp(argv[i], "--diagnosed") == 0) clampd::factory::diagnosed = std::atoi(argv[i + 1]);
    if (std::strcmp(argv[i], "--disturbances") == 0) clampd::factory::disturbances = std::atoi(argv[i + 1]);
  }
  return RUN_ALL_TESTS();
}
