#include "clampd/line/capability.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace clampd::quality {
namespace {

/// Values of exactly this mean and standard deviation.
std::vector<double> values_of(double mean, double sd, int n, unsigned seed = 1) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<double> values;
  double sum = 0.0, squares = 0.0;
  for (int i = 0; i < n; ++i) values.push_back(normal(random));
  for (const double value : values) sum += value;
  for (double& value : values) value -= sum / n;
  for (const double value : values) squares += value * value;
  for (double& value : values) value = mean + sd * value / std::sqrt(squares / (n - 1));
  return values;
}

/// NIST/SEMATECH e-Handbook of Statistical Methods, 6.1.6: limits 8 and 20, mean 16, s = 2.
TEST(Capability, OfTheNistExample) {
  const Capability found = capability(values_of(16.0, 2.0, 50), 8.0, 20.0);
  EXPECT_NEAR(found.mean, 16.0, 1e-12);
  EXPECT_NEAR(found.sd_overall, 2.0, 1e-12);
  EXPECT_NEAR(found.pp.value, 1.0, 1e-12);
  EXPECT_NEAR(found.ppk.value, 0.6667, 5e-5);
}

/// Montgomery, example 8.4: n = 20, Cp = 2.29 of limits 62 and 38 with s = 1.75: 1.57 <= Cp <= 3.01.
TEST(Capability, ConfidenceOfMontgomerysPotential) {
  const Capability found = capability(values_of(50.0, 1.75, 20), 38.0, 62.0);
  EXPECT_NEAR(found.pp.value, 2.29, 5e-3);
  EXPECT_NEAR(found.pp.lower, 1.57, 1e-2);
  EXPECT_NEAR(found.pp.upper, 3.01, 5e-3);
}

/// Montgomery, example 8.5: n = 20, Cpk = 1.33: 0.88 <= Cpk <= 1.78 (the book's normal approximation).
TEST(Capability, ConfidenceOfMontgomerysActual) {
  const Capability found = capability(values_of(0.0, 1.0, 20), -3.99, 9.0);
  EXPECT_NEAR(found.ppk.value, 1.33, 1e-9);
  EXPECT_NEAR(found.ppk.lower, 0.88, 0.01);
  EXPECT_NEAR(found.ppk.upper, 1.78, 0.01);
}

TEST(Capability, ADriftShowsInTheOverallScatterOnly) {
  std::vector<double> values = values_of(0.0, 1.0, 200);
  const Capability steady = capability(values, -6.0, 6.0);
  EXPECT_NEAR(steady.cp.value / steady.pp.value, 1.0, 0.1);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] += 0.02 * static_cast<double>(i);
  const Capability drifting = capability(values, -6.0, 6.0);
  EXPECT_NEAR(drifting.sd_within, steady.sd_within, 0.02);
  EXPECT_GT(drifting.cp.value, 1.4 * drifting.pp.value);
}

/// 95 % intervals contain the truth in about 95 % of cases: also with the moving range's degrees of freedom.
TEST(Capability, IntervalsHoldWhatTheyPromise) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  constexpr int kTrials = 2000;
  int cp = 0, cpk = 0, ppk = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<double> values(40);
    for (double& value : values) value = normal(random);
    const Capability found = capability(values, -3.0, 4.5);
    cp += found.cp.lower <= 1.25 && 1.25 <= found.cp.upper;
    cpk += found.cpk.lower <= 1.0 && 1.0 <= found.cpk.upper;
    ppk += found.ppk.lower <= 1.0 && 1.0 <= found.ppk.upper;
  }
  for (const int count : {cp, cpk, ppk}) {
    EXPECT_GT(count, 0.93 * kTrials);
    EXPECT_LT(count, 0.97 * kTrials);
  }
}

TEST(Capability, OneLimitOrNoScatter) {
  const double infinity = std::numeric_limits<double>::infinity();
  const Capability one_sided = capability(values_of(0.0, 1.0, 20), -infinity, 3.0);
  EXPECT_TRUE(std::isnan(one_sided.pp.value));
  EXPECT_NEAR(one_sided.ppk.value, 1.0, 1e-12);
  const std::vector<double> equal(5, 1.0);
  EXPECT_TRUE(std::isnan(capability(equal, 0.0, 2.0).cpk.value));
}

}  // namespace
}  // namespace clampd::quality
