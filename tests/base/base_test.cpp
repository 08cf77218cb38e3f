#include <gtest/gtest.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/base/result.hpp"

namespace clampd {
namespace {

TEST(Assert, PassesTrueAndAbortsOnFalseWithThePlace) {
  CLAMPD_ASSERT(1 + 1 == 2);
  EXPECT_DEATH(CLAMPD_ASSERT(1 + 1 == 3), "1 \\+ 1 == 3.*base_test.cpp");
}

TEST(Clock, NeverRunsBackwards) {
  std::int64_t last_ns = monotonic_now_ns();
  for (int i = 0; i < 10'000; ++i) {
    const std::int64_t now_ns = monotonic_now_ns();
    ASSERT_GE(now_ns, last_ns);
    last_ns = now_ns;
  }
  EXPECT_EQ(kPeriod_ns, static_cast<std::int64_t>(kPeriod_s * 1e9));
}

TEST(Result, CarriesAValueOrAMessage) {
  const auto half = [](int value) -> Result<int> {
    if (value % 2 != 0) return failure("odd");
    return value / 2;
  };
  EXPECT_EQ(half(4).value(), 2);
  EXPECT_EQ(half(3).error().message, "odd");
}

}  // namespace
}  // namespace clampd
