// A disk that takes no more, and then does again.

#include <sys/resource.h>

#include <csignal>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/store.hpp"
#include "faults/station.hpp"
#include "support/eventually.hpp"

namespace clampd::faults {
namespace {

using support::eventually;
using ::testing::HasSubstr;

/// No file of the station may grow beyond this, as on a disk that is full.
void allow(pid_t process, rlim_t bytes) {
  rlimit limit{};
  ASSERT_EQ(::prlimit(process, RLIMIT_FSIZE, nullptr, &limit), 0);
  limit.rlim_cur = bytes;
  ASSERT_EQ(::prlimit(process, RLIMIT_FSIZE, &limit, nullptr), 0);
}

TEST(Disk, ThatIsFullReleasesNoBrakeAndLosesNoResult) {
  ::signal(SIGXFSZ, SIG_IGN);  // inherited: the write fails instead
  Station station;
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  const api::Client& client = station.client();
  ASSERT_TRUE(client.start({.serial = "BEFORE"}));
  EXPECT_EQ(station.finished().at("verdict"), "PASS");

  ASSERT_TRUE(station.wait_for_idle());
  ASSERT_TRUE(client.start({.serial = "FULL"}));
  allow(station.process(), 4096);
  const nlohmann::ordered_json refused = station.finished();
  EXPECT_EQ(refused.at("verdict"), "ERROR") << "what is not on record releases no brake";
  EXPECT_THAT(refused.at("reason").get<std::string>(),
              HasSubstr("Judged PASS, but the result of FULL could not be saved: "));
  const auto status = client.status();
  ASSERT_TRUE(status);
  EXPECT_EQ(status->last_verdict, "ERROR");
  EXPECT_THAT(status->storage, HasSubstr("could not be saved"));
  EXPECT_THAT(status->storage, HasSubstr("disk"));
  const auto next = client.start({.serial = "NEXT"});
  ASSERT_FALSE(next) << "no check while a result is not on record";
  EXPECT_THAT(next.error().message, HasSubstr("no brake is checked"));
  {
    const auto archive = CheckStore::open(station.database(), CheckStore::Access::ReadOnly);
    ASSERT_TRUE(archive) << archive.error().message;
    EXPECT_EQ(archive->list({})->size(), 1U) << "nothing half of it";
  }

  allow(station.process(), 1U << 30);
  ASSERT_TRUE(eventually([&] { return client.status()->storage.empty(); })) << station.log();
  EXPECT_EQ(client.status()->last_verdict, "PASS");
  EXPECT_EQ(station.finished().at("verdict"), "PASS");
  ASSERT_TRUE(station.wait_for_idle());
  ASSERT_TRUE(client.start({.serial = "NEXT"}));
  EXPECT_EQ(station.finished().at("verdict"), "PASS");
  EXPECT_EQ(station.end(SIGTERM), 0);
  const auto archive = CheckStore::open(station.database(), CheckStore::Access::ReadOnly);
  ASSERT_TRUE(archive) << archive.error().message;
  const auto checks = archive->list({});
  ASSERT_EQ(checks->size(), 3U);
  EXPECT_EQ((*checks)[0].serial, "NEXT");
  EXPECT_EQ((*checks)[1].serial, "FULL");
  EXPECT_EQ((*checks)[1].verdict, Verdict::Pass);
  EXPECT_EQ((*checks)[1].id, refused.at("record"));
}

TEST(Disk, ThatStaysFullUntilTheEndIsNotSilentAboutWhatIsLost) {
  ::signal(SIGXFSZ, SIG_IGN);
  Station station;
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  ASSERT_TRUE(station.client().start({.serial = "UNSAVED"}));
  allow(station.process(), 4096);
  EXPECT_EQ(station.finished().at("verdict"), "ERROR");
  EXPECT_EQ(station.end(SIGTERM), 0);
  EXPECT_THAT(station.log(),
              HasSubstr("the result of UNSAVED, PASS, could not be saved until the end and is lost"));
  {
    const auto archive = CheckStore::open(station.database(), CheckStore::Access::ReadOnly);
    ASSERT_TRUE(archive) << archive.error().message;
    EXPECT_TRUE(archive->list({})->empty());
  }
  // With room again, the next start says on record that this check has no result.
  station.start();
  ASSERT_TRUE(station.wait_for_idle());
  const auto recorded = [&] {
    const auto archive = CheckStore::open(station.database(), CheckStore::Access::ReadOnly);
    return archive && archive->list({})->size() == 1 && archive->list({})->front().verdict == Verdict::Error;
  };
  EXPECT_TRUE(eventually(recorded)) << station.log();
  EXPECT_EQ(station.end(SIGTERM), 0);
}

}  // namespace
}  // namespace clampd::faults
