#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "clampd/base/realtime.hpp"

namespace clampd::rt {

/// A copy of a histogram, in cyclictest's words.
struct HistogramSnapshot {
  std::uint64_t count = 0;
  double min_us = 0.0;
  double avg_us = 0.0;
  double max_us = 0.0;
  /// bins[k] counts durations in [k, k+1) us; the last bin takes everything longer.
  std::vector<std::uint64_t> bins;
};

/// Durations in bins of 1 us, written by one thread without locks. Other threads may take a snapshot at any
/// time; while the writer is at work its fields may be one entry apart from each other.
class DurationHistogram {
 public:
  static constexpr std::size_t kOverflowBin = 1000;

  /// Writer only. Negative durations (a clock that was read twice) count as zero.
  CLAMPD_REALTIME void record(std::int64_t duration_ns) noexcept {
    duration_ns = std::max<std::int64_t>(duration_ns, 0);
    add(bins_[static_cast<std::size_t>(std::min<std::int64_t>(duration_ns / 1000, kOverflowBin))], 1);
    add(sum_ns_, static_cast<std::uint64_t>(duration_ns));
    if (duration_ns < min_ns_.load(std::memory_order_relaxed)) {
      min_ns_.store(duration_ns, std::memory_order_relaxed);
    }
    if (duration_ns > max_ns_.load(std::memory_order_relaxed)) {
      max_ns_.store(duration_ns, std::memory_order_relaxed);
    }
    add(count_, 1);
  }

  /// Writer only.
  CLAMPD_REALTIME void reset() noexcept {
    count_.store(0, std::memory_order_relaxed);
    sum_ns_.store(0, std::memory_order_relaxed);
    min_ns_.store(kNoMinimum, std::memory_order_relaxed);
    max_ns_.store(0, std::memory_order_relaxed);
    for (auto& bin : bins_) bin.store(0, std::memory_order_relaxed);
  }

  HistogramSnapshot snapshot() const {
    HistogramSnapshot copy;
    copy.count = count_.load(std::memory_order_relaxed);
    copy.bins.reserve(bins_.size());
    for (const auto& bin : bins_) copy.bins.push_back(bin.load(std::memory_order_relaxed));
    if (copy.count > 0) {
      copy.min_us = static_cast<double>(min_ns_.load(std::memory_order_relaxed)) * 1e-3;
      copy.max_us = static_cast<double>(max_ns_.load(std::memory_order_relaxed)) * 1e-3;
      copy.avg_us = static_cast<double>(sum_ns_.load(std::memory_order_relaxed)) * 1e-3 /
                    static_cast<double>(copy.count);
    }
    return copy;
  }

 private:
  static constexpr std::int64_t kNoMinimum = std::numeric_limits<std::int64_t>::max();

  // With one writer a load and a store suffice; a locked read-modify-write would only cost time.
  static void add(std::atomic<std::uint64_t>& counter, std::uint64_t amount) noexcept {
    counter.store(counter.load(std::memory_order_relaxed) + amount, std::memory_order_relaxed);
  }

  std::atomic<std::uint64_t> count_{0};
  std::atomic<std::uint64_t> sum_ns_{0};
  std::atomic<std::int64_t> min_ns_{kNoMinimum};
  std::atomic<std::int64_t> max_ns_{0};
  std::array<std::atomic<std::uint64_t>, kOverflowBin + 1> bins_{};
};

}  // namespace clampd::rt
