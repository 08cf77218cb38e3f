#include "rt/ring.hpp"

#include <thread>

#include <gtest/gtest.h>

namespace clampd::rt {
namespace {

Sample numbered(std::int64_t number) {
  Sample sample;
  sample.sample_index = number;
  sample.brake_time_ns = 3 * number;
  sample.force_N = 0.5 * static_cast<double>(number);
  return sample;
}

TEST(Ring, KeepsOrderAndContent) {
  SampleRing ring(16);
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(ring.push(numbered(i)));
  Sample sample;
  for (int i = 0; i < 10; ++i) {
    ASSERT_TRUE(ring.pop(sample));
    EXPECT_EQ(sample.sample_index, i);
    EXPECT_EQ(sample.force_N, 0.5 * i);
  }
  EXPECT_FALSE(ring.pop(sample));
}

TEST(Ring, DropsTheNewestWhenFullAndSaysSo) {
  SampleRing ring(16);
  for (int i = 0; i < 16; ++i) ASSERT_TRUE(ring.push(numbered(i)));
  EXPECT_FALSE(ring.push(numbered(16)));
  Sample sample;
  ASSERT_TRUE(ring.pop(sample));
  EXPECT_EQ(sample.sample_index, 0);
  EXPECT_TRUE(ring.push(numbered(17)));
  std::int64_t last = 0;
  while (ring.pop(sample)) last = sample.sample_index;
  EXPECT_EQ(last, 17);
}

TEST(Ring, TwoThreadsSeeWholeSamplesInOrder) {
  constexpr std::int64_t kCount = 100'000;
  SampleRing ring(64);
  std::thread producer([&ring] {
    for (std::int64_t i = 0; i < kCount;) {
      if (ring.push(numbered(i))) {
        ++i;
      } else {
        std::this_thread::yield();
      }
    }
  });
  std::int64_t expected = 0;
  std::int64_t torn = 0;
  while (expected < kCount) {
    Sample sample;
    if (!ring.pop(sample)) {
      std::this_thread::yield();
      continue;
    }
    torn += sample.sample_index != expected || sample.brake_time_ns != 3 * expected ||
            sample.force_N != 0.5 * static_cast<double>(expected);
    ++expected;
  }
  producer.join();
  EXPECT_EQ(torn, 0);
}

}  // namespace
}  // namespace clampd::rt
