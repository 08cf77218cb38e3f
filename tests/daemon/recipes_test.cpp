// The real daemon with two recipes, over its control API.

#include <csignal>
#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "faults/station.hpp"
#include "support/command.hpp"

namespace clampd::faults {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// All that a nominal brake passes, but k2, which is as given.
std::string recipe(const std::string& part, const std::string& version, const std::string& k2) {
  return "part_number = \"" + part + "\"\nversion = \"" + version + "\"\nserials = [\"" + part + "-*\"]\n" +
         "[limits]\nrevision = \"of " + part + "\"\n[limits.parameters_normalised]\nk2 = " + k2 + R"(
k1 = {lower = 0.1, upper = 3.0}
TC = {lower = 0.1, upper = 4.0}
Ts0 = {lower = 0.1, upper = 4.0}
Tv = {lower = 0.1, upper = 9.0}
mus = {lower = 0.1, upper = 4.0}
ws = {lower = 0.1, upper = 9.0}
)";
}

TEST(DaemonWithRecipes, JudgesEachPartByItsOwn) {
  Station station("[recipes]\ndirectory = \"recipes\"\n");
  std::filesystem::create_directory(station.folder().path("recipes"));
  const std::string good = recipe("GOOD", "1", "{lower = 0.8, upper = 1.2}");
  const std::string bad = recipe("BAD", "7", "{lower = 1.6, upper = 2.0}");
  station.folder().write("recipes/good.toml", good);
  station.folder().write("recipes/bad.toml", bad);
  EXPECT_THAT(station.start().part_numbers, ElementsAre("BAD", "GOOD"));
  ASSERT_TRUE(station.wait_for_idle());

  const auto unknown = station.client().start({.serial = "X-1"});
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().message, HasSubstr("known are: BAD, GOOD"));
  const auto next = station.client().next({.serial = "X-1", .part_number = "UGLY"});
  ASSERT_FALSE(next) << "whoever scans hears it before the button is pressed";
  EXPECT_THAT(next.error().message, HasSubstr("UGLY has no recipe"));

  ASSERT_TRUE(station.client().start({.serial = "GOOD-1"}));
  station.folder().write("recipes/good.toml", recipe("GOOD", "2", "{lower = 1.6, upper = 2.0}"));
  auto record = station.finished();
  EXPECT_EQ(record.at("verdict"), "PASS") << record.at("reason");
  EXPECT_EQ(record.at("part_number"), "GOOD");
  EXPECT_EQ(record.at("recipe").at("version"), "1");

  ASSERT_TRUE(station.wait_for_idle());
  ASSERT_TRUE(station.client().start({.serial = "BAD-1", .part_number = "BAD"}));
  record = station.finished();
  EXPECT_EQ(record.at("verdict"), "FAIL") << record.at("reason");
  EXPECT_EQ(record.at("recipe").at("version"), "7");
  EXPECT_EQ(record.at("limits").at("revision"), "of BAD");
  EXPECT_EQ(station.end(SIGTERM), 0);
}

TEST(DaemonWithRecipes, TheDoctorNamesABadOne) {
  Station station("[recipes]\ndirectory = \"recipes\"\n");
  std::filesystem::create_directory(station.folder().path("recipes"));
  const std::string file = station.folder().write("recipes/bad.toml", "part_number = \"P\"\nversion = 3\n");
  const support::Outcome doctor = support::run_command(std::string(CLAMPCTL) + " doctor --config " +
                                                 station.folder().path("station.toml"));
  EXPECT_EQ(doctor.exit_code, 2);
  EXPECT_THAT(doctor.output, HasSubstr(file + ":2:"));
}

}  // namespace
}  // namespace clampd::faults
