#include "rt/histogram.hpp"

#include <numeric>
#include <thread>

#include <gtest/gtest.h>

namespace clampd::rt {
namespace {

TEST(Histogram, SpeaksCyclictest) {
  DurationHistogram histogram;
  for (const std::int64_t duration_ns : {999, 1000, 1999, 14'500, 2'000'000}) histogram.record(duration_ns);
  const HistogramSnapshot snapshot = histogram.snapshot();
  EXPECT_EQ(snapshot.count, 5U);
  EXPECT_DOUBLE_EQ(snapshot.min_us, 0.999);
  EXPECT_DOUBLE_EQ(snapshot.max_us, 2000.0);
  EXPECT_NEAR(snapshot.avg_us, (0.999 + 1.0 + 1.999 + 14.5 + 2000.0) / 5, 1e-9);
  ASSERT_EQ(snapshot.bins.size(), 1001U);
  EXPECT_EQ(snapshot.bins[0], 1U);
  EXPECT_EQ(snapshot.bins[1], 2U);
  EXPECT_EQ(snapshot.bins[14], 1U);
  EXPECT_EQ(snapshot.bins[1000], 1U);
}

TEST(Histogram, BoundaryOfTheOverflowBin) {
  DurationHistogram histogram;
  histogram.record(999'999);
  histogram.record(1'000'000);
  const HistogramSnapshot snapshot = histogram.snapshot();
  EXPECT_EQ(snapshot.bins[999], 1U);
  EXPECT_EQ(snapshot.bins[1000], 1U);
}

TEST(Histogram, EmptyAndResetAreZero) {
  DurationHistogram histogram;
  EXPECT_EQ(histogram.snapshot().max_us, 0.0);
  histogram.record(50'000);
  histogram.record(-10);
  EXPECT_EQ(histogram.snapshot().min_us, 0.0);
  histogram.reset();
  const HistogramSnapshot snapshot = histogram.snapshot();
  EXPECT_EQ(snapshot.count, 0U);
  EXPECT_EQ(snapshot.min_us, 0.0);
  EXPECT_EQ(snapshot.avg_us, 0.0);
  EXPECT_EQ(snapshot.max_us, 0.0);
  EXPECT_EQ(std::accumulate(snapshot.bins.begin(), snapshot.bins.end(), std::uint64_t{0}), 0U);
}

TEST(Histogram, MayBeReadWhileWritten) {
  constexpr std::uint64_t kCount = 20'000;
  DurationHistogram histogram;
  std::thread writer([&histogram] {
    for (std::uint64_t i = 0; i < kCount; ++i) histogram.record(static_cast<std::int64_t>(i % 50) * 1000);
  });
  double highest_us = 0.0;
  std::uint64_t count = 0;
  while (count < kCount) {
    const HistogramSnapshot snapshot = histogram.snapshot();
    EXPECT_GE(snapshot.count, count);
    count = snapshot.count;
    highest_us = std::max(highest_us, snapshot.max_us);
  }
  writer.join();
  EXPECT_DOUBLE_EQ(highest_us, 49.0);
}

}  // namespace
}  // namespace clampd::rt
