#include "clampd/line/gauge_study.hpp"

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/views/figure.hpp"
#include "clampd/views/gauge_view.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

constexpr int kBrakes = 10, kOperators = 3, kRepeats = 3;
constexpr double kSpread = 0.05;  ///< of the brakes' parameters, relative

struct SimulatedStudy {
  std::vector<CheckRecord> checks;
  std::vector<ParameterVector> truths;  ///< by brake
};

/// Ten simulated brakes, each checked three times by three operators, who in truth differ in nothing.
const SimulatedStudy& simulated_study() {
  static const SimulatedStudy study = [] {
    SimulatedStudy result;
    std::mt19937 random(11);
    std::normal_distribution<double> normal;
    for (int brake = 0; brake < kBrakes; ++brake) {
      sim::PlantConfiguration plant = bench::plant(1);
      for (std::size_t i = 0; i < kParameterCount; ++i)
        plant.brake.theta[static_cast<Eigen::Index>(i)] *= 1.0 + kSpread * normal(random);
      result.truths.push_back(plant.brake.theta);
      for (int op = 0; op < kOperators; ++op)
        for (int repeat = 0; repeat < kRepeats; ++repeat) {
          plant.seed = static_cast<std::uint64_t>(1 + brake * 100 + op * 10 + repeat);
          CheckRecord check = bench::check(plant, 3);  // of two, one pair in a thousand contradicts itself
          EXPECT_EQ(check.verdict, Verdict::Pass) << check.reason;
          check.serial = "brake " + std::to_string(brake);
          check.operator_name = "operator " + std::to_string(op);
          check.runs.clear();
          result.checks.push_back(std::move(check));
        }
    }
    return result;
  }();
  return study;
}

TEST(GaugeOfChecks, FindsOnSimulatedBrakesWhatWasPutIn) {
  const SimulatedStudy& simulated = simulated_study();
  const auto quantities = gauge_of_checks(simulated.checks);
  ASSERT_TRUE(quantities) << quantities.error().message;
  ASSERT_EQ(quantities->size(), kParameterCount);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const GaugeQuantity& quantity = (*quantities)[i];
    const quality::GaugeStudy& study = quantity.study;
    EXPECT_EQ(quantity.name, kParameterTable[i].name);
    EXPECT_EQ(study.parts, 10u);
    EXPECT_EQ(study.operators, 3u);
    EXPECT_EQ(study.repeats, 3u);
    double claimed_square = 0.0, mean = 0.0, spread_square = 0.0;
    for (const CheckRecord& check : simulated.checks)
      claimed_square += std::pow(check.parameters[i].sd, 2) / static_cast<double>(simulated.checks.size());
    for (const ParameterVector& truth : simulated.truths)
      mean += truth[static_cast<Eigen::Index>(i)] / kBrakes;
    for (const ParameterVector& truth : simulated.truths)
      spread_square += std::pow(truth[static_cast<Eigen::Index>(i)] - mean, 2) / (kBrakes - 1);
    // The scatter from check to check is what every check says of itself; so few repeats overstate it a
    // little.
    EXPECT_GT(study.repeatability.sd, 0.35 * std::sqrt(claimed_square)) << quantity.name;
    EXPECT_LT(study.repeatability.sd, 1.6 * std::sqrt(claimed_square)) << quantity.name;
    // No operator does anything to a simulated brake.
    EXPECT_LT(study.reproducibility.sd, 0.7 * study.repeatability.sd) << quantity.name;
    const double tolerance = study.gauge.sd + 0.1 * std::sqrt(spread_square);
    EXPECT_NEAR(study.part_variation.sd, std::sqrt(spread_square), tolerance) << quantity.name;
  }
  EXPECT_LT((*quantities)[k2].study.gauge.of_total, 0.1);
  EXPECT_GE((*quantities)[k2].study.distinct_categories, 14.0);
  EXPECT_NEAR((*quantities)[k2].study.gauge.of_tolerance,
              6.0 * (*quantities)[k2].study.gauge.sd / (40.48 - 29.92), 1e-3);
}

TEST(GaugeOfChecks, TakesValidChecksOnlyAndNamesWhatIsMissing) {
  std::vector<CheckRecord> checks = simulated_study().checks;
  checks[4].verdict = Verdict::Error;
  const auto incomplete = gauge_of_checks(checks);
  ASSERT_FALSE(incomplete);
  EXPECT_THAT(incomplete.error().message, HasSubstr("operator 1 measured part brake 0 2 times"));
  EXPECT_THAT(gauge_of_checks({}).error().message, HasSubstr("no valid checks"));
}

TEST(GaugeReport, IsAPageThatNeedsNothingElse) {
  if (const auto drawable = report::can_draw(); !drawable) GTEST_SKIP() << drawable.error().message;
  const auto page = gauge_report(*gauge_of_checks(simulated_study().checks), "a study");
  ASSERT_TRUE(page) << page.error().message;
  for (const char* expected : {"Gauge R&amp;R", "operator 2", "parts x operators", "k2 in N/rad^2"})
    EXPECT_THAT(*page, HasSubstr(expected));
  EXPECT_THAT(*page, ::testing::Not(HasSubstr("src=")));
}

TEST(GaugeOfCsv, ReadsColumnsInAnyOrder) {
  const auto quantities = gauge_of_csv(
      "trial, width ,operator,part\r\n1,1.0,A,1\r\n2,1.1,A,1\r\n1,2.0,A,2\r\n2,2.1,A,2\r\n"
      "1,1.2,B,1\r\n2,1.3,B,1\r\n1,2.2,B,2\r\n2,2.3,B,2\r\n\r\n",
      "study.csv", {{"width", 6.0}});
  ASSERT_TRUE(quantities) << quantities.error().message;
  ASSERT_EQ(quantities->size(), 1u);
  EXPECT_EQ((*quantities)[0].name, "width");
  EXPECT_NEAR((*quantities)[0].study.gauge.of_tolerance, (*quantities)[0].study.gauge.sd, 1e-12);
  EXPECT_EQ(gauge_json(*quantities).at("quantities").at(0).at("repeats"), 2);
}

TEST(GaugeOfCsv, NamesLineAndColumn) {
  const auto message = [](const std::string& text) {
    const auto read = gauge_of_csv(text, "study.csv", {});
    return read ? std::string() : read.error().message;
  };
  EXPECT_THAT(message("part,value\n"), HasSubstr("study.csv:1: a gauge study needs the columns"));
  EXPECT_THAT(message("part,operator,value\n1,A,x\n"), HasSubstr("study.csv:2:3: 'x' is not a number"));
  EXPECT_THAT(message("part,operator,value\n1,A\n"), HasSubstr("study.csv:2: 2 columns, the header has 3"));
  EXPECT_THAT(message("part,operator,value\n1,A,nan\n"), HasSubstr("not a number"));
  EXPECT_THAT(message(""), HasSubstr("no"));
  EXPECT_THAT(gauge_of_csv("part,operator,value\n", "s.csv", {{"width", 1.0}}).error().message,
              HasSubstr("no column width"));
}

}  // namespace
}  // namespace clampd
