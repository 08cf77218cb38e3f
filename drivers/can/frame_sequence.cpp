#include "drivers/can/frame_sequence.hpp"

namespace clampd::can {

FrameSequence::FrameSequence(std::vector<SequenceStep> steps)
    : steps_(std::move(steps)), counters_(steps_.size()) {}

std::optional<Frame> FrameSequence::due(std::int64_t now_ns) noexcept {
  if (done() || (next_ > 0 && now_ns < due_ns_)) return std::nullopt;
  due_ns_ = now_ns + steps_[next_].wait_ns;
  return next();
}

std::optional<Frame> FrameSequence::next() noexcept {
  if (done()) return std::nullopt;
  const SequenceStep& step = steps_[next_++];
  Frame frame = step.frame;
  std::uint32_t& counter = counters_[step.counter];
  step.protection.protect(frame, counter);
  if (const std::uint64_t values = step.protection.counter_values(); values > 0)
    counter = static_cast<std::uint32_t>((counter + 1ULL) % values);
  return frame;
}

bool SequenceWatch::completes(const Frame& frame) noexcept {
  if (steps_.empty() || frame.id != steps_[next_].frame.id) return false;
  const SequenceStep& step = steps_[next_];
  Frame expected = step.frame;
  step.protection.protect(expected, step.protection.has_counter() ? step.protection.counter_of(frame) : 0);
  if (frame.size != expected.size || frame.data != expected.data) return false;
  if (++next_ < steps_.size()) return false;
  next_ = 0;
  return true;
}

}  // namespace clampd::can
