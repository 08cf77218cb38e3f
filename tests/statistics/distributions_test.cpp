#include "clampd/statistics/distributions.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace clampd::statistics {
namespace {

// Tables of the NIST/SEMATECH e-Handbook of Statistical Methods, section 1.3.6.7.
TEST(Distributions, HaveThePublishedQuantiles) {
  EXPECT_NEAR(chi_squared_upper_quantile(0.05, 1), 3.841, 5e-4);
  EXPECT_NEAR(chi_squared_upper_quantile(0.001, 10), 29.588, 5e-4);
  EXPECT_NEAR(chi_squared_upper_quantile(0.975, 20), 9.591, 5e-4);
  EXPECT_NEAR(student_t_upper_quantile(0.025, 9), 2.262, 5e-4);
  EXPECT_NEAR(normal_quantile(0.975), 1.960, 5e-4);
}

TEST(Distributions, HaveThePublishedTails) {
  EXPECT_NEAR(chi_squared_p_value(18.307, 10), 0.05, 5e-6);
  EXPECT_NEAR(fisher_f_p_value(4.103, 2, 10), 0.05, 5e-5);
  EXPECT_NEAR(fisher_f_p_value(2.978, 10, 10), 0.05, 5e-5);
}

TEST(Distributions, ATailBeyondTheSmallestNumbersStillHasALogarithm) {
  // With two degrees of freedom the tail is exp(-x/2) exactly.
  EXPECT_NEAR(chi_squared_neg_log_p(100.0, 2), 50.0, 1e-9);
  EXPECT_NEAR(chi_squared_neg_log_p(4000.0, 2), 2000.0, 1e-6);
  // It grows without a step where the one way of computing takes over from the other.
  double before = chi_squared_neg_log_p(1100.0, 7);
  for (double x = 1101.0; x < 1300.0; x += 1.0) {
    const double here = chi_squared_neg_log_p(x, 7);
    EXPECT_GT(here, before);
    EXPECT_LT(here - before, 0.501);
    before = here;
  }
}

TEST(Distributions, WhatTellsNothingIsNoEvidence) {
  EXPECT_EQ(chi_squared_p_value(-1.0, 3), 1.0);
  EXPECT_EQ(chi_squared_p_value(5.0, 0), 1.0);
  EXPECT_EQ(chi_squared_neg_log_p(0.0, 3), 0.0);
  EXPECT_EQ(fisher_f_p_value(3.0, 2, 0), 1.0);
  EXPECT_TRUE(std::isnan(chi_squared_p_value(std::nan(""), 3)));
  EXPECT_TRUE(std::isnan(fisher_f_p_value(std::nan(""), 3, 3)));
  EXPECT_EQ(chi_squared_p_value(std::numeric_limits<double>::infinity(), 3), 0.0);
}

}  // namespace
}  // namespace clampd::statistics
