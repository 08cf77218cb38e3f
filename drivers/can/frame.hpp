#pragma once

#include <array>
#include <cstdint>

namespace clampd::can {

/// Set in Frame::id for a 29-bit identifier, as SocketCAN and DBC files do.
inline constexpr std::uint32_t kExtendedId = 0x8000'0000U;

/// One classic CAN data frame.
struct Frame {
  std::uint32_t id = 0;   ///< 11 or 29 bits; kExtendedId is set for the latter
  std::uint8_t size = 0;  ///< 0..8 bytes
  std::array<std::uint8_t, 8> data{};

  friend bool operator==(const Frame&, const Frame&) = default;
};

/// A frame and the time it arrived at (CLOCK_MONOTONIC or virtual time).
struct TimedFrame {
  Frame frame;
  std::int64_t arrival_ns = 0;
};

/// Bits a data frame can take at most on the wire, stuff bits and the three bits of interframe space
/// included. Of 8 bytes: 135 with an 11-bit identifier, 160 with a 29-bit one.
constexpr int worst_case_bits(std::uint32_t id, int size) noexcept {
  const int data_bits = 8 * size;
  const bool extended = (id & kExtendedId) != 0;
  const int stuffable_bits = (extended ? 54 : 34) + data_bits;
  return (extended ? 67 : 47) + data_bits + (stuffable_bits - 1) / 4;
}
static_assert(worst_case_bits(0x100, 8) == 135);
static_assert(worst_case_bits(kExtendedId | 0x100, 8) == 160);

}  // namespace clampd::can
