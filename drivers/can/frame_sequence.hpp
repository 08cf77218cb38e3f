#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "clampd/base/realtime.hpp"
#include "drivers/can/frame.hpp"
#include "drivers/can/protection.hpp"

namespace clampd::can {

/// A frame that a brake wants beside the cyclic ones, to be woken or put to sleep.
struct FrameRequest {
  std::string message;                                  ///< of the DBC file
  std::vector<std::pair<std::string, double>> signals;  ///< in their own units; those not named are raw zero
  double wait_ms = 10.0;                                ///< until the next frame of the sequence
  bool operator==(const FrameRequest&) const = default;
};

/// The same, ready to be sent.
struct SequenceStep {
  Frame frame;
  FrameProtection protection;  ///< as for all frames, where the message has its signals
  std::int64_t wait_ns = 0;
  std::size_t counter = 0;  ///< the first step of the same message, whose alive counter goes on in this one
  bool operator==(const SequenceStep&) const = default;
};

inline constexpr std::size_t kMaxSequenceSteps = 16;

/// Sends the steps, one after the other. Allocates only when it is made.
class FrameSequence {
 public:
  explicit FrameSequence(std::vector<SequenceStep> steps);

  /// The next frame, if it is time for it.
  CLAMPD_REALTIME std::optional<Frame> due(std::int64_t now_ns) noexcept;
  /// The next frame, whatever the time is.
  CLAMPD_REALTIME std::optional<Frame> next() noexcept;
  CLAMPD_REALTIME bool done() const noexcept { return next_ == steps_.size(); }
  CLAMPD_REALTIME void restart() noexcept { next_ = 0; }

 private:
  std::vector<SequenceStep> steps_;
  std::vector<std::uint32_t> counters_;  ///< by SequenceStep::counter
  std::size_t next_ = 0;
  std::int64_t due_ns_ = 0;
};

/// The brake's end: whether all steps have come in their order. Other frames may lie between them.
class SequenceWatch {
 public:
  explicit SequenceWatch(std::vector<SequenceStep> steps) : steps_(std::move(steps)) {}
  /// True for the frame that completes the sequence; then it begins anew.
  CLAMPD_REALTIME bool completes(const Frame& frame) noexcept;

 private:
  std::vector<SequenceStep> steps_;
  std::size_t next_ = 0;
};

}  // namespace clampd::can
