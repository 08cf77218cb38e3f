#include "clampd/attribution/attribution.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/views/attribution_view.hpp"
#include "support/factory.hpp"

namespace clampd::attribution {
namespace {

using support::Factory;
using support::make_line;
using ::testing::HasSubstr;
using ::testing::Not;

const AttributionOptions kOptions{0.01, 1};

std::vector<Finding> findings_of(const Factory& factory, std::uint64_t seed) {
  const LineTable table = make_line(factory, seed);
  return attribute(table, kOptions).parameters.at(0).findings;
}

TEST(Attribution, NamesNothingOnALineWithoutACause) {
  int found = 0;
  for (std::uint64_t seed = 0; seed < 30; ++seed) {
    Factory factory;
    factory.stations = 8;
    factory.brakes = 2000;
    factory.deviations.wander = seed % 2 == 0 ? 0.0 : 0.1;
    found += findings_of(factory, 300 + seed).empty() ? 0 : 1;
  }
  // 30 lines at 1 % each: three or more have a probability of 0.3 %.
  EXPECT_LE(found, 2);
}

TEST(Attribution, NamesTheStationThatChangedAndWhen) {
  int right = 0, others = 0;
  for (std::uint64_t seed = 0; seed < 8; ++seed) {
    Factory factory;
    factory.stations = 10;
    factory.brakes = 16000;
    factory.step_station = static_cast<int>(seed);
    factory.step = seed % 2 == 0 ? 0.4 : -0.4;  // one standard deviation of the stations
    factory.step_at = 0.25 + 0.06 * static_cast<double>(seed);
    const LineTable table = make_line(factory, 400 + seed);
    const std::vector<Finding> findings = attribute(table, kOptions).parameters.at(0).findings;
    bool named = false;
    for (const Finding& finding : findings) {
      if (finding.number != factory.step_station || finding.kind == Finding::Kind::BatchApart)
        ++others;
      else if (finding.kind == Finding::Kind::StationStep)
        named =
            named ||
            (std::abs(finding.period / static_cast<double>(table.layout.periods) - factory.step_at) < 0.1 &&
             std::abs(finding.size - factory.step) < 4.0 * finding.sd);
    }
    right += named ? 1 : 0;
  }
  EXPECT_GE(right, 7);
  EXPECT_LE(others, 1);
}

TEST(Attribution, NamesTheStationThatDrifts) {
  int right = 0;
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    Factory factory;
    factory.stations = 10;
    factory.brakes = 12000;
    factory.drift_station = 3;
    factory.drift = 0.6;
    const std::vector<Finding> findings = findings_of(factory, 500 + seed);
    right += !findings.empty() && findings[0].kind == Finding::Kind::StationDrift && findings[0].number == 3
                 ? 1
                 : 0;
  }
  EXPECT_GE(right, 5);
}

TEST(Attribution, WhereStationsDoNotDifferTheirLevelsAreKnown) {
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    Factory factory;
    factory.stations = 6;
    factory.brakes = 1200;
    factory.deviations.station = 0.0;
    const LineTable table = make_line(factory, 650 + seed);
    const LineAttribution found = attribute(table, kOptions);
    // A spread that chance shows may leave a question, but none that takes more brakes than there are.
    const int needed = found.parameters.at(0).brakes_needed;
    EXPECT_LT(needed, factory.brakes) << seed;
    EXPECT_EQ(attribution_json(table, found, 0.01)["cannot_tell"].get<std::string>().empty(), needed == 0) << seed;
  }
}

TEST(Attribution, NamesTheBatchThatIsApart) {
  Factory factory;
  factory.apart_batch = 17;
  factory.apart = 4.0;
  const LineTable table = make_line(factory, 600);
  const LineAttribution found = attribute(table, kOptions);
  const std::vector<Finding>& findings = found.parameters.at(0).findings;
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].kind, Finding::Kind::BatchApart);
  EXPECT_EQ(findings[0].number, 17);
  EXPECT_NEAR(findings[0].size, 4.0, 1.5);
  EXPECT_THAT(attribution_json(table, found, 0.01)["parameters"][0]["findings"][0]["words"],
              HasSubstr("batch batch 17: k2 differs by +"));
}

TEST(Attribution, SaysWhenStationsCannotBeTold) {
  Factory factory;
  factory.stations = 6;
  factory.batches = 6;
  factory.batch_at_one_station = true;
  factory.checked_twice = 0.0;
  factory.deviations.batch = 1.0;
  LineTable table = make_line(factory, 700);
  LineAttribution found = attribute(table, kOptions);
  EXPECT_THAT(found.separable, ::testing::Each(false));
  EXPECT_GT(found.parameters[0].brakes_needed, 0);
  EXPECT_THAT(format_attribution(table, found, 0.01), HasSubstr("do not tell 6 stations apart"));

  // The same line, with brakes that went to two stations.
  factory.checked_twice = 0.2;
  table = make_line(factory, 700);
  found = attribute(table, kOptions);
  EXPECT_THAT(found.separable, ::testing::Each(true));
  EXPECT_THAT(format_attribution(table, found, 0.01), Not(HasSubstr("apart from the brakes")));
}

TEST(Attribution, OneStationHasNoLevelButATime) {
  Factory factory;
  factory.stations = 1;
  factory.brakes = 2000;
  factory.step_station = 0;
  factory.step = 1.5;
  const LineTable table = make_line(factory, 800);
  const LineAttribution found = attribute(table, kOptions);
  EXPECT_FALSE(found.parameters[0].components.station);
  EXPECT_TRUE(found.parameters[0].stations.empty());
  const auto json = attribution_json(table, found, 0.01);
  EXPECT_TRUE(json["parameters"][0]["sd"]["stations"].is_null());
}

}  // namespace
}  // namespace clampd::attribution
