#include "clampd/line/master.hpp"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/views/master_view.hpp"
#include "support/check_records.hpp"

namespace clampd {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr std::int64_t kHour_ns = 3'600'000'000'000;
constexpr std::int64_t kStart_ns = 1'795'219'200'000'000'000;  // 2026-11-21T00:00:00Z

/// Certified: nominal to within 2 %.
LimitSet certified() {
  LimitSet limits;
  limits.revision = "cal-7";
  limits.guard_band_k = 0.0;
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double nominal = kParameterTable[i].nominal;
    limits.intervals[i] = {nominal - 0.02 * std::abs(nominal), nominal + 0.02 * std::abs(nominal)};
  }
  return limits;
}

/// A check whose k2 is off by `k2_percent`; others scatter a little.
CheckRecord check(int number, double k2_percent, Verdict verdict = Verdict::Pass) {
  CheckRecord record = support::make_check_record("check-" + std::to_string(100 + number));
  record.serial = "M-1";
  record.verdict = verdict;
  record.started = "2026-11-21T00:00:00.000Z";
  record.parameters.clear();
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double off = i == k2 ? 0.01 * k2_percent : 0.001 * ((number * 7 + static_cast<int>(i)) % 5 - 2);
    record.parameters.push_back({std::string(kParameterTable[i].name), std::string(kParameterTable[i].unit),
                                 kParameterTable[i].nominal * (1.0 + off), 0.0, 0.0, 0.0,
                                 ParameterVerdict::Pass});
  }
  return record;
}

MasterReport report_of(const std::vector<double>& k2_percents, double age_h = 1.0) {
  std::vector<CheckRecord> newest_first;
  for (std::size_t i = 0; i < k2_percents.size(); ++i)
    newest_first.insert(newest_first.begin(), check(static_cast<int>(i), k2_percents[i]));
  return master_report({"M-1", "master.toml", 24.0}, certified(), newest_first,
                       kStart_ns + static_cast<std::int64_t>(age_h * static_cast<double>(kHour_ns)));
}

const std::vector<double> kSteady{.1, -.1, .2, -.2, .1, -.1, .2, -.2, .1};

std::vector<double> steady_and(double last) {
  std::vector<double> values = kSteady;
  values.push_back(last);
  return values;
}

TEST(Master, Good) {
  const MasterReport report = report_of(kSteady);
  EXPECT_EQ(report.state, MasterState::Good) << report.text;
  EXPECT_FALSE(asks_for_something(report));
  EXPECT_EQ(report.record, "check-108");
  EXPECT_NEAR(report.age_h, 1.0, 1e-9);
  EXPECT_EQ(report.parameters.size(), kParameterCount);
  EXPECT_EQ(master_json(report).at("state"), "good");
}

TEST(Master, DueWhenOldOrNeverChecked) {
  EXPECT_EQ(report_of(kSteady, 24.1).state, MasterState::Due);
  EXPECT_EQ(report_of(kSteady, 23.9).state, MasterState::Good);
  const MasterReport never = report_of({});
  EXPECT_EQ(never.state, MasterState::Due);
  EXPECT_THAT(never.text, HasSubstr("clampctl run --master"));
  EXPECT_THAT(format_master(never), HasSubstr("due"));
  const MasterReport invalid =
      master_report({"M-1", "", 24.0}, certified(), {check(1, 0.0, Verdict::Error)}, kStart_ns);
  EXPECT_EQ(invalid.state, MasterState::Due) << "an invalid check is none";
}

TEST(Master, OffOutsideOfItsTolerance) {
  const MasterReport report = report_of(steady_and(2.1));
  EXPECT_EQ(report.state, MasterState::Off);
  EXPECT_THAT(report.text, HasSubstr("(k2)"));
  EXPECT_TRUE(asks_for_something(report));
  EXPECT_EQ(report_of(steady_and(-2.1), 100.0).state, MasterState::Off) << "worse than being due";
}

TEST(Master, DriftingWithinItsTolerance) {
  const MasterReport report = report_of(steady_and(1.9));
  EXPECT_EQ(report.state, MasterState::Drifting);
  EXPECT_THAT(report.parameters[k2].drift, ElementsAre(HasSubstr("beyond 3 sigma")));
  EXPECT_THAT(report.parameters[k1].drift, IsEmpty());
  EXPECT_THAT(report.text, HasSubstr("k2 of the master brake M-1 drifted"));
  EXPECT_EQ(report_of(steady_and(0.2)).state, MasterState::Good);
  EXPECT_EQ(report_of({.1, -.1, .1, 1.9}).state, MasterState::Good) << "too few to tell";
}

TEST(Master, NoneIsConfigured) {
  const MasterReport report = master_report({}, certified(), {check(1, 0.0)}, kStart_ns);
  EXPECT_EQ(report.state, MasterState::None);
  EXPECT_FALSE(asks_for_something(report));
}

}  // namespace
}  // namespace clampd
