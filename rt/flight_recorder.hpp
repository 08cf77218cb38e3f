#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

#include "clampd/base/realtime.hpp"
#include "clampd/record/sample.hpp"

namespace clampd::rt {

/// Keeps the last samples and, at a fault, a copy of them for other threads to read.
/// The loop never waits: while a reader holds the copy, the capture is put off to the next tick.
class FlightRecorder {
 public:
  static constexpr std::size_t kCapacity = 512;

  /// Where the next sample is to be written. Loop only.
  CLAMPD_REALTIME Sample& next() noexcept {
    Sample& sample = *next_;
    next_ = next_ + 1 < live_.data() + kCapacity ? next_ + 1 : live_.data();
    if (size_ < kCapacity) ++size_;
    return sample;
  }

  /// Copies what was written, oldest first. False if a reader holds the copy: try again later. Loop only.
  CLAMPD_REALTIME bool capture() noexcept {
    Holder expected = Holder::Nobody;
    if (!holder_.compare_exchange_strong(expected, Holder::Loop, std::memory_order_acquire)) return false;
    std::rotate_copy(live_.data(), next_, live_.data() + size_, captured_.data());
    captured_size_ = size_;
    holder_.store(Holder::Nobody, std::memory_order_release);
    return true;
  }

  /// The samples up to the latest captured fault, oldest first; empty before the first fault. Any other
  /// thread.
  std::vector<Sample> last_capture() const {
    std::vector<Sample> samples;
    samples.reserve(kCapacity);
    Holder expected = Holder::Nobody;
    while (!holder_.compare_exchange_weak(expected, Holder::Reader, std::memory_order_acquire)) {
      expected = Holder::Nobody;
      std::this_thread::yield();
    }
    samples.assign(captured_.begin(), captured_.begin() + static_cast<std::ptrdiff_t>(captured_size_));
    holder_.store(Holder::Nobody, std::memory_order_release);
    return samples;
  }

 private:
  enum class Holder : unsigned char { Nobody, Loop, Reader };

  std::array<Sample, kCapacity> live_{};
  Sample* next_ = live_.data();  ///< once all places are taken, that of the oldest sample
  std::size_t size_ = 0;
  mutable std::atomic<Holder> holder_{Holder::Nobody};
  std::array<Sample, kCapacity> captured_{};
  std::size_t captured_size_ = 0;
};

}  // namespace clampd::rt
