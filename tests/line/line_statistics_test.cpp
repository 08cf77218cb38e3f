#include "clampd/line/line_statistics.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/views/limits_view.hpp"
#include "clampd/views/line_statistics_view.hpp"
#include "support/check_records.hpp"

namespace clampd {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

CheckRecord check(int minute, const std::string& serial, double k2, Verdict verdict = Verdict::Pass) {
  CheckRecord record = support::make_check_record("2026112000" + std::to_string(10 + minute));
  record.started = "2026-11-20T00:" + std::to_string(10 + minute) + ":00.000Z";
  record.serial = serial;
  record.verdict = verdict;
  record.parameters = {{"k2", "N/rad^2", k2, 0.1, 30.0, 40.0, ParameterVerdict::Pass}};
  return record;
}

TEST(LineStatistics, TakeTheLastValidCheckOfEachBrake) {
  const LineStatistics found =
      // The last one saved first. The clock was set back before B: the order stays.
      line_statistics(
          {check(6, "D", 36.0, Verdict::Fail), check(5, "MASTER", 50.0), check(0, "B", 99.0, Verdict::Error),
           check(0, "B", 35.0), check(2, "A", 34.0), check(1, "A", 33.0)},
          "MASTER");
  EXPECT_EQ(found.checks, 5u);
  EXPECT_EQ(found.passed, 3u);
  EXPECT_EQ(found.failed, 1u);
  EXPECT_EQ(found.invalid, 1u);
  EXPECT_EQ(found.simulated, 5u);
  EXPECT_THAT(found.serials, ElementsAre("A", "B", "D"));
  ASSERT_EQ(found.parameters.size(), 1u);
  EXPECT_THAT(found.parameters[0].values, ElementsAre(34.0, 35.0, 36.0));
  EXPECT_DOUBLE_EQ(found.parameters[0].capability.mean, 35.0);
  EXPECT_DOUBLE_EQ(found.parameters[0].capability.ppk.value, 5.0 / 3.0);
  EXPECT_FALSE(found.parameters[0].limits_changed);
  EXPECT_THAT(format_statistics(found), HasSubstr("yield 75.0 %"));
  EXPECT_EQ(statistics_json(found).at("parameters").at(0).at("ppk").at("value"), 5.0 / 3.0);
}

CheckRecord of_recipe(int minute, const std::string& part, const std::string& version, double k2,
                      double upper) {
  CheckRecord record = check(minute, part + std::to_string(minute), k2);
  record.part_number = part;
  record.recipe = RecipeRecord{part + ".toml", version, version};
  record.parameters[0].upper = upper;
  return record;
}

TEST(LineStatistics, NeverMixPartNumbers) {
  const LineStatistics found =
      line_statistics({of_recipe(5, "B", "1", 52.0, 60.0), of_recipe(4, "A", "1", 36.0, 40.0),
                       of_recipe(3, "B", "1", 50.0, 60.0), of_recipe(2, "A", "1", 34.0, 40.0)},
                      "");
  EXPECT_EQ(found.checks, 4u);
  EXPECT_THAT(found.parameters, IsEmpty());
  ASSERT_EQ(found.parts.size(), 2u);
  EXPECT_EQ(found.parts[0].part_number, "A");
  EXPECT_THAT(found.parts[0].parameters.at(0).values, ElementsAre(34.0, 36.0));
  EXPECT_THAT(found.parts[1].parameters.at(0).values, ElementsAre(50.0, 52.0));
  EXPECT_EQ(found.parts[1].parameters.at(0).upper, 60.0);
  EXPECT_THAT(format_statistics(found), HasSubstr("Part number B\n2 checks"));
  EXPECT_EQ(statistics_json(found).at("parts").at(1).at("part_number"), "B");
}

TEST(LineStatistics, LeaveOutWhatARecipeJudgedByOtherLimits) {
  const LineStatistics found =
      line_statistics({of_recipe(5, "A", "3", 36.0, 41.0), of_recipe(4, "A", "2", 35.0, 41.0),
                       of_recipe(3, "A", "1", 34.0, 40.0)},
                      "");
  EXPECT_EQ(found.part_number, "A");
  EXPECT_THAT(found.parameters.at(0).values, ElementsAre(35.0, 36.0))
      << "another version with the same limits counts";
  EXPECT_FALSE(found.parameters[0].limits_changed);
  EXPECT_EQ(found.other_limits, 1u);
  EXPECT_THAT(format_statistics(found), HasSubstr("1 more brakes are left out"));
}

TEST(LineStatistics, NameTheRuleAndTheBrake) {
  std::vector<CheckRecord> checks;
  for (int i = 0; i < 20; ++i)
    checks.push_back(check(i, "S" + std::to_string(i), i == 17 ? 39.0 : 35.0 + 0.1 * ((i * 7) % 5)));
  checks[19].parameters[0].upper = 41.0;
  std::reverse(checks.begin(), checks.end());
  const LineStatistics found = line_statistics(checks, "");
  EXPECT_TRUE(found.parameters[0].limits_changed);
  EXPECT_EQ(found.parameters[0].upper, 41.0);
  const std::string text = format_statistics(found);
  EXPECT_THAT(text, ::testing::ContainsRegex("k2 +S17 +Nelson 1 \\(Western Electric 1\\)"));
  EXPECT_THAT(text, ::testing::ContainsRegex("k2 +S17 .*; moving range"));
}

TEST(LineStatistics, NeverMixSimulatedAndRealBrakesAndLeaveOutVoidOnes) {
  std::vector<CheckRecord> checks{check(4, "D", 36.0), check(3, "C", 99.0), check(2, "B", 35.0),
                                  check(1, "A", 34.0)};
  checks[1].voided = VoidRecord{"the wrong brake", "ada", ""};
  LineStatistics found = line_statistics(checks, "");
  EXPECT_THAT(found.serials, ElementsAre("A", "B", "D"));
  EXPECT_EQ(found.voided, 1U);
  EXPECT_FALSE(found.simulated_left_out) << "there is nothing else";
  checks[0].simulated = false;
  checks[2].simulated = false;
  found = line_statistics(checks, "");
  EXPECT_THAT(found.serials, ElementsAre("B", "D"));
  EXPECT_EQ(found.checks, 2U);
  EXPECT_EQ(found.simulated, 1U);
  EXPECT_TRUE(found.simulated_left_out);
  EXPECT_THAT(format_statistics(found), HasSubstr("1 SIMULATED are left out"));
}

TEST(LineStatistics, ColumnsOfLongNamesDoNotTouch) {
  std::vector<CheckRecord> checks{check(2, "B", 35.0), check(1, "A", 34.0)};
  for (CheckRecord& each : checks) {
    ParameterRecord& long_one = each.parameters.emplace_back(each.parameters[0]);
    long_one.name = "force-hysteresis.half_width";
    long_one.value = -1.2345e-11 * long_one.value;
  }
  const std::string text = format_statistics(line_statistics(checks, ""));
  EXPECT_THAT(text, ::testing::ContainsRegex("force-hysteresis.half_width  +-4.2"));
}

TEST(LineStatistics, OfNothing) {
  EXPECT_THAT(format_statistics(line_statistics({}, "")), HasSubstr("No checks"));
  const LineStatistics one = line_statistics({check(1, "A", 33.0)}, "");
  EXPECT_THAT(one.parameters, IsEmpty());
  EXPECT_THAT(format_statistics(one), HasSubstr("at least two brakes"));
}

constexpr const char* kLimits = R"(revision = "1"
author = "Ada"
[parameters_normalised]
k1 = {lower = 0.5, upper = 2}
k2 = {lower = 0.85, upper = 1.15}
TC = {lower = 0.5, upper = 2}
Ts0 = {lower = 0.5, upper = 2}
Tv = {lower = 0.5, upper = 2}
mus = {lower = 0.5, upper = 2}
ws = {lower = 0.5, upper = 2}
)";

TEST(LimitsHistory, SaysWhoChangedWhatAndWarnsOfAHiddenChange) {
  std::string second = kLimits, third = kLimits;
  second.replace(second.find("0.85"), 4, "0.80");
  third.replace(third.find("\"1\""), 3, "\"2\"");
  const auto limits = [](const std::string& contents, const std::string& revision) {
    return LimitsRevision{"sha", revision, "Ada", "", "limits.toml", contents, "2026-11-20T00:00:00.000Z"};
  };
  const std::vector<LimitsStep> steps =
      limits_steps({limits(kLimits, "1"), limits(second, "1"), limits(third, "2"), limits("garbage", "3")});
  EXPECT_THAT(steps[0].changes, IsEmpty());
  EXPECT_THAT(steps[1].changes, ElementsAre("k2: lower 29.92 -> 28.16 N/rad^2"));
  EXPECT_TRUE(steps[1].same_revision);
  EXPECT_THAT(steps[2].changes, ElementsAre("k2: lower 28.16 -> 29.92 N/rad^2"));
  EXPECT_FALSE(steps[2].same_revision);
  EXPECT_THAT(steps[3].changes, ElementsAre(HasSubstr("limits.toml")));
  EXPECT_THAT(format_limits(steps), HasSubstr("WARNING"));
  EXPECT_EQ(limits_json(steps).at("limits").size(), 4u);
}

}  // namespace
}  // namespace clampd
