#include "drivers/can/frame_sequence.hpp"

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"
#include "drivers/can/brake_codec.hpp"
#include "drivers/can/brake_node.hpp"
#include "drivers/can/can_brake.hpp"
#include "drivers/can/embedded_bus.hpp"
#include "support/allocation_trap.hpp"

namespace clampd::can {
namespace {

using ::testing::HasSubstr;

constexpr const char* kSequencedFrames = R"(VERSION ""
BU_: X
BO_ 256 Command: 8 X
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" X
 SG_ Counter : 8|4@1+ (1,0) [0|15] "" X
 SG_ Torque : 16|16@1- (0.0001,0) [-3.2|3.2] "Nm" X
 SG_ Enable : 32|1@1+ (1,0) [0|1] "" X
BO_ 384 Feedback: 8 X
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" X
 SG_ Counter : 8|4@1+ (1,0) [0|15] "" X
 SG_ Force : 16|8@1- (500,0) [-4000|45000] "N" X
 SG_ Velocity : 24|8@1- (5,0) [-600|600] "rad/s" X
 SG_ Torque : 32|8@1- (0.05,0) [-3.2|3.2] "Nm" X
 SG_ Clock : 40|16@1+ (10,0) [0|655350] "us" X
BO_ 0 Network: 2 X
 SG_ Order : 0|8@1+ (1,0) [0|130] "" X
 SG_ Node : 8|8@1+ (1,0) [0|127] "" X
BO_ 512 ModeRequest: 4 X
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" X
 SG_ Counter : 8|4@1+ (1,0) [0|15] "" X
 SG_ Mode : 16|4@1+ (1,0) [0|5] "" X
 SG_ Limit : 20|12@1- (0.5,0) [-100|100] "%" X
)";

ProtocolMapping sequenced_mapping() {
  ProtocolMapping names = command_and_feedback_mapping();
  names.position = "";
  names.startup = {{"Network", {{"Order", 1.0}, {"Node", 5.0}}, 50.0},
                   {"ModeRequest", {{"Mode", 2.0}}, 20.0},
                   {"ModeRequest", {{"Mode", 3.0}, {"Limit", -12.5}}, 0.0}};
  names.shutdown = {{"ModeRequest", {{"Mode", 0.0}}}};
  return names;
}

Result<ProtocolCodec> sequenced_codec(const ProtocolMapping& names) {
  return parse_dbc(kSequencedFrames, "brake.dbc").and_then([&](const Database& database) {
    return ProtocolCodec::build(database, names);
  });
}

std::string sequence_refusal(const FrameRequest& request) {
  ProtocolMapping names = sequenced_mapping();
  names.startup = {request};
  const auto built = sequenced_codec(names);
  return built ? "" : built.error().message;
}

TEST(FrameSequence, SendsEachFrameInItsTimeWithACounterOfItsOwn) {
  const auto built = sequenced_codec(sequenced_mapping());
  ASSERT_TRUE(built) << built.error().message;
  EXPECT_EQ(built->command_ids(), (std::vector<std::uint32_t>{256, 0, 512}));
  FrameSequence sequence(built->startup);
  std::vector<std::pair<std::int64_t, Frame>> sent;
  for (std::int64_t t_ms = 0; t_ms < 200; ++t_ms)
    if (const auto frame = sequence.due(t_ms * kNanosecondsPerMillisecond)) sent.emplace_back(t_ms, *frame);
  ASSERT_EQ(sent.size(), 3U);
  EXPECT_TRUE(sequence.done());
  EXPECT_EQ(sent[0].first, 0);
  EXPECT_EQ(sent[1].first, 50);
  EXPECT_EQ(sent[2].first, 70);
  EXPECT_EQ(sent[0].second.size, 2);
  EXPECT_EQ(sent[0].second.data[0], 1);
  EXPECT_EQ(sent[0].second.data[1], 5);
  for (std::size_t i : {1U, 2U}) {
    const FrameProtection& protection = built->startup[i].protection;
    EXPECT_TRUE(protection.matches(sent[i].second));
    EXPECT_EQ(protection.counter_of(sent[i].second), i - 1);
    EXPECT_EQ(sent[i].second.data[2] & 0xFU, i + 1) << "the mode";
  }
}

TEST(FrameSequence, RefusesWhatCannotBeSent) {
  EXPECT_THAT(sequence_refusal({"Wake", {}}),
              HasSubstr("start-up frame 1: there is no message Wake in brake.dbc"));
  EXPECT_THAT(sequence_refusal({"Command", {}}), HasSubstr("Command is sent in every period"));
  EXPECT_THAT(sequence_refusal({"Feedback", {}}), HasSubstr("Feedback is sent in every period"));
  EXPECT_THAT(sequence_refusal({"ModeRequest", {{"Speed", 1.0}}}),
              HasSubstr("message ModeRequest of brake.dbc has no signal Speed that can be set; it has Crc, "
                        "Counter, Mode, Limit"));
  EXPECT_THAT(sequence_refusal({"ModeRequest", {{"Crc", 1.0}}}), HasSubstr("no signal Crc that can be set"));
  EXPECT_THAT(sequence_refusal({"ModeRequest", {{"Mode", 6.0}}}),
              HasSubstr("ModeRequest.Mode cannot be 6: brake.dbc allows 0 to 5"));
  EXPECT_THAT(sequence_refusal({"ModeRequest", {{"Limit", -120.0}}}), HasSubstr("allows -100 to 100"));
  ProtocolMapping many = sequenced_mapping();
  many.shutdown.assign(17, {"Network", {}});
  const auto built = sequenced_codec(many);
  ASSERT_FALSE(built);
  EXPECT_THAT(built.error().message, HasSubstr("shut-down: 17 frames are too many; at most 16"));
}

/// A brake that turns as it is told.
class Follower {
 public:
  void command(const DriveCommand& command) noexcept { command_ = command; }
  BrakeFeedback sample() noexcept {
    BrakeFeedback reading;
    reading.brake_time_ns = time_ns_ += kPeriod_ns;
    reading.torque_Nm = command_.enable ? command_.torque_Nm : 0.0;
    return reading;
  }
  bool enabled() const noexcept { return command_.enable; }

 private:
  DriveCommand command_;
  std::int64_t time_ns_ = 0;
};

class SleepingBrake {
 public:
  /// Milliseconds until a sample came; nothing within `most_ms`.
  std::optional<int> until_awake(int most_ms) {
    for (int t_ms = 0; t_ms < most_ms; ++t_ms)
      if (period()) return t_ms;
    return std::nullopt;
  }
  /// One period; true if it brought a sample.
  bool period(bool powered = true) {
    now_ns_ += kPeriod_ns;
    if (powered) node_->tick(now_ns_ - kPeriod_ns / 2);
    const bool heard = brake_.receive(samples_, now_ns_) > 0;
    brake_.send({1.0, true}, now_ns_);
    return heard;
  }
  void restart_brake() { node_.emplace(bus_.end(EmbeddedBus::End::Brake), codec_, follower_); }
  void end() { brake_.end(now_ns_); }
  bool enabled() const { return follower_.enabled(); }

 private:
  ProtocolCodec codec_ = sequenced_codec(sequenced_mapping()).value();
  EmbeddedBus bus_;
  Follower follower_;
  std::optional<BrakeNode<Follower>> node_{std::in_place, bus_.end(EmbeddedBus::End::Brake), codec_,
                                           follower_};
  CanBrake brake_{bus_.end(EmbeddedBus::End::Station), codec_};
  std::array<BrakeFeedback, 8> samples_;
  std::int64_t now_ns_ = 3'000'000'000;
};

TEST(CanBrake, WakesABrakeThatSleepsAndOneThatWasRestarted) {
  SleepingBrake bench;
  const auto first = bench.until_awake(200);
  ASSERT_TRUE(first);
  EXPECT_GE(*first, 70) << "not before the last frame of the sequence";
  EXPECT_LE(*first, 75);
  for (int i = 0; i < 3000; ++i) ASSERT_TRUE(bench.period()) << i;
  EXPECT_TRUE(bench.enabled());
  bench.restart_brake();
  const auto again = bench.until_awake(3000);
  ASSERT_TRUE(again) << "a brake that is silent for a second is woken anew";
  EXPECT_GE(*again, 1000);
  EXPECT_LE(*again, 1100);
  for (int i = 0; i < 2500; ++i) bench.period(false);
  bench.restart_brake();
  EXPECT_TRUE(bench.until_awake(1200)) << "also one that was switched on late";
}

TEST(CanBrake, PutsTheBrakeToSleepWhenTheStationEnds) {
  SleepingBrake bench;
  ASSERT_TRUE(bench.until_awake(200));
  for (int i = 0; i < 10; ++i) bench.period();
  ASSERT_TRUE(bench.enabled());
  bench.end();
  for (int i = 0; i < 3; ++i) bench.period();
  EXPECT_FALSE(bench.enabled());
  EXPECT_FALSE(bench.period());
}

TEST(CanBrake, AllocatesNothingWhileItWakesABrake) {
  SleepingBrake bench;
  const support::AllocationTrap trap;
  const auto awake = bench.until_awake(200);
  bench.end();
  EXPECT_EQ(trap.allocations(), 0U);
  EXPECT_TRUE(awake);
}

}  // namespace
}  // namespace clampd::can
