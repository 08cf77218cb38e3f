#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "clampd/base/realtime.hpp"
#include "clampd/ports/brake_port.hpp"
#include "drivers/can/frame.hpp"

namespace clampd::can {

/// Cumulative counts since the bus was opened, and its present state.
struct BusHealth {
  LinkState link = LinkState::Up;
  std::uint64_t frames_received = 0;
  std::uint64_t frames_sent = 0;
  std::uint64_t send_failures = 0;
  std::uint64_t error_frames = 0;
  std::uint64_t bus_off_events = 0;
  std::uint64_t receive_overflows = 0;
  std::uint64_t bus_bits = 0;  ///< of the frames sent and received here, worst-case stuffing
};

/// No more frames than this are taken from a bus in one tick: a flooded bus may not hold the loop. A period
/// brings three.
inline constexpr int kFramesPerTick = 64;

/// One end of a CAN bus, without blocking.
class FrameBus {
 public:
  virtual ~FrameBus() = default;
  FrameBus() = default;
  FrameBus(const FrameBus&) = delete;
  FrameBus& operator=(const FrameBus&) = delete;

  /// Takes the data frames that arrived since the last call, oldest first, as many as fit into `out`.
  CLAMPD_REALTIME virtual std::size_t receive(std::span<TimedFrame> out, std::int64_t now_ns) noexcept = 0;

  /// Hands one frame to the link; false if the link did not take it.
  CLAMPD_REALTIME virtual bool send(const Frame& frame, std::int64_t now_ns) noexcept = 0;

  CLAMPD_REALTIME virtual BusHealth health() const noexcept = 0;
};

}  // namespace clampd::can
