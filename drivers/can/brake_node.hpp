#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "clampd/ports/brake_port.hpp"
#include "drivers/can/bus.hpp"
#include "drivers/can/protocol.hpp"

namespace clampd::can {

/// A simulated brake's side of the bus. `Brake` has `BrakeFeedback sample() noexcept` and
/// `void command(const DriveCommand&) noexcept`, and its own watchdog.
///
/// When the brake's own link fails (down, gone, bus-off) it goes to zero torque at its next sample without
/// waiting for the watchdog, reports a fault, and stays so until a command with enable = 0 has come: torque
/// never returns by itself.
///
/// A brake whose frames include a start-up sequence is asleep until it has come, and again after that of the
/// shut-down: it obeys no command then, and sends nothing.
template <class Brake>
class BrakeNode {
 public:
  /// `bus` and `brake` must outlive this.
  BrakeNode(FrameBus& bus, const ProtocolCodec& codec, Brake& brake)
      : bus_{bus},
        brake_{brake},
        protocol_{codec},
        startup_{codec.startup},
        shutdown_{codec.shutdown},
        asleep_{!codec.startup.empty()} {
    bus_off_events_ = bus_.health().bus_off_events;
  }

  /// One sampling instant: latches the newest valid command, samples, sends the feedback. Returns what was
  /// sampled.
  CLAMPD_REALTIME BrakeFeedback tick(std::int64_t now_ns, WireFault fault = WireFault::None) noexcept {
    std::optional<DriveCommand> newest;
    TimedFrame received;
    for (int frames = 0; frames < kFramesPerTick; ++frames) {
      if (bus_.receive({&received, 1}, now_ns) == 0) break;
      if (const auto command = protocol_.accept(received.frame, received.arrival_ns)) newest = command;
      if (startup_.completes(received.frame)) asleep_ = false;
      if (shutdown_.completes(received.frame)) asleep_ = true;
    }
    const BusHealth health = bus_.health();
    const bool link_lost = health.link != LinkState::Up && health.link != LinkState::ErrorPassive;
    const bool failed = link_lost || health.bus_off_events != bus_off_events_;
    bus_off_events_ = health.bus_off_events;
    if (asleep_) newest = DriveCommand{0.0, false};
    if (failed) {
      if (!inhibited_) brake_.command({0.0, false});
      inhibited_ = true;
    } else if (newest) {
      if (!newest->enable) inhibited_ = false;
      brake_.command(inhibited_ ? DriveCommand{0.0, false} : *newest);
    }
    BrakeFeedback reading = brake_.sample();
    reading.brake_fault = reading.brake_fault || inhibited_;
    std::array<Frame, kMaxFeedbackFrames> frames;
    const std::size_t count = protocol_.feedback(reading, frames, fault);
    if (asleep_) return reading;
    for (std::size_t i = 0; i < count; ++i) bus_.send(frames[i], now_ns);
    return reading;
  }

  const ProtocolCounts& counts() const noexcept { return protocol_.counts(); }

 private:
  FrameBus& bus_;
  Brake& brake_;
  BrakeProtocol protocol_;
  SequenceWatch startup_, shutdown_;
  bool asleep_;
  std::uint64_t bus_off_events_ = 0;
  bool inhibited_ = false;
};

}  // namespace clampd::can
