#include <regex>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::Outcome;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;

Outcome reproduce(const std::string& arguments, const std::string& environment = "") {
  return support::run_command(fmt::format("{} \"{}\" reproduce {}", environment, CLAMPCTL, arguments));
}

std::size_t count(const std::string& text, const std::string& what) {
  std::size_t found = 0;
  for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += what.size()) ++found;
  return found;
}

TEST(ReproduceCommand, ATinyStudyHoldsEveryFigureAndTheTable) {
  const support::TemporaryDirectory folder;
  const Outcome outcome = reproduce(fmt::format("--repeats 4 --starts 16 --out {} --json {}",
                                                folder.path("report.html"), folder.path("figures.json")));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("report.html"));
  EXPECT_THAT(outcome.output, Not(HasSubstr("\r")));

  const std::string html = folder.read("report.html");
  for (const char* section :
       {"Summary", "Fig. 1:", "Fig. 2:", "Fig. 4:", "Table II:", "Fig. 5:", "Fig. 6:", "Fig. 7:", "Fig. 8:"})
    EXPECT_TRUE(std::regex_search(html, std::regex(fmt::format("<h2 id=\"section-\\d+\">{}", section))))
        << section;
  EXPECT_EQ(count(html, "<svg"), 7U);
  EXPECT_EQ(count(html, "</svg>"), 7U);
  EXPECT_THAT(html, Not(HasSubstr("<script")));
  const std::regex reference("(?:href|src)=['\"]([^'\"]*)['\"]");
  for (std::sregex_iterator match(html.begin(), html.end(), reference), end; match != end; ++match)
    EXPECT_EQ((*match)[1].str().substr(0, 1), "#");
  // Whatever a study comes to, its words hold numbers.
  for (const char* slip : {">nan", " nan ", "inf ", "{:"}) EXPECT_THAT(html, Not(HasSubstr(slip)));

  const nlohmann::json figures = nlohmann::json::parse(folder.read("figures.json"));
  EXPECT_EQ(figures["schema"], "clampd.reproduction/1");
  EXPECT_EQ(figures["repeats"], 4);
  ASSERT_THAT(figures["table"], SizeIs(3));
  for (const auto& column : figures["table"]) {
    ASSERT_THAT(column["parameters"], SizeIs(7));
    for (const auto& parameter : column["parameters"]) {
      EXPECT_GT(parameter["bound"], 0.0);
      EXPECT_GE(parameter["bound"], parameter["bound_exact_torque"]) << "torque noise never helps";
    }
  }
  for (const auto& claim : figures["claims"])
    EXPECT_THAT(claim["verdict"], AnyOf("confirmed", "partly", "not confirmed", "contradicts itself"));
  // The data are simulated with Table II's parameters, which the estimates must find from Table I's.
  const auto& pem = figures["table"][1]["parameters"];
  EXPECT_NEAR(pem[1]["mean_normalised"], 0.936, 0.02) << "k2";
  EXPECT_NEAR(pem[4]["mean_normalised"], 2.450, 0.3) << "Tv";
}

TEST(ReproduceCommand, SaysWhatToInstallBeforeItComputes) {
  const support::TemporaryDirectory folder;
  const Outcome outcome = reproduce("--out " + folder.path("report.html"), "PATH=/nonexistent");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("gnuplot-nox"));
  EXPECT_EQ(folder.entries(), 0U);
}

TEST(ReproduceCommand, RefusesWhatItCannotDo) {
  const support::TemporaryDirectory folder;
  EXPECT_THAT(reproduce("--repeats 2 --out " + folder.path("a.html")).output, HasSubstr("repeats"));
  EXPECT_THAT(reproduce("--starts 0 --out " + folder.path("a.html")).output, HasSubstr("starts"));
  EXPECT_THAT(reproduce("--out /nowhere/at/all.html").output, HasSubstr("/nowhere"));
  EXPECT_THAT(reproduce("--out " + folder.path("")).output, HasSubstr("folder"));
  EXPECT_THAT(reproduce(fmt::format("--out {0} --json {0}", folder.path("a.html"))).output,
              HasSubstr("same file"));
  EXPECT_EQ(folder.entries(), 0U);
}

}  // namespace
}  // namespace clampd
