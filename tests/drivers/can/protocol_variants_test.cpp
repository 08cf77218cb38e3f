// The same brake over frames of other shapes: CAN FD, one frame or three, every checksum, counters of any
// width and none, no sample clock. What the protocol promises holds for all of them.

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"
#include "drivers/can/brake_node.hpp"
#include "drivers/can/can_brake.hpp"
#include "drivers/can/embedded_bus.hpp"

namespace clampd::can {
namespace {

struct Variant {
  const char* name;
  Checksum checksum;
  std::size_t header_bytes;    ///< of checksum and counter, at the beginning of each frame
  const char* header_signals;  ///< of each frame
  bool floats;                 ///< readings as 32-bit floats
  int feedback_frames;         ///< 1 or 3
  bool counted;
  bool clocked = true;
  bool tells_samples() const { return counted || clocked; }
};

void PrintTo(const Variant& variant, std::ostream* out) {
  *out << variant.name;
}

constexpr const char* kNibbleCounter =
    " SG_ Crc : 0|8@1+ (1,0) [0|255] \"\" X\n SG_ AliveCounter : 8|4@1+ (1,0) [0|15] \"\" X\n";
constexpr const char* kProfile4 =
    " SG_ Crc : 71|32@0+ (1,0) [0|0] \"\" X\n SG_ AliveCounter : 23|16@0+ (1,0) [0|0] \"\" X\n";
constexpr const char* kProfile5 =
    " SG_ Crc : 0|16@1+ (1,0) [0|0] \"\" X\n SG_ AliveCounter : 16|8@1+ (1,0) [0|0] \"\" X\n";
constexpr const char* kProfile7 =
    " SG_ Crc : 7|64@0+ (1,0) [0|0] \"\" X\n SG_ AliveCounter : 103|32@0+ (1,0) [0|0] \"\" X\n";

const std::vector<Variant> kVariants{
    {"SaeJ1850InOneFrame", Checksum::SaeJ1850, 2, kNibbleCounter, false, 1, true},
    {"Profile1aInThreeFrames", Checksum::E2e1a, 2, kNibbleCounter, false, 3, true},
    {"Profile1bInThreeFrames", Checksum::E2e1b, 2, kNibbleCounter, false, 3, true},
    {"Profile1cInOneFrame", Checksum::E2e1c, 2, kNibbleCounter, true, 1, true},
    {"Profile2InThreeFrames", Checksum::E2e2, 2, kNibbleCounter, false, 3, true},
    {"Profile4InOneFrame", Checksum::E2e4, 12, kProfile4, true, 1, true},
    {"Profile5InThreeFrames", Checksum::E2e5, 3, kProfile5, false, 3, true},
    {"Profile7InOneFrame", Checksum::E2e7, 20, kProfile7, true, 1, true},
    {"XorWithAWideCounter", Checksum::Xor, 4,
     " SG_ Crc : 0|8@1+ (1,0) [0|255] \"\" X\n SG_ AliveCounter : 8|20@1+ (1,0) [0|0] \"\" X\n", false, 3,
     true},
    {"TwoBitsOfCounter", Checksum::SaeJ1850, 2,
     " SG_ Crc : 0|8@1+ (1,0) [0|255] \"\" X\n SG_ AliveCounter : 8|2@1+ (1,0) [0|3] \"\" X\n", false, 3,
     true},
    {"NoCounter", Checksum::SaeJ1850, 1, " SG_ Crc : 0|8@1+ (1,0) [0|255] \"\" X\n", false, 3, false},
    {"NoSampleClock", Checksum::SaeJ1850, 2, kNibbleCounter, false, 3, true, false},
    {"NoSampleClockAndNoChecksum", Checksum::None, 1, " SG_ AliveCounter : 0|2@1+ (1,0) [0|3] \"\" X\n", true,
     1, true, false},
    {"NoCounterAndNoChecksum", Checksum::None, 0, "", true, 3, false},
    {"NeitherSampleClockNorCounter", Checksum::SaeJ1850, 1, " SG_ Crc : 0|8@1+ (1,0) [0|255] \"\" X\n", false,
     3, false, false},
};

/// The DBC text of the variant's frames. Frames of more than 8 bytes are CAN FD.
std::string dbc_of(const Variant& v) {
  constexpr std::array<std::size_t, 3> kClassicAndFdSizes{8, 32, 64};
  const auto size_for = [&](std::size_t bytes) {
    for (const std::size_t size : kClassicAndFdSizes)
      if (bytes <= size) return size;
    return std::size_t{64};
  };
  std::size_t byte = 0;
  std::string frames, types;
  const auto frame = [&](int id, const char* name, std::size_t payload) {
    frames +=
        fmt::format("BO_ {} {}: {} X\n{}", id, name, size_for(v.header_bytes + payload), v.header_signals);
    byte = v.header_bytes;
  };
  const auto reading = [&](int id, const char* name, const char* scale, const char* range, const char* unit) {
    const std::size_t bytes = v.floats ? 4 : 2;
    frames += fmt::format(" SG_ {} : {}|{}@1- ({},0) {} \"{}\" X\n", name, 8 * byte, 8 * bytes,
                          v.floats ? "1" : scale, range, unit);
    if (v.floats) types += fmt::format("SIG_VALTYPE_ {} {} : 1;\n", id, name);
    byte += bytes;
  };
  const std::size_t reading_bytes = v.floats ? 4 : 2;
  frame(256, "Command", reading_bytes + 1);
  reading(256, "TorqueCommand", "0.0001", "[-3.2|3.2]", "Nm");
  frames += fmt::format(" SG_ Enable : {}|1@1+ (1,0) [0|1] \"\" X\n", 8 * byte);
  const bool apart = v.feedback_frames == 3;
  frame(384, "A", apart ? 2 * reading_bytes : 4 * reading_bytes + 5);
  reading(384, "Force", "2", "[-4000|45000]", "N");
  reading(384, "Velocity", "0.02", "[-600|600]", "rad/s");
  if (apart) frame(385, "B", 2 * reading_bytes);
  reading(apart ? 385 : 384, "Torque", "0.0001", "[-3.2|3.2]", "Nm");
  reading(apart ? 385 : 384, "Position", "0.02", "[-500|500]", "rad");
  if (apart) frame(386, "C", 5);
  frames += fmt::format(" SG_ SampleClock : {}|32@1+ (1,0) [0|4294967295] \"us\" X\n", 8 * byte);
  byte += 4;
  frames += fmt::format(" SG_ Fault : {}|1@1+ (1,0) [0|1] \"\" X\n", 8 * byte);
  std::string attributes;
  for (int id : {256, 384, 385, 386})
    if (apart || id < 385)
      attributes += fmt::format(
          "BA_ \"E2EDataIdList\" BO_ {0} \"{1},2,3,4,5,6,7,8,9,10,11,12,13,14,15,16\";\n", id, id - 200);
  return "VERSION \"\"\nBU_: X\n" + frames + "BA_DEF_ BO_ \"E2EDataIdList\" STRING;\n" +
         "BA_DEF_DEF_ \"E2EDataIdList\" \"\";\n" + attributes + types;
}

ProtocolCodec codec_of(const Variant& v) {
  const bool apart = v.feedback_frames == 3;
  ProtocolMapping mapping;
  mapping.torque_command = "Command.TorqueCommand";
  mapping.enable = "Command.Enable";
  mapping.force = "A.Force";
  mapping.velocity = "A.Velocity";
  mapping.torque = apart ? "B.Torque" : "A.Torque";
  mapping.position = apart ? "B.Position" : "A.Position";
  mapping.sample_clock = apart ? "C.SampleClock" : "A.SampleClock";
  mapping.fault = apart ? "C.Fault" : "A.Fault";
  mapping.enabled = mapping.watchdog = "";
  if (!v.counted) mapping.counter = {};
  if (!v.clocked) mapping.sample_clock = "";
  if (v.checksum == Checksum::None) mapping.crc = {};
  mapping.protection.checksum = v.checksum;
  mapping.fast_data = true;
  const auto codec = parse_dbc(dbc_of(v), "variant.dbc").and_then([&](const Database& database) {
    return ProtocolCodec::build(database, mapping);
  });
  EXPECT_TRUE(codec) << codec.error().message << "\n" << dbc_of(v);
  return codec.value_or(ProtocolCodec{});
}

class Variants : public ::testing::TestWithParam<Variant> {
 protected:
  /// Without a sample clock, the first samples only tell when the brake samples.
  void SetUp() override {
    if (GetParam().clocked) return;
    while (!deliver(next_sample())) continue;
    first_index_ = 1;
  }

  std::vector<Frame> next_sample(WireFault fault = WireFault::None) {
    now_ns_ += kPeriod_ns;
    BrakeFeedback reading = reading_;
    reading.brake_time_ns = now_ns_;
    std::array<Frame, kMaxFeedbackFrames> frames;
    const std::size_t count = brake_.feedback(reading, frames, fault);
    return {frames.begin(), frames.begin() + static_cast<std::ptrdiff_t>(count)};
  }

  std::optional<BrakeFeedback> deliver(const std::vector<Frame>& frames) {
    std::optional<BrakeFeedback> result;
    std::int64_t arrival_ns = now_ns_;
    for (const Frame& frame : frames)
      if (const auto feedback = station_.accept(frame, arrival_ns += 100'000)) result = feedback;
    return result;
  }

  ProtocolCodec codec_ = codec_of(GetParam());
  StationProtocol station_{codec_};
  BrakeProtocol brake_{codec_};
  BrakeFeedback reading_{0, 0, 0, 1.2345, -56.78, 23456.0, 12.34, true, false, false};
  std::int64_t now_ns_ = 5'000'000'000;
  std::int64_t first_index_ = 0;
};

TEST_P(Variants, SamplesAndCommandsArriveAsTheyWereGiven) {
  for (int i = 0; i < 300; ++i) {
    const auto sample = deliver(next_sample());
    ASSERT_TRUE(sample) << i;
    EXPECT_EQ(sample->sample_index, first_index_ + i);
    EXPECT_NEAR(sample->force_N, 23456.0, 1.0);
    EXPECT_NEAR(sample->velocity_rad_s, -56.78, 0.01);
    EXPECT_NEAR(sample->torque_Nm, 1.2345, 0.5e-4);
    EXPECT_NEAR(sample->position_rad, 12.34, 0.01);
    const auto command = brake_.accept(station_.command({-1.5, true}), now_ns_);
    ASSERT_TRUE(command);
    EXPECT_NEAR(command->torque_Nm, -1.5, 0.5e-4);
  }
  EXPECT_EQ(station_.counts().lost_samples, 0U);
  EXPECT_EQ(station_.counts().counter_errors, 0U);
}

TEST_P(Variants, ALostFrameIsALostSampleAndFramesOfTwoSamplesAreNeverJoined) {
  const std::size_t frames = codec_.feedback_frames;
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(deliver(next_sample()));
  for (std::size_t lost = 0; lost < frames; ++lost) {
    std::vector<Frame> some = next_sample();
    some.erase(some.begin() + static_cast<std::ptrdiff_t>(lost));
    reading_.force_N += 100.0;
    EXPECT_FALSE(deliver(some));
    if (!GetParam().tells_samples()) {
      EXPECT_FALSE(deliver(next_sample())) << "it may be the one that is missing, held up";
    }
    for (int i = 0; i < 3; ++i) {
      const auto next = deliver(next_sample());
      ASSERT_TRUE(next) << lost << " " << i;
      EXPECT_NEAR(next->force_N, reading_.force_N, 1.0);
    }
  }
  EXPECT_EQ(station_.counts().lost_samples, GetParam().tells_samples() ? frames : 2 * frames);
}

TEST_P(Variants, SpoiledAndRepeatedFramesAreRefused) {
  ASSERT_TRUE(deliver(next_sample()));
  if (GetParam().checksum != Checksum::None) {
    for (int i = 0; i < 20; ++i) EXPECT_FALSE(deliver(next_sample(WireFault::CorruptCrc)));
    EXPECT_EQ(station_.counts().crc_errors, 20U * codec_.feedback_frames);
    Frame command = station_.command({1.0, true});
    codec_.command.protection.spoil(command);
    EXPECT_FALSE(brake_.accept(command, now_ns_));
  }
  if (!GetParam().tells_samples()) return;
  while (!deliver(next_sample())) continue;
  const std::vector<Frame> same = next_sample();
  ASSERT_TRUE(deliver(same));
  const std::uint64_t before = station_.counts().counter_errors;
  for (int i = 0; i < 20; ++i) {
    now_ns_ += kPeriod_ns;
    EXPECT_FALSE(deliver(same)) << "a brake that stands still";
  }
  EXPECT_GE(station_.counts().counter_errors, before + 20);
}

TEST_P(Variants, WrongSizesAndFormatsAreRefused) {
  ASSERT_TRUE(deliver(next_sample()));
  auto frames = next_sample();
  for (Frame& frame : frames) frame.size = static_cast<std::uint8_t>(frame.size - 1);
  EXPECT_FALSE(deliver(frames));
  frames = next_sample();
  for (Frame& frame : frames)
    frame.format = frame.format == FrameFormat::Classic ? FrameFormat::Fd : FrameFormat::Classic;
  EXPECT_FALSE(deliver(frames));
  EXPECT_EQ(station_.counts().crc_errors, 2U * codec_.feedback_frames);
}

/// A brake that says what it was last told.
class Echo {
 public:
  void command(const DriveCommand& command) noexcept { command_ = command; }
  BrakeFeedback sample() noexcept {
    BrakeFeedback reading;
    reading.brake_time_ns = time_ns_ += kPeriod_ns;
    reading.torque_Nm = command_.torque_Nm;
    return reading;
  }

 private:
  DriveCommand command_;
  std::int64_t time_ns_ = 0;
};

TEST_P(Variants, TheBusCarriesThemInAPeriod) {
  EmbeddedBus bus(1e6, {codec_.needs_flexible_data_rate(), 5.0});
  Echo echo;
  BrakeNode<Echo> node(bus.end(EmbeddedBus::End::Brake), codec_, echo);
  CanBrake brake(bus.end(EmbeddedBus::End::Station), codec_);
  std::array<BrakeFeedback, 8> samples;
  for (int k = 1; k <= 1000; ++k) {
    const std::int64_t now_ns = k * kPeriod_ns;
    node.tick(now_ns - kPeriod_ns / 2);
    const std::size_t received = brake.receive(samples, now_ns);
    if (GetParam().clocked || k > ArrivalClock::kSettlingSamples) {
      ASSERT_EQ(received, 1U) << k;
    }
    if (k > 1 && received == 1U) {
      EXPECT_NEAR(samples[0].torque_Nm, 0.001 * (k - 1), 0.5e-4);
    }
    ASSERT_TRUE(brake.send({0.001 * k, true}, now_ns));
  }
  EXPECT_EQ(brake.health().bus_bits, 1000U * static_cast<std::uint64_t>(codec_.bits_per_period(5.0)));
  EXPECT_LT(bus_load(codec_, 1e6, 5.0), 0.75);
}

INSTANTIATE_TEST_SUITE_P(Frames, Variants, ::testing::ValuesIn(kVariants),
                         [](const auto& variant) { return std::string(variant.param.name); });

TEST(EmbeddedBus, TakesNoCanFdFrameWithoutBeingSetUpForIt) {
  EmbeddedBus bus;
  FrameBus& end = bus.end(EmbeddedBus::End::Station);
  EXPECT_TRUE(end.send(Frame{0x100, 8, {}}, 0));
  EXPECT_FALSE(end.send(Frame{0x100, 12, {}, FrameFormat::Fd}, 0));
  EXPECT_EQ(end.health().send_failures, 1U);
}

}  // namespace
}  // namespace clampd::can
