// Progress and colours as a terminal gets them, narrow and dumb ones too.

#include <algorithm>
#include <chrono>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "dashboard/pseudo_terminal.hpp"
#include "support/temporary_directory.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::screen {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;

int columns_of(const std::string& text) {
  return static_cast<int>(std::count_if(
      text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xC0U) != 0x80U; }));
}

TEST(ProgressText, LeavesTheLastColumnOfAnyTerminalFree) {
  for (int columns = 0; columns <= 120; ++columns) {
    const std::string text = cli::progress_text(0.42, "searching for the cause: Größe", 75s, columns);
    EXPECT_LE(columns_of(text), std::max(0, columns - 1)) << columns;
    if (columns > 6) {
      EXPECT_THAT(text, HasSubstr("42 %")) << columns;
    }
    // No character is cut in two: what a terminal shows of half of one is anybody's guess.
    if (!text.empty()) {
      EXPECT_NE(static_cast<unsigned char>(text.back()), 0xC3) << columns;
    }
  }
  EXPECT_THAT(cli::progress_text(0.42, "step", 75s, 80),
              AllOf(HasSubstr("step, 75 s"), HasSubstr("█"), HasSubstr("░")));
  EXPECT_THAT(cli::progress_text(0.0, "step", 0s, 80), Not(HasSubstr(", 0 s")));
}

/// What was written between one beginning of the line and the next.
std::vector<std::string> lines_shown(const std::string& output) {
  const std::string again = "\r\033[K";
  std::vector<std::string> lines;
  for (std::size_t at = output.find(again); at != std::string::npos;) {
    const std::size_t next = output.find(again, at + again.size());
    lines.push_back(
        output.substr(at + again.size(), next == std::string::npos ? next : next - at - again.size()));
    at = next;
  }
  if (!lines.empty()) lines.pop_back();  // what follows the last one is the result
  return lines;
}

std::vector<std::string> short_design() {
  return {CLAMPCTL, "design", "--duration", "0.1", "--starts", "60"};
}

TEST(Progress, OneLineOfANarrowTerminalShowsADesignFromItsBeginning) {
  PseudoTerminal design(short_design(), 60, {"TERM=xterm"});
  EXPECT_EQ(design.end(), 0) << design.output();
  const std::vector<std::string> lines = lines_shown(design.output());
  ASSERT_THAT(lines, Not(SizeIs(0)));
  EXPECT_THAT(lines.front(), HasSubstr("0 %"));
  for (const std::string& line : lines) {
    EXPECT_LT(columns_of(line), 60) << line;
    EXPECT_THAT(line, Not(HasSubstr("\n")));
  }
}

TEST(Progress, ATinyCOLUMNSIsRespected) {
  std::vector<std::string> arguments = short_design();
  PseudoTerminal design(arguments, 100, {"TERM=xterm", "COLUMNS=12"});
  EXPECT_EQ(design.end(), 0) << design.output();
  for (const std::string& line : lines_shown(design.output())) EXPECT_LT(columns_of(line), 12) << line;
}

TEST(Progress, ADumbTerminalGetsPlainText) {
  PseudoTerminal design(short_design(), 80, {"TERM=dumb"});
  EXPECT_EQ(design.end(), 0);
  EXPECT_THAT(design.output(), AllOf(HasSubstr("log det"), Not(HasSubstr("\033"))));
  PseudoTerminal wrong({CLAMPCTL, "identify", "no-such-run.csv"}, 80, {"TERM=dumb"});
  EXPECT_EQ(wrong.end(), 2);
  EXPECT_THAT(wrong.output(), AllOf(HasSubstr("error:"), Not(HasSubstr("\033"))));
}

class CauseSearch : public ::testing::Test {
 protected:
  /// A check in this process of a brake whose force reading lags.
  PseudoTerminal check(std::vector<std::string> further) {
    folder_.write("station.toml",
                  "[check]\nrepeats = 6\n[archive]\ndatabase = \"" + folder_.path("checks.sqlite") + "\"\n");
    folder_.write("brake.toml", "[effects]\nforce-lag = 0.01\n");
    std::vector<std::string> arguments{
        CLAMPCTL,   "--config", folder_.path("station.toml"), "run",
        "--serial", "S-1",      "--simulated-brake",          folder_.path("brake.toml")};
    arguments.insert(arguments.end(), further.begin(), further.end());
    return PseudoTerminal(
        arguments, 100, {"TERM=xterm", "HOME=" + folder_.path(""), "XDG_DATA_HOME=" + folder_.path("data")});
  }

  support::TemporaryDirectory folder_;
};

TEST_F(CauseSearch, ShowsItsProgressAndIsDoneOnceForCheckAndSettling) {
  PseudoTerminal run = check({"--settle"});
  EXPECT_EQ(run.end(), 3) << run.output();
  EXPECT_THAT(run.output(), HasSubstr("trying every effect"));
  int begun = 0;
  bool before = false;
  for (const std::string& line : lines_shown(run.output())) {
    const bool now = line.find("fitting the base model") != std::string::npos;
    begun += now && !before ? 1 : 0;
    before = now;
  }
  EXPECT_EQ(begun, 1) << "the runs of the check were diagnosed already";
  EXPECT_THAT(run.output(), HasSubstr("force-lag"));
}

TEST_F(CauseSearch, EndsWithCtrlCAndLeavesTheVerdict) {
  PseudoTerminal run = check({});
  ASSERT_TRUE(run.writes("searching for the cause")) << run.output();
  run.interrupt();
  EXPECT_EQ(run.end(), 3) << run.output();
  EXPECT_THAT(run.output(), AllOf(HasSubstr("ERROR"), HasSubstr("the search was given up")));
}

}  // namespace
}  // namespace clampd::screen
