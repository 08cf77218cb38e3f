#pragma once

#include <cstdint>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"

namespace clampd::can {

/// The sampling instants of a brake that sends no clock of its own, from the arrivals of its frames. The
/// brake is taken to sample at a constant period near the nominal one; each arrival is late by a delay that
/// varies. A fading-memory filter of first order follows phase and period (growing memory at first; Brookner,
/// Tracking and Kalman Filtering Made Easy, 1998, ch. 6 and 7): with a memory of 2000 samples, its instants
/// vary by 4 % of what the arrivals do. A constant delay does not matter: it is the same for all readings.
///
/// Where an alive counter counts the samples, a late one is known for what it is. Without a counter the time
/// alone tells them, so that less is believed: the first sample after a gap is refused, since it may be a new
/// one or one that was held up, and so is one that follows on the one before it at once.
class ArrivalClock {
 public:
  enum class Verdict : std::uint8_t {
    Settling,  ///< too few arrivals are known, or their period is not the nominal one: no time of it is known
    Good,
    Refused,  ///< too early or too late by the arrivals before, or which sample it is cannot be told
  };
  struct Instant {
    Verdict verdict = Verdict::Settling;
    std::int64_t samples = 0;  ///< that the brake took since the call before: 1 or more; without a counter 0
                               ///< where an arrival follows on the one before it at once
    std::int64_t time_ns = 0;  ///< on the clock of the arrivals; increases from one good instant to the next
  };

  /// `counter_values`: how many the alive counter has, at least 4, or 0 for a brake without one. `cycle_ns`:
  /// how often the brake samples, nominally.
  explicit ArrivalClock(std::uint64_t counter_values, std::int64_t cycle_ns = kPeriod_ns);

  /// Takes the arrival of a sample, whose alive counter is `counted` steps (modulo its values) after the one
  /// of the call before.
  CLAMPD_REALTIME Instant follow(std::uint64_t counted, std::int64_t arrival_ns) noexcept;

  /// Standard deviation by which arrivals vary about the instants; 0 while settling.
  CLAMPD_REALTIME double jitter_ns() const noexcept;

  static constexpr int kSettlingSamples = 64;
  static constexpr double kPeriodTolerance = 0.02;

 private:
  void restart(std::int64_t arrival_ns) noexcept;
  double samples_since(std::uint64_t counted, double since_ns) const noexcept;
  bool believable(double samples, double late_ns) const noexcept;
  bool settled() const noexcept { return arrivals_ >= kSettlingSamples; }

  std::uint64_t counter_values_;
  double cycle_ns_;
  std::int64_t origin_ns_ = 0;  ///< arrival that the times below count from
  double time_ns_ = 0.0;        ///< of the latest sample
  double period_ns_;
  double variance_ns2_ = 0.0;
  int arrivals_ = 0;  ///< since the start, up to the memory
  int doubts_ = 0;    ///< one after the other
};

}  // namespace clampd::can
