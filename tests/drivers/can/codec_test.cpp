#include "drivers/can/codec.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>

namespace clampd::can {
namespace {

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
  codec->torque_command.encode(frame, 100.0);
  EXPECT_DOUBLE_EQ(codec->torque_command.decode(frame), 3.2);
  codec->torque_command.encode(frame, -std::numeric_limits<double>::infinity());
  EXPECT_DOUBLE_EQ(codec->torque_command.decode(frame), -3.2);
  codec->torque_command.encode(frame, std::nan(""));
  EXPECT_DOUBLE_EQ(codec->torque_command.decode(frame), 0.0);
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
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeFeedback", "Force").multiplexor = 3; }),
              HasSubstr("is multiplexed"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeClock").attributes["E2EDataId"] = "70000"; }),
              HasSubstr("E2EDataId is '70000'"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeCommand", "TorqueCommand").minimum = 0.0; }),
              HasSubstr("torques of both signs"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeCommand", "TorqueCommand").offset = 0.00005; }),
              HasSubstr("cannot express zero torque"));
  EXPECT_THAT(with([](Database& d) { edit(d, "BrakeClock", "SampleClock").bits = 8; }),
              HasSubstr("wrap after 16 ms"));
}

}  // namespace
}  // namespace clampd::can
