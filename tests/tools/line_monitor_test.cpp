// `clampctl line monitor` as its user runs it, day after day, with a state file.

#include <filesystem>
#include <random>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/record/file.hpp"
#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;

class LineMonitorCommand : public ::testing::Test {
 protected:
  Outcome monitor(const std::string& arguments) {
    return support::run_command("cd '" + folder_.path("") + "' && " + CLAMPCTL + " line monitor " +
                                arguments);
  }

  /// Three stations that share their batches; station "North/1" is `shift` higher from 3 August on.
  void write_checks(const std::string& name, int first, int end, double shift) {
    std::string text = "record,serial,batch,station,started,verdict,k2 [N/rad^2],k2 sd [N/rad^2]\n";
    for (int day = first; day < end; ++day) {
      std::mt19937_64 random(500 + static_cast<std::uint64_t>(day));
      std::normal_distribution<double> normal;
      for (int i = 0; i < 30; ++i)
        text += fmt::format(
            "R{0}-{1},S{0}-{1},B{2},{3},2026-{4:02}-{5:02}T08:{1:02}:00.000Z,PASS,{6:.6f},0.1\n", day, i,
            day / 5,
            i % 3 == 0   ? "North/1"
            : i % 3 == 1 ? "B"
                         : "C",
            7 + day / 31, 1 + day % 31, 50.0 + normal(random) + (i % 3 == 0 && day >= 33 ? shift : 0.0));
    }
    folder_.write(name, text);
  }

  support::TemporaryDirectory folder_;
};

TEST_F(LineMonitorCommand, RaisesAnAlarmKeepsItAndBeginsAnewWhenItIsAcknowledged) {
  write_checks("july.csv", 0, 31, 2.0);
  write_checks("august.csv", 25, 60, 2.0);
  const Outcome quiet = monitor("july.csv --state line.json");
  EXPECT_EQ(quiet.exit_code, 0) << quiet.output;
  EXPECT_THAT(quiet.output, AllOf(HasSubstr("900 checks counted"), HasSubstr("up to 2026-07-30")));
  const Outcome alarm = monitor("july.csv august.csv --state line.json --json found.json");
  EXPECT_EQ(alarm.exit_code, 3) << alarm.output;
  EXPECT_THAT(alarm.output,
              AllOf(HasSubstr("ALARM North/1/k2"), HasSubstr("900 of days that were counted before")));
  const auto found = nlohmann::json::parse(folder_.read("found.json"));
  EXPECT_EQ(found.at("schema"), "clampd.line_monitor/1");
  EXPECT_EQ(found.at("monitored").at(0).at("state"), "alarm");
  EXPECT_NEAR(found.at("monitored").at(0).at("size").get<double>(), 2.0, 1.0);
  EXPECT_EQ(monitor("august.csv --state line.json").exit_code, 3)
      << "it stays until somebody says that it was mended";
  const Outcome mended = monitor("--state line.json --acknowledge North/1/k2");
  EXPECT_EQ(mended.exit_code, 0) << mended.output;
  EXPECT_EQ(monitor("--state line.json --acknowledge North/1/k2").exit_code, 2);
}

TEST_F(LineMonitorCommand, RefusesWhatItCannotGoOnFromAndLeavesItAlone) {
  write_checks("checks.csv", 0, 20, 0.0);
  ASSERT_EQ(monitor("checks.csv --state line.json --false-alarms-per-year 2").exit_code, 0);
  const std::string state = folder_.read("line.json");
  const Outcome other = monitor("checks.csv --state line.json --false-alarms-per-year 1");
  EXPECT_EQ(other.exit_code, 2);
  EXPECT_THAT(other.output, HasSubstr("was begun with --false-alarms-per-year 2, not 1"));
  EXPECT_EQ(monitor("checks.csv --state checks.csv").exit_code, 2) << "a state over the checks";
  EXPECT_EQ(monitor("--state line.json").exit_code, 2);
  EXPECT_EQ(monitor("checks.csv --acknowledge B/k2").exit_code, 2);
  EXPECT_EQ(monitor("missing.csv --state line.json").exit_code, 2);
  EXPECT_EQ(folder_.read("line.json"), state);
  folder_.write("line.json", state.substr(0, state.size() / 2));
  const Outcome damaged = monitor("checks.csv --state line.json");
  EXPECT_EQ(damaged.exit_code, 2);
  EXPECT_THAT(damaged.output, HasSubstr("line.json: is damaged"));
  EXPECT_EQ(folder_.read("line.json"), state.substr(0, state.size() / 2));
  folder_.write("empty.csv", "serial,batch,station,started,verdict,k2 [N/rad^2],k2 sd [N/rad^2]\n");
  folder_.write("line.json", state);
  EXPECT_EQ(monitor("empty.csv --state line.json").exit_code, 0) << "a day without checks is no error";
}

// Of two that count different days at the same time, the later one would write over what the first counted.
TEST_F(LineMonitorCommand, RunsOnOneStateOneAtATime) {
  write_checks("checks.csv", 0, 20, 0.0);
  ASSERT_EQ(monitor("checks.csv --state line.json").exit_code, 0);
  const std::string state = folder_.read("line.json");
  {
    const auto other = FileLock::take(folder_.path("line.json"), std::chrono::milliseconds(0));
    ASSERT_TRUE(other) << other.error().message;
    write_checks("more.csv", 20, 25, 0.0);
    const Outcome refused = monitor("more.csv --state line.json");
    EXPECT_EQ(refused.exit_code, 2);
    EXPECT_THAT(refused.output, HasSubstr("another process is changing a file of its folder"));
  }
  EXPECT_EQ(folder_.read("line.json"), state);
  EXPECT_EQ(monitor("more.csv --state line.json").exit_code, 0);
}

}  // namespace
}  // namespace clampd
