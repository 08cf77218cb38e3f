// What leaves the archive, read back by readers that know the formats and not the writers.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/csv.hpp"
#include "clampd/archive/dfq.hpp"
#include "support/check_records.hpp"

namespace clampd {
namespace {

using support::make_check_record;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

/// A small AQDEF reader by the definition of the K-fields: "Knnnn[/index] text". A characteristic's first
/// K0001 after another one of its own begins a new value set; index 0 stands for all characteristics.
struct DfqFile {
  struct Value {
    double value = 0.0;
    std::map<std::string, std::string> more;  ///< K0002, K0004, ...
  };
  std::map<std::string, std::string> part;                            ///< K1xxx, K0100
  std::map<int, std::map<std::string, std::string>> characteristics;  ///< K2xxx
  std::map<int, std::vector<Value>> values;
};

DfqFile read_dfq(const std::string& text) {
  DfqFile file;
  std::size_t at = 0;
  while (at < text.size()) {
    const std::size_t end = text.find("\r\n", at);
    if (end == std::string::npos) {
      ADD_FAILURE() << "a line without CR LF at its end";
      break;
    }
    const std::string line = text.substr(at, end - at);
    at = end + 2;
    EXPECT_THAT(line, Not(HasSubstr("\n")));
    if (line.size() < 7 || line[0] != 'K') {
      ADD_FAILURE() << "no K-field: " << line;
      continue;
    }
    const std::string key = line.substr(0, 5);
    const std::size_t blank = line.find(' ');
    const int index = line[5] == '/' ? std::stoi(line.substr(6, blank - 6)) : -1;
    const std::string content = line.substr(blank + 1);
    EXPECT_FALSE(content.empty()) << line;
    if (key == "K0100" || key[1] == '1') {
      file.part[key] = content;
    } else if (key[1] == '2') {
      file.characteristics[index][key] = content;
    } else if (key == "K0001") {
      file.values[index].push_back({std::stod(content), {}});
    } else if (key[1] == '0') {
      for (auto& [characteristic, values] : file.values)
        if (index == 0 || index == characteristic) values.back().more[key] = content;
    } else {
      ADD_FAILURE() << "unexpected field " << line;
    }
  }
  return file;
}

CheckRecord numbered(int number) {
  char id[64];
  std::snprintf(id, sizeof id, "20261120T08%02d00000Z-%08x", number, static_cast<unsigned>(number));
  CheckRecord record = make_check_record(id);
  char started[64];
  std::snprintf(started, sizeof started, "2026-11-20T08:%02d:30.500Z", number);
  record.started = started;
  record.serial = "EMB-" + std::to_string(100 + number);
  record.verdict = Verdict::Pass;
  record.operator_name = number % 2 == 0 ? "Jo Müller" : "Łukasz";
  for (ParameterRecord& parameter : record.parameters) parameter.value *= 1.0 + 0.001 * number;
  return record;
}

std::vector<CheckRecord> fifty_checks() {
  std::vector<CheckRecord> checks;
  for (int i = 49; i >= 0; --i) checks.push_back(numbered(i));  // newest first, as the store lists them
  return checks;
}

TEST(Dfq, FiftyChecksReadBackByAnotherReader) {
  std::vector<CheckRecord> checks = fifty_checks();
  CheckRecord& failed = checks[49 - 7];
  failed.verdict = Verdict::Error;
  failed.parameters.clear();
  const auto text = format_dfq(checks, {{"k1", -0.354}, {"k2", 35.2}});
  ASSERT_TRUE(text) << text.error().message;
  const DfqFile file = read_dfq(*text);

  EXPECT_EQ(file.part.at("K0100"), "7");
  EXPECT_EQ(file.part.at("K1001"), "P-17");
  EXPECT_EQ(file.part.at("K1081"), "line 3");
  EXPECT_THAT(file.part.at("K1900"), HasSubstr("K0008 operator: 1 = Jo M\xfcller, 2 = ?ukasz;"));
  EXPECT_THAT(file.part.at("K1900"), HasSubstr("all brakes simulated"));
  ASSERT_EQ(file.characteristics.size(), 7u);
  const auto& k2 = file.characteristics.at(2);
  EXPECT_EQ(k2.at("K2001"), "2");
  EXPECT_EQ(k2.at("K2002"), "k2");
  EXPECT_EQ(k2.at("K2142"), "N/rad^2");
  EXPECT_DOUBLE_EQ(std::stod(k2.at("K2101")), 35.2);
  EXPECT_DOUBLE_EQ(std::stod(k2.at("K2110")), 29.92);
  EXPECT_DOUBLE_EQ(std::stod(k2.at("K2111")), 40.48);
  EXPECT_EQ(file.characteristics.at(3).count("K2101"), 0u) << "no nominal value was given";

  for (int i = 1; i <= 7; ++i) {
    const auto& values = file.values.at(i);
    ASSERT_EQ(values.size(), 50u);
    for (int k = 0; k < 50; ++k) {  // the oldest first
      const CheckRecord& check = checks[static_cast<std::size_t>(49 - k)];
      const DfqFile::Value& value = values[static_cast<std::size_t>(k)];
      EXPECT_EQ(value.more.at("K0014"), check.serial);
      char expected[32];
      std::snprintf(expected, sizeof expected, "20.11.2026/08:%02d:30", k);
      EXPECT_EQ(value.more.at("K0004"), expected);
      EXPECT_EQ(value.more.at("K0006"), "B-3");
      EXPECT_EQ(value.more.at("K0008"), k % 2 == 0 ? "1" : "2");
      EXPECT_EQ(value.more.at("K0010"), "1");
      if (k == 7) {
        EXPECT_EQ(value.more.at("K0002"), "255") << "an ERROR says nothing about the brake";
        EXPECT_THAT(value.more.at("K0009"), HasSubstr("ERROR"));
      } else {
        EXPECT_EQ(value.more.at("K0002"), "0");
        const double measured = check.parameters[static_cast<std::size_t>(i - 1)].value;
        EXPECT_NEAR(value.value, measured, 1e-8 * std::abs(measured));
      }
    }
  }
}

TEST(Dfq, ValuesOfAnInvalidCheckAreNotValuesOfTheBrake) {
  CheckRecord check = numbered(1);
  check.verdict = Verdict::Error;  // identified, but not tracked
  const DfqFile file = read_dfq(*format_dfq({numbered(0), check}, {}));
  EXPECT_EQ(file.values.at(1)[0].more.at("K0002"), "0");
  EXPECT_EQ(file.values.at(1)[1].more.at("K0002"), "255");
}

TEST(Dfq, TheSheetsCharacteristicsFollowTheParameters) {
  CheckRecord check = numbered(0);
  check.sheet = support::make_sheet_record();
  const DfqFile file = read_dfq(*format_dfq({check}, {}));
  EXPECT_EQ(file.part.at("K0100"), "12");
  ASSERT_EQ(file.characteristics.size(), 12u);
  const auto& time = file.characteristics.at(8);
  EXPECT_EQ(time.at("K2002"), "apply-time at force_N 20000, share 0.9");
  EXPECT_EQ(time.at("K2142"), "s");
  EXPECT_EQ(time.count("K2110"), 0u) << "it has no lower limit";
  EXPECT_DOUBLE_EQ(std::stod(time.at("K2111")), 0.14);
  EXPECT_EQ(time.at("K2022"), "6") << "a tenth of 47 microseconds";
  EXPECT_DOUBLE_EQ(file.values.at(8)[0].value, 0.1523);
  EXPECT_EQ(file.values.at(8)[0].more.at("K0002"), "0");
  EXPECT_EQ(file.values.at(12)[0].more.at("K0002"), "255") << "it is not known";
  EXPECT_FALSE(format_dfq({check, numbered(1)}, {})) << "the other was asked for less";
}

TEST(Dfq, RefusesUnlikeChecks) {
  CheckRecord other = numbered(1);
  other.part_number = "P-18";
  EXPECT_THAT(format_dfq({numbered(0), other}, {}).error().message, HasSubstr("'P-17' and 'P-18'"));
  other = numbered(1);
  other.parameters[3].upper *= 1.1;
  EXPECT_THAT(format_dfq({numbered(0), other}, {}).error().message,
              HasSubstr("different parameters or limits"));
  other = numbered(1);
  other.parameters.pop_back();
  EXPECT_FALSE(format_dfq({numbered(0), other}, {}));
  EXPECT_FALSE(format_dfq({}, {}));
}

TEST(Dfq, NamesOfManyOperatorsAreNotCutOff) {
  std::vector<CheckRecord> checks;
  for (int i = 0; i < 30; ++i) {
    checks.push_back(numbered(i));
    checks.back().operator_name = "operator number " + std::to_string(i);
  }
  const std::string text = *format_dfq(checks, {});
  EXPECT_THAT(text, HasSubstr("K1900 K0004 is UTC; K0009 names what K0008"));
  const DfqFile file = read_dfq(text);
  for (const auto& value : file.values.at(1)) {
    const std::string number = std::to_string(std::stoi(value.more.at("K0008")) - 1);
    EXPECT_THAT(value.more.at("K0009"), HasSubstr("operator number " + number + ";"));
  }
}

TEST(Dfq, ValuesOfAVoidCheckDoNotCount) {
  CheckRecord check = numbered(0);
  check.voided = VoidRecord{"the wrong brake", "ada", ""};
  const DfqFile file = read_dfq(*format_dfq({check}, {}));
  EXPECT_EQ(file.values.at(1)[0].more.at("K0002"), "255");
  EXPECT_THAT(file.values.at(1)[0].more.at("K0009"), HasSubstr("VOID"));
}

TEST(Dfq, NoTextBreaksALine) {
  CheckRecord check = numbered(0);
  check.serial = "A\r\nK0001/1 999";
  check.batch = std::string("B\x0f\x14") + "1";
  const DfqFile file = read_dfq(*format_dfq({check}, {}));
  EXPECT_EQ(file.values.at(1).size(), 1u);
  EXPECT_EQ(file.values.at(1)[0].more.at("K0014"), "A  K0001/1 999");
  EXPECT_EQ(file.values.at(1)[0].more.at("K0006"), "B  1");
}

/// RFC 4180.
std::vector<std::vector<std::string>> read_csv(const std::string& text) {
  std::vector<std::vector<std::string>> rows(1, std::vector<std::string>(1));
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    std::string& field = rows.back().back();
    if (quoted) {
      if (text[i] != '"')
        field += text[i];
      else if (i + 1 < text.size() && text[i + 1] == '"')
        field += text[i++];
      else
        quoted = false;
    } else if (text[i] == '"') {
      quoted = true;
    } else if (text[i] == ',') {
      rows.back().emplace_back();
    } else if (text.compare(i, 2, "\r\n") == 0) {
      ++i;
      rows.emplace_back(1);
    } else {
      field += text[i];
    }
  }
  rows.pop_back();  // after the last line break
  return rows;
}

TEST(Csv, OneRowACheckWithEveryParameter) {
  CheckRecord plain = numbered(0);
  plain.reason = "a, \"b\"\nand c";
  CheckRecord extended = numbered(1);
  extended.serial = "=HYPERLINK(\"x\")";
  extended.parameters.push_back({"backlash.play", "rad", 0.2, 0.01, 0.0, 0.5, ParameterVerdict::Pass});
  const auto rows = read_csv(format_csv({plain, extended}));
  ASSERT_EQ(rows.size(), 3u);
  ASSERT_EQ(rows[1].size(), rows[0].size());
  ASSERT_EQ(rows[2].size(), rows[0].size());
  const auto column = [&](const std::string& name) {
    const auto found = std::find(rows[0].begin(), rows[0].end(), name);
    EXPECT_NE(found, rows[0].end()) << name;
    return static_cast<std::size_t>(found - rows[0].begin());
  };
  EXPECT_EQ(rows[1][column("reason")], plain.reason);
  EXPECT_EQ(rows[2][column("serial")], "'=HYPERLINK(\"x\")") << "no spreadsheet runs it";
  EXPECT_DOUBLE_EQ(std::stod(rows[1][column("k2 [N/rad^2]")]), plain.parameters[1].value);
  EXPECT_DOUBLE_EQ(std::stod(rows[2][column("k2 upper [N/rad^2]")]), 40.48);
  EXPECT_EQ(rows[1][column("backlash.play [rad]")], "");
  EXPECT_DOUBLE_EQ(std::stod(rows[2][column("backlash.play [rad]")]), 0.2);
  EXPECT_EQ(rows[2][column("k2 verdict")], "fail");
}

TEST(Csv, HasTheSheetsCharacteristicsToo) {
  CheckRecord asked = numbered(1);
  asked.recipe = RecipeRecord{"r.toml", "=3", std::string(64, 'd')};
  asked.sheet = support::make_sheet_record();
  const auto rows = read_csv(format_csv({numbered(0), asked}));
  const auto cell = [&](std::size_t row, const std::string& name) {
    const auto found = std::find(rows[0].begin(), rows[0].end(), name);
    EXPECT_NE(found, rows[0].end()) << name;
    return rows[row].at(static_cast<std::size_t>(found - rows[0].begin()));
  };
  EXPECT_EQ(cell(2, "sheet stiffness, 20 kN [N/rad]"), "951.25");
  EXPECT_EQ(cell(2, "sheet stiffness, 20 kN verdict"), "pass");
  EXPECT_EQ(cell(2, "sheet drag upper [N m]"), "") << "it has none";
  EXPECT_EQ(cell(2, "sheet holding [N m]"), "");
  EXPECT_EQ(cell(2, "sheet holding verdict"), "");
  EXPECT_EQ(cell(2, "sheet to 27 kN verdict"), "fail");
  EXPECT_EQ(cell(1, "sheet stiffness, 20 kN [N/rad]"), "");
  EXPECT_EQ(cell(2, "recipe_version"), "'=3") << "no spreadsheet runs it";
  EXPECT_EQ(cell(2, "recipe_sha256"), std::string(64, 'd'));
  EXPECT_EQ(cell(1, "recipe_version"), "");
}

TEST(Csv, NoFormulaBeginsAtASemicolonEither) {
  CheckRecord check = numbered(0);
  check.serial = "SN;=HYPERLINK(1)";
  check.batch = ";@x";
  check.operator_name = "A; B;-1";
  check.voided = VoidRecord{"=1", "", ""};
  const std::string text = format_csv({check});
  for (const char* cell : {"\"SN;'=HYPERLINK(1)\"", "\";'@x\"", "\"A; B;'-1\"", ",'=1,"})
    EXPECT_THAT(text, HasSubstr(cell));
}

}  // namespace
}  // namespace clampd
