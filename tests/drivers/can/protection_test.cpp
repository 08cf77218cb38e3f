#include "drivers/can/protection.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <string>
#include <vector>

namespace clampd::can {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using Bytes = std::vector<std::uint8_t>;

Signal whole_bytes(const std::string& name, std::size_t byte, std::size_t bytes, ByteOrder order) {
  Signal signal;
  signal.name = name;
  signal.start_bit = 8 * byte + (order == ByteOrder::Intel ? 0 : 7);
  signal.bits = 8 * bytes;
  signal.order = order;
  return signal;
}

Signal low_nibble(const std::string& name, std::size_t byte) {
  Signal signal;
  signal.name = name;
  signal.start_bit = 8 * byte;
  signal.bits = 4;
  return signal;
}

Message message(std::size_t size, std::vector<Signal> signals, const std::string& data_id = "") {
  Message result;
  result.id = 0x100;
  result.name = "M";
  result.size_bytes = size;
  result.signals = std::move(signals);
  if (!data_id.empty()) result.attributes["E2EDataId"] = data_id;
  return result;
}

ProtectionDescription of(Checksum checksum) {
  ProtectionDescription description;
  description.checksum = checksum;
  return description;
}

Result<FrameProtection> build(const Message& m, Checksum checksum) {
  return FrameProtection::build(m, "Counter", "Crc", of(checksum), "message M of x.dbc");
}

std::string error_of(const Result<FrameProtection>& protection) {
  return protection ? "no error" : protection.error().message;
}

/// What stands in a frame of zeros once it is protected.
Bytes protect(const FrameProtection& protection, std::size_t size, std::uint32_t counter) {
  Frame frame{0x100, static_cast<std::uint8_t>(size), {}};
  protection.protect(frame, counter);
  EXPECT_TRUE(protection.matches(frame));
  return {frame.data.begin(), frame.data.begin() + static_cast<std::ptrdiff_t>(size)};
}

/// The CRC of the given bytes, which stand before it in a frame.
std::uint64_t crc_of(const CrcDescription& crc, const Bytes& bytes) {
  ProtectionDescription description = of(Checksum::Crc);
  description.crc = crc;
  const std::size_t width = static_cast<std::size_t>(crc.width_bits) / 8;
  const Message m =
      message(bytes.size() + width, {whole_bytes("Crc", bytes.size(), width, ByteOrder::Motorola)});
  const auto protection = FrameProtection::build(m, "", "Crc", description, "message M of x.dbc");
  EXPECT_TRUE(protection) << error_of(protection);
  Frame frame{0x100, static_cast<std::uint8_t>(m.size_bytes), {}};
  std::copy(bytes.begin(), bytes.end(), frame.data.begin());
  protection->protect(frame, 0);
  return Field{m.signals.front(), 1.0}.raw(frame);
}

struct Algorithm {
  const char* name;
  CrcDescription crc;
  std::uint64_t check;                 ///< of "123456789", catalogue of parametrised CRC algorithms
  std::vector<std::uint64_t> autosar;  ///< of kAutosarBytes, AUTOSAR SWS CRCLibrary R20-11
};

const std::vector<Bytes> kAutosarBytes{{0, 0, 0, 0},
                                       {0xF2, 0x01, 0x83},
                                       {0x0F, 0xAA, 0x00, 0x55},
                                       {0x00, 0xFF, 0x55, 0x11},
                                       {0x33, 0x22, 0x55, 0xAA, 0xBB, 0xCC, 0xDD, 0xEE, 0xFF},
                                       {0x92, 0x6B, 0x55},
                                       {0xFF, 0xFF, 0xFF, 0xFF}};

const std::vector<Algorithm> kAlgorithms{
    {"CRC-8/SAE-J1850", {8, 0x1D, 0xFF, 0xFF}, 0x4B, {0x59, 0x37, 0x79, 0xB8, 0xCB, 0x8C, 0x74}},
    {"CRC-8/AUTOSAR", {8, 0x2F, 0xFF, 0xFF}, 0xDF, {0x12, 0xC2, 0xC6, 0x77, 0x11, 0x33, 0x6C}},
    {"CRC-16/IBM-3740",
     {16, 0x1021, 0xFFFF, 0},
     0x29B1,
     {0x84C0, 0xD374, 0x2023, 0xB8F9, 0xF53F, 0x0745, 0x1D0F}},
    {"CRC-32/ISO-HDLC",
     {32, 0x04C11DB7, 0xFFFFFFFF, 0xFFFFFFFF, true},
     0xCBF43926,
     {0x2144DF1C, 0x24AB9D77, 0xB6C9B287, 0x32A06212, 0xB0AE863D, 0x9CDEA29B, 0xFFFFFFFF}},
    {"CRC-32/AUTOSAR",
     {32, 0xF4ACFB13, 0xFFFFFFFF, 0xFFFFFFFF, true},
     0x1697D06A,
     {0x6FB32240, 0x4F721A25, 0x20662DF8, 0x9BD7996E, 0xA65A343D, 0xEE688A78, 0xFFFFFFFF}},
    {"CRC-64/XZ",
     {64, 0x42F0E1EBA9EA3693, 0xFFFFFFFFFFFFFFFF, 0xFFFFFFFFFFFFFFFF, true},
     0x995DC9BBDF1939FA,
     {0xF4A586351E1B9F4B, 0x319C27668164F1C6, 0x54C5D0F7667C1575, 0xA63822BE7E0704E6, 0x701ECEB219A8E5D5,
      0x5FAA96A9B59F3E4E, 0xFFFFFFFF00000000}}};

TEST(Crc, GivesThePublishedValues) {
  const std::string digits = "123456789";
  for (const Algorithm& algorithm : kAlgorithms) {
    SCOPED_TRACE(algorithm.name);
    EXPECT_EQ(crc_of(algorithm.crc, {digits.begin(), digits.end()}), algorithm.check);
    for (std::size_t i = 0; i < kAutosarBytes.size(); ++i)
      EXPECT_EQ(crc_of(algorithm.crc, kAutosarBytes[i]), algorithm.autosar[i]) << i;
  }
}

// The examples of AUTOSAR FO PRS E2EProtocol: frames of zeros.

TEST(E2eProfile1, GivesThePublishedExamples) {
  const Message m =
      message(8, {whole_bytes("Crc", 0, 1, ByteOrder::Intel), low_nibble("Counter", 1)}, "0x123");
  const auto both = build(m, Checksum::E2e1a);
  ASSERT_TRUE(both) << error_of(both);
  EXPECT_THAT(protect(*both, 8, 0), ElementsAre(0xCC, 0, 0, 0, 0, 0, 0, 0));
  EXPECT_THAT(protect(*both, 8, 1), ElementsAre(0x91, 1, 0, 0, 0, 0, 0, 0));
  const auto nibble = build(m, Checksum::E2e1c);
  ASSERT_TRUE(nibble) << error_of(nibble);
  EXPECT_THAT(protect(*nibble, 8, 0), ElementsAre(0x2A, 0x10, 0, 0, 0, 0, 0, 0));
  EXPECT_THAT(protect(*nibble, 8, 1), ElementsAre(0x77, 0x11, 0, 0, 0, 0, 0, 0));
}

TEST(E2eProfile1, CountsToFourteenAndTakesNoFifteen) {
  const Message m =
      message(8, {whole_bytes("Crc", 0, 1, ByteOrder::Intel), low_nibble("Counter", 1)}, "0x123");
  const auto protection = build(m, Checksum::E2e1a);
  ASSERT_TRUE(protection);
  EXPECT_EQ(protection->counter_values(), 15U);
  Frame frame{0x100, 8, {}};
  protection->protect(frame, 15);
  EXPECT_FALSE(protection->matches(frame));
}

TEST(E2eProfile1, AlternatesBetweenTheBytesOfTheDataId) {
  const auto with = [](const std::string& id) {
    const auto built =
        build(message(8, {whole_bytes("Crc", 0, 1, ByteOrder::Intel), low_nibble("Counter", 1)}, id),
              Checksum::E2e1b);
    EXPECT_TRUE(built);
    return *built;
  };
  const FrameProtection one = with("0x123"), other_high = with("0x223"), other_low = with("0x124");
  EXPECT_EQ(protect(one, 8, 2), protect(other_high, 8, 2));
  EXPECT_NE(protect(one, 8, 3), protect(other_high, 8, 3));
  EXPECT_NE(protect(one, 8, 2), protect(other_low, 8, 2));
  EXPECT_EQ(protect(one, 8, 3), protect(other_low, 8, 3));
}

TEST(E2eProfile2, GivesThePublishedExamples) {
  Message m = message(8, {whole_bytes("Crc", 0, 1, ByteOrder::Intel), low_nibble("Counter", 1)});
  m.attributes["E2EDataIdList"] = "1, 2, 3, 4, 5, 6, 7, 8, 9, 0x0A, 11, 12, 13, 14, 15, 16";
  const auto protection = build(m, Checksum::E2e2);
  ASSERT_TRUE(protection) << error_of(protection);
  const Bytes crc{0x1B, 0x98, 0x31, 0x0D, 0x18, 0x9B, 0x65, 0x08,
                  0x1D, 0x9E, 0x37, 0x0B, 0x1E, 0x9D, 0xCD, 0x0E};
  for (std::uint32_t i = 0; i < crc.size(); ++i) {
    const std::uint8_t counter = (i + 1) % 16;
    EXPECT_THAT(protect(*protection, 8, counter), ElementsAre(crc[i], counter, 0, 0, 0, 0, 0, 0));
  }
}

TEST(E2eProfile4, GivesThePublishedExample) {
  const Message m = message(
      16, {whole_bytes("Crc", 8, 4, ByteOrder::Motorola), whole_bytes("Counter", 2, 2, ByteOrder::Motorola)},
      "0x0a0b0c0d");
  const auto protection = build(m, Checksum::E2e4);
  ASSERT_TRUE(protection) << error_of(protection);
  EXPECT_THAT(protect(*protection, 16, 0), ElementsAre(0x00, 0x10, 0x00, 0x00, 0x0A, 0x0B, 0x0C, 0x0D, 0x86,
                                                       0x2B, 0x05, 0x56, 0, 0, 0, 0));
}

TEST(E2eProfile5, GivesThePublishedExample) {
  const Message m =
      message(8, {whole_bytes("Crc", 0, 2, ByteOrder::Intel), whole_bytes("Counter", 2, 1, ByteOrder::Intel)},
              "0x1234");
  const auto protection = build(m, Checksum::E2e5);
  ASSERT_TRUE(protection) << error_of(protection);
  EXPECT_THAT(protect(*protection, 8, 0), ElementsAre(0x1C, 0xCA, 0, 0, 0, 0, 0, 0));
}

TEST(E2eProfile7, GivesThePublishedExample) {
  const Message m = message(
      24, {whole_bytes("Crc", 0, 8, ByteOrder::Motorola), whole_bytes("Counter", 12, 4, ByteOrder::Motorola)},
      "0x0a0b0c0d");
  const auto protection = build(m, Checksum::E2e7);
  ASSERT_TRUE(protection) << error_of(protection);
  EXPECT_THAT(protect(*protection, 24, 0),
              ElementsAre(0x1F, 0xB2, 0xE7, 0x37, 0xFC, 0xED, 0xBC, 0xD9, 0, 0, 0, 0x18, 0, 0, 0, 0, 0x0A,
                          0x0B, 0x0C, 0x0D, 0, 0, 0, 0));
}

TEST(Protection, EverySingleBitErrorShowsWithEveryChecksum) {
  const Message small = [] {
    Message m = message(8, {whole_bytes("Crc", 0, 1, ByteOrder::Intel), low_nibble("Counter", 1)}, "291");
    m.attributes["E2EDataIdList"] = "1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16";
    return m;
  }();
  const std::vector<std::pair<Checksum, Message>> cases{
      {Checksum::SaeJ1850, small},
      {Checksum::E2e1a, small},
      {Checksum::E2e1b, small},
      {Checksum::E2e1c, small},
      {Checksum::E2e2, small},
      {Checksum::Xor, small},
      {Checksum::Crc, small},
      {Checksum::E2e4, message(32, {whole_bytes("Crc", 12, 4, ByteOrder::Motorola),
                                    whole_bytes("Counter", 6, 2, ByteOrder::Motorola)})},
      {Checksum::E2e5, message(64, {whole_bytes("Crc", 3, 2, ByteOrder::Intel),
                                    whole_bytes("Counter", 5, 1, ByteOrder::Intel)})},
      {Checksum::E2e7, message(48, {whole_bytes("Crc", 9, 8, ByteOrder::Motorola),
                                    whole_bytes("Counter", 21, 4, ByteOrder::Motorola)})}};
  std::mt19937_64 random{7};
  for (const auto& [checksum, m] : cases) {
    SCOPED_TRACE(kChecksumNames[static_cast<std::size_t>(checksum)]);
    const auto protection = build(m, checksum);
    ASSERT_TRUE(protection) << error_of(protection);
    Frame good{0x100, static_cast<std::uint8_t>(m.size_bytes), {}};
    for (std::size_t i = 0; i < good.size; ++i) good.data[i] = static_cast<std::uint8_t>(random());
    protection->protect(good, 9);
    ASSERT_TRUE(protection->matches(good));
    EXPECT_EQ(protection->counter_of(good), 9U);
    for (std::size_t bit = 0; bit < 8 * m.size_bytes; ++bit) {
      Frame bad = good;
      bad.data[bit / 8] ^= static_cast<std::uint8_t>(1U << (bit % 8));
      EXPECT_FALSE(protection->matches(bad)) << bit;
    }
    Frame spoiled = good;
    protection->spoil(spoiled);
    EXPECT_FALSE(protection->matches(spoiled));
  }
}

TEST(Protection, MayBeNone) {
  const Message m = message(8, {});
  const auto protection = FrameProtection::build(m, "", "", of(Checksum::None), "message M of x.dbc");
  ASSERT_TRUE(protection) << error_of(protection);
  EXPECT_FALSE(protection->has_counter());
  EXPECT_FALSE(protection->has_checksum());
  EXPECT_EQ(protect(*protection, 8, 5), Bytes(8, 0));
}

TEST(Protection, ErrorsSayWhatTheFrameNeeds) {
  const Message plain = message(8, {whole_bytes("Crc", 0, 1, ByteOrder::Intel), low_nibble("Counter", 1)});
  EXPECT_THAT(error_of(build(message(8, {}), Checksum::SaeJ1850)),
              HasSubstr("message M of x.dbc needs a checksum Crc: 8 bits that fill whole bytes"));
  EXPECT_THAT(error_of(build(plain, Checksum::E2e5)),
              HasSubstr("16 bits that fill whole bytes, least significant"));
  EXPECT_THAT(error_of(build(plain, Checksum::E2e2)),
              HasSubstr("E2EDataIdList, \"1,2,...\"; it is not there"));
  Message list = plain;
  list.attributes["E2EDataIdList"] = "1,2,300";
  EXPECT_THAT(error_of(build(list, Checksum::E2e2)), HasSubstr("it is '1,2,300'"));
  Message id = plain;
  id.attributes["E2EDataId"] = "65536";
  EXPECT_THAT(error_of(build(id, Checksum::SaeJ1850)),
              HasSubstr("E2EDataId is '65536'; expected 0 to 65535"));
  const Message misplaced = message(
      16, {whole_bytes("Crc", 8, 4, ByteOrder::Motorola), whole_bytes("Counter", 4, 2, ByteOrder::Motorola)});
  EXPECT_THAT(error_of(build(misplaced, Checksum::E2e4)), HasSubstr("has its counter at byte 2"));
  const Message narrow = message(
      16, {whole_bytes("Crc", 4, 4, ByteOrder::Motorola), whole_bytes("Counter", 2, 2, ByteOrder::Motorola)});
  EXPECT_THAT(error_of(build(narrow, Checksum::E2e4)), HasSubstr("do not fit around its checksum"));
  EXPECT_THAT(error_of(FrameProtection::build(plain, "", "Crc", of(Checksum::E2e1a), "message M of x.dbc")),
              HasSubstr("needs an alive counter : 4 bits"));
}

}  // namespace
}  // namespace clampd::can
