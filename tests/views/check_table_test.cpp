#include "clampd/views/check_table.hpp"

#include <algorithm>
#include <sstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/check_records.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

std::size_t widest_line(const std::string& text) {
  std::istringstream lines(text);
  std::size_t widest = 0;
  for (std::string line; std::getline(lines, line);)
    widest = std::max(widest, static_cast<std::size_t>(std::count_if(line.begin(), line.end(), [](char c) {
                        return (static_cast<unsigned char>(c) & 0xc0) != 0x80;
                      })));
  return widest;
}

TEST(FormatCheck, SaysWhatATechnicianAsks) {
  const std::string text = format_check(support::make_check_record(), false);
  SCOPED_TRACE(text);
  for (const char* wanted :
       {"EMB-0042", "=====  FAIL  =====", "k2 is 24.64 N/rad^2, below its lower limit", "SIMULATED BRAKE",
        "operator Jo", "o|-----------|", "± 0.1", "17.4 s on the bench",
        "17432 ticks, 1 skipped, 2 samples lost", "max 28 µs", "bus load 40 %",
        "212 N rms over 2 of 2 repeats", "revision 1", "20261120T234107123Z-9f3a61c2"})
    EXPECT_THAT(text, HasSubstr(wanted));
  EXPECT_THAT(text, Not(HasSubstr("\033")));
  EXPECT_LE(widest_line(text), 100u);
}

TEST(FormatCheck, ShowsTheSheet) {
  CheckRecord record = support::make_check_record();
  EXPECT_THAT(format_check(record, false), Not(HasSubstr("sheet")));
  record.sheet = support::make_sheet_record();
  const std::string text = format_check(record, false);
  SCOPED_TRACE(text);
  for (const char* wanted :
       {"apply-time at force_N 20000, share 0.9", "0.1523", "± 4.7e-05", "… 0.14", "FAIL", "800 … 1500",
        "0 …", "not reached", "this brake does not get there", "not known",
        "it needs mus, which these runs do not determine",
        "The model does not explain all of this brake's motion", "Sheet     revision 4 (configs/sheet.toml)"})
    EXPECT_THAT(text, HasSubstr(wanted));
  EXPECT_LE(widest_line(text), 100u);
}

TEST(FormatCheck, TheParametersOfEffectsFitIn) {
  CheckRecord record = support::make_check_record();
  record.parameters.push_back(
      {"stiffness-hysteresis.travel", "rad", 0.52, 0.01, 0.0, 0.3, ParameterVerdict::Fail});
  const std::string text = format_check(record, false);
  EXPECT_THAT(text, HasSubstr("stiffness-hysteresis.travel"));
  EXPECT_THAT(text, HasSubstr("0.52"));
  EXPECT_LE(widest_line(text), 100u);
}

TEST(FormatCheck, ColoursOnlyWhenAsked) {
  EXPECT_THAT(format_check(support::make_check_record(), true), HasSubstr("\033[1;97;41m"));
}

TEST(FormatCheck, AnErrorWithoutRunsIsShortAndStillWhole) {
  CheckRecord record;
  record.serial = "X";
  record.reason =
      "No feedback from the brake: is it powered, is the cable plugged in, and does the bit rate of the "
      "interface match that of the brake?";
  record.id = "id";
  const std::string text = format_check(record, false);
  SCOPED_TRACE(text);
  EXPECT_THAT(text, HasSubstr("=====  ERROR  ====="));
  EXPECT_THAT(text, Not(HasSubstr("lower")));
  EXPECT_THAT(text, Not(HasSubstr("nan")));
  EXPECT_LE(widest_line(text), 100u);
}

TEST(FormatCheck, AMarginalVerdictSaysSo) {
  CheckRecord record = support::make_check_record();
  record.verdict = Verdict::Pass;
  record.marginal = true;
  EXPECT_THAT(format_check(record, false), HasSubstr("=====  PASS (marginal)  ====="));
}

TEST(FormatChecks, OneLineEach) {
  CheckSummary check;
  check.id = "20261120T234107123Z-9f3a61c2";
  check.serial = "a serial number that is too long for its column, in übergröße";
  check.verdict = Verdict::Fail;
  check.marginal = true;
  check.reason = "k2 is 24.64 N/rad^2, below its lower limit 29.92 N/rad^2.";
  const std::string text = format_checks({check, check}, false);
  SCOPED_TRACE(text);
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 3);
  EXPECT_THAT(text, HasSubstr("FAIL (marginal)"));
  EXPECT_LE(widest_line(text), 100u);
  EXPECT_EQ(format_checks({}, false), "No checks.\n");
}

TEST(FormatChecks, NeverCutsACharacterInTwo) {
  CheckSummary check;
  for (std::size_t i = 0; i < 40; ++i) {
    check.serial = std::string(i, 'x') + std::string("ßßßßßßßßßßßßßßßßßßßß");
    const std::string text = format_checks({check}, false);
    for (std::size_t k = 0; k < text.size(); ++k) {
      const bool leads = static_cast<unsigned char>(text[k]) >= 0xc0;
      EXPECT_TRUE(!leads || (static_cast<unsigned char>(text[k + 1]) & 0xc0) == 0x80) << text;
    }
  }
}

}  // namespace
}  // namespace clampd
