#pragma once

#include <atomic>
#include <bit>
#include <cstdint>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/record/sample.hpp"

namespace clampd {

/// What the loop learns of the station's switches at the beginning of a tick.
struct Interlocks {
  bool emergency_stop = false;      ///< pressed, or its wire is off
  bool fixture_open = false;        ///< false too where no line tells
  bool start_button_stuck = false;  ///< held at start-up, or far longer than a press
  bool lost =
      false;  ///< a line cannot be read, or who reads the lines fell silent: believe none of the above

  /// Whether nothing of it is so; at one look, since the loop asks in every tick.
  bool none() const noexcept { return std::bit_cast<std::uint32_t>(*this) == 0; }
};

/// What the loop tells the enable relay's guard.
struct LoopBeat {
  std::uint64_t ticks = 0;
  StationState state = StationState::Init;
};

/// Between the loop and who reads and drives the station's lines; declared here, since both the loop (rt) and
/// the driver speak it and neither may include the other. One word each way, one writer each: neither side
/// ever waits. It holds no pointers and may live in memory shared with another process.
class InterlockBoard {
 public:
  /// The loop takes readings older than `lost_after_ns` for lost.
  explicit InterlockBoard(std::int64_t lost_after_ns) noexcept : lost_after_ns_(lost_after_ns) {}

  /// By the reader of the lines, at least every `lost_after_ns`.
  void publish(const Interlocks& interlocks, std::int64_t now_ns) noexcept {
    const std::uint64_t flags =
        (interlocks.emergency_stop ? kEmergencyStop : 0) | (interlocks.fixture_open ? kFixtureOpen : 0) |
        (interlocks.start_button_stuck ? kStartButtonStuck : 0) | (interlocks.lost ? kLost : 0);
    inputs_.store(static_cast<std::uint64_t>(now_ns) << kFlagBits | flags, std::memory_order_release);
  }

  /// By anyone. Before the first publish(): lost.
  CLAMPD_REALTIME Interlocks read(std::int64_t now_ns) const noexcept {
    const std::uint64_t word = inputs_.load(std::memory_order_acquire);
    const auto stamp_ns = static_cast<std::int64_t>(word >> kFlagBits);
    Interlocks interlocks;
    interlocks.emergency_stop = (word & kEmergencyStop) != 0;
    interlocks.fixture_open = (word & kFixtureOpen) != 0;
    interlocks.start_button_stuck = (word & kStartButtonStuck) != 0;
    interlocks.lost = (word & kLost) != 0 || word == 0 || now_ns - stamp_ns > lost_after_ns_;
    return interlocks;
  }

  /// By the loop, once a tick, and a last time with the state FAULT when it ends.
  CLAMPD_REALTIME void beat(const LoopBeat& beat) noexcept {
    beat_.store(beat.ticks << kStateBits | static_cast<std::uint64_t>(beat.state), std::memory_order_release);
  }

  LoopBeat last_beat() const noexcept {
    const std::uint64_t word = beat_.load(std::memory_order_acquire);
    return {word >> kStateBits, static_cast<StationState>(word & ((1U << kStateBits) - 1))};
  }

 private:
  static constexpr int kFlagBits = 4;  // 2^60 ns of CLOCK_MONOTONIC are 36 years
  static constexpr std::uint64_t kEmergencyStop = 1;
  static constexpr std::uint64_t kFixtureOpen = 2;
  static constexpr std::uint64_t kStartButtonStuck = 4;
  static constexpr std::uint64_t kLost = 8;
  static constexpr int kStateBits = 8;

  static_assert(std::atomic<std::uint64_t>::is_always_lock_free);
  std::atomic<std::uint64_t> inputs_{0};
  std::atomic<std::uint64_t> beat_{0};
  const std::int64_t lost_after_ns_;
};

}  // namespace clampd
