#include "drivers/can/arrival_clock.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/assert.hpp"

namespace clampd::can {
namespace {

constexpr int kMemory = 2000;
/// That the period is near the loop's is worth as much as so many arrivals.
constexpr int kPrior = 8;
/// So many arrivals, one after the other, that do not agree with those before are the beginning of new ones.
constexpr int kDoubtsUntilRestart = 8;
/// In periods: what is late by more than the first is doubtful. A bus or a gateway may hold it up, but nothing
/// brings a sample early.
constexpr double kDoubtful = 0.5, kLate = 1.5;
/// One arrival moves the filter by no more than one that is late by so many standard deviations: delays have
/// a long tail to one side.
constexpr double kLateness_sd = 3.0;
constexpr double kLeastDeviation_ns = 1e3;
constexpr auto kNominalPeriod_ns = static_cast<double>(kPeriod_ns);

}  // namespace

ArrivalClock::ArrivalClock(std::uint64_t counter_values) : counter_values_{counter_values} {
  CLAMPD_ASSERT(counter_values >= 4);
}

void ArrivalClock::restart(std::int64_t arrival_ns) noexcept {
  origin_ns_ = arrival_ns;
  time_ns_ = 0.0;
  period_ns_ = kNominalPeriod_ns;
  variance_ns2_ = 0.0;
  arrivals_ = kPrior;
  doubts_ = 0;
}

ArrivalClock::Instant ArrivalClock::follow(std::uint64_t counted, std::int64_t arrival_ns) noexcept {
  if (arrivals_ == 0) {
    restart(arrival_ns);
    return {Verdict::Settling, 1, arrival_ns};
  }
  // The counter tells the samples but for whole turns, which the time since the latest one tells.
  const double since_ns = static_cast<double>(arrival_ns - origin_ns_) - time_ns_;
  const double turns = std::round((since_ns / period_ns_ - static_cast<double>(counted)) /
                                  static_cast<double>(counter_values_));
  const double least_turns = counted == 0 ? 1.0 : 0.0;
  const double samples =
      static_cast<double>(counted) + std::max(least_turns, turns) * static_cast<double>(counter_values_);
  Instant instant{Verdict::Settling, static_cast<std::int64_t>(samples), 0};

  const double late_ns = since_ns - samples * period_ns_;
  time_ns_ += samples * period_ns_;
  doubts_ = std::abs(late_ns) < kDoubtful * kNominalPeriod_ns ? 0 : doubts_ + 1;
  if (doubts_ >= (settled() ? kDoubtsUntilRestart : 1)) {
    restart(arrival_ns);
    return instant;
  }
  if (late_ns <= -kDoubtful * kNominalPeriod_ns || late_ns >= kLate * kNominalPeriod_ns) {
    instant.verdict = Verdict::Refused;
    return instant;
  }
  arrivals_ = std::min(arrivals_ + 1, kMemory);
  const double k = arrivals_;
  const double most_ns = kLateness_sd * std::max(jitter_ns(), kLeastDeviation_ns);
  const double step_ns = settled() && jitter_ns() > 0.0 ? std::clamp(late_ns, -most_ns, most_ns) : late_ns;
  time_ns_ += 2.0 * (2.0 * k - 1.0) / (k * (k + 1.0)) * step_ns;
  period_ns_ += 6.0 / (k * (k + 1.0)) * step_ns / samples;
  variance_ns2_ += (step_ns * step_ns - variance_ns2_) / (k - kPrior);
  if (!settled()) return instant;
  if (std::abs(period_ns_ - kNominalPeriod_ns) > kPeriodTolerance * kNominalPeriod_ns) {
    restart(arrival_ns);
    return instant;
  }
  instant.verdict = Verdict::Good;
  instant.time_ns = origin_ns_ + std::llround(time_ns_);
  return instant;
}

double ArrivalClock::jitter_ns() const noexcept {
  return settled() ? std::sqrt(variance_ns2_) : 0.0;
}

}  // namespace clampd::can
