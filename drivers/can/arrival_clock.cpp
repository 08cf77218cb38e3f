#include "drivers/can/arrival_clock.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/assert.hpp"

namespace clampd::can {
namespace {

constexpr int kMemory = 2000;
/// That the period is near the nominal one is worth as much as so many arrivals.
constexpr int kPrior = 8;
/// So many arrivals, one after the other, that do not agree with those before are the beginning of new ones.
constexpr int kDoubtsUntilRestart = 8;
/// In periods: what is late by more than the first is doubtful. A bus or a gateway may hold it up, but
/// nothing brings a sample early.
constexpr double kDoubtful = 0.5, kLate = 1.5;
/// One arrival moves the filter by no more than one that is late by so many standard deviations: delays have
/// a long tail to one side.
constexpr double kLateness_sd = 3.0;
constexpr double kLeastDeviation_ns = 1e3;

}  // namespace

ArrivalClock::ArrivalClock(std::uint64_t counter_values, std::int64_t cycle_ns)
    : counter_values_{counter_values}, cycle_ns_{static_cast<double>(cycle_ns)}, period_ns_{cycle_ns_} {
  CLAMPD_ASSERT(counter_values == 0 || counter_values >= 4);
}

void ArrivalClock::restart(std::int64_t arrival_ns) noexcept {
  origin_ns_ = arrival_ns;
  time_ns_ = 0.0;
  period_ns_ = cycle_ns_;
  variance_ns2_ = 0.0;
  arrivals_ = kPrior;
  doubts_ = 0;
}

/// Of a counter, all but its whole turns is known; the time since the latest sample tells these.
double ArrivalClock::samples_since(std::uint64_t counted, double since_ns) const noexcept {
  const double periods = since_ns / period_ns_;
  if (counter_values_ == 0) return std::max(0.0, std::round(periods));
  const auto values = static_cast<double>(counter_values_);
  const auto steps = static_cast<double>(counted);
  return steps + std::max(counted == 0 ? 1.0 : 0.0, std::round((periods - steps) / values)) * values;
}

bool ArrivalClock::believable(double samples, double late_ns) const noexcept {
  // Rounding has told which sample it is, unless one is missing before it.
  if (counter_values_ == 0) return samples == 1.0;
  return late_ns > -kDoubtful * cycle_ns_ && late_ns < kLate * cycle_ns_;
}

ArrivalClock::Instant ArrivalClock::follow(std::uint64_t counted, std::int64_t arrival_ns) noexcept {
  if (arrivals_ == 0) {
    restart(arrival_ns);
    return {Verdict::Settling, 1, arrival_ns};
  }
  const double since_ns = static_cast<double>(arrival_ns - origin_ns_) - time_ns_;
  const double samples = samples_since(counted, since_ns);
  Instant instant{Verdict::Settling, static_cast<std::int64_t>(samples), 0};

  const double late_ns = since_ns - samples * period_ns_;
  time_ns_ += samples * period_ns_;
  const bool believed = believable(samples, late_ns);
  const bool doubtful = counter_values_ == 0 ? !believed : std::abs(late_ns) >= kDoubtful * cycle_ns_;
  doubts_ = doubtful ? doubts_ + 1 : 0;
  if (doubts_ >= (settled() ? kDoubtsUntilRestart : 1)) {
    restart(arrival_ns);
    return instant;
  }
  if (!believed) {
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
  if (std::abs(period_ns_ - cycle_ns_) > kPeriodTolerance * cycle_ns_) {
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
