#include "drivers/can/can_brake.hpp"

#include "clampd/base/clock.hpp"

namespace clampd::can {
namespace {

constexpr std::int64_t kAsleepAfter_ns = kNanosecondsPerSecond;

}  // namespace

std::size_t CanBrake::receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept {
  // What piled up while the station started tells nothing of the brake now, and when its frames came then was
  // disturbed by that start.
  if (!begin_ns_) begin_ns_ = now_ns - kPeriod_ns;
  // One frame at a time: what does not fit into `out` waits in the bus rather than here.
  std::size_t filled = 0;
  TimedFrame received;
  for (int frames = 0; frames < kFramesPerTick && filled < out.size(); ++frames) {
    if (bus_.receive({&received, 1}, now_ns) == 0) break;
    if (received.arrival_ns < *begin_ns_) continue;
    if (const auto feedback = protocol_.accept(received.frame, received.arrival_ns)) {
      out[filled++] = *feedback;
      awake_ns_ = now_ns;
    }
  }
  return filled;
}

bool CanBrake::send(const DriveCommand& command, std::int64_t now_ns) noexcept {
  wake(now_ns);
  last_ = command;
  return bus_.send(protocol_.command(command), now_ns);
}

void CanBrake::repeat(std::int64_t now_ns) noexcept {
  bus_.send(protocol_.command(last_), now_ns);
}

void CanBrake::wake(std::int64_t now_ns) noexcept {
  if (startup_.done() && now_ns - awake_ns_ > kAsleepAfter_ns) startup_.restart();
  if (const auto frame = startup_.due(now_ns)) {
    bus_.send(*frame, now_ns);
    awake_ns_ = now_ns;
  }
}

void CanBrake::end(std::int64_t now_ns) noexcept {
  while (const auto frame = shutdown_.next()) bus_.send(*frame, now_ns);
}

PortHealth CanBrake::health() const noexcept {
  const BusHealth bus = bus_.health();
  const ProtocolCounts& counts = protocol_.counts();
  PortHealth health;
  health.link = bus.link;
  health.frames_received = bus.frames_received;
  health.frames_sent = bus.frames_sent;
  health.send_failures = bus.send_failures;
  health.crc_errors = counts.crc_errors;
  health.counter_errors = counts.counter_errors;
  health.lost_samples = counts.lost_samples;
  health.implausible = counts.implausible;
  health.error_frames = bus.error_frames;
  health.bus_off_events = bus.bus_off_events;
  health.receive_overflows = bus.receive_overflows;
  health.bus_bits = bus.bus_bits;
  health.arrival_jitter_ns = protocol_.arrival_jitter_ns();
  return health;
}

}  // namespace clampd::can
