#include "clampd/sheet/sheet.hpp"

#include <cmath>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/record/checksum.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

const std::string kGood = R"(revision = "3"
author = "QA"
changed = 2026-11-25
[[characteristic]]
kind = "apply-time"
unit = "s"
force_N = 20000
share = 0.9
clearance_rad = 6
upper = 0.15
[[characteristic]]
name = "holds"
kind = "holding-margin"
unit = "N m"
force_N = 20000
lower = 0
)";

std::string refusal(const std::string& from, const std::string& to) {
  std::string text = kGood;
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  const Result<Sheet> sheet = parse_sheet(text.replace(at, from.size(), to), "sheet.toml");
  EXPECT_FALSE(sheet) << to;
  return sheet ? "" : sheet.error().message;
}

TEST(SheetFile, SaysWhatTheLineAsksFor) {
  const Result<Sheet> sheet = parse_sheet(kGood, "sheet.toml");
  ASSERT_TRUE(sheet) << sheet.error().message;
  EXPECT_EQ(sheet->revision, "3");
  EXPECT_EQ(sheet->changed, "2026-11-25");
  EXPECT_EQ(sheet->sha256, sha256_hex(kGood));
  ASSERT_EQ(sheet->characteristics.size(), 2u);
  const Characteristic& time = sheet->characteristics[0];
  EXPECT_EQ(time.name, "apply-time at force_N 20000, share 0.9, clearance_rad 6");
  EXPECT_EQ(circumstances_text(time),
            "force_N 20000, share 0.9, clearance_rad 6, torque_limit_Nm 3, speed_limit_rad_s 270");
  EXPECT_EQ(time.kind->unit, "s");
  EXPECT_EQ(time.circumstances.force_N, 20e3);
  EXPECT_EQ(time.circumstances.share, 0.9);
  EXPECT_EQ(time.circumstances.torque_limit_Nm, 3.0);
  EXPECT_EQ(time.upper, 0.15);
  EXPECT_TRUE(std::isinf(time.lower) && time.has_limits());
  EXPECT_EQ(sheet->characteristics[1].name, "holds");
  EXPECT_EQ(sheet->characteristics[1].lower, 0.0);
}

/// As a check without results records it.
SheetRecord recorded(const Sheet& sheet) {
  SheetRecord record{sheet.file, sheet.revision, sheet.sha256, false, {}};
  for (const Characteristic& line : sheet.characteristics) {
    CharacteristicRecord& kept = record.characteristics.emplace_back();
    kept.name = line.name;
    kept.kind = line.kind->name;
    kept.unit = line.kind->unit;
    kept.circumstances = circumstances_text(line);
    kept.lower = line.lower;
    kept.upper = line.upper;
  }
  return record;
}

TEST(SheetFile, IsReadBackFromWhatARecordSaysOfIt) {
  std::string text = kGood;
  text.replace(text.find("20000"), 5, "20000.0625");
  text.replace(text.find("0.9"), 3, "0.8123456789");
  const Result<Sheet> sheet = parse_sheet(text, "sheet.toml");
  ASSERT_TRUE(sheet) << sheet.error().message;
  SheetRecord record = recorded(*sheet);
  const Result<Sheet> read = sheet_of(record);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->sha256, sheet->sha256);
  ASSERT_EQ(read->characteristics.size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) {
    const Characteristic &line = read->characteristics[i], &original = sheet->characteristics[i];
    EXPECT_EQ(line.name, original.name);
    EXPECT_EQ(line.kind, original.kind);
    EXPECT_EQ(line.lower, original.lower);
    EXPECT_EQ(line.upper, original.upper);
    for (const CircumstanceInfo& info : line.kind->circumstances)
      EXPECT_EQ(line.circumstances.*info.member, original.circumstances.*info.member) << info.key;
  }

  const auto refused = [&](std::string CharacteristicRecord::*member, const std::string& value) {
    SheetRecord changed = record;
    changed.characteristics[1].*member = value;
    const Result<Sheet> refusal = sheet_of(changed);
    return refusal ? std::string("none") : refusal.error().message;
  };
  EXPECT_THAT(refused(&CharacteristicRecord::kind, "levitation"), HasSubstr("line holds of the sheet: this version knows no kind levitation"));
  EXPECT_THAT(refused(&CharacteristicRecord::unit, "mN m"), HasSubstr("knows no kind holding-margin in mN m"));
  for (const char* odd : {"", "force_N", "force_N x", "force_N 20000, share 0.9", "force_N 2e9", "force_N 20000 N"})
    EXPECT_THAT(refused(&CharacteristicRecord::circumstances, odd), HasSubstr("are not those of a holding-margin")) << odd;
}

TEST(SheetFile, ContactPointAndClearanceHaveNoCircumstances) {
  const std::string lines = R"(revision = "1"
[[characteristic]]
kind = "contact-point"
unit = "rad"
lower = 9998.5
[[characteristic]]
kind = "clearance"
unit = "rad"
lower = 4
upper = 8
)";
  const Result<Sheet> sheet = parse_sheet(lines, "sheet.toml");
  ASSERT_TRUE(sheet) << sheet.error().message;
  EXPECT_EQ(sheet->characteristics[0].name, "contact-point");
  EXPECT_EQ(sheet->characteristics[1].name, "clearance");
  SheetRecord record = recorded(*sheet);
  for (const CharacteristicRecord& line : record.characteristics) EXPECT_EQ(line.circumstances, "");
  ASSERT_TRUE(sheet_of(record));
  record.characteristics[1].circumstances = "force_N 20000";
  EXPECT_THAT(sheet_of(record).error().message, HasSubstr("are not those of a clearance"));

  const auto refused = [&](const std::string& from, const std::string& to) {
    std::string text = lines;
    const Result<Sheet> read = parse_sheet(text.replace(text.find(from), from.size(), to), "sheet.toml");
    return read ? std::string("none") : read.error().message;
  };
  EXPECT_THAT(refused("unit = \"rad\"", "unit = \"deg\""),
              HasSubstr("sheet.toml:4:8: contact-point is in rad, not in deg"));
  EXPECT_THAT(refused("lower = 4", "lower = 4\nclearance_rad = 6"),
              HasSubstr("sheet.toml:10:1: unknown key clearance_rad"));
  EXPECT_THAT(refused("lower = 4", "lower = 4\nforce_N = 20000"), HasSubstr("unknown key force_N"));
  EXPECT_THAT(refused("upper = 8", "upper = 8000"), HasSubstr("upper = 8000 rad cannot be meant"));
}

TEST(SheetFile, TheShippedOneIsValid) {
  const Result<Sheet> sheet = read_sheet(std::string(CLAMPD_SOURCE_DIR) + "/configs/sheet.toml");
  ASSERT_TRUE(sheet) << sheet.error().message;
  for (const CharacteristicKind& kind : characteristic_kinds())
    EXPECT_TRUE(std::any_of(sheet->characteristics.begin(), sheet->characteristics.end(),
                            [&](const Characteristic& line) { return line.kind == &kind; }))
        << kind.name << " has no example";
}

TEST(SheetFile, RefusesWhatCannotBeMeantAndSaysWhere) {
  EXPECT_THAT(refusal("upper = 0.15", "uper = 0.15"), HasSubstr("sheet.toml:10:1: unknown key uper"));
  EXPECT_THAT(refusal("upper = 0.15", "uper = 0.15"), HasSubstr("did you mean upper?"));
  EXPECT_THAT(refusal("share = 0.9", "share = 90"),
              HasSubstr("sheet.toml:8:9: characteristic.share = 90 is outside"));
  EXPECT_THAT(refusal("force_N = 20000", "force_N = 20"),
              HasSubstr("characteristic.force_N = 20 is outside of 500"));
  EXPECT_THAT(refusal("share = 0.9", ""), HasSubstr("apply-time needs share"));
  EXPECT_THAT(refusal("share = 0.9", "share = 0.9\nspeed_rad_s = 5"), HasSubstr("unknown key speed_rad_s"));
  EXPECT_THAT(refusal("\"apply-time\"", "\"aply-time\""),
              HasSubstr("sheet.toml:5:8: unknown kind aply-time; known are apply-time"));
  EXPECT_THAT(refusal("kind = \"apply-time\"", ""),
              HasSubstr("sheet.toml:4:1: a characteristic needs a kind"));
  EXPECT_THAT(refusal("unit = \"s\"", "unit = \"ms\""),
              HasSubstr("sheet.toml:6:8: apply-time is in s, not in ms: convert"));
  EXPECT_THAT(refusal("unit = \"s\"", ""), HasSubstr("apply-time needs unit = \"s\""));
  EXPECT_THAT(refusal("upper = 0.15", "upper = 150"),
              HasSubstr("sheet.toml:10:9: upper = 150 s cannot be meant"));
  EXPECT_THAT(refusal("upper = 0.15", "upper = 0.15\nlower = 0.2"),
              HasSubstr("lower 0.2 must be below upper 0.15"));
  EXPECT_THAT(refusal("upper = 0.15", "upper = nan"), HasSubstr("characteristic.upper = nan is outside"));
  EXPECT_THAT(refusal("upper = 0.15", "upper = \"0.15\""), HasSubstr("must be a number"));
  EXPECT_THAT(refusal("[[characteristic]]", "[characteristic]"), HasSubstr("not valid TOML"));
  EXPECT_THAT(refusal("revision = \"3\"", ""), HasSubstr("no revision"));
  EXPECT_THAT(refusal("changed = 2026-11-25", "changed = \"today\""), HasSubstr("must be a date"));
  const std::string again = kGood.substr(kGood.rfind("[[characteristic]]"));
  EXPECT_THAT(refusal("lower = 0\n", "lower = 0\n" + again),
              HasSubstr("sheet.toml:17:1: holds is there twice"));
  const Result<Sheet> empty = parse_sheet("revision = \"1\"\n", "sheet.toml");
  ASSERT_FALSE(empty);
  EXPECT_THAT(empty.error().message, HasSubstr("asks for nothing"));
  EXPECT_FALSE(read_sheet("/nowhere/sheet.toml"));
}

}  // namespace
}  // namespace clampd
