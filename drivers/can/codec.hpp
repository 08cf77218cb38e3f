#pragma once

// Turns samples and commands into frames and back. Built from a DBC file and the names of the signals in it,
// so that a lab maps its own brake by editing DBC and configuration. Pure: no I/O, no time. Units become SI
// here and nowhere else.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/base/result.hpp"
#include "clampd/ports/brake_port.hpp"
#include "drivers/can/dbc.hpp"
#include "drivers/can/field.hpp"
#include "drivers/can/frame.hpp"
#include "drivers/can/frame_sequence.hpp"
#include "drivers/can/protection.hpp"

namespace clampd::can {

/// Where in the DBC file what stands, as "Message.Signal". The defaults fit configs/brake.dbc.
/// Every message named here must hold one of the signals `counter` and one of `crc`, shaped as the protection
/// wants them.
struct ProtocolMapping {
  /// Exactly one of the two: what the brake is told. The other is empty.
  std::string torque_command = "BrakeCommand.TorqueCommand";
  std::string velocity_command;
  std::string enable = "BrakeCommand.Enable";
  std::string force = "BrakeFeedback.Force";
  std::string velocity = "BrakeFeedback.Velocity";
  std::string torque = "BrakeFeedback.Torque";
  std::string position = "BrakeClock.Position";         ///< empty if the brake has none
  std::string sample_clock = "BrakeClock.SampleClock";  ///< empty if the brake has none: see ArrivalClock
  std::string enabled = "BrakeFeedback.Enabled";        ///< empty if the brake has none, so the next two
  std::string watchdog = "BrakeFeedback.Watchdog";
  std::string fault = "BrakeFeedback.Fault";
  /// Names of the signal in any message, or "Message.Signal"; empty: the frames carry none.
  std::vector<std::string> counter = std::vector<std::string>(1, "AliveCounter");
  std::vector<std::string> crc = std::vector<std::string>(1, "Crc");
  ProtectionDescription protection;
  std::vector<FrameRequest> startup;   ///< what wakes the brake, before it sends or obeys
  std::vector<FrameRequest> shutdown;  ///< what is sent when the station ends, after the last command
  std::int64_t period_ns = kPeriod_ns;  ///< of the loop
  int samples_per_period = 1;           ///< feedback: one of kFramesPerPeriod
  int commands_per_period = 1;          ///< likewise
  /// Frames of more than 8 bytes, and those that the DBC file's attribute VFrameFormat says so of, are CAN
  /// FD; their data are sent faster.
  bool fast_data = false;
};

/// The one signal of a message that is among these names of counters or checksums. Without one: all
/// names, "A or B", for whoever says that none is there. Error: the message has several of them.
Result<std::string> own_name(const Message& message, const std::vector<std::string>& names);

inline constexpr std::size_t kMaxFeedbackFrames = 4;

/// How often in the loop's period a brake may sample, and want a command.
inline constexpr std::array kFramesPerPeriod{1, 2, 4, 5, 8, 10, 20, 25};

/// The value of a multiplexor by which a frame holds what is looked for.
struct Selector {
  Field field;
  std::uint64_t value = 0;
  bool operator==(const Selector&) const = default;
};
inline constexpr std::size_t kMaxSelectors = 2;

/// One frame with its protection.
struct FrameLayout {
  std::uint32_t id = 0;
  std::uint8_t size = 0;
  FrameFormat format = FrameFormat::Classic;
  FrameProtection protection;
  std::array<Selector, kMaxSelectors> selectors{};  ///< of a multiplexed frame
  std::size_t selector_count = 0;

  /// All zero but for the multiplexors.
  CLAMPD_REALTIME Frame blank() const noexcept;
  /// Whether a frame has this identifier and, if it is multiplexed, holds what is looked for.
  CLAMPD_REALTIME bool is_meant_by(const Frame& frame) const noexcept;
  /// Whether a frame with this identifier has the size, format and protection that it must have. A bit-rate
  /// switch is not looked at: it is the sender's choice.
  CLAMPD_REALTIME bool intact(const Frame& frame) const noexcept;
  bool operator==(const FrameLayout&) const = default;
};

/// A quantity of the feedback: which of its frames, and where in it.
struct FeedbackField {
  bool present = false;
  std::size_t frame = 0;
  Field field;

  bool operator==(const FeedbackField&) const = default;
};

/// Everything the protocol needs to know of the frames; immutable once built.
struct ProtocolCodec {
  FrameLayout command;
  CommandedQuantity commanded = CommandedQuantity::Torque;
  Field setpoint;  ///< of what is commanded, in N m or rad/s
  Field enable;

  std::array<FrameLayout, kMaxFeedbackFrames> feedback;
  std::size_t feedback_frames = 0;
  FeedbackField force;
  FeedbackField velocity;
  FeedbackField torque;
  FeedbackField position;
  FeedbackField sample_clock;  ///< raw: unsigned count of `clock_tick_ns`, wraps at its width; may be absent
  FeedbackField enabled;
  FeedbackField watchdog;
  FeedbackField fault;
  std::int64_t clock_tick_ns = 1000;
  std::vector<SequenceStep> startup, shutdown;
  std::int64_t period_ns = kPeriod_ns;
  int samples_per_period = 1;
  int commands_per_period = 1;

  std::int64_t feedback_cycle_ns() const noexcept { return period_ns / samples_per_period; }
  double feedback_cycle_ms() const noexcept { return 1e-6 * static_cast<double>(feedback_cycle_ns()); }
  std::int64_t command_cycle_ns() const noexcept { return period_ns / commands_per_period; }

  /// Checks the mapping against the database. Errors name the DBC file, message and signal, and what is
  /// needed: a name that is not there, a message with defects or of a size that no frame has, multiplexed
  /// signals of one message that exclude each other, an unknown unit, a counter or checksum of the wrong
  /// shape or mapped to another role too, both or none of torque and velocity command, a command, velocity,
  /// torque or clock that cannot express what the loop needs, a start-up or shut-down frame that cannot be
  /// made.
  static Result<ProtocolCodec> build(const Database& database, const ProtocolMapping& mapping);

  /// Identifiers the station receives, in the order of `feedback`.
  std::vector<std::uint32_t> feedback_ids() const;
  /// Identifiers the brake receives: the command's first, then those of start-up and shut-down.
  std::vector<std::uint32_t> command_ids() const;
  /// Whether any frame is CAN FD.
  bool needs_flexible_data_rate() const;
  /// Wire bits of one period of the loop, worst case, at the nominal bit rate: commands and all feedback
  /// frames.
  int bits_per_period(double data_speedup = 1.0) const;
  /// The same frames, read and written the same.
  bool operator==(const ProtocolCodec&) const = default;
};

/// Share of the bus (0..1) that the cyclic frames of this codec take at most.
double bus_load(const ProtocolCodec& codec, double bitrate_bit_s, double data_speedup = 1.0);

}  // namespace clampd::can
