#include "drivers/can/dbc.hpp"

#include <fmt/core.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "drivers/can/log_check.hpp"
#include "support/shared_data.hpp"

namespace clampd::can {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::string error_of(std::string_view text) {
  const auto database = parse_dbc(text, "x.dbc");
  return database ? "no error" : database.error().message;
}

std::string slurp(const std::filesystem::path& path) {
  std::ifstream stream{path, std::ios::binary};
  std::stringstream content;
  content << stream.rdbuf();
  return content.str();
}

// ---- the real files
// -------------------------------------------------------------------------------------------------

std::filesystem::path real_dbc_folder() {
  return support::shared_data("data/dbc");
}

struct RealFile {
  std::string name;
  std::size_t defects;  ///< of messages: 6 overlaps, 1 and 2 ranges upside down, 32 impossible identifiers
};

class RealDbc : public ::testing::TestWithParam<RealFile> {
 protected:
  void SetUp() override {
    path_ = real_dbc_folder() / GetParam().name;
    if (!std::filesystem::exists(path_)) {
      GTEST_SKIP() << path_ << " is not there; set CLAMPD_SHARED to the folder that holds data/dbc";
    }
    text_ = slurp(path_);
  }

  std::filesystem::path path_;
  std::string text_;
};

/// Counts lines that begin (after blanks) with `keyword` and a blank.
std::size_t count_lines(const std::string& text, const std::string& keyword) {
  std::istringstream lines{text};
  std::size_t count = 0;
  for (std::string line; std::getline(lines, line);) {
    const std::size_t begin = line.find_first_not_of(" \t");
    if (begin != std::string::npos && line.compare(begin, keyword.size() + 1, keyword + " ") == 0) ++count;
  }
  return count;
}

TEST_P(RealDbc, HasAsManyMessagesAndSignalsAsLinesSaySo) {
  const auto database = read_dbc(path_.string());
  ASSERT_TRUE(database) << database.error().message;
  std::size_t signals = 0;
  std::size_t defects = 0;
  for (const Message& message : database->messages) {
    signals += message.signals.size();
    defects += message.defects.size();
  }
  EXPECT_EQ(database->messages.size(), count_lines(text_, "BO_"));
  EXPECT_EQ(signals, count_lines(text_, "SG_"));
  EXPECT_EQ(defects, GetParam().defects);
  EXPECT_EQ(database->value_tables.size(), count_lines(text_, "VAL_TABLE_"));
}

/// Frames of the file's own messages, ten of each, a millisecond apart.
FrameLog log_of(const Database& database, std::mt19937_64& random) {
  FrameLog log;
  for (int k = 0; k < 10; ++k)
    for (const Message& message : database.messages) {
      Frame frame{message.id, static_cast<std::uint8_t>(std::min(message.size_bytes, kMaxFrameBytes)), {}};
      if (frame.size > kClassicBytes) frame.format = FrameFormat::Fd;
      for (std::size_t i = 0; i < frame.size; ++i) frame.data[i] = static_cast<std::uint8_t>(random());
      log.frames.push_back({k * 1'000'000, frame});
    }
  return log;
}

void set_unit(Database& database, const std::string& place, const char* unit) {
  for (Message& message : database.messages)
    for (Signal& signal : message.signals)
      if (message.name + "." + signal.name == place) signal.unit = unit;
}

TEST_P(RealDbc, ALogIsUnderstoodOrRefusedWithTheReason) {
  const auto database = read_dbc(path_.string());
  ASSERT_TRUE(database) << database.error().message;
  std::mt19937_64 random{5};
  const FrameLog log = log_of(*database, random);
  EXPECT_EQ(identifiers(log, *database).size(), database->messages.size());
  std::vector<std::string> places;
  for (const Message& message : database->messages)
    for (const Signal& signal : message.signals) places.push_back(message.name + "." + signal.name);
  if (places.empty()) return;
  int built = 0;
  for (int trial = 0; trial < 400; ++trial) {
    Database candidate = *database;
    // Any signal, in most trials with the unit that the role wants: then more than the unit is looked at.
    const auto any = [&](const char* unit) {
      const std::string place = places[random() % places.size()];
      if (trial % 4 != 0) set_unit(candidate, place, unit);
      return place;
    };
    ProtocolMapping mapping;
    mapping.torque_command = any("Nm");
    const std::string command = mapping.torque_command.substr(0, mapping.torque_command.find('.'));
    mapping.enable = command + "." + candidate.find_message(command)->signals.back().name;
    mapping.force = any("N");
    mapping.velocity = any("rad/s");
    mapping.torque = any("Nm");
    mapping.position = any("rad");
    mapping.sample_clock = any("us");
    mapping.enabled = mapping.watchdog = mapping.fault = "";
    mapping.counter = mapping.crc = {};
    mapping.protection.checksum = Checksum::None;
    const auto codec = ProtocolCodec::build(candidate, mapping);
    if (!codec) {
      EXPECT_GT(codec.error().message.size(), 30U) << codec.error().message;
      continue;
    }
    ++built;
    const LogFinding finding = check_log(log, candidate, mapping, *codec);
    EXPECT_EQ(finding.frames.size(), 1 + codec->feedback_frames);
    for (const FrameFinding& frame : finding.frames) EXPECT_EQ(frame.seen, 10U);
  }
  RecordProperty("built", built);
}

TEST_P(RealDbc, EverySignalOfEveryMessageSurvivesARoundTrip) {
  const auto database = read_dbc(path_.string());
  ASSERT_TRUE(database) << database.error().message;
  std::mt19937_64 random{20261120};
  for (const Message& message : database->messages) {
    for (const Signal& signal : message.signals) {
      SCOPED_TRACE(fmt::format("{}.{}", message.name, signal.name));
      for (int trial = 0; trial < 4; ++trial) {
        std::vector<std::uint8_t> frame(message.size_bytes);
        for (auto& byte : frame) byte = static_cast<std::uint8_t>(random());
        const std::uint64_t raw = extract_raw(signal, frame);
        // Writing back what was read changes nothing; writing its complement changes just this signal's bits.
        std::vector<std::uint8_t> copy = frame;
        insert_raw(signal, raw, copy);
        ASSERT_EQ(copy, frame);
        insert_raw(signal, ~raw, copy);
        std::size_t changed = 0;
        for (std::size_t i = 0; i < frame.size(); ++i) {
          changed += static_cast<std::size_t>(std::popcount(static_cast<unsigned>(copy[i] ^ frame[i])));
        }
        ASSERT_EQ(changed, signal.bits);
        // Physical values: a double holds 53 bits exactly.
        if (signal.bits <= 40) {
          std::vector<std::uint8_t> again(message.size_bytes);
          encode(signal, decode(signal, frame), again);
          ASSERT_EQ(extract_raw(signal, again), raw);
        }
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(
    Vehicles, RealDbc,
    ::testing::Values(RealFile{"comma_body.dbc", 0}, RealFile{"ford_lincoln_base_pt.dbc", 0},
                      RealFile{"hyundai_i30_2014.dbc", 6}, RealFile{"rivian_primary_actuator.dbc", 1},
                      RealFile{"tesla_can.dbc", 2}, RealFile{"tesla_model3_party.dbc", 0},
                      RealFile{"toyota_2017_ref_pt.dbc", 32}),
    [](const auto& file) { return std::filesystem::path{file.param.name}.stem().string(); });

TEST(RealDbcDetails, KnowsWhatOneCanReadInTheFiles) {
  const auto folder = real_dbc_folder();
  if (!std::filesystem::exists(folder)) {
    GTEST_SKIP() << folder << " is not there; set CLAMPD_SHARED to the folder that holds data/dbc";
  }
  const auto rivian = read_dbc((folder / "rivian_primary_actuator.dbc").string());
  ASSERT_TRUE(rivian) << rivian.error().message;
  const Message* status = rivian->find_message(64U);
  ASSERT_NE(status, nullptr);
  EXPECT_EQ(status->name, "SAS_Status");
  const Signal* angle = status->find_signal("SAS_Status_AngleSafe");
  ASSERT_NE(angle, nullptr);
  // 23|15@0-: the sign is bit 7 of byte 2, the lowest bit is bit 1 of byte 3.
  const std::vector<std::uint8_t> minus_one_step{0, 0, 0xFF, 0xFE, 0, 0, 0, 0};
  EXPECT_DOUBLE_EQ(decode(*angle, minus_one_step), -0.0009765625);
  EXPECT_EQ(angle->unit, "rad");
  EXPECT_THAT(angle->receivers, SizeIs(5));

  const auto ford = read_dbc((folder / "ford_lincoln_base_pt.dbc").string());
  ASSERT_TRUE(ford) << ford.error().message;
  EXPECT_EQ(ford->find_message(2612224016U)->id & 0x1FFF'FFFFU, 2612224016U - 0x8000'0000U);
  EXPECT_EQ(ford->find_message(823U)->find_signal("DteAcceptNew_B_Rq")->values.at(1), "Yes");
}

// ---- the grammar
// ----------------------------------------------------------------------------------------------------

constexpr std::string_view kSmall = R"(VERSION "1"
BS_:
BU_: A B
BO_ 100 Small: 8 A
 SG_ Intel : 4|12@1- (0.5,-10) [-1000|1000] "N" B
 SG_ Motorola : 23|16@0+ (1,0) [0|0] "" A,B
 SG_ Real : 32|32@1- (1,0) [0|0] "m/s" B
BO_ 2147483649 Long: 8 A
 SG_ Mux M : 0|8@1+ (1,0) [0|0] "" B
 SG_ One m1 : 8|16@1+ (1,0) [0|0] "" B
 SG_ Two m2M : 8|8@1+ (1,0) [0|0] "" B
 SG_ Deep m7 : 16|8@1+ (1,0) [0|0] "" B
CM_ SG_ 100 Intel "with a \"quote\"
and a second line; BO_ 5 X";
BA_DEF_ BO_ "Cycle" INT 0 10;
BA_DEF_DEF_ "Cycle" 0;
BA_ "Cycle" BO_ 100 5;
VAL_ 100 Motorola -1 "low" 7 "seven" ;
SIG_VALTYPE_ 100 Real : 1;
SIG_GROUP_ 100 Group 1 : Intel Motorola;
SG_MUL_VAL_ 2147483649 Deep Two 7-9, 12-12;
)";

TEST(Dbc, ReadsEveryPartOfASmallFile) {
  const auto database = parse_dbc(kSmall, "small.dbc");
  ASSERT_TRUE(database) << database.error().message;
  EXPECT_EQ(database->version, "1");
  EXPECT_THAT(database->nodes, ::testing::ElementsAre("A", "B"));
  EXPECT_THAT(database->defects, IsEmpty());
  ASSERT_THAT(database->messages, SizeIs(2));

  const Message& small = database->messages[0];
  EXPECT_EQ(small.attributes.at("Cycle"), "5");
  const Signal& intel = *small.find_signal("Intel");
  EXPECT_EQ(intel.comment, "with a \"quote\"\nand a second line; BO_ 5 X");
  EXPECT_EQ(intel.type, ValueType::Signed);
  EXPECT_DOUBLE_EQ(intel.minimum, -1000.0);
  EXPECT_EQ(small.find_signal("Motorola")->values.at(-1), "low");
  EXPECT_FALSE(small.find_signal("Motorola")->has_range());
  EXPECT_EQ(small.find_signal("Real")->type, ValueType::Float32);

  // Known bytes: -3 in 12 bits from bit 4; 0x1234 big-endian in bytes 2 and 3; 1.5f little-endian.
  const std::vector<std::uint8_t> bytes{0xD0, 0xFF, 0x12, 0x34, 0x00, 0x00, 0xC0, 0x3F};
  EXPECT_DOUBLE_EQ(decode(intel, bytes), -3 * 0.5 - 10);
  EXPECT_DOUBLE_EQ(decode(*small.find_signal("Motorola"), bytes), 0x1234);
  EXPECT_DOUBLE_EQ(decode(*small.find_signal("Real"), bytes), 1.5);
  std::vector<std::uint8_t> written(8);
  encode(intel, -11.5, written);
  encode(*small.find_signal("Motorola"), 0x1234, written);
  encode(*small.find_signal("Real"), 1.5, written);
  EXPECT_EQ(written, bytes);

  const Message& extended = database->messages[1];
  EXPECT_EQ(extended.id, 0x8000'0001U);
  EXPECT_THAT(extended.defects, IsEmpty()) << "exclusive multiplexed signals may share bits";
  EXPECT_EQ(extended.find_signal("One")->multiplexor, 0U);
  const Signal& deep = *extended.find_signal("Deep");
  EXPECT_EQ(deep.multiplexor, 2U);
  EXPECT_THAT(deep.selected_by, ::testing::ElementsAre(std::pair{7U, 9U}, std::pair{12U, 12U}));
}

TEST(Dbc, EncodingSaturates) {
  const auto database = parse_dbc(kSmall, "small.dbc");
  ASSERT_TRUE(database);
  std::vector<std::uint8_t> bytes(8);
  const Signal& intel = *database->messages[0].find_signal("Intel");
  encode(intel, 1e9, bytes);
  EXPECT_DOUBLE_EQ(decode(intel, bytes), 2047 * 0.5 - 10);
  encode(intel, -1e9, bytes);
  EXPECT_DOUBLE_EQ(decode(intel, bytes), -2048 * 0.5 - 10);
  const Signal& motorola = *database->messages[0].find_signal("Motorola");
  encode(motorola, 1e9, bytes);
  EXPECT_DOUBLE_EQ(decode(motorola, bytes), 65535.0);
  encode(motorola, -5.0, bytes);
  EXPECT_DOUBLE_EQ(decode(motorola, bytes), 0.0);
}

TEST(Dbc, ErrorsNamePlaceAndExpectation) {
  EXPECT_THAT(error_of(""), HasSubstr("x.dbc:1:1: expected at least one message"));
  EXPECT_THAT(error_of("hello"), HasSubstr("x.dbc:1:1: expected a section"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n SG_ S : 0|8@1+ (1,0 [0|0] \"\" N\n"),
              HasSubstr("x.dbc:2:22: expected ')', found '['"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n SG_ S : 0|8@2+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("x.dbc:2:14: expected the byte order between 0 and 1"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n SG_ S : 0|8@1+ (0,0) [0|0] \"\" N\n"),
              HasSubstr("x.dbc:2:18: signal S has a scale"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\nBO_ 1 K: 8 N\n"),
              HasSubstr("x.dbc:2:5: message id 1 is used twice, first by M"));
  EXPECT_THAT(error_of("BO_ 1 M: 65 N\n"),
              HasSubstr("x.dbc:1:10: expected the frame's size in bytes between 0 and 64"));
  EXPECT_THAT(error_of("BO_ 1 M: 4 N\n SG_ S : 28|8@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("x.dbc:2:6: signal S (8 bits"));
  EXPECT_THAT(error_of("BO_ 1 M: 4 N\n SG_ S : 24|2@0+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("does not lie inside"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n SG_ S : 0|65@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("number of bits between 1 and 64"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n SG_ S m1 : 0|8@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("has 0 multiplexors"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n SG_ S x1 : 0|8@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("multiplexing mark"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\nCM_ \"never ends"), HasSubstr("x.dbc:2:5: this text never ends"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\nBA_DEF_ BO_ \"x\" INT 0 1"),
              HasSubstr("';' to end BA_DEF_, the file ends"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n\x01"), HasSubstr("x.dbc:2:1: byte 0x01"));
  EXPECT_THAT(error_of("BO_ 1 M: 8 N\n SG_ S : 0|8@1- (1,0) [0|0] \"\" N\nSIG_VALTYPE_ 1 S : 1;"),
              HasSubstr("cannot be a floating point number of 32 bits: it has 8"));
}

TEST(Dbc, CirclesOfMultiplexorsAreRefused) {
  EXPECT_THAT(
      error_of(
          "BO_ 1 M: 8 N\n SG_ A m1M : 0|8@1+ (1,0) [0|0] \"\" N\n SG_ B m1M : 8|8@1+ (1,0) [0|0] \"\" N\n"
          "SG_MUL_VAL_ 1 A B 1-1;\nSG_MUL_VAL_ 1 B A 1-1;\n"),
      HasSubstr("circle"));
}

TEST(Dbc, DefectsOfAMessageAreKeptWithTheirPlace) {
  const auto database = parse_dbc(
      "BO_ 1 M: 8 N\n SG_ A : 0|8@1+ (1,0) [0|0] \"\" N\n SG_ B : 7|4@0+ (1,0) [5|-5] \"\" N\n"
      " SG_ A : 8|8@1+ (1,0) [0|0] \"\" N\nBO_ 2048 K: 8 N\nVAL_ 1 C 0 \"x\";\nCM_ BO_ 9 \"y\";\n",
      "x.dbc");
  ASSERT_TRUE(database) << database.error().message;
  EXPECT_THAT(database->messages[0].defects,
              ::testing::UnorderedElementsAre(HasSubstr("x.dbc:3:6: the range of B is upside down"),
                                              HasSubstr("x.dbc:3:6: signal B overlaps signal A"),
                                              HasSubstr("x.dbc:4:6: message M has two signals A")));
  EXPECT_THAT(database->messages[1].defects,
              ::testing::ElementsAre(HasSubstr("x.dbc:5:5: message id 2048 is neither")));
  EXPECT_THAT(database->defects, ::testing::ElementsAre(HasSubstr("x.dbc:6:8: message M has no signal C"),
                                                        HasSubstr("x.dbc:7:9: there is no message 9")));
}

TEST(Dbc, MissingFileIsAnError) {
  const auto database = read_dbc("/nonexistent/brake.dbc");
  ASSERT_FALSE(database);
  EXPECT_THAT(database.error().message, HasSubstr("/nonexistent/brake.dbc"));
}

TEST(Dbc, EveryTruncationEndsWell) {
  for (std::size_t length = 0; length < kSmall.size(); ++length) {
    const auto database = parse_dbc(kSmall.substr(0, length), "x.dbc");
    if (!database) {
      EXPECT_THAT(database.error().message, HasSubstr("x.dbc:"));
    }
  }
}

TEST(Dbc, MutationsNeverCrashAndAlwaysNameThePlace) {
  std::string original = slurp(std::filesystem::path{CLAMPD_SOURCE_DIR} / "configs/brake.dbc");
  original += kSmall;
  constexpr std::string_view kBytes = "0123456789-+.:;|@()[],\"\\ \nmMeESGBO_\x80";
  std::mt19937_64 random{7};
  int refused = 0;
  for (int round = 0; round < 4000; ++round) {
    std::string text = round % 2 == 0 ? original : std::string{kSmall};
    const std::size_t edits = 1 + random() % 3;
    for (std::size_t edit = 0; edit < edits; ++edit) {
      const std::size_t at = random() % text.size();
      switch (random() % 4) {
        case 0:
          text.erase(at, 1 + random() % 8);
          break;
        case 1:
          text.insert(at, 1, kBytes[random() % kBytes.size()]);
          break;
        case 2:
          text[at] = kBytes[random() % kBytes.size()];
          break;
        default:
          text.insert(at, text.substr(random() % text.size(), random() % 40));
          break;
      }
      if (text.empty()) text = "x";
    }
    const auto database = parse_dbc(text, "x.dbc");
    if (!database) {
      ++refused;
      ASSERT_EQ(database.error().message.find("x.dbc:"), 0U) << database.error().message;
      continue;
    }
    for (const Message& message : database->messages) {
      std::vector<std::uint8_t> frame(message.size_bytes, 0xA5);
      for (const Signal& signal : message.signals) insert_raw(signal, extract_raw(signal, frame), frame);
      ASSERT_EQ(frame, std::vector<std::uint8_t>(message.size_bytes, 0xA5));
    }
  }
  EXPECT_GT(refused, 1000) << "a strict reader refuses most of them";
}

}  // namespace
}  // namespace clampd::can
