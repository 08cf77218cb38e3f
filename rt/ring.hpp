#pragma once

#include <cstddef>
#include <cstdint>

#include <boost/lockfree/spsc_queue.hpp>

#include "clampd/base/realtime.hpp"
#include "clampd/record/sample.hpp"

namespace clampd::rt {

/// Carries samples from the loop (the only producer) to one worker (the only consumer), lock-free.
/// Allocates in the constructor and never again. A full ring drops the newest sample and says so: the loop
/// never waits for a slow consumer.
class SampleRing {
 public:
  explicit SampleRing(std::size_t capacity) : queue_(capacity) {}

  /// False if the ring was full and the sample is lost. Producer only.
  CLAMPD_REALTIME bool push(const Sample& sample) noexcept { return queue_.push(sample); }

  /// False if the ring is empty. Consumer only.
  bool pop(Sample& sample) noexcept { return queue_.pop(sample); }

 private:
  boost::lockfree::spsc_queue<Sample> queue_;
};

}  // namespace clampd::rt
