#include "drivers/can/arrival_clock.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"
#include "support/allocation_trap.hpp"

namespace clampd::can {
namespace {

using Verdict = ArrivalClock::Verdict;

/// A brake of which every sample's true instant is known, and how late it arrives.
class Brake {
 public:
  Brake(double period_ns, double delay_ns, std::uint64_t seed = 5, std::uint64_t counter_values = 16)
      : period_ns_(period_ns), delay_ns_(delay_ns), random_(seed), counter_values_(counter_values) {}

  struct Arrival {
    double sampled_ns;
    std::int64_t arrival_ns;
    std::uint64_t counted;
  };
  /// The next sample that arrives, after so many that got lost. Every fiftieth is four times as late as most.
  Arrival next(int lost = 0) {
    sampled_ns_ += period_ns_ * (1 + lost);
    const double delay_ns =
        delay_ns_ * uniform_(random_) + (uniform_(random_) < 0.02 ? 3.0 * delay_ns_ : 0.0);
    return {sampled_ns_, std::llround(sampled_ns_ + delay_ns),
            static_cast<std::uint64_t>(1 + lost) % counter_values_};
  }
  void pause(double ns) { sampled_ns_ += ns; }

 private:
  double period_ns_, delay_ns_;
  std::mt19937_64 random_;
  std::uniform_real_distribution<double> uniform_{0.0, 1.0};
  std::uint64_t counter_values_;
  double sampled_ns_ = 7.2e15;  // as after three months
};

class Periods : public ::testing::TestWithParam<double> {};

TEST_P(Periods, AreFollowedFarBetterThanTheArrivalsVary) {
  constexpr double kDelay_ns = 100e3;
  const double period_ns = GetParam() * static_cast<double>(kPeriod_ns);
  Brake brake(period_ns, kDelay_ns);
  ArrivalClock clock(16);
  std::mt19937_64 random(8);
  std::vector<double> errors_ns;
  std::int64_t samples = 0, taken = 0, previous_ns = 0;
  for (int i = 0; i < 6000; ++i) {
    const int lost = random() % 100 == 0 ? static_cast<int>(random() % 40) : 0;
    taken += 1 + lost;
    const Brake::Arrival arrival = brake.next(lost);
    const ArrivalClock::Instant instant = clock.follow(arrival.counted, arrival.arrival_ns);
    samples += instant.samples;
    ASSERT_EQ(samples, taken) << i;
    if (i < ArrivalClock::kSettlingSamples) continue;
    ASSERT_EQ(instant.verdict, Verdict::Good) << i;
    EXPECT_GT(instant.time_ns, previous_ns);
    previous_ns = instant.time_ns;
    if (i >= 3000) errors_ns.push_back(static_cast<double>(instant.time_ns) - arrival.sampled_ns);
  }
  const auto [least, most] = std::minmax_element(errors_ns.begin(), errors_ns.end());
  EXPECT_LT(*most - *least, 0.25 * kDelay_ns) << "of delays that vary by four times as much as this is";
  // A run of 300 samples: its times are straight to within far less.
  double worst_ns = 0.0;
  for (std::size_t i = 300; i < errors_ns.size(); ++i)
    worst_ns = std::max(worst_ns, std::abs(errors_ns[i] - errors_ns[i - 300]));
  EXPECT_LT(worst_ns, 0.15 * kDelay_ns);
  EXPECT_GT(clock.jitter_ns(), 0.2 * kDelay_ns);
  EXPECT_LT(clock.jitter_ns(), 0.8 * kDelay_ns);
}

INSTANTIATE_TEST_SUITE_P(ArrivalClock, Periods, ::testing::Values(0.99, 0.9999, 1.0, 1.0001, 1.015));

TEST(ArrivalClock, FollowsNoOtherPeriodThanTheLoops) {
  for (const double period : {0.5, 0.9, 0.97, 1.03, 1.1, 1.5, 2.0, 5.0, 10.0}) {
    Brake brake(period * static_cast<double>(kPeriod_ns), 20e3);
    ArrivalClock clock(16);
    for (int i = 0; i < 3000; ++i) {
      const Brake::Arrival arrival = brake.next();
      ASSERT_NE(clock.follow(arrival.counted, arrival.arrival_ns).verdict, Verdict::Good) << period;
    }
  }
}

TEST(ArrivalClock, RefusesWhatComesInABurstAndGoesOn) {
  Brake brake(1e6, 20e3);
  ArrivalClock clock(16);
  std::int64_t previous_ns = 0;
  int refused = 0;
  for (int i = 0; i < 2000; ++i) {
    Brake::Arrival arrival = brake.next();
    // A gateway that stands still for five milliseconds, and then sends everything at once.
    if (i >= 1000 && i < 1005) arrival.arrival_ns += (1005 - i) * kPeriod_ns;
    const ArrivalClock::Instant instant = clock.follow(arrival.counted, arrival.arrival_ns);
    EXPECT_EQ(instant.samples, 1);
    if (i < 100) continue;
    refused += instant.verdict == Verdict::Refused ? 1 : 0;
    if (instant.verdict != Verdict::Good) continue;
    EXPECT_NEAR(static_cast<double>(instant.time_ns), arrival.sampled_ns + 10e3, 20e3) << i;
    EXPECT_GT(instant.time_ns, previous_ns);
    previous_ns = instant.time_ns;
  }
  EXPECT_EQ(refused, 4) << "the last one is late by no more than a bus may hold it up";
}

TEST(ArrivalClock, ABrakeThatBeganAnewIsFollowedAnew) {
  Brake brake(1e6, 20e3);
  ArrivalClock clock(16);
  for (int i = 0; i < 500; ++i) {
    const Brake::Arrival arrival = brake.next();
    clock.follow(arrival.counted, arrival.arrival_ns);
  }
  brake.pause(123.4e6);
  int missed = 0;
  std::int64_t previous_ns = 0;
  for (int i = 0; i < 500; ++i) {
    Brake::Arrival arrival = brake.next();
    if (i == 0) arrival.counted = 9;
    const ArrivalClock::Instant instant = clock.follow(arrival.counted, arrival.arrival_ns);
    EXPECT_GE(instant.samples, 1);
    missed += instant.verdict == Verdict::Good ? 0 : 1;
    if (instant.verdict != Verdict::Good) continue;
    EXPECT_NEAR(static_cast<double>(instant.time_ns), arrival.sampled_ns + 10e3, 20e3) << i;
    EXPECT_GT(instant.time_ns, previous_ns);
    previous_ns = instant.time_ns;
  }
  EXPECT_GT(missed, 0) << "no sample has a time before its brake's new phase is known";
  EXPECT_LT(missed, 2 * ArrivalClock::kSettlingSamples);
}

// Nothing counts the samples of this brake. Frames are lost, held up by up to four periods, and let go in
// bursts: what is believed is where it belongs.
TEST(ArrivalClock, WithoutACounterNothingIsTakenForAnotherSample) {
  constexpr double kDelay_ns = 50e3;
  Brake brake(1.0003e6, kDelay_ns, 11, 16);
  ArrivalClock clock(0);
  std::mt19937_64 random(4);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::int64_t previous_ns = 0, held_until_ns = 0;
  double last_sampled_ns = 0.0;
  std::int64_t samples = 0;
  int good = 0, lost_or_held = 0, offered = 0;
  for (int i = 0; i < 20000; ++i) {
    const bool calm = i < 200;
    const int lost = !calm && uniform(random) < 0.003 ? 1 + static_cast<int>(random() % 5) : 0;
    Brake::Arrival arrival = brake.next(lost);
    if (!calm && uniform(random) < 0.003)
      held_until_ns = arrival.arrival_ns + std::llround(4e6 * uniform(random));
    lost_or_held += lost > 0 || arrival.arrival_ns < held_until_ns ? 1 : 0;
    arrival.arrival_ns = std::max(arrival.arrival_ns, held_until_ns + 1000 * i % 7);
    const ArrivalClock::Instant instant = clock.follow(0, arrival.arrival_ns);
    ASSERT_GE(instant.samples, 0);
    samples += instant.samples;
    if (i < ArrivalClock::kSettlingSamples) continue;
    ++offered;
    if (instant.verdict != Verdict::Good) continue;
    ++good;
    ASSERT_NEAR(static_cast<double>(instant.time_ns), arrival.sampled_ns + 0.5 * kDelay_ns, 0.3e6) << i;
    ASSERT_GT(instant.time_ns, previous_ns);
    if (last_sampled_ns > 0.0) {
      ASSERT_EQ(samples, std::llround((arrival.sampled_ns - last_sampled_ns) / 1.0003e6)) << i;
    }
    samples = 0;
    last_sampled_ns = arrival.sampled_ns;
    previous_ns = instant.time_ns;
  }
  EXPECT_GT(lost_or_held, 100);
  EXPECT_GT(good, offered - 4 * lost_or_held) << "what is refused is what lies beside a gap";
}

TEST(ArrivalClock, WithoutACounterNoOtherPeriodIsFollowed) {
  for (const double period : {0.2, 0.25, 0.5, 0.9, 0.97, 1.03, 1.1, 1.5, 2.0, 3.0, 5.0, 10.0}) {
    Brake brake(period * static_cast<double>(kPeriod_ns), 20e3);
    ArrivalClock clock(0);
    for (int i = 0; i < 3000; ++i)
      ASSERT_NE(clock.follow(0, brake.next().arrival_ns).verdict, Verdict::Good) << period;
  }
}

TEST(ArrivalClock, AllocatesNothing) {
  Brake brake(1e6, 20e3);
  ArrivalClock clock(16);
  const support::AllocationTrap trap;
  for (int i = 0; i < 500; ++i) {
    const Brake::Arrival arrival = brake.next();
    clock.follow(arrival.counted, arrival.arrival_ns);
  }
  EXPECT_EQ(trap.allocations(), 0U);
}

}  // namespace
}  // namespace clampd::can
