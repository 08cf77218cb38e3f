#pragma once

// The end-to-end protection of commands and feedback, for both ends. Pure: frames and time come in as
// arguments, so that the very code of the bench runs in the tests.

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/ports/brake_port.hpp"
#include "drivers/can/arrival_clock.hpp"
#include "drivers/can/codec.hpp"
#include "drivers/can/frame.hpp"

namespace clampd::can {

/// What became of an alive counter.
enum class AliveVerdict : std::uint8_t {
  Next,      ///< the expected one, or the first after a silence
  Skipped,   ///< some frames were lost; this one is newer and good
  Repeated,  ///< the same again: a frozen or replayed frame
  Backward,  ///< more than half of the counter's turn ahead: an old frame
};

/// Judges the alive counter of one frame identifier. Only intact frames may come here. Longer silence than
/// half a turn of the counter makes it ambiguous: any value is then accepted as a new start.
class AliveCheck {
 public:
  AliveCheck() = default;
  /// `values`: how many the counter has, at least 4. `cycle_ns`: how often it counts.
  AliveCheck(std::uint64_t values, std::int64_t cycle_ns);

  CLAMPD_REALTIME AliveVerdict judge(std::uint32_t counter, std::int64_t arrival_ns) noexcept;

 private:
  std::uint64_t values_ = 16;
  std::int64_t silence_ns_ = 8 * kPeriod_ns;
  bool started_ = false;
  std::uint32_t last_ = 0;
  std::int64_t last_arrival_ns_ = 0;
};

struct ProtocolCounts {
  std::uint64_t crc_errors = 0;  ///< frames refused: wrong checksum, size or format
  /// Frames or samples refused: the counter or the sample clock (without one, the arrival) repeats or jumps.
  std::uint64_t counter_errors = 0;
  std::uint64_t lost_samples =
      0;  ///< samples the brake took and the station never completed (station's end only)
  /// Frames refused: a value outside of its DBC range, or force, velocity or torque at an end of it other
  /// than zero.
  std::uint64_t implausible = 0;
};

/// The station's end: commands out, samples in.
class StationProtocol {
 public:
  explicit StationProtocol(const ProtocolCodec& codec);

  /// The next command frame. A torque that is not finite goes out as a disabled zero torque.
  CLAMPD_REALTIME Frame command(const DriveCommand& command) noexcept;

  /// Takes one received frame. When it completes a sample (all feedback frames with one counter value;
  /// without a counter, within half a cycle of the first), that sample: `sample_index` counts from 0 and
  /// follows counter and sample clock, `brake_time_ns` is the unwrapped sample clock, `arrival_time_ns` that
  /// of the completing frame. Without a sample clock, `brake_time_ns` is the instant that the arrivals tell,
  /// and there is no sample until they do. Frames of other identifiers, or multiplexed ones
  /// with other content, are ignored.
  ///
  /// Of a brake that samples several times in a period, one sample comes for each period, once all of it are
  /// there: the readings of the first, and the mean of their torques, which is what acts until the next one.
  /// Periods begin where commands take effect, as soon as changes of the torque show it: within one of them
  /// the torque then is constant, as the model has it. Where they begin moves by whole samples, and
  /// `brake_time_ns` counts as if it never had.
  CLAMPD_REALTIME std::optional<BrakeFeedback> accept(const Frame& frame, std::int64_t arrival_ns) noexcept;

  CLAMPD_REALTIME const ProtocolCounts& counts() const noexcept { return counts_; }
  /// Standard deviation of the arrivals about the instants that they tell; 0 with a sample clock.
  CLAMPD_REALTIME double arrival_jitter_ns() const noexcept { return arrivals_.jitter_ns(); }

 private:
  void follow_commands(const BrakeFeedback& sample) noexcept;
  std::optional<BrakeFeedback> of_period(const BrakeFeedback& sample) noexcept;
  bool plausible(std::size_t index, const Frame& frame) const noexcept;
  std::optional<BrakeFeedback> complete(std::int64_t arrival_ns) noexcept;
  bool follow_sample_clock(std::uint32_t previous_counter) noexcept;
  bool follow_arrivals(std::uint32_t previous_counter) noexcept;

  ProtocolCodec codec_;
  std::uint64_t counter_values_ = 0;  ///< of the feedback; 0: its frames carry no counter
  ProtocolCounts counts_;
  std::uint32_t command_counter_ = 0;
  std::array<AliveCheck, kMaxFeedbackFrames> alive_;

  std::array<Frame, kMaxFeedbackFrames> parts_;
  unsigned received_parts_ = 0;  ///< bit i: parts_[i] belongs to the sample of parts_counter_
  std::uint32_t parts_counter_ = 0;
  std::int64_t parts_arrival_ns_ = 0;  ///< of the first of them

  bool synchronised_ = false;
  ArrivalClock arrivals_;  ///< without a sample clock
  std::uint64_t last_clock_ = 0;
  std::uint32_t last_counter_ = 0;
  std::int64_t sample_index_ = 0;
  std::int64_t brake_time_ns_ = 0;
  BrakeFeedback period_;       ///< the first sample of the present period, its torque the sum of all so far
  int samples_of_period_ = 0;  ///< that have come, one after the other
  std::array<double, kFramesPerPeriod.back()> changes_Nm2_{};  ///< of the torque, by place in the period
  double last_torque_Nm_ = 0.0;
  std::int64_t last_sample_ = -1;
  std::int64_t shifted_ = 0;  ///< samples by which periods begin later than they did
};

/// What a simulated brake may do wrong on the wire, on purpose. Where its frames carry no counter,
/// FrozenCounter sends the frames of the sample before again.
enum class WireFault : std::uint8_t { None, CorruptCrc, FrozenCounter, ImpossibleValues, Silent };

/// The brake's end: commands in, samples out.
class BrakeProtocol {
 public:
  explicit BrakeProtocol(const ProtocolCodec& codec);

  /// Takes one received frame; the command in it, if it is one and passes CRC, counter and range.
  CLAMPD_REALTIME std::optional<DriveCommand> accept(const Frame& frame, std::int64_t arrival_ns) noexcept;

  /// Encodes one sample into `out` (room for kMaxFeedbackFrames) and returns the number of frames. Of
  /// `reading`, the index and arrival time are not sent.
  CLAMPD_REALTIME std::size_t feedback(const BrakeFeedback& reading, std::span<Frame> out,
                                       WireFault fault = WireFault::None) noexcept;

  CLAMPD_REALTIME const ProtocolCounts& counts() const noexcept { return counts_; }

 private:
  ProtocolCodec codec_;
  ProtocolCounts counts_;
  AliveCheck alive_;
  std::uint32_t feedback_counter_ = 0;
  std::array<Frame, kMaxFeedbackFrames> sent_;  ///< feedback
};

}  // namespace clampd::can
