#include "clampd/line_page/line_page.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/line/capability.hpp"

namespace clampd::line_page {
namespace {

using nlohmann::ordered_json;
using reanalysis::LineRows;
using reanalysis::ListedCheck;
using reanalysis::MeasuredCheck;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr double kDay_s = 86'400.0;
constexpr double kNow_s = 1'796'040'000.0;  // 2026-11-30T12:00Z
constexpr double kSpread = 0.02;            // of brakes, times nominal

/// A line of two stations over thirty days.
struct Line {
  double drift = 0.0;        ///< of north's k2 from the first day to the last, times nominal
  double south_days = 30.0;  ///< that south was at work, of the thirty
  double north_days = 30.0;
  double simulated = 0.0;  ///< share of the checks
  double spread = kSpread;
};

/// Ten checks a day and station of brakes that come in batches of four days; one in twenty fails, one in
/// twenty is an error.
LineRows rows_of(const Line& line) {
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  LineRows rows;
  rows.where = "PostgreSQL: archive, database line";
  rows.now_s = kNow_s;
  rows.span = reanalysis::kLineSpans[2];
  rows.part_number = "P";
  for (int number = 0; number < 600; ++number) {
    const bool north = number % 2 == 0;
    const double day = number / 20.0;
    if (day >= (north ? line.north_days : line.south_days)) continue;
    MeasuredCheck check;
    check.started_s = kNow_s - (30.0 - day) * kDay_s + kDay_s / 2.0 + 1.0;
    if (check.started_s > kNow_s) break;
    check.station = north ? "north" : "south";
    check.serial = fmt::format("S{}", number);
    check.batch = fmt::format("B{}", number / 80);
    check.simulated = number < 600 * line.simulated;
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const double nominal = kParameterTable[i].nominal;
      const double drift = north && i == k2 ? line.drift * day / 30.0 : 0.0;
      check.readings[i] = {nominal * (1.0 + drift + line.spread * normal(random)),
                           std::abs(nominal) * line.spread / 20.0};
      check.limits[i] = std::minmax(0.85 * nominal, 1.15 * nominal);
    }
    const Verdict verdict = number % 40 < 2   ? Verdict::Fail
                            : number % 40 < 4 ? Verdict::Timeout
                                              : Verdict::Pass;
    rows.checks.push_back({check.started_s, check.station, "P", verdict, check.simulated});
    if (is_about_the_brake(verdict)) rows.measured.push_back(std::move(check));
  }
  std::reverse(rows.checks.begin(), rows.checks.end());
  std::reverse(rows.measured.begin(), rows.measured.end());
  for (const char* station : {"north", "south"}) {
    const auto last = std::find_if(rows.checks.begin(), rows.checks.end(),
                                   [&](const ListedCheck& check) { return check.station == station; });
    if (last != rows.checks.end())
      rows.stations.push_back({station, last->started_s, "the last", "P", last->verdict, "why"});
  }
  return rows;
}

ordered_json page_of(const LineRows& rows) {
  return document(rows, attribution_of(rows));
}

std::vector<std::string> findings_of(const ordered_json& page) {
  std::vector<std::string> words;
  for (const ordered_json& parameter : page.at("attribution").at("parameters"))
    for (const ordered_json& finding : parameter.at("findings")) words.push_back(finding.at("words"));
  return words;
}

TEST(LinePage, CountsTheChecksOfEachStationAndShowsWhichOneIsSilent) {
  const ordered_json page = page_of(rows_of({.south_days = 27.0}));
  EXPECT_EQ(page["schema"], "clampd.line_page/1");
  EXPECT_EQ(page["made"], "2026-11-30T12:00:00.000Z");
  EXPECT_EQ(page["since"], "2026-11-01T00:00:00.000Z");
  ASSERT_EQ(page["stations"].size(), 2U);
  const ordered_json &north = page["stations"][0], &south = page["stations"][1];
  EXPECT_EQ(north["station"], "north");
  EXPECT_EQ(north["span"], ordered_json({{"passed", 265}, {"failed", 15}, {"invalid", 15}}));
  EXPECT_EQ(north["periods"].size(), 30U);
  EXPECT_EQ(north["periods"][0][0].get<int>() + north["periods"][0][1].get<int>() +
                north["periods"][0][2].get<int>(),
            10);
  EXPECT_EQ(north["silent"], false);
  EXPECT_EQ(south["silent"], true);
  // North has made some 26 checks since south's last one, and the two are equally busy.
  EXPECT_NEAR(south["missed"].get<double>(), 26.0, 3.0);
  EXPECT_EQ(south["day"], ordered_json({{"passed", 0}, {"failed", 0}, {"invalid", 0}}));
  EXPECT_EQ(south["last"]["serial"], "the last");
}

TEST(LinePage, NoStationIsSilentWhileTheWholeLineRests) {
  const ordered_json page = page_of(rows_of({.south_days = 24.0, .north_days = 24.0}));
  for (const ordered_json& station : page["stations"]) EXPECT_EQ(station["silent"], false) << station;
}

TEST(LinePage, AStationWithoutAnyCheckInTheSpanIsSilent) {
  LineRows rows = rows_of({});
  rows.stations.push_back({"west", kNow_s - 50 * kDay_s, "long ago", "P", Verdict::Pass, ""});
  const ordered_json west = page_of(rows)["stations"][2];
  EXPECT_EQ(west["silent"], true);
  EXPECT_TRUE(west["missed"].is_null());
  EXPECT_EQ(west["last"]["age_s"], 50 * kDay_s);
}

TEST(LinePage, AStationThatDriftsIsSeenAndNamed) {
  const ordered_json page = page_of(rows_of({.drift = 0.06}));
  EXPECT_THAT(findings_of(page),
              ElementsAre(AllOf(HasSubstr("station north: k2"), HasSubstr("drifts, by +"))));
  const ordered_json& stiffness = page["parameters"][k2];
  EXPECT_EQ(stiffness["name"], "k2");
  const ordered_json &north = stiffness["stations"][0]["periods"],
                     &south = stiffness["stations"][1]["periods"];
  const auto rise = [](const ordered_json& periods) {
    return (periods["mean"][28].get<double>() - periods["mean"][1].get<double>()) /
           kParameterTable[k2].nominal;
  };
  const double uncertainty = 2.0 * kSpread / std::sqrt(8.0);
  EXPECT_NEAR(rise(north), 0.06 * 27.0 / 30.0, 2.5 * uncertainty);
  EXPECT_NEAR(rise(south), 0.0, 2.5 * uncertainty);
  EXPECT_NEAR(north["sd"][1].get<double>(),
              kParameterTable[k2].nominal * kSpread / std::sqrt(north["brakes"][1].get<double>()),
              0.1 * kParameterTable[k2].nominal * kSpread);
}

TEST(LinePage, NothingIsNamedOnALineWithoutACause) {
  EXPECT_THAT(findings_of(page_of(rows_of({}))), IsEmpty());
}

TEST(LinePage, ABrakeCountsOnceAtAStationByItsLastCheck) {
  LineRows rows = rows_of({});
  const auto last_of_north =
      std::find_if(rows.measured.begin(), rows.measured.end(),
                   [](const MeasuredCheck& check) { return check.station == "north"; });
  MeasuredCheck again = *last_of_north;
  again.started_s += 10.0;
  again.readings[k2].first = 1.1 * kParameterTable[k2].nominal;
  rows.measured.insert(rows.measured.begin(), again);

  const ordered_json at_north = page_of(rows)["parameters"][k2]["stations"][0];
  std::vector<double> values;
  for (const MeasuredCheck& check : rows.measured)
    if (check.station == "north" && (check.serial != again.serial || check.started_s == again.started_s))
      values.push_back(check.readings[k2].first);
  std::reverse(values.begin(), values.end());
  const quality::Capability expected =
      quality::capability(values, again.limits[k2].first, again.limits[k2].second);
  EXPECT_EQ(at_north["brakes"], values.size());
  EXPECT_DOUBLE_EQ(at_north["mean"], expected.mean);
  EXPECT_DOUBLE_EQ(at_north["sd"], expected.sd_overall);
  EXPECT_DOUBLE_EQ(at_north["cpk"]["value"], expected.cpk.value);
  EXPECT_DOUBLE_EQ(at_north["cpk"]["lower"], expected.cpk.lower);
}

TEST(LinePage, SaysWhetherTheLimitsChangedAndDrawsThoseOfTheNewestCheck) {
  LineRows rows = rows_of({});
  EXPECT_EQ(page_of(rows)["parameters"][TC]["limits_changed"], false);
  rows.measured.front().limits[TC] = {-std::numeric_limits<double>::infinity(), 1.0};
  const ordered_json friction = page_of(rows)["parameters"][TC];
  EXPECT_EQ(friction["limits_changed"], true);
  EXPECT_EQ(friction["upper"], 1.0);
  EXPECT_TRUE(friction["lower"].is_null());
  EXPECT_EQ(page_of(rows)["parameters"][k2]["limits_changed"], false);
}

TEST(LinePage, SimulatedBrakesCountWhereThereAreNoOthers) {
  const ordered_json mixed = page_of(rows_of({.simulated = 0.25}));
  EXPECT_EQ(mixed["simulated_left_out"].get<std::size_t>() + mixed["measured"].get<std::size_t>(),
            rows_of({}).measured.size());
  EXPECT_NEAR(mixed["simulated_left_out"].get<double>(), 0.25 * 570, 10.0);
  const ordered_json alone = page_of(rows_of({.simulated = 1.0}));
  EXPECT_EQ(alone["simulated_left_out"], 0);
  EXPECT_EQ(alone["measured"], rows_of({}).measured.size());
}

TEST(LinePage, SaysFromWhenOnItWasRead) {
  LineRows rows = rows_of({});
  EXPECT_TRUE(page_of(rows)["read_since"].is_null());
  rows.checks.resize(100);
  rows.more_checks = true;
  const ordered_json page = page_of(rows);
  EXPECT_THAT(page["read_since"], HasSubstr("2026-11-2"));
  EXPECT_EQ(page["checks"], 100);
}

TEST(LinePage, AnArchiveWithoutChecksGivesAPageToo) {
  LineRows rows;
  rows.now_s = kNow_s;
  rows.span = reanalysis::kLineSpans[0];
  const ordered_json page = page_of(rows);
  EXPECT_THAT(page["stations"], IsEmpty());
  EXPECT_THAT(page["parameters"], IsEmpty());
  EXPECT_TRUE(page["attribution"].is_null());
}

TEST(LinePage, FewChecksHaveNoCapabilityAndNoAttribution) {
  LineRows rows = rows_of({});
  rows.measured.resize(1);
  const ordered_json page = page_of(rows);
  EXPECT_TRUE(page["attribution"].is_null());
  ASSERT_EQ(page["parameters"].size(), kParameterCount);
  const ordered_json& only = page["parameters"][k2]["stations"][0];
  EXPECT_EQ(only["brakes"], 1);
  EXPECT_DOUBLE_EQ(only["mean"], rows.measured[0].readings[k2].first);
  EXPECT_TRUE(only["cpk"]["value"].is_null());
}

TEST(LinePage, BrakesThatAreAllAlikeAreNoHindrance) {
  const ordered_json page = page_of(rows_of({.spread = 0.0}));
  EXPECT_THAT(findings_of(page), IsEmpty());
  EXPECT_TRUE(page["parameters"][k2]["stations"][0]["cpk"]["value"].is_null());
  EXPECT_EQ(ordered_json::parse(page.dump()), page);
}

TEST(LinePage, ClaimsAndJobsAreTold) {
  LineRows rows = rows_of({});
  rows.claims.push_back({"host:1", 3, "wider", "C-1", "S-1", kNow_s - 40.0, 2, false});
  reanalysis::JobStatus job;
  job.id = 3;
  job.done = 5;
  job.failed = 1;
  job.failures.emplace_back("no raw runs", 1);
  rows.jobs.push_back(job);
  const ordered_json page = page_of(rows);
  EXPECT_EQ(page["claims"][0]["worker"], "host:1");
  EXPECT_EQ(page["claims"][0]["age_s"], 40.0);
  EXPECT_EQ(page["claims"][0]["alive"], false);
  EXPECT_EQ(page["jobs"][0]["tasks"], 6);
  EXPECT_EQ(page["jobs"][0]["failures"][0]["reason"], "no raw runs");
}

}  // namespace
}  // namespace clampd::line_page
