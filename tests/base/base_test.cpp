#include <algorithm>
#include <atomic>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/base/parallel.hpp"
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

TEST(ThreadBudget, AreOneAccountForAllCopies) {
  EXPECT_FALSE(ThreadBudget().take()) << "by itself, none";
  const ThreadBudget threads(3);
  const ThreadBudget copy = threads;
  EXPECT_TRUE(threads.take());
  EXPECT_TRUE(copy.take());
  EXPECT_FALSE(threads.take()) << "the caller's thread is the third";
  copy.give_back();
  EXPECT_TRUE(threads.take());
}

TEST(ThreadBudget, LoopsWithinLoopsDoAllWorkOnceAndShareThem) {
  constexpr int kThreads = 3;
  constexpr std::size_t kOuter = 7, kInner = 50;
  const ThreadBudget threads(kThreads);
  std::vector<std::atomic<int>> done(kOuter * kInner);
  std::atomic<int> at_once{0}, most{0};
  for_each_index(kOuter, threads, [&](std::size_t outer) {
    for_each_index(kInner, threads, [&](std::size_t inner) {
      const int now = ++at_once;
      for (int seen = most; seen < now && !most.compare_exchange_weak(seen, now);) {
      }
      ++done[outer * kInner + inner];
      --at_once;
    });
  });
  EXPECT_TRUE(std::all_of(done.begin(), done.end(), [](const auto& times) { return times == 1; }));
  EXPECT_LE(most, kThreads);
  for (int i = 1; i < kThreads; ++i) EXPECT_TRUE(threads.take()) << "all are given back";
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
