// The records' commands as a user runs them: exit codes, files, messages.

#include <algorithm>
#include <filesystem>
#include <string>

#include <SQLiteCpp/SQLiteCpp.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/views/figure.hpp"
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

  outcome = clampctl("results last --csv - --dfq one.dfq");
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("record,serial"), HasSubstr(",C,"), Not(HasSubstr(",A,")),
                                    HasSubstr("1 check exported")));
  EXPECT_THAT(folder_.read("one.dfq"), AllOf(HasSubstr("K0014/0 C\r\n"), Not(HasSubstr("K0014/0 A\r\n"))));
  EXPECT_FALSE(std::filesystem::exists(folder_.path("-")));
  EXPECT_EQ(clampctl("results none --csv one.csv").exit_code, 2);

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

TEST_F(RecordsCommands, RunsAndLastSamplesOfACheckAreExported) {
  check("--serial A");
  Outcome outcome = clampctl("results last --runs runs");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_TRUE(std::filesystem::exists(folder_.path("runs/run-02.csv")));
  EXPECT_EQ(clampctl("results last --runs runs").exit_code, 2) << "no file is overwritten";
  outcome = clampctl("identify runs/run-01.csv runs/run-02.csv");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  outcome = clampctl("results last --flight -");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("did not end in a fault"));
  EXPECT_EQ(clampctl("results --runs runs").exit_code, 2);

  folder_.write("silent.toml", "[[fault]]\nkind = \"silent\"\nat_s = 1.5\nduration_s = 100.0\n");
  check("--serial B --simulated-brake silent.toml", 3);
  outcome = clampctl("results last --flight flight.csv");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  const std::string flight = folder_.read("flight.csv");
  EXPECT_THAT(flight, HasSubstr("torque_command_Nm"));
  EXPECT_GT(std::count(flight.begin(), flight.end(), '\n'), 100);
  if (report::can_draw()) {
    outcome = clampctl("report B --out b.html");
    EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
    EXPECT_THAT(folder_.read("b.html"), HasSubstr("The last samples before the fault"));
  }
}

TEST_F(RecordsCommands, AVoidRecordStaysAndCountsNowhere) {
  check("--serial A");
  check("--serial B");
  EXPECT_EQ(clampctl("results --void reason").exit_code, 2);
  EXPECT_EQ(clampctl("results last --void ' '").exit_code, 2);
  Outcome outcome = clampctl("results last --void 'the wrong brake'");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(clampctl("results last").output, HasSubstr("the wrong brake"));
  const auto statistics = nlohmann::json::parse(clampctl("statistics --json").output);
  EXPECT_EQ(statistics.at("checks"), 1);
  EXPECT_EQ(statistics.at("void"), 1);
  EXPECT_THAT(clampctl("results").output, HasSubstr("PASS VOID"));
  EXPECT_EQ(clampctl("records verify").exit_code, 0);
}

TEST_F(RecordsCommands, AreVerifiedBackedUpAndRestored) {
  check("--serial A");
  check("--serial B");
  Outcome outcome = clampctl("records verify");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("2 checks, 4 raw runs"), HasSubstr("All as it was recorded")));
  EXPECT_EQ(clampctl("records backup copy.sqlite").exit_code, 0);
  EXPECT_EQ(clampctl("records verify copy.sqlite").exit_code, 0);
  const std::string id =
      nlohmann::json::parse(clampctl("results --serial A --json").output).at("checks")[0].at("record");
  SQLite::Database(folder_.path("state/simulated.sqlite"), SQLite::OPEN_READWRITE)
      .exec("UPDATE checks SET verdict = 1 WHERE serial = 'A'");
  outcome = clampctl("records verify --json");
  EXPECT_EQ(outcome.exit_code, 3);
  const auto found = nlohmann::json::parse(outcome.output);
  EXPECT_EQ(found.at("damage")[0].at("record"), id);
  EXPECT_THAT(clampctl("results " + id).output, HasSubstr("was changed after it was recorded"));
  EXPECT_EQ(clampctl("results last").exit_code, 0);
  outcome = clampctl("records restore copy.sqlite");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("simulated.sqlite.before-"));
  EXPECT_EQ(clampctl("results " + id).exit_code, 0);
  folder_.write("damaged.sqlite", std::string(8192, 'x'));
  EXPECT_EQ(clampctl("records verify damaged.sqlite").exit_code, 3);
  EXPECT_EQ(clampctl("records verify none.sqlite").exit_code, 2);
  EXPECT_EQ(clampctl("records restore damaged.sqlite").exit_code, 2);
  EXPECT_EQ(clampctl("records").exit_code, 2);
}

TEST_F(RecordsCommands, OneBrakeHasOneSerialNumber) {
  check("--serial '  X ' --operator ' Jo'");
  check("--serial X --operator Jo");
  const auto listed = nlohmann::json::parse(clampctl("results --serial X --operator Jo --json").output);
  EXPECT_EQ(listed.at("checks").size(), 2U);
  Outcome outcome = clampctl("run --serial \"$(printf 'M\\374ller')\" --repeats 2");
  EXPECT_EQ(outcome.exit_code, 2) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("the serial number is no UTF-8"));
}

TEST_F(RecordsCommands, PruneSaysFirstWhatItWouldDo) {
  folder_.write("all.toml", "[retention]\nraw_megabytes = 0\n");
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
