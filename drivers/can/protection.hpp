#pragma once

// What proves that a frame is whole, new, and the one that was meant: checksum, alive counter, data id. Every
// brake has its own; the configuration describes it, this computes it.

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "clampd/base/realtime.hpp"
#include "clampd/base/result.hpp"
#include "drivers/can/dbc.hpp"
#include "drivers/can/field.hpp"
#include "drivers/can/frame.hpp"

namespace clampd::can {

/// The names are those of the configuration, `[can.protection] checksum`.
enum class Checksum : std::uint8_t {
  SaeJ1850,  ///< "sae-j1850": CRC-8 SAE J1850 over both bytes of the data id and the frame; the default
  E2e1a,     ///< "e2e-1a": AUTOSAR E2E profile 1, both bytes of the data id
  E2e1b,     ///< "e2e-1b": profile 1, low and high byte alternating, low byte with even counters
  E2e1c,     ///< "e2e-1c": profile 1, low byte, and the low nibble of the high byte in the frame
  E2e2,      ///< "e2e-2": profile 2, one data id for each value of the counter
  E2e4,      ///< "e2e-4": profile 4, 12 bytes of header, CRC-32
  E2e5,      ///< "e2e-5": profile 5, 3 bytes of header, CRC-16
  E2e7,      ///< "e2e-7": profile 7, 20 bytes of header, CRC-64
  Crc,       ///< "crc": as CrcDescription says
  Xor,       ///< "xor": exclusive or of all other bytes
  None,      ///< "none": the frames carry none
};

/// In the order of Checksum.
inline constexpr std::array<std::string_view, 11> kChecksumNames{
    "sae-j1850", "e2e-1a", "e2e-1b", "e2e-1c", "e2e-2", "e2e-4", "e2e-5", "e2e-7", "crc", "xor", "none"};

/// Where the data id goes into a checksum of the brake's own.
enum class DataIdPlace : std::uint8_t { None, Before, After };

/// A CRC by the parameters of the catalogue of parametrised CRC algorithms (Williams 1993).
struct CrcDescription {
  int width_bits = 8;  ///< 8, 16, 32 or 64
  std::uint64_t polynomial = 0x1D;
  std::uint64_t start = 0;
  std::uint64_t final_xor = 0;
  bool reflected = false;                   ///< input and output
  DataIdPlace data_id = DataIdPlace::None;  ///< both bytes of it, low byte first

  bool operator==(const CrcDescription&) const = default;
};

/// What the configuration says of a brake's protection.
struct ProtectionDescription {
  Checksum checksum = Checksum::SaeJ1850;
  CrcDescription crc;  ///< of Checksum::Crc
};

/// Steps forward from one value of a counter of `values` to another; 0 where there is none.
CLAMPD_REALTIME constexpr std::uint64_t counter_steps(std::uint32_t from, std::uint32_t to,
                                                      std::uint64_t values) noexcept {
  return values == 0 ? 0 : (to + values - from) % values;
}

/// The protection of one frame of the DBC file.
class FrameProtection {
 public:
  FrameProtection() = default;

  /// `counter` and `checksum` are signals of `message`; an empty `counter` is a frame without one, an empty
  /// `checksum` goes with Checksum::None only. The data id is the message's DBC attribute E2EDataId, for
  /// profile 2 the sixteen of E2EDataIdList; without one it is the identifier's low 16 bits where a whole
  /// frame is meant by it, and an error where AUTOSAR demands one. `where` begins the error messages: a
  /// signal that is missing or has another shape or place than the profile wants, a data id out of range.
  static Result<FrameProtection> build(const Message& message, const std::string& counter,
                                       const std::string& checksum, const ProtectionDescription& description,
                                       const std::string& where);

  /// Writes counter, header and checksum; everything else must be in place.
  CLAMPD_REALTIME void protect(Frame& frame, std::uint32_t alive_counter) const noexcept;
  CLAMPD_REALTIME bool matches(const Frame& frame) const noexcept;
  /// Makes the checksum wrong, for tests of the other end. Does nothing to a frame without one.
  void spoil(Frame& frame) const noexcept;

  bool has_counter() const noexcept { return counter_values_ > 0; }
  CLAMPD_REALTIME std::uint32_t counter_of(const Frame& frame) const noexcept;
  /// How many values the counter has before it begins anew; 0 without one.
  std::uint64_t counter_values() const noexcept { return counter_values_; }
  /// Steps of the counter from one of its values to another, forward; 0 without one.
  CLAMPD_REALTIME std::uint64_t steps(std::uint32_t from, std::uint32_t to) const noexcept {
    return counter_steps(from, to, counter_values_);
  }
  bool has_checksum() const noexcept { return checksum_ != Checksum::None; }
  bool operator==(const FrameProtection&) const = default;

 private:
  class Builder;
  std::uint64_t compute(const Frame& frame) const noexcept;
  bool header_matches(const Frame& frame) const noexcept;

  Checksum checksum_ = Checksum::None;
  CrcDescription crc_;
  Field counter_;
  std::uint64_t counter_values_ = 0;
  Field value_;                             ///< the checksum's own place
  std::size_t first_byte_ = 0, bytes_ = 0;  ///< of it
  std::uint32_t data_id_ = 0;
  std::array<std::uint8_t, 16> data_ids_{};  ///< of profile 2
  Field nibble_;                             ///< of profile 1c
  bool has_header_ = false;                  ///< of profiles 4 and 7, which hold the next two
  Field length_, data_id_field_;
};

}  // namespace clampd::can
