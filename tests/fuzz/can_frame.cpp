// Whatever may be on the bus, as the loop reads it: frames of any identifier, size and content, some with a
// valid CRC. Ten bytes make one frame; then a healthy brake speaks, and must be understood again.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <deque>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "drivers/can/can_brake.hpp"
#include "drivers/can/codec.hpp"
#include "drivers/can/dbc.hpp"
#include "drivers/can/protocol.hpp"

namespace clampd::can {
namespace {

class Wire final : public FrameBus {
 public:
  std::size_t receive(std::span<TimedFrame> out, std::int64_t) noexcept override {
    std::size_t taken = 0;
    for (; taken < out.size() && !frames.empty(); ++taken) {
      out[taken] = frames.front();
      frames.pop_front();
    }
    return taken;
  }
  bool send(const Frame& frame, std::int64_t) noexcept override {
    sent = frame;
    return true;
  }
  BusHealth health() const noexcept override { return {}; }

  std::deque<TimedFrame> frames;
  Frame sent;
};

ProtocolCodec codec_of(const ProtocolMapping& mapping) {
  const auto built = read_dbc(CLAMPD_SOURCE_DIR "/configs/brake.dbc").and_then([&](const Database& database) {
    return ProtocolCodec::build(database, mapping);
  });
  CLAMPD_ASSERT(built.has_value());
  return *built;
}

/// One brake that sends a clock, one that only counts, and one that does neither.
const std::array<ProtocolCodec, 3>& codecs() {
  static const std::array<ProtocolCodec, 3> codecs = [] {
    ProtocolMapping clockless;
    clockless.sample_clock = "";
    ProtocolMapping uncounted = clockless;
    uncounted.counter = {};
    return std::array{codec_of({}), codec_of(clockless), codec_of(uncounted)};
  }();
  return codecs;
}

constexpr std::size_t kBytesPerFrame = 10;

/// How it came, then its content: bits 0 and 1 of the first byte say which frame it is, bit 2 that counter
/// (bits 4 to 7) and CRC are put right, bit 3 that its size is; the second byte is the time since the last
/// one, in 0.1 ms.
Frame frame_of(const ProtocolCodec& codec, const std::uint8_t* bytes) {
  const std::array<const FrameLayout*, 3> layouts{&codec.command, &codec.feedback[0], &codec.feedback[1]};
  const std::size_t which = bytes[0] & 3U;
  const FrameLayout& layout = *layouts[std::min<std::size_t>(which, 2)];
  Frame frame = layout.blank();
  std::copy_n(bytes + 2, 8, frame.data.begin());
  if (which == 3) frame.id = bytes[2] * 257U | (bytes[3] >= 128 ? kExtendedId : 0U);
  if ((bytes[0] & 4U) != 0)
    layout.protection.protect(frame, bytes[0] >> 4);
  else if ((bytes[0] & 8U) == 0)
    frame.size = bytes[0] >> 4 & 7U;
  return frame;
}

void check(const BrakeFeedback& reading, std::int64_t& index, std::int64_t& time_ns) {
  for (const double value :
       {reading.force_N, reading.velocity_rad_s, reading.torque_Nm, reading.position_rad})
    CLAMPD_ASSERT(std::isfinite(value));
  CLAMPD_ASSERT(reading.force_N >= -4000.0 && reading.force_N <= 45000.0);
  CLAMPD_ASSERT(std::abs(reading.velocity_rad_s) <= 600.0 && std::abs(reading.torque_Nm) <= 3.2);
  CLAMPD_ASSERT(reading.sample_index > index && reading.brake_time_ns > time_ns);
  index = reading.sample_index;
  time_ns = reading.brake_time_ns;
}

void listen(const ProtocolCodec& codec, const std::uint8_t* data, std::size_t size) {
  Wire wire;
  CanBrake station(wire, codec);
  BrakeProtocol brake(codec);
  std::array<BrakeFeedback, 8> readings;
  std::int64_t now_ns = 1'000'000'000;
  std::int64_t index = -1;
  std::int64_t time_ns = -1;
  const auto receive = [&] {
    while (!wire.frames.empty()) {
      const std::size_t count = station.receive(readings, now_ns);
      for (std::size_t i = 0; i < count; ++i) check(readings[i], index, time_ns);
    }
  };
  for (; size >= kBytesPerFrame; data += kBytesPerFrame, size -= kBytesPerFrame) {
    now_ns += data[1] * 100'000;
    const Frame frame = frame_of(codec, data);
    wire.frames.push_back({frame, now_ns});
    if (data[1] > 10) receive();
    if (const auto command = brake.accept(frame, now_ns))
      CLAMPD_ASSERT(std::isfinite(command->torque_Nm) && std::abs(command->torque_Nm) <= 3.2 + 1e-9);
  }
  receive();

  const int samples = codec.sample_clock.present ? 8 : 4 * ArrivalClock::kSettlingSamples;
  BrakeFeedback reading;
  reading.brake_time_ns = 123'000'000;
  BrakeProtocol healthy(codec);
  for (int sample = 0; sample < samples; ++sample) {
    now_ns += kPeriod_ns;
    reading.brake_time_ns += kPeriod_ns;
    std::array<Frame, kMaxFeedbackFrames> frames;
    const std::size_t count = healthy.feedback(reading, frames);
    for (std::size_t i = 0; i < count; ++i) wire.frames.push_back({frames[i], now_ns});
    const std::int64_t before = index;
    receive();
    if (sample >= samples / 2) CLAMPD_ASSERT(index == before + 1);
  }
  for (const double torque_Nm : {1.0, std::nan(""), 1e300}) {
    station.send({torque_Nm, true}, now_ns);
    now_ns += 10 * kPeriod_ns;
    const auto command = brake.accept(wire.sent, now_ns);
    CLAMPD_ASSERT(command && std::isfinite(command->torque_Nm) &&
                  command->enable == std::isfinite(torque_Nm));
  }
}

}  // namespace
}  // namespace clampd::can

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  for (const clampd::can::ProtocolCodec& codec : clampd::can::codecs())
    clampd::can::listen(codec, data, size);
  return 0;
}
