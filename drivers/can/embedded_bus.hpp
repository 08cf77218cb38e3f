#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "drivers/can/bus.hpp"

namespace clampd::can {

/// A CAN bus inside of one thread, in virtual time, for kernels without CAN and for tests. Frames take their
/// worst-case time on a wire of the given bit rate, one after the other, and arrive in order. Not
/// thread-safe.
class EmbeddedBus {
 public:
  enum class End : std::uint8_t { Station, Brake };

  explicit EmbeddedBus(double bitrate_bit_s = 1e6, const BusFormat& format = {});
  EmbeddedBus(const EmbeddedBus&) = delete;
  EmbeddedBus& operator=(const EmbeddedBus&) = delete;

  FrameBus& end(End end) noexcept { return ends_[index(end)]; }

  /// The next `frames` that this end sends are lost on the wire.
  void drop_next(End sender, std::size_t frames) noexcept { ends_[index(sender)].drops_ = frames; }
  /// The next `frames` that this end sends arrive with one bit flipped.
  void corrupt_next(End sender, std::size_t frames) noexcept { ends_[index(sender)].corruptions_ = frames; }
  /// Both ends see this state; sends fail unless it is Up or ErrorPassive, and what was under way is lost.
  /// BusOff counts.
  void set_link(LinkState link) noexcept;

 private:
  static constexpr std::size_t kQueueFrames = 256;
  static std::size_t index(End end) noexcept { return static_cast<std::size_t>(end); }

  class Port final : public FrameBus {
   public:
    std::size_t receive(std::span<TimedFrame> out, std::int64_t now_ns) noexcept override;
    bool send(const Frame& frame, std::int64_t now_ns) noexcept override;
    BusHealth health() const noexcept override { return health_; }

   private:
    friend class EmbeddedBus;
    void push(const TimedFrame& frame) noexcept;

    EmbeddedBus* bus_ = nullptr;
    Port* peer_ = nullptr;
    BusHealth health_;
    std::array<TimedFrame, kQueueFrames> queue_;
    std::size_t head_ = 0;
    std::size_t queued_ = 0;
    std::size_t drops_ = 0;
    std::size_t corruptions_ = 0;
  };

  double bit_ns_;
  BusFormat format_;
  std::int64_t wire_free_ns_ = 0;
  std::array<Port, 2> ends_;
};

}  // namespace clampd::can
