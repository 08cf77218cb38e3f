#include "clampd/publish/backoff.hpp"

#include <gtest/gtest.h>

namespace clampd::publish {
namespace {

using namespace std::chrono_literals;

TEST(Backoff, DoublesUpToItsBoundAndStaysInTheUpperHalf) {
  Backoff backoff({100ms, 1'000ms}, 7);
  for (const auto bound : {100ms, 200ms, 400ms, 800ms, 1'000ms, 1'000ms, 1'000ms}) {
    const auto wait = backoff.next();
    EXPECT_GE(wait, bound / 2);
    EXPECT_LE(wait, bound);
  }
  backoff.reset();
  EXPECT_LE(backoff.next(), 100ms);
}

TEST(Backoff, StationsDoNotComeBackTogether) {
  Backoff a({1'000ms, 60'000ms}, 1), b({1'000ms, 60'000ms}, 2), again({1'000ms, 60'000ms}, 1);
  int same = 0;
  for (int i = 0; i < 20; ++i) {
    const auto wait = a.next();
    EXPECT_EQ(wait, again.next());
    same += wait == b.next() ? 1 : 0;
  }
  EXPECT_LT(same, 3);
}

}  // namespace
}  // namespace clampd::publish
