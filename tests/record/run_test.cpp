#include "clampd/record/run.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <span>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace clampd {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

const std::string kHeader = "time_s,torque_Nm,velocity_rad_s,force_N\n";

struct BadInput {
  std::string label;
  std::string text;
  std::string place;  ///< "line:column" of the message
  std::string says;
};
void PrintTo(const BadInput& bad, std::ostream* out) {
  *out << bad.label;
}

class RunRefuses : public ::testing::TestWithParam<BadInput> {};

TEST_P(RunRefuses, WithFileLineAndColumn) {
  const Result<LoadedRun> result = parse_run(GetParam().text, "bad.csv");
  ASSERT_FALSE(result.has_value());
  EXPECT_THAT(result.error().message, StartsWith("bad.csv:" + GetParam().place + ": "));
  EXPECT_THAT(result.error().message, HasSubstr(GetParam().says));
}

INSTANTIATE_TEST_SUITE_P(
    Inputs, RunRefuses,
    ::testing::Values(
        BadInput{"empty", "", "1:1", "empty"}, BadInput{"blank", "\n \r\n\n", "1:1", "empty"},
        BadInput{"bom_only", "\xEF\xBB\xBF", "1:1", "empty"},
        BadInput{"header_only", kHeader, "2:1", "no rows"},
        BadInput{"missing_force", "time_s,torque_Nm,velocity_rad_s\n0,0,0\n", "1:1", "force_N is missing"},
        BadInput{"no_header", "0,1,2,3\n1,1,2,3\n", "1:1", "time_s is missing"},
        BadInput{"twice", "time_s,torque_Nm,velocity_rad_s,force_N,torque_Nm\n0,0,0,0,0\n", "1:41",
                 "torque_Nm appears twice"},
        BadInput{"semicolons", "time_s;torque_Nm;velocity_rad_s;force_N\n0;0;0;0\n", "1:7", "commas"},
        BadInput{"text", kHeader + "0,0,0,0\n0.001,0,abc,0\n", "3:9",
                 "velocity_rad_s is not a finite number: \"abc\""},
        BadInput{"trailing_garbage", kHeader + "0,0,0,1.5N\n", "2:7", "\"1.5N\""},
        BadInput{"missing_field", kHeader + "0,,0,0\n", "2:3", "torque_Nm is not a finite number"},
        BadInput{"nan", kHeader + "0,nan,0,0\n", "2:3", "torque_Nm is not a finite number"},
        BadInput{"inf", kHeader + "0,0,0,-inf\n", "2:7", "force_N is not a finite number"},
        BadInput{"overflow", kHeader + "0,0,0,1e999\n", "2:7", "force_N is not a finite number"},
        BadInput{"decimal_comma", kHeader + "0,0,0,1,5\n", "2:9", "5 fields, the header 4"},
        BadInput{"short_row", kHeader + "0,0,0,0\n1,0,0\n", "3:6", "3 fields, the header 4"},
        BadInput{"time_stands", kHeader + "0,0,0,0\n0,0,0,0\n", "3:1", "time_s does not increase: 0 after 0"},
        BadInput{"time_back", kHeader + "0.5,0,0,0\n0.4,0,0,0\n", "3:1", "does not increase: 0.4 after 0.5"},
        BadInput{"drive_half_on", "time_s,drive_enabled,torque_Nm,velocity_rad_s,force_N\n0,0.5,0,0,0\n",
                 "2:3", "drive_enabled is 0.5; it must be 1, or 0"},
        BadInput{"gap", kHeader + "0,0,0,0\n\n1,0,0,0\n", "3:1", "empty line"},
        BadInput{"binary",
                 std::string("\x7f"
                             "ELF\0\1\2\3",
                             8),
                 "1:1", "time_s is missing"}),
    [](const auto& input) { return input.param.label; });

TEST(ParseRun, ReadsColumnsInAnyOrder) {
  const auto loaded =
      parse_run("force_N,velocity_rad_s,time_s,position_rad,torque_Nm\n1,2,3,4,5\n6,7,8,9,10\n", "a.csv");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_THAT(loaded->run.time_s, ElementsAre(3, 8));
  EXPECT_THAT(loaded->run.torque_Nm, ElementsAre(5, 10));
  EXPECT_THAT(loaded->run.velocity_rad_s, ElementsAre(2, 7));
  EXPECT_THAT(loaded->run.force_N, ElementsAre(1, 6));
  EXPECT_THAT(loaded->run.position_rad, ElementsAre(4, 9));
  EXPECT_TRUE(loaded->notices.empty());
  EXPECT_EQ(loaded->run.name, "a.csv");
}

TEST(ParseRun, ToleratesWhatSpreadsheetsAdd) {
  const auto loaded = parse_run(
      "\xEF\xBB\xBF\"time_s\", \"torque_Nm\" ,velocity_rad_s,\"force_N\"\r\n0, +1.5 "
      ",-2e1,.5\r\n\"1\",0,0,0\r\n\r\n \n",
      "x.csv");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_THAT(loaded->run.torque_Nm, ElementsAre(1.5, 0));
  EXPECT_THAT(loaded->run.velocity_rad_s, ElementsAre(-20, 0));
  EXPECT_THAT(loaded->run.force_N, ElementsAre(0.5, 0));
  EXPECT_TRUE(loaded->run.position_rad.empty());
}

TEST(ParseRun, IgnoresFurtherColumnsWithANotice) {
  const auto loaded = parse_run("time_s,torque_Nm,comment,velocity_rad_s,force_N\n0,1,hello,2,3\n", "x.csv");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_THAT(loaded->notices, ElementsAre("x.csv:1:18: column \"comment\" is ignored"));
}

TEST(ParseRun, ReadsALastLineWithoutItsEnd) {
  const auto loaded = parse_run(kHeader + "0,1,2,3", "x.csv");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(loaded->run.size(), 1u);
}

TEST(FormatRun, ReadsBackTheSameDoubles) {
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  clampd::Run run;  // inside a TEST, plain Run is a member of testing::Test
  for (int i = 0; i < 500; ++i) {
    run.time_s.push_back(i * 1e-3);
    run.torque_Nm.push_back(normal(random) * std::pow(10.0, normal(random) * 5));
    run.velocity_rad_s.push_back(-0.0);
    run.force_N.push_back(std::numeric_limits<double>::denorm_min());
    run.position_rad.push_back(1.0 / 3.0);
  }
  run.torque_Nm[0] = std::numeric_limits<double>::max();
  const auto loaded = parse_run(format_run(run), "x.csv");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(loaded->run.time_s, run.time_s);
  EXPECT_EQ(loaded->run.torque_Nm, run.torque_Nm);
  EXPECT_EQ(loaded->run.force_N, run.force_N);
  EXPECT_EQ(loaded->run.position_rad, run.position_rad);
  EXPECT_TRUE(std::signbit(loaded->run.velocity_rad_s[0]));
}

clampd::Run torque_readings(const std::vector<double>& torque_Nm, double enabled) {
  clampd::Run run;
  for (const double torque : torque_Nm) {
    run.time_s.push_back(1e-3 * static_cast<double>(run.size()));
    run.torque_Nm.push_back(torque);
    run.drive_enabled.push_back(enabled);
  }
  run.velocity_rad_s = run.force_N = std::vector<double>(run.size(), 0.0);
  return run;
}

std::vector<double> noise(std::size_t count, double mean, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(mean, 0.01);
  std::vector<double> values(count);
  std::ranges::generate(values, [&] { return normal(random); });
  return values;
}

TEST(TorqueWhileOff, IsTheMeanOfTheRowsWithTheDriveOffAndHowSureThatIs) {
  clampd::Run off = torque_readings(noise(1000, 0.03, 1), 0.0);
  const clampd::Run on = torque_readings(noise(1000, 1.0, 2), 1.0);
  const auto read_back = parse_run(format_run(off), "off.csv");
  ASSERT_TRUE(read_back) << read_back.error().message;
  EXPECT_EQ(read_back->run.drive_enabled, off.drive_enabled);
  const std::vector runs{off, on};
  const auto torque = torque_while_off(runs);
  ASSERT_TRUE(torque);
  EXPECT_EQ(torque->rows, 1000U);
  EXPECT_NEAR(torque->mean_Nm, 0.03, 4.0 * 0.01 / std::sqrt(1000.0));
  EXPECT_GT(torque->sd_Nm, 0.9 * 0.01 / std::sqrt(1000.0));
  EXPECT_LT(torque->sd_Nm, 2.0 * 0.01 / std::sqrt(1000.0));
  EXPECT_THAT(driven_runs(runs), testing::SizeIs(1));

  // A slow wander is no noise that averages out.
  for (std::size_t k = 0; k < off.size(); ++k)
    off.torque_Nm[k] += 0.01 * std::sin(6.28 * static_cast<double>(k) / 1000.0);
  EXPECT_GT(torque_while_off(std::span(&off, 1))->sd_Nm, 4.0 * torque->sd_Nm);
}

TEST(TorqueWhileOff, IsNotKnownFromFewReadingsNorFromOnesThatNeverChange) {
  const clampd::Run few = torque_readings(noise(19, 0.0, 1), 0.0);
  EXPECT_EQ(torque_while_off(std::span(&few, 1)), std::nullopt);
  const clampd::Run dead = torque_readings(std::vector<double>(1000, 0.0), 0.0);
  EXPECT_EQ(torque_while_off(std::span(&dead, 1)), std::nullopt);
  EXPECT_FALSE(is_driven(dead));
}

TEST(TorqueWhileOff, PoolsByRows) {
  const TorqueWhileOff once{0.01, 0.003, 100}, longer{0.04, 0.001, 200};
  EXPECT_EQ(pooled(once, std::nullopt), once);
  EXPECT_EQ(pooled(std::nullopt, longer), longer);
  const auto both = pooled(once, longer);
  EXPECT_EQ(both->rows, 300U);
  EXPECT_NEAR(both->mean_Nm, 0.03, 1e-15);
  EXPECT_NEAR(both->sd_Nm, std::hypot(0.003, 0.002) / 3.0, 1e-15);
}

TEST(ParseRun, NeverCrashesOnDamagedText) {
  const std::string good = kHeader + "0,1,2,3\n0.001,-1.5e-3,2,3\n0.002,1,2,3\n";
  std::mt19937 random(11);
  int refused = 0;
  for (int i = 0; i < 5000; ++i) {
    std::string text = good;
    for (int j = 0; j < 3; ++j) text[random() % text.size()] = static_cast<char>(random() % 256);
    text.resize(random() % (text.size() + 1));
    const auto loaded = parse_run(text, "x.csv");
    if (!loaded) {
      ++refused;
      EXPECT_THAT(loaded.error().message, StartsWith("x.csv:"));
    } else {
      EXPECT_EQ(loaded->run.force_N.size(), loaded->run.size());
    }
  }
  EXPECT_GT(refused, 2500);
}

TEST(ReadRun, SaysWhichFile) {
  const auto missing = read_run("/nonexistent/run.csv");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().message, "/nonexistent/run.csv: cannot open: No such file or directory");
  const auto directory = read_run("/");
  ASSERT_FALSE(directory);
  EXPECT_THAT(directory.error().message, HasSubstr("is a directory"));
}

TEST(RunFiles, WriteTheColumnsThatARunHas) {
  clampd::Run motion;
  motion.time_s = {0.0, 0.1};
  motion.velocity_rad_s = {1.0, -1.0};
  EXPECT_EQ(format_run(motion), "time_s,velocity_rad_s\n0,1\n0.1,-1\n");
}

}  // namespace
}  // namespace clampd
