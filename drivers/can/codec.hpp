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

#include "clampd/base/realtime.hpp"
#include "clampd/base/result.hpp"
#include "drivers/can/dbc.hpp"
#include "drivers/can/frame.hpp"

namespace clampd::can {

/// Where in the DBC file what stands, as "Message.Signal". The defaults fit configs/brake.dbc.
/// Every message named here must hold the signals `counter` (4 bits) and `crc` (one whole byte).
struct ProtocolMapping {
  std::string torque_command = "BrakeCommand.TorqueCommand";
  std::string enable = "BrakeCommand.Enable";
  std::string force = "BrakeFeedback.Force";
  std::string velocity = "BrakeFeedback.Velocity";
  std::string torque = "BrakeFeedback.Torque";
  std::string position = "BrakeClock.Position";  ///< empty if the brake has none
  std::string sample_clock = "BrakeClock.SampleClock";
  std::string enabled = "BrakeFeedback.Enabled";  ///< empty if the brake has none, so the next two
  std::string watchdog = "BrakeFeedback.Watchdog";
  std::string fault = "BrakeFeedback.Fault";
  std::string counter = "AliveCounter";
  std::string crc = "Crc";
};

inline constexpr std::size_t kMaxFeedbackFrames = 4;

/// One signal of a classic frame, resolved to a shift and a mask over the frame's 64 bits, in SI units.
class Field {
 public:
  Field() = default;
  /// `si_per_unit`: SI value of one of the signal's own units.
  Field(const Signal& signal, double si_per_unit);

  CLAMPD_REALTIME std::uint64_t raw(const Frame& frame) const noexcept;
  CLAMPD_REALTIME void set_raw(Frame& frame, std::uint64_t raw) const noexcept;
  CLAMPD_REALTIME double decode(const Frame& frame) const noexcept;
  /// Rounds to the nearest raw value; saturates at the DBC's range and at the field's limits. NaN becomes the
  /// raw zero.
  CLAMPD_REALTIME void encode(Frame& frame, double value) const noexcept;
  /// Finite and within the DBC's range, where it states one.
  CLAMPD_REALTIME bool plausible(double value) const noexcept;
  std::uint64_t largest_raw() const noexcept { return mask_; }
  double scale() const noexcept { return scale_; }
  double minimum() const noexcept { return minimum_; }
  double maximum() const noexcept { return maximum_; }

 private:
  bool motorola_ = false;
  ValueType type_ = ValueType::Unsigned;
  unsigned shift_ = 0;
  unsigned bits_ = 1;
  std::uint64_t mask_ = 1;
  double scale_ = 1.0;
  double offset_ = 0.0;
  double minimum_ = 0.0;  ///< SI; infinite where neither the DBC nor the field's width limits it
  double maximum_ = 0.0;
};

/// CRC-8 SAE J1850 (polynomial 0x1D, start 0xFF, final exclusive-or 0xFF) over the data id, low byte first,
/// and then the frame's bytes in order without byte `crc_byte`; the layout of AUTOSAR's E2E profile 1 with
/// both id bytes included.
CLAMPD_REALTIME std::uint8_t e2e_crc(std::uint16_t data_id, const Frame& frame,
                                     std::size_t crc_byte) noexcept;

/// One frame with its protection: identifier, size, counter and CRC.
struct FrameLayout {
  std::uint32_t id = 0;
  std::uint8_t size = 0;
  std::uint16_t data_id =
      0;  ///< DBC attribute E2EDataId of the message; its identifier's low 16 bits without one
  std::size_t crc_byte = 0;
  Field counter;

  CLAMPD_REALTIME Frame blank() const noexcept;
  /// Writes counter and CRC; everything else must be in place.
  CLAMPD_REALTIME void protect(Frame& frame, std::uint8_t alive_counter) const noexcept;
  CLAMPD_REALTIME bool crc_matches(const Frame& frame) const noexcept;
  CLAMPD_REALTIME std::uint8_t counter_of(const Frame& frame) const noexcept;
};

/// A quantity of the feedback: which of its frames, and where in it.
struct FeedbackField {
  bool present = false;
  std::size_t frame = 0;
  Field field;
};

/// Everything the protocol needs to know of the frames; immutable once built.
struct ProtocolCodec {
  FrameLayout command;
  Field torque_command;
  Field enable;

  std::array<FrameLayout, kMaxFeedbackFrames> feedback;
  std::size_t feedback_frames = 0;
  FeedbackField force;
  FeedbackField velocity;
  FeedbackField torque;
  FeedbackField position;
  FeedbackField sample_clock;  ///< raw: unsigned count of `clock_tick_ns`, wraps at its width
  FeedbackField enabled;
  FeedbackField watchdog;
  FeedbackField fault;
  std::int64_t clock_tick_ns = 1000;

  /// Checks the mapping against the database. Errors name the DBC file, message and signal, and what is
  /// needed: a name that is not there, a message with defects or over 8 bytes, a multiplexed signal, an
  /// unknown unit, a counter or CRC of the wrong shape, a command or clock that cannot express what the loop
  /// needs.
  static Result<ProtocolCodec> build(const Database& database, const ProtocolMapping& mapping);

  /// Identifiers the station receives, in the order of `feedback`.
  std::vector<std::uint32_t> feedback_ids() const;
  /// Wire bits of one sample period, worst case: command and all feedback frames.
  int bits_per_period() const;
};

/// Share of the bus (0..1) that the cyclic frames of this codec take at most.
double bus_load(const ProtocolCodec& codec, double bitrate_bit_s);

}  // namespace clampd::can
