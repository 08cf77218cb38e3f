// A lab's DBC file: read, mapped, and every signal of it used on frames of its size.

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "drivers/can/codec.hpp"
#include "drivers/can/dbc.hpp"
#include "drivers/can/protocol.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace clampd;
  using namespace clampd::can;
  const auto database = parse_dbc({reinterpret_cast<const char*>(data), size}, "input.dbc");
  if (!database) {
    CLAMPD_ASSERT(database.error().message.starts_with("input.dbc:"));
    return 0;
  }
  for (const Message& message : database->messages) {
    std::array<std::uint8_t, 64> content{};
    for (std::size_t i = 0; i < content.size(); ++i) content[i] = static_cast<std::uint8_t>(0xA5 + 29 * i);
    const std::span<std::uint8_t> frame(content.data(), message.size_bytes);
    for (const Signal& signal : message.signals) {
      const std::uint64_t raw = extract_raw(signal, frame);
      insert_raw(signal, raw, frame);
      CLAMPD_ASSERT(extract_raw(signal, frame) == raw);
      const double value = decode(signal, frame);
      for (const double physical : {value, 0.0, 1e300, -1e300, std::nan("")}) encode(signal, physical, frame);
    }
  }
  const auto codec = ProtocolCodec::build(*database, {});
  if (!codec) {
    CLAMPD_ASSERT(codec.error().message.find("input.dbc") != std::string::npos);
    return 0;
  }
  CLAMPD_ASSERT(codec->feedback_frames > 0 && codec->feedback_frames <= kMaxFeedbackFrames);
  Frame command = codec->command.blank();
  for (const double torque_Nm : {1.5, -3.0, 1e300, std::nan("")}) {
    codec->setpoint.encode(command, torque_Nm);
    codec->command.protection.protect(command, 1);
    CLAMPD_ASSERT(codec->command.intact(command) && codec->command.protection.counter_of(command) == 1);
    CLAMPD_ASSERT(std::isfinite(codec->setpoint.decode(command)));
  }
  // A brake that speaks it, its clock about to wrap.
  BrakeProtocol brake(*codec);
  StationProtocol station(*codec);
  BrakeFeedback reading;
  reading.brake_time_ns = std::numeric_limits<std::int64_t>::max() - 20 * kPeriod_ns;
  for (int sample = 0; sample < 16; ++sample) {
    reading.brake_time_ns += kPeriod_ns;
    std::array<Frame, kMaxFeedbackFrames> frames;
    const std::size_t count = brake.feedback(reading, frames);
    for (std::size_t i = 0; i < count; ++i)
      if (const auto taken = station.accept(frames[i], sample * kPeriod_ns))
        CLAMPD_ASSERT(std::isfinite(taken->force_N) && std::isfinite(taken->velocity_rad_s) &&
                      std::isfinite(taken->torque_Nm));
  }
  return 0;
}
