#include "clampd/line/constants.hpp"

#include <gtest/gtest.h>

namespace clampd::quality {
namespace {

struct TableRow {
  int n;
  double d2, d3, c4;
};

/// Montgomery, Introduction to Statistical Quality Control, Appendix VI.
constexpr TableRow kTable[] = {{2, 1.128, 0.853, 0.7979},  {3, 1.693, 0.888, 0.8862},
                               {4, 2.059, 0.880, 0.9213},  {5, 2.326, 0.864, 0.9400},
                               {10, 3.078, 0.797, 0.9727}, {15, 3.472, 0.756, 0.9823},
                               {25, 3.931, 0.708, 0.9896}};

TEST(ChartConstants, AreThoseOfTheTables) {
  for (const TableRow& row : kTable) {
    EXPECT_NEAR(range_mean(row.n), row.d2, 6e-4) << row.n;
    EXPECT_NEAR(range_sd(row.n), row.d3, 1.1e-3) << row.n;  // the table truncates some
    EXPECT_NEAR(deviation_mean(row.n), row.c4, 6e-5) << row.n;
  }
}

/// AIAG, Measurement Systems Analysis, 4th edition: the constants of its report form.
TEST(ChartConstants, AreThoseOfTheGaugeForm) {
  EXPECT_NEAR(1.0 / range_mean(2), 0.8862, 5e-5);              // K1, two trials
  EXPECT_NEAR(1.0 / range_mean(3), 0.5908, 5e-5);              // K1, three trials
  EXPECT_NEAR(1.0 / average_range_mean(2, 1), 0.7071, 5e-5);   // K2, two appraisers
  EXPECT_NEAR(1.0 / average_range_mean(3, 1), 0.5231, 5e-5);   // K2, three appraisers
  EXPECT_NEAR(1.0 / average_range_mean(10, 1), 0.3146, 5e-5);  // K3, ten parts
}

}  // namespace
}  // namespace clampd::quality
