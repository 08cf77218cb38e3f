// The records' commands as a user runs them: exit codes, files, messages.

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/report/figure.hpp"
#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class RecordsCommands : public ::testing::Test {
 protected:
  Outcome clampctl(const std::string& arguments) {
    return support::run_command("cd '" + folder_.path("") + "' && STATE_DIRECTORY='" + folder_.path("state") +
                                "' " CLAMPCTL " " + arguments);
  }
  void check(const std::string& options, int exit_code = 0) {
    const Outcome outcome = clampctl("run --repeats 2 " + options);
    EXPECT_EQ(outcome.exit_code, exit_code) << outcome.output;
  }
  support::TemporaryDirectory folder_;
};

TEST_F(RecordsCommands, ExportWhatWasChosen) {
  check("--serial A --operator Jo --batch 1");
  check("--serial B --operator Jo --batch 1");
  check("--serial C --operator Bo --batch 2");
  Outcome outcome = clampctl("results --batch 1 --csv one.csv --dfq one.dfq");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("2 checks exported"));
  EXPECT_THAT(folder_.read("one.csv"), AllOf(HasSubstr(",A,"), HasSubstr(",B,"), Not(HasSubstr(",C,"))));
  EXPECT_THAT(folder_.read("one.dfq"),
              AllOf(HasSubstr("K0014/0 A\r\n"), HasSubstr("K0014/0 B\r\n"), HasSubstr("K2101/2 35.2\r\n")));

  outcome = clampctl("results --operator Bo --until 2999-12-31 --json");
  const auto listed = nlohmann::json::parse(outcome.output).at("checks");
  ASSERT_EQ(listed.size(), 1u);
  EXPECT_EQ(listed[0].at("serial"), "C");

  outcome = clampctl("results last --candump run.log");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("reconstructed"));
  EXPECT_THAT(folder_.read("run.log"), HasSubstr(") can0 "));

  EXPECT_EQ(clampctl("results --candump run.log").exit_code, 2);
  EXPECT_EQ(clampctl("results --since yesterday").exit_code, 2);
  EXPECT_EQ(clampctl("results --dfq no/such/folder/x.dfq").exit_code, 2);
  outcome = clampctl("results --serial nobody --dfq none.dfq");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_FALSE(std::filesystem::exists(folder_.path("none.dfq")));

  outcome = clampctl("statistics");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("3 brakes"));
  EXPECT_EQ(nlohmann::json::parse(clampctl("statistics --json").output).at("schema"), "clampd.statistics/1");
  outcome = clampctl("limits");
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("revision 1"), HasSubstr("built-in limits.toml")));
  outcome = clampctl("gauge");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("every operator must measure every part"));
}

TEST_F(RecordsCommands, PruneSaysFirstWhatItWouldDo) {
  folder_.write("all.toml", "");
  folder_.write("some.toml", "[retention]\nraw_days = 1\n");
  check("--serial A");
  EXPECT_EQ(clampctl("results --config all.toml --prune").exit_code, 2);
  Outcome outcome = clampctl("results --config some.toml --prune");
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_THAT(outcome.output, HasSubstr("No raw runs to remove"));
  outcome = clampctl("results --config some.toml --prune --yes --json");
  EXPECT_EQ(nlohmann::json::parse(outcome.output).at("checks").size(), 0u);
}

TEST_F(RecordsCommands, ReportOfABrake) {
  if (const auto drawable = report::can_draw(); !drawable) GTEST_SKIP() << drawable.error().message;
  check("--serial A");
  Outcome outcome = clampctl("report A --out a.html");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(folder_.read("a.html"),
              AllOf(HasSubstr("<strong>PASS</strong>"), HasSubstr("reference"), HasSubstr("</html>")));
  outcome = clampctl("report B");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("no check of B"));
}

TEST_F(RecordsCommands, GaugeStudyOfAFile) {
  folder_.write(
      "study.csv",
      "part,operator,width\n1,A,1.0\n1,A,1.1\n2,A,2.0\n2,A,2.1\n1,B,1.0\n1,B,1.2\n2,B,2.0\n2,B,2.2\n");
  Outcome outcome = clampctl("gauge --study study.csv --tolerance width=4");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("2 parts x 2 operators x 2 repeats"));
  EXPECT_EQ(clampctl("gauge --study study.csv --tolerance width").exit_code, 2);
  EXPECT_EQ(clampctl("gauge --tolerance width=4").exit_code, 2);
  EXPECT_EQ(clampctl("gauge --study none.csv").exit_code, 2);
}

TEST_F(RecordsCommands, MasterBrakeJudgesTheStation) {
  const auto limits = [](const std::string& k2) {
    return "revision = \"cal\"\nguard_band_k = 0\n[parameters_normalised]\nk1 = {lower = 0.9, upper = "
           "1.1}\nk2 = " +
           k2 +
           "\nTC = {lower = 0.5, upper = 2}\nTs0 = {lower = 0.5, upper = 2}\nTv = {lower = 0.5, upper = 2}\n"
           "mus = {lower = 0.9, upper = 1.1}\nws = {lower = 0.5, upper = 2}\n";
  };
  folder_.write("station.toml", "[master]\nserial = \"M-1\"\nlimits = \"master.toml\"\n");
  folder_.write("master.toml", limits("{lower = 0.97, upper = 1.03}"));
  Outcome outcome = clampctl("master --config station.toml");
  EXPECT_EQ(outcome.exit_code, 3);
  EXPECT_THAT(outcome.output, HasSubstr("master check due"));
  check("--master --config station.toml");
  EXPECT_EQ(clampctl("master --config station.toml").exit_code, 0);

  folder_.write("soft.toml", "[parameters_normalised]\nk2 = 0.95\n");
  outcome = clampctl("run --master --repeats 2 --config station.toml --simulated-brake soft.toml");
  EXPECT_EQ(outcome.exit_code, 3) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("M-1: off"), HasSubstr("do not check brakes")));
  EXPECT_EQ(nlohmann::json::parse(clampctl("master --json --config station.toml").output).at("state"), "off");

  EXPECT_EQ(clampctl("run --master").exit_code, 2) << "none is configured";
  EXPECT_EQ(clampctl("run --master --serial A --config station.toml").exit_code, 2);
  EXPECT_EQ(clampctl("master").exit_code, 2);
}

}  // namespace
}  // namespace clampd
