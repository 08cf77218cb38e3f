#include "clampd/statistics/sequential.hpp"

#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include "clampd/statistics/distributions.hpp"

namespace clampd::statistics {
namespace {

TEST(RepeatedLooks, OneLookTakesTheNormalQuantile) {
  EXPECT_NEAR(repeated_look_factor(0.025, 1, 1), 1.959964, 1e-5);
  EXPECT_NEAR(repeated_look_factor(0.0227501, 20, 20), 2.0, 1e-5);
}

/// Pocock's constants for two-sided tests at 5 % (Jennison and Turnbull 2000, table 2.1). With two sides
/// at 2.5 % each, crossing both is rare enough not to show in the third digit.
TEST(RepeatedLooks, AgreesWithPococksTable) {
  EXPECT_NEAR(repeated_look_factor(0.025, 1, 2), 2.178, 2e-3);
  EXPECT_NEAR(repeated_look_factor(0.025, 1, 5), 2.413, 2e-3);
  EXPECT_NEAR(repeated_look_factor(0.025, 1, 10), 2.555, 2e-3);
  EXPECT_NEAR(repeated_look_factor(0.025, 1, 20), 2.672, 2e-3);
}

TEST(RepeatedLooks, MoreLooksAskForMore) {
  double before = 2.0;
  for (const int most : {5, 8, 20, 40}) {
    const double factor = repeated_look_factor(0.0227501, 4, most);
    EXPECT_GT(factor, before) << most;
    before = factor;
  }
  EXPECT_LT(repeated_look_factor(0.0227501, 8, 20), repeated_look_factor(0.0227501, 4, 20));
}

/// Sums of independent draws, drawn by something that knows nothing of the integration.
TEST(RepeatedLooks, HoldsItsProbabilityInSimulation) {
  constexpr int kFirst = 4, kMost = 20, kPaths = 200'000;
  constexpr double kProbability = 0.0227501;
  const double factor = repeated_look_factor(kProbability, kFirst, kMost);
  std::mt19937_64 random(1);
  std::normal_distribution<double> share;
  int crossed = 0;
  for (int path = 0; path < kPaths; ++path) {
    double sum = 0.0;
    bool above = false;
    for (int n = 1; n <= kMost; ++n) {
      sum += share(random);
      above = above || (n >= kFirst && sum > factor * std::sqrt(n));
    }
    crossed += above;
  }
  // Four standard deviations of the count.
  const double sd = std::sqrt(kProbability / kPaths);
  EXPECT_NEAR(static_cast<double>(crossed) / kPaths, kProbability, 4.0 * sd);
}

/// Shares of very different size, as of runs that are chosen for what is in doubt.
TEST(RepeatedLooks, HoldsItsProbabilityForUnevenShares) {
  constexpr int kPaths = 200'000;
  constexpr double kProbability = 0.0227501;
  const std::vector<double> information{4.0, 5.0, 6.0, 20.0, 34.0, 48.0, 49.0, 300.0};
  const double factor = repeated_look_factor(kProbability, information);
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  int crossed = 0;
  for (int path = 0; path < kPaths; ++path) {
    double sum = 0.0, before = 0.0;
    bool above = false;
    for (const double now : information) {
      sum += std::sqrt(now - before) * normal(random);
      before = now;
      above = above || sum > factor * std::sqrt(now);
    }
    crossed += above;
  }
  EXPECT_NEAR(static_cast<double>(crossed) / kPaths, kProbability, 4.0 * std::sqrt(kProbability / kPaths));
  EXPECT_NEAR(factor, repeated_look_factor(kProbability, std::vector{40.0, 50.0, 60.0, 200.0, 340.0, 480.0, 490.0, 3000.0}),
              1e-9)
      << "the unit does not matter";
}

TEST(RepeatedLooks, AnEstimatedDeviationAsksForStudentsQuantile) {
  EXPECT_EQ(with_estimated_deviation(2.6, std::numeric_limits<double>::infinity()), 2.6);
  EXPECT_NEAR(with_estimated_deviation(1.959964, 5.0), student_t_upper_quantile(0.025, 5.0), 1e-4);
  EXPECT_GT(with_estimated_deviation(2.6, 4.0), with_estimated_deviation(2.6, 10.0));
}

}  // namespace
}  // namespace clampd::statistics
