#include "drivers/can/codec.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <string>
#include <utility>

#include "clampd/base/clock.hpp"
#include "drivers/can/brake_codec.hpp"
#include "drivers/can/protocol.hpp"

namespace clampd::can {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr const char* kBrakeDbc = CLAMPD_SOURCE_DIR "/configs/brake.dbc";

Database brake_database() {
  auto database = read_dbc(kBrakeDbc);
  EXPECT_TRUE(database) << database.error().message;
  return database.value_or(Database{});
}

std::string build_error(const Database& database, const ProtocolMapping& mapping) {
  const auto codec = ProtocolCodec::build(database, mapping);
  return codec ? "no error" : codec.error().message;
}

Message& edit(Database& database, const std::string& name) {
  for (Message& message : database.messages) {
    if (message.name == name) return message;
  }
  ADD_FAILURE() << name;
  return database.messages.front();
}

Signal& edit(Database& database, const std::string& message, const std::string& name) {
  for (Signal& signal : edit(database, message).signals) {
    if (signal.name == name) return signal;
  }
  ADD_FAILURE() << name;
  return database.messages.front().signals.front();
}

TEST(Field, AgreesWithTheBitwiseReaderForEveryShapeAndPlace) {
  std::mt19937_64 random{11};
  int tried = 0;
  for (int trial = 0; trial < 40000; ++trial) {
    const std::size_t frame_bits = 8 * std::size_t{kFdSizes[1 + random() % (kFdSizes.size() - 1)]};
    Signal signal;
    signal.bits = 1 + random() % std::min<std::size_t>(64, frame_bits);
    signal.order = random() % 2 == 0 ? ByteOrder::Intel : ByteOrder::Motorola;
    signal.type = random() % 2 == 0 ? ValueType::Signed : ValueType::Unsigned;
    const std::size_t begin = random() % (frame_bits + 1 - signal.bits);
    signal.start_bit = signal.order == ByteOrder::Intel ? begin : 8 * (begin / 8) + 7 - begin % 8;
    if (!Field::fits(signal)) {
      ASSERT_GT(signal.bits, 57U);
      continue;
    }
    ++tried;
    Frame frame{0x100, static_cast<std::uint8_t>(frame_bits / 8), {}};
    for (std::size_t i = 0; i < frame.size; ++i) frame.data[i] = static_cast<std::uint8_t>(random());
    const Field field{signal, 1.0};
    ASSERT_EQ(field.raw(frame), extract_raw(signal, frame.data) & field.largest_raw());
    ASSERT_DOUBLE_EQ(field.decode(frame), decode(signal, frame.data));
    Frame other = frame;
    auto expected = frame.data;
    const std::uint64_t raw = random();
    field.set_raw(other, raw);
    insert_raw(signal, raw, expected);
    ASSERT_EQ(other.data, expected);
    const double value =
        std::ldexp(static_cast<double>(random() % 1000) - 500.0, static_cast<int>(random() % 60));
    field.encode(other, value);
    encode(signal, value, expected);
    if (signal.bits <= 53) {
      ASSERT_EQ(other.data, expected) << value << " in " << signal.bits;
    }
  }
  EXPECT_GT(tried, 38000);
}

TEST(Field, KeepsToTheRangeAndRefusesNan) {
  const Database database = brake_database();
  const auto codec = ProtocolCodec::build(database, {});
  ASSERT_TRUE(codec) << codec.error().message;
  Frame frame = codec->command.blank();
  codec->setpoint.encode(frame, 100.0);
  EXPECT_DOUBLE_EQ(codec->setpoint.decode(frame), 3.2);
  codec->setpoint.encode(frame, -std::numeric_limits<double>::infinity());
  EXPECT_DOUBLE_EQ(codec->setpoint.decode(frame), -3.2);
  codec->setpoint.encode(frame, std::nan(""));
  EXPECT_DOUBLE_EQ(codec->setpoint.decode(frame), 0.0);
  EXPECT_TRUE(codec->force.field.plausible(45000.0));
  EXPECT_FALSE(codec->force.field.plausible(45001.0));
  EXPECT_FALSE(codec->force.field.plausible(std::nan("")));
}

TEST(Codec, EverySingleBitErrorOfAFrameShows) {
  const auto codec = ProtocolCodec::build(brake_database(), {});
  ASSERT_TRUE(codec);
  for (std::size_t i = 0; i < codec->feedback_frames; ++i) {
    Frame good = codec->feedback[i].blank();
    codec->feedback[i].protection.protect(good, 9);
    EXPECT_TRUE(codec->feedback[i].intact(good));
    for (std::size_t bit = 0; bit < 64; ++bit) {
      Frame bad = good;
      bad.data[bit / 8] ^= static_cast<std::uint8_t>(1U << (bit % 8));
      EXPECT_FALSE(codec->feedback[i].intact(bad)) << bit;
    }
  }
}

TEST(Codec, OneFrameDoesNotPassForAnother) {
  const auto codec = ProtocolCodec::build(brake_database(), {});
  ASSERT_TRUE(codec);
  ASSERT_EQ(codec->feedback_frames, 2U);
  Frame frame = codec->feedback[0].blank();
  codec->feedback[0].protection.protect(frame, 1);
  EXPECT_FALSE(codec->feedback[1].intact(frame));
}

TEST(Codec, LeavesRoomOnABusOfOneMegabit) {
  const auto codec = ProtocolCodec::build(brake_database(), {});
  ASSERT_TRUE(codec);
  EXPECT_EQ(codec->bits_per_period(), 105 + 135 + 135);
  EXPECT_LT(bus_load(*codec, 1e6), 0.42);
  EXPECT_LT(bus_load(*codec, 500e3), 0.80);
}

TEST(Codec, ShippedDbcHasNoDefects) {
  const Database database = brake_database();
  EXPECT_TRUE(database.defects.empty());
  for (const Message& message : database.messages) EXPECT_TRUE(message.defects.empty()) << message.name;
}

TEST(Codec, ALabsOwnNamesUnitsAndOrdersWork) {
  Database database = brake_database();
  edit(database, "BrakeFeedback").name = "Lab";
  edit(database, "Lab", "Force").name = "Kraft";
  Signal& force = edit(database, "Lab", "Kraft");
  force.order = ByteOrder::Motorola;
  force.start_bit = 7;
  force.unit = "kN";
  force.scale = 0.001;
  force.offset = -4;
  force.minimum = -4;
  force.maximum = 45;
  Signal& velocity = edit(database, "Lab", "Velocity");
  velocity.unit = "rpm";
  velocity.scale = 0.2;
  velocity.minimum = -6000;
  velocity.maximum = 6000;
  ProtocolMapping mapping;
  mapping.force = "Lab.Kraft";
  mapping.velocity = "Lab.Velocity";
  mapping.torque = "Lab.Torque";
  mapping.enabled = "Lab.Enabled";
  mapping.watchdog = "";
  mapping.fault = "";
  mapping.position = "";
  const auto codec = ProtocolCodec::build(database, mapping);
  ASSERT_TRUE(codec) << codec.error().message;
  Frame frame = codec->feedback[codec->force.frame].blank();
  codec->force.field.encode(frame, 23456.0);
  codec->velocity.field.encode(frame, 100.0);
  EXPECT_NEAR(codec->force.field.decode(frame), 23456.0, 1e-9);
  EXPECT_NEAR(codec->velocity.field.decode(frame), 100.0, 0.2 * M_PI / 30 / 2);
  EXPECT_EQ(frame.data[0], (23456 + 4000) >> 8);
  EXPECT_FALSE(codec->position.present);
}

TEST(Codec, ErrorsSayWhatTheMappingNeeds) {
  const Database good = brake_database();
  ProtocolMapping mapping;
  mapping.force = "Force";
  EXPECT_THAT(build_error(good, mapping), HasSubstr("force: 'Force' must read Message.Signal"));
  mapping.force = "Nope.Force";
  EXPECT_THAT(build_error(good, mapping), HasSubstr("there is no message Nope in"));
  mapping.force = "BrakeFeedback.Kraft";
  EXPECT_THAT(build_error(good, mapping), HasSubstr("has no signal Kraft; it has Force, Velocity"));
  mapping.force = "";
  EXPECT_THAT(build_error(good, mapping), HasSubstr("force: '' must read"));
  mapping.force = "BrakeCommand.TorqueCommand";
  EXPECT_THAT(build_error(good, mapping), HasSubstr("command's own message"));

  const auto with = [&](const auto& change) {
    Database database = good;
    change(database);
    return build_error(database, {});
  };
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeFeedback", "Force").unit = "lbf"; }),
              HasSubstr("has the unit \"lbf\"; expected \"N\", \"kN\""));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeFeedback", "AliveCounter").bits = 1; }),
              HasSubstr("needs an alive counter AliveCounter: 2 to 32 bits"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeClock", "Crc").start_bit = 55; }),
              HasSubstr("needs a checksum Crc: 8 bits"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeClock").size_bytes = 13; }),
              HasSubstr("has 13 bytes; a CAN FD frame"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeClock").defects.push_back("x.dbc:1:2: overlap"); }),
              HasSubstr("x.dbc:1:2: overlap"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeClock").attributes["E2EDataId"] = "70000"; }),
              HasSubstr("E2EDataId is '70000'"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeCommand", "TorqueCommand").minimum = 0.0; }),
              HasSubstr("a torque of either sign"));
  EXPECT_THAT(with([](Database& d) {
                Signal& command = edit(d, "BrakeCommand", "TorqueCommand");
                command.type = ValueType::Unsigned;  // and no range that says so
                command.minimum = command.maximum = 0.0;
              }),
              AllOf(HasSubstr("torque command: BrakeCommand.TorqueCommand in"),
                    HasSubstr("it has 0 to 6.5535 in SI units")));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeFeedback", "Velocity").minimum = 0.0; }),
              HasSubstr("brake.dbc must have a range that includes a velocity of either sign"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeFeedback", "Torque").maximum = 0.0; }),
              HasSubstr("a torque of either sign"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeCommand", "TorqueCommand").offset = 0.00005; }),
              HasSubstr("cannot express a torque of zero"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeClock", "SampleClock").bits = 8; }),
              HasSubstr("wrap after 16 ms"));
}

TEST(Codec, ARoleIsNoCounterAndNoChecksum) {
  ProtocolMapping mapping;
  mapping.enable = "BrakeCommand.AliveCounter";
  EXPECT_THAT(build_error(brake_database(), mapping),
              HasSubstr("is what [can.mapping] names as counter; name a signal"));
  mapping = {};
  mapping.fault = "BrakeFeedback.Crc";
  EXPECT_THAT(build_error(brake_database(), mapping), HasSubstr("fault: BrakeFeedback.Crc in"));
}

TEST(Codec, UnitsAndFormatsAreReadAsFilesWriteThem) {
  Database database = brake_database();
  edit(database, "BrakeFeedback", "Velocity").unit = "RPM";
  edit(database, "BrakeClock", "Position").unit = "degrees";
  edit(database, "BrakeFeedback", "Enabled").unit = "SED";
  database.attribute_defaults["VFrameFormat"] = "StandardCAN_FD";
  edit(database, "BrakeClock").attributes["VFrameFormat"] = "0";
  const auto codec = ProtocolCodec::build(database, {});
  ASSERT_TRUE(codec) << codec.error().message;
  EXPECT_NEAR(codec->velocity.field.scale(), 0.02 * M_PI / 30.0, 1e-12);
  EXPECT_NEAR(codec->position.field.scale(), 0.001 * M_PI / 180.0, 1e-12);
  EXPECT_EQ(codec->command.format, FrameFormat::Fd);
  EXPECT_EQ(codec->feedback[0].format, FrameFormat::Fd);
  EXPECT_EQ(codec->feedback[1].format, FrameFormat::Classic);
}

TEST(Field, IsLimitedByItsRangeAndByItsWidth) {
  Signal signal;
  signal.bits = 8;
  signal.scale = -0.5;
  signal.offset = 10.0;
  const auto limits = [&] {
    const Field field(signal, 2.0);
    return std::pair{field.minimum(), field.maximum()};
  };
  EXPECT_EQ(limits(), (std::pair{-235.0, 20.0}));
  signal.type = ValueType::Signed;
  EXPECT_EQ(limits(), (std::pair{-107.0, 148.0}));
  signal.minimum = -20.0;
  signal.maximum = 500.0;
  EXPECT_EQ(limits(), (std::pair{-40.0, 148.0}));
  signal.minimum = 400.0;  // out of reach
  EXPECT_EQ(limits(), (std::pair{800.0, 1000.0}));
  EXPECT_FALSE(Field(signal, 2.0).plausible(148.0));
  signal.type = ValueType::Float32;
  signal.bits = 32;
  signal.minimum = signal.maximum = 0.0;
  EXPECT_TRUE(std::isinf(Field(signal, 1.0).maximum()));
  EXPECT_EQ(Field(signal, 1.0).step(), 0.0);
}

/// The shipped brake, told its speed in place of its torque.
Database velocity_database() {
  Database database = brake_database();
  Signal& command = edit(database, "BrakeCommand", "TorqueCommand");
  command.name = "VelocityCommand";
  command.unit = "rpm";
  command.scale = 0.5;
  command.minimum = -6000.0;
  command.maximum = 6000.0;
  return database;
}

TEST(Codec, ABrakeIsToldItsTorqueOrItsSpeedAndNeverTheOtherOne) {
  ProtocolMapping mapping;
  mapping.torque_command = "";
  mapping.velocity_command = "BrakeCommand.VelocityCommand";
  const auto codec = ProtocolCodec::build(velocity_database(), mapping);
  ASSERT_TRUE(codec) << codec.error().message;
  EXPECT_EQ(codec->commanded, CommandedQuantity::Velocity);
  StationProtocol station(*codec);
  BrakeProtocol brake(*codec);
  const auto understood = [&](const DriveCommand& command) {
    return brake.accept(station.command(command), 0).value();
  };
  constexpr auto kVelocity = CommandedQuantity::Velocity;
  const DriveCommand told = understood({.enable = true, .velocity_rad_s = -123.4, .commanded = kVelocity});
  EXPECT_TRUE(told.enable);
  EXPECT_EQ(told.commanded, kVelocity);
  EXPECT_NEAR(told.velocity_rad_s, -123.4, 0.25 * M_PI / 30.0);
  EXPECT_EQ(told.torque_Nm, 0.0);

  const DriveCommand refused[] = {
      {.torque_Nm = 1.5, .enable = true},  // a torque, to a brake that would take it for a speed
      {.enable = false, .velocity_rad_s = 50.0, .commanded = kVelocity},
      {.enable = true, .velocity_rad_s = std::nan(""), .commanded = kVelocity}};
  for (const DriveCommand& command : refused) {
    EXPECT_FALSE(understood(command).enable);
    EXPECT_EQ(understood(command).velocity_rad_s, 0.0);
  }

  StationProtocol to_torque(brake_codec());
  BrakeProtocol by_torque(brake_codec());
  const auto other = by_torque.accept(
      to_torque.command({.enable = true, .velocity_rad_s = 50.0, .commanded = kVelocity}), 0);
  ASSERT_TRUE(other);
  EXPECT_FALSE(other->enable);
  EXPECT_EQ(other->torque_Nm, 0.0);
}

TEST(Codec, ErrorsSayWhatASpeedCommandNeeds) {
  ProtocolMapping mapping;
  mapping.velocity_command = "BrakeCommand.VelocityCommand";
  EXPECT_THAT(build_error(velocity_database(), mapping),
              HasSubstr("both a torque command, BrakeCommand.TorqueCommand, and a velocity command"));
  mapping.torque_command = "";
  Database database = velocity_database();
  edit(database, "BrakeCommand", "VelocityCommand").unit = "Nm";
  EXPECT_THAT(build_error(database, mapping), HasSubstr("velocity command: BrakeCommand.VelocityCommand in"));
  database = velocity_database();
  edit(database, "BrakeCommand", "VelocityCommand").minimum = 0.0;
  EXPECT_THAT(build_error(database, mapping), HasSubstr("a velocity of either sign"));
  database = velocity_database();
  edit(database, "BrakeCommand", "VelocityCommand").offset = 0.2;
  EXPECT_THAT(build_error(database, mapping), HasSubstr("cannot express a velocity of zero"));
}

constexpr const char* kMultiplexedFrames = R"(VERSION ""
BU_: X
BO_ 256 Command: 8 X
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" X
 SG_ Counter : 8|4@1+ (1,0) [0|15] "" X
 SG_ Mode M : 12|4@1+ (1,0) [0|15] "" X
 SG_ Enable : 16|1@1+ (1,0) [0|1] "" X
 SG_ Torque m6 : 32|16@1- (0.0001,0) [-3.2|3.2] "Nm" X
 SG_ Speed m7 : 32|16@1- (0.1,0) [0|0] "rad/s" X
BO_ 384 Feedback: 16 X
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" X
 SG_ Counter : 8|4@1+ (1,0) [0|15] "" X
 SG_ Page M : 12|4@1+ (1,0) [0|15] "" X
 SG_ Half m2M : 16|8@1+ (1,0) [0|255] "" X
 SG_ Force m2 : 24|16@1- (2,0) [-4000|45000] "N" X
 SG_ Velocity m2 : 40|16@1- (0.02,0) [-600|600] "rad/s" X
 SG_ Torque m2 : 56|16@1- (0.0001,0) [-3.2|3.2] "Nm" X
 SG_ Position m2 : 72|16@1- (0.02,0) [-500|500] "rad" X
 SG_ Clock m9 : 88|32@1+ (1,0) [0|4294967295] "us" X
 SG_ Temperature m3 : 24|16@1- (0.1,0) [0|0] "degC" X
 SG_ Other m3 : 40|16@1- (2,0) [-4000|45000] "N" X
SG_MUL_VAL_ 384 Half Page 2-2;
SG_MUL_VAL_ 384 Force Page 1-2, 8-8;
SG_MUL_VAL_ 384 Velocity Page 2-2, 5-8;
SG_MUL_VAL_ 384 Torque Page 2-2;
SG_MUL_VAL_ 384 Position Page 2-2;
SG_MUL_VAL_ 384 Clock Half 9-11;
SG_MUL_VAL_ 384 Temperature Page 3-3;
SG_MUL_VAL_ 384 Other Page 3-3;
)";

TEST(Codec, MultiplexedSignalsAreReadWhereTheyAre) {
  const auto database = parse_dbc(kMultiplexedFrames, "brake.dbc");
  ASSERT_TRUE(database) << database.error().message;
  const auto codec = ProtocolCodec::build(*database, command_and_feedback_mapping());
  ASSERT_TRUE(codec) << codec.error().message;
  StationProtocol station(*codec);
  BrakeProtocol brake(*codec);

  const Frame command = station.command({-1.5, true});
  EXPECT_EQ(command.data[1] >> 4, 6) << "the mode in which the frame holds a torque";
  const auto understood = brake.accept(command, 0);
  ASSERT_TRUE(understood);
  EXPECT_NEAR(understood->torque_Nm, -1.5, 1e-4);
  Frame speed = command;
  speed.data[1] = static_cast<std::uint8_t>(0x70 | (command.data[1] & 0x0F));
  EXPECT_FALSE(brake.accept(speed, 0));
  EXPECT_EQ(brake.counts().crc_errors, 0U) << "not meant for it";

  for (int k = 1; k <= 100; ++k) {
    BrakeFeedback reading;
    reading.force_N = 100.0 * k;
    reading.velocity_rad_s = -3.0 * k;
    reading.brake_time_ns = k * kPeriod_ns;
    std::array<Frame, kMaxFeedbackFrames> frames;
    ASSERT_EQ(brake.feedback(reading, frames), 1U);
    EXPECT_EQ(frames[0].data[1] >> 4, 2);
    EXPECT_EQ(frames[0].data[2], 9);
    // A frame with something else in the same places, in between.
    Frame other = frames[0];
    other.data[1] = static_cast<std::uint8_t>(0x30 | (other.data[1] & 0x0F));
    EXPECT_FALSE(station.accept(other, k * kPeriod_ns - 500'000));
    const auto sample = station.accept(frames[0], k * kPeriod_ns);
    ASSERT_TRUE(sample) << k;
    EXPECT_NEAR(sample->force_N, reading.force_N, 1.0);
    EXPECT_NEAR(sample->velocity_rad_s, reading.velocity_rad_s, 0.01);
    EXPECT_EQ(sample->brake_time_ns, reading.brake_time_ns);
  }
  EXPECT_EQ(station.counts().crc_errors + station.counts().counter_errors + station.counts().lost_samples,
            0U);
}

TEST(Codec, RefusesMultiplexedSignalsThatNeverComeTogether) {
  const auto database = parse_dbc(kMultiplexedFrames, "brake.dbc");
  ASSERT_TRUE(database);
  ProtocolMapping names = command_and_feedback_mapping();
  names.force = "Feedback.Other";
  EXPECT_THAT(
      build_error(*database, names),
      HasSubstr("message Feedback of brake.dbc: no frame holds all of Other, Velocity, Torque, Position, "
                "Clock, as its multiplexor Page has it"));
  names = command_and_feedback_mapping();
  names.enabled = "Feedback.Half";
  EXPECT_THAT(build_error(*database, names), HasSubstr("Half in brake.dbc is a multiplexor"));
  const Database good = brake_database();
  Database circular = good;
  edit(circular, "BrakeFeedback", "Force").multiplexor = 3;
  for (Signal& signal : edit(circular, "BrakeFeedback").signals) signal.multiplexor = 3;
  EXPECT_NE(build_error(circular, {}), "no error") << "and ends";
}

}  // namespace
}  // namespace clampd::can
