#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

namespace clampd::can {

/// Set in Frame::id for a 29-bit identifier, as SocketCAN and DBC files do.
inline constexpr std::uint32_t kExtendedId = 0x8000'0000U;

inline constexpr std::size_t kClassicBytes = 8;
inline constexpr std::size_t kMaxFrameBytes = 64;  ///< of a CAN FD frame

/// How a data frame is sent.
enum class FrameFormat : std::uint8_t {
  Classic,     ///< at most 8 bytes
  Fd,          ///< CAN FD, all of it at the nominal bit rate
  FdFastData,  ///< CAN FD with bit-rate switch: its data at the bus's data bit rate
};

/// One data frame.
struct Frame {
  std::uint32_t id = 0;                             ///< 11 or 29 bits; kExtendedId is set for the latter
  std::uint8_t size = 0;                            ///< bytes; of a CAN FD frame one of kFdSizes
  std::array<std::uint8_t, kMaxFrameBytes> data{};  ///< zero from `size` on
  FrameFormat format = FrameFormat::Classic;

  friend bool operator==(const Frame&, const Frame&) = default;
};

/// The sizes that a CAN FD frame can have (ISO 11898-1:2015, table of the data length codes).
inline constexpr std::array<std::uint8_t, 16> kFdSizes{0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};

constexpr bool is_fd_size(std::size_t size) noexcept {
  return std::find(kFdSizes.begin(), kFdSizes.end(), size) != kFdSizes.end();
}

/// A frame and the time it arrived at (CLOCK_MONOTONIC or virtual time).
struct TimedFrame {
  Frame frame;
  std::int64_t arrival_ns = 0;
};

/// What a bus can carry, and how much faster than its nominal bit rate the data of a frame with bit-rate
/// switch are.
struct BusFormat {
  bool flexible_data_rate = false;
  double data_speedup = 1.0;  ///< data bit rate over nominal bit rate
};

/// Time that a data frame takes at most on the wire, in bits of the nominal bit rate: stuff bits and the
/// three bits of interframe space included. Of 8 classic bytes: 135 with an 11-bit identifier, 160 with a
/// 29-bit one. For CAN FD: ISO 11898-1:2015, with its fixed stuff bits in the CRC field.
constexpr int worst_case_bits(std::uint32_t id, std::size_t size, FrameFormat format = FrameFormat::Classic,
                              double data_speedup = 1.0) noexcept {
  const int data_bits = 8 * static_cast<int>(size);
  const bool extended = (id & kExtendedId) != 0;
  if (format == FrameFormat::Classic) {
    const int stuffable_bits = (extended ? 54 : 34) + data_bits;
    return (extended ? 67 : 47) + data_bits + (stuffable_bits - 1) / 4;
  }
  const int arbitration_bits = extended ? 36 : 17;            // start of frame to bit-rate switch
  const int end_bits = 13;                                    // CRC delimiter to interframe space
  const int control_bits = 5;                                 // error state indicator, data length code
  const int crc_bits = size <= 16 ? 4 + 17 + 6 : 4 + 21 + 7;  // stuff count, CRC, fixed stuff bits
  const int data_phase_bits = control_bits + data_bits + (control_bits + data_bits) / 4 + crc_bits;
  const double speedup = format == FrameFormat::FdFastData ? data_speedup : 1.0;
  const double bits = arbitration_bits + (arbitration_bits - 1) / 4 + end_bits + data_phase_bits / speedup;
  return static_cast<int>(bits) + (static_cast<double>(static_cast<int>(bits)) < bits ? 1 : 0);
}
static_assert(worst_case_bits(0x100, 8) == 135);
static_assert(worst_case_bits(kExtendedId | 0x100, 8) == 160);

constexpr int worst_case_bits(const Frame& frame, const BusFormat& bus) noexcept {
  return worst_case_bits(frame.id, frame.size, frame.format, bus.data_speedup);
}

}  // namespace clampd::can
