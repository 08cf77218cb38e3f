#include "clampd/line/control_chart.hpp"

#include <set>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace clampd::quality {
namespace {

using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;

/// NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2: flow rates of ten batches.
TEST(IndividualsChart, OfTheNistExample) {
  const std::vector<double> rates{49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1};
  const ChartPair charts = individuals_chart(rates);
  EXPECT_NEAR(charts.location.centre, 50.81, 1e-9);
  EXPECT_NEAR(charts.spread.centre, 1.8778, 5e-5);
  EXPECT_NEAR(charts.location.upper, 55.8041, 2e-3);  // the handbook divides by 1.128
  EXPECT_NEAR(charts.location.lower, 45.8159, 2e-3);
  EXPECT_EQ(charts.spread.points.size(), 9u);
  EXPECT_THAT(charts.spread.signals, IsEmpty());
}

/// Montgomery, Introduction to Statistical Quality Control, example 6.1: flow width of the hard-bake process,
/// 25 samples of 5 wafers.
const std::vector<std::vector<double>> kFlowWidth{
    {1.3235, 1.4128, 1.6744, 1.4573, 1.6914}, {1.4314, 1.3592, 1.6075, 1.4666, 1.6109},
    {1.4284, 1.4871, 1.4932, 1.4324, 1.5674}, {1.5028, 1.6352, 1.3841, 1.2831, 1.5507},
    {1.5604, 1.2735, 1.5265, 1.4363, 1.6441}, {1.5955, 1.5451, 1.3574, 1.3281, 1.4198},
    {1.6274, 1.5064, 1.8366, 1.4177, 1.5144}, {1.4190, 1.4303, 1.6637, 1.6067, 1.5519},
    {1.3884, 1.7277, 1.5355, 1.5176, 1.3688}, {1.4039, 1.6697, 1.5089, 1.4627, 1.5220},
    {1.4158, 1.7667, 1.4278, 1.5928, 1.4181}, {1.5821, 1.3355, 1.5777, 1.3908, 1.7559},
    {1.2856, 1.4106, 1.4447, 1.6398, 1.1928}, {1.4951, 1.4036, 1.5893, 1.6458, 1.4969},
    {1.3589, 1.2863, 1.5996, 1.2497, 1.5471}, {1.5747, 1.5301, 1.5171, 1.1839, 1.8662},
    {1.3680, 1.7269, 1.3957, 1.5014, 1.4449}, {1.4163, 1.3864, 1.3057, 1.6210, 1.5573},
    {1.5796, 1.4185, 1.6541, 1.5116, 1.7247}, {1.7106, 1.4412, 1.2361, 1.3820, 1.7601},
    {1.4371, 1.5051, 1.3485, 1.5670, 1.4880}, {1.4738, 1.5936, 1.6583, 1.4973, 1.4720},
    {1.5917, 1.4333, 1.5551, 1.5295, 1.6866}, {1.6399, 1.5243, 1.5705, 1.5563, 1.5530},
    {1.5797, 1.3663, 1.6240, 1.3732, 1.6887}};

TEST(MeanRangeChart, OfMontgomerysExample) {
  const ChartPair charts = mean_range_chart(kFlowWidth);
  EXPECT_NEAR(charts.location.centre, 1.5056, 5e-5);
  EXPECT_NEAR(charts.spread.centre, 0.32521, 5e-6);
  EXPECT_NEAR(charts.location.upper, 1.69325, 1e-4);
  EXPECT_NEAR(charts.location.lower, 1.31795, 1e-4);
  EXPECT_NEAR(charts.spread.upper, 0.68749, 2e-4);
  EXPECT_EQ(charts.spread.lower, 0.0);
  EXPECT_NEAR(charts.sigma, 0.1398, 5e-5);
  EXPECT_THAT(charts.spread.signals, IsEmpty());
  for (const Signal& signal : charts.location.signals) EXPECT_NE(signal.rule, Rule::BeyondLimits);
}

TEST(MeanDeviationChart, AgreesWithTheRanges) {
  const ChartPair ranges = mean_range_chart(kFlowWidth), deviations = mean_deviation_chart(kFlowWidth);
  EXPECT_EQ(deviations.location.centre, ranges.location.centre);
  EXPECT_NEAR(deviations.sigma, ranges.sigma, 0.03 * ranges.sigma);
  // A3 = 1.427, B4 = 2.089 for n = 5
  EXPECT_NEAR((deviations.location.upper - deviations.location.centre) / deviations.spread.centre, 1.427,
              1e-3);
  EXPECT_NEAR(deviations.spread.upper / deviations.spread.centre, 2.089, 1e-3);
}

std::set<Rule> rules_broken(const std::vector<double>& points, RuleSet rules = RuleSet::Nelson) {
  std::set<Rule> broken;
  for (const Signal& signal : signals(points, 0.0, 1.0, rules)) {
    broken.insert(signal.rule);
    EXPECT_EQ(signal.at, points.size() - 1) << name(signal.rule) << " before its last point";
  }
  return broken;
}

/// Each rule at its last point and one short of it.
TEST(Rules, EachIsSeenWhereItIsComplete) {
  EXPECT_THAT(rules_broken({0.1, -3.01}), UnorderedElementsAre(Rule::BeyondLimits));
  EXPECT_THAT(rules_broken({0.1, -2.99}), IsEmpty());
  EXPECT_THAT(rules_broken({-.1, .3, .1, .3, .1, .3, .1, .3, .2, .1}),
              UnorderedElementsAre(Rule::NineOnOneSide));
  EXPECT_THAT(rules_broken({-.1, .3, .1, .3, .1, .3, .1, .3, .2}), IsEmpty());
  EXPECT_THAT(rules_broken({-.5, -.3, -.1, .1, .3, .5}), UnorderedElementsAre(Rule::SixTrending));
  EXPECT_THAT(rules_broken({-.3, -.1, .1, .3, .5}), IsEmpty());
  EXPECT_THAT(rules_broken({.5, .3, .1, -.1, -.3, -.5}), UnorderedElementsAre(Rule::SixTrending));
  EXPECT_THAT(rules_broken({-1.1, .1, -.1, .1, -.1, .1, -.1, .1, -.1, .1, -.1, .1, -.1, .1}),
              UnorderedElementsAre(Rule::Alternating));
  EXPECT_THAT(rules_broken({.1, -.1, .1, -.1, .1, -.1, .1, -.1, .1, -.1, .1, -.1, .1}), IsEmpty());
  EXPECT_THAT(rules_broken({2.1, 0.0, 2.1}), UnorderedElementsAre(Rule::TwoOfThree));
  EXPECT_THAT(rules_broken({2.1, 0.0, -2.1}), IsEmpty());
  EXPECT_THAT(rules_broken({-1.1, -1.1, .1, -1.1, -1.1}), UnorderedElementsAre(Rule::FourOfFive));
  EXPECT_THAT(rules_broken({-1.1, -1.1, .1, -1.1, 1.1}), IsEmpty());
  EXPECT_THAT(rules_broken({.1, .2, -.1, .1, .3, -.2, -.3, .1, .2, -.1, .4, .5, -.1, -.2, .1}),
              UnorderedElementsAre(Rule::FifteenWithin));
  EXPECT_THAT(rules_broken({1.1, 1.2, -1.1, -1.2, 1.1, 1.2, -1.1, -1.2}),
              UnorderedElementsAre(Rule::EightBeyond));
  EXPECT_THAT(rules_broken({1.1, 1.2, -1.1, -1.2, 1.1, 1.2, -1.1}), IsEmpty());
  EXPECT_THAT(rules_broken({-.1, .3, .1, .3, .1, .3, .1, .3, .2}, RuleSet::WesternElectric),
              UnorderedElementsAre(Rule::EightOnOneSide));
}

TEST(Rules, HaveNames) {
  EXPECT_EQ(name(Rule::TwoOfThree), "Nelson 5 (Western Electric 2)");
  EXPECT_EQ(name(Rule::EightOnOneSide), "Western Electric 4");
  EXPECT_EQ(description(Rule::EightBeyond), "eight points in a row beyond 1 sigma on both sides");
}

TEST(Rules, EqualPointsAreNoSignal) {
  EXPECT_THAT(individuals_chart(std::vector<double>(20, 1.0)).location.signals, IsEmpty());
}

}  // namespace
}  // namespace clampd::quality
