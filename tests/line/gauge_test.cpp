#include "clampd/line/gauge.hpp"

#include <array>
#include <cmath>
#include <random>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace clampd::quality {
namespace {

using ::testing::HasSubstr;

/// AIAG, Measurement Systems Analysis, 4th edition, figure III-B 15: three appraisers, three trials each, ten
/// parts.
constexpr double kAiag[3][3][10] = {{{0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36},
                                     {0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25},
                                     {0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31}},
                                    {{0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68},
                                     {0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62},
                                     {0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50}},
                                    {{0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49},
                                     {-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77},
                                     {-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16}}};

std::vector<GaugeReading> aiag() {
  std::vector<GaugeReading> readings;
  for (int trial = 0; trial < 3; ++trial)
    for (int appraiser = 0; appraiser < 3; ++appraiser)
      for (int part = 0; part < 10; ++part)
        readings.push_back({std::to_string(part + 1), std::string(1, static_cast<char>('A' + appraiser)),
                            kAiag[appraiser][trial][part]});
  return readings;
}

/// The manual's tables III-B 7 to 10.
TEST(GaugeAnova, ReproducesThePublishedExample) {
  const auto study = gauge_anova(aiag(), {.tolerance = 8.0});
  ASSERT_TRUE(study) << study.error().message;
  ASSERT_EQ(study->anova.size(), 5u);
  const AnovaRow &parts = study->anova[0], &appraisers = study->anova[1], &interaction = study->anova[2],
                 &equipment = study->anova[3], &total = study->anova[4];
  EXPECT_NEAR(appraisers.sum_of_squares, 3.1673, 1e-4);
  EXPECT_NEAR(appraisers.mean_square, 1.58363, 1e-5);
  EXPECT_NEAR(parts.sum_of_squares, 88.3619, 1e-4);
  EXPECT_NEAR(parts.mean_square, 9.81799, 1e-5);
  EXPECT_NEAR(interaction.sum_of_squares, 0.3590, 1e-4);
  EXPECT_NEAR(interaction.mean_square, 0.01994, 1e-5);
  EXPECT_NEAR(interaction.f, 0.434, 1e-3);
  EXPECT_NEAR(equipment.sum_of_squares, 2.7589, 1e-4);
  EXPECT_NEAR(equipment.mean_square, 0.04598, 1e-5);
  EXPECT_NEAR(total.sum_of_squares, 94.6471, 1e-4);
  EXPECT_EQ(total.freedom, 89.0);

  EXPECT_TRUE(study->interaction_pooled);
  EXPECT_NEAR(study->repeatability.sd, 0.19993, 5e-6);
  EXPECT_NEAR(study->operator_effect.sd, 0.22684, 5e-6);
  EXPECT_EQ(study->interaction.sd, 0.0);
  EXPECT_NEAR(study->gauge.sd, 0.30237, 5e-6);
  EXPECT_NEAR(study->part_variation.sd, 1.04233, 5e-6);
  EXPECT_NEAR(study->total.sd, 1.0853, 5e-5);
  EXPECT_NEAR(100.0 * study->repeatability.of_total, 18.42, 5e-3);
  EXPECT_NEAR(100.0 * study->operator_effect.of_total, 20.90, 5e-3);
  EXPECT_NEAR(100.0 * study->gauge.of_total, 27.86, 5e-3);
  EXPECT_NEAR(100.0 * study->part_variation.of_total, 96.04, 5e-3);
  EXPECT_NEAR(100.0 * study->gauge.of_tolerance, 600.0 * 0.30237 / 8.0, 1e-3);
  EXPECT_EQ(std::floor(study->distinct_categories), 4.0);
  EXPECT_EQ(grade(study->gauge.of_total), GaugeGrade::Conditional);
}

/// The manual's figure III-B 16, whose constants and intermediate results have four digits.
TEST(GaugeAverageRange, ReproducesThePublishedExample) {
  const auto study = gauge_average_range(aiag(), {});
  ASSERT_TRUE(study) << study.error().message;
  EXPECT_NEAR(study->repeatability.sd, 0.20188, 1e-4);
  EXPECT_NEAR(study->operator_effect.sd, 0.22963, 1e-4);
  EXPECT_NEAR(study->gauge.sd, 0.30575, 1e-4);
  EXPECT_NEAR(study->part_variation.sd, 1.10456, 2e-4);
  EXPECT_NEAR(study->total.sd, 1.14610, 2e-4);
  EXPECT_NEAR(100.0 * study->gauge.of_total, 26.68, 0.02);
  EXPECT_EQ(std::floor(study->distinct_categories), 5.0);
  EXPECT_TRUE(std::isnan(study->gauge.of_tolerance));
}

std::vector<GaugeReading> simulated(std::mt19937& random, double repeat, double op, double both, double part,
                                    int parts = 10) {
  std::normal_distribution<double> normal;
  std::vector<double> of_part(static_cast<std::size_t>(parts));
  std::array<double, 3> of_operator{};
  for (double& effect : of_part) effect = part * normal(random);
  for (double& effect : of_operator) effect = op * normal(random);
  std::vector<GaugeReading> readings;
  for (std::size_t p = 0; p < of_part.size(); ++p)
    for (std::size_t o = 0; o < of_operator.size(); ++o) {
      const double cell = of_part[p] + of_operator[o] + both * normal(random);
      for (int i = 0; i < 3; ++i)
        readings.push_back(
            {"part " + std::to_string(p), "operator " + std::to_string(o), cell + repeat * normal(random)});
    }
  return readings;
}

TEST(GaugeAnova, FindsTheVariancesOfASimulatedStudy) {
  std::mt19937 random(3);
  double repeat = 0.0, op = 0.0, both = 0.0, part = 0.0;
  constexpr int kStudies = 400;
  for (int i = 0; i < kStudies; ++i) {
    const auto study = gauge_anova(simulated(random, 1.0, 2.0, 1.5, 5.0), {.pooling_p = 1.0});
    ASSERT_TRUE(study);
    repeat += std::pow(study->repeatability.sd, 2) / kStudies;
    op += std::pow(study->operator_effect.sd, 2) / kStudies;
    both += std::pow(study->interaction.sd, 2) / kStudies;
    part += std::pow(study->part_variation.sd, 2) / kStudies;
  }
  EXPECT_NEAR(repeat, 1.0, 0.05);
  EXPECT_NEAR(op, 4.0, 0.8);
  EXPECT_NEAR(both, 2.25, 0.2);
  EXPECT_NEAR(part, 25.0, 2.5);
}

TEST(GaugeAnova, KeepsAnInteractionThatIsThere) {
  std::mt19937 random(5);
  const auto study = gauge_anova(simulated(random, 1.0, 0.0, 3.0, 10.0), {});
  ASSERT_TRUE(study);
  EXPECT_FALSE(study->interaction_pooled);
  EXPECT_LT(study->anova[2].p, 1e-6);
  EXPECT_NEAR(study->interaction.sd, 3.0, 1.0);
  EXPECT_NEAR(study->gauge.sd, std::hypot(study->repeatability.sd, study->reproducibility.sd), 1e-12);
}

TEST(GaugeAnova, NeedsACompleteStudy) {
  std::vector<GaugeReading> readings = aiag();
  readings.erase(readings.begin() + 3);  // part 4 by A
  EXPECT_THAT(gauge_anova(readings, {}).error().message, HasSubstr("operator A measured part 4 2 times"));
  EXPECT_THAT(gauge_anova({}, {}).error().message, HasSubstr("two parts and two operators"));
  readings = aiag();
  readings.resize(30);
  EXPECT_THAT(gauge_anova(readings, {}).error().message, HasSubstr("once only"));
  readings = aiag();
  readings[5].value = NAN;
  EXPECT_THAT(gauge_anova(readings, {}).error().message, HasSubstr("not a number"));
}

TEST(GaugeGrade, ByTheGuideline) {
  EXPECT_EQ(to_string(grade(0.09)), "good");
  EXPECT_EQ(to_string(grade(0.30)), "conditional");
  EXPECT_EQ(to_string(grade(0.31)), "unacceptable");
}

}  // namespace
}  // namespace clampd::quality
