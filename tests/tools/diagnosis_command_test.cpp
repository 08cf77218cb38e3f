// `clampctl diagnose` as a user and a script see it.

#include <filesystem>
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
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

class DiagnoseCommand : public ::testing::Test {
 protected:
  /// In the test's folder, which is also where results go.
  Outcome clampctl(const std::string& arguments, const std::string& environment = "") {
    return support::run_command(
        fmt::format("cd '{}' && {} '{}' {}", folder_.path(""), environment, CLAMPCTL, arguments));
  }
  bool exists(const std::string& name) { return std::filesystem::exists(folder_.path(name)); }

  support::TemporaryDirectory folder_;
};

constexpr const char* kRunHeader = "time_s,torque_Nm,velocity_rad_s,force_N\n";

TEST_F(DiagnoseCommand, NamesTheOffsetOfTheForceReadingAndWritesEverything) {
  ASSERT_EQ(
      clampctl("simulate --manoeuvre staircase --effect force-offset=400 --seed 11 --repeats 2 --out runs")
          .exit_code,
      0);
  ASSERT_EQ(
      clampctl("simulate --manoeuvre clearance --effect force-offset=400 --seed 12 --out runs").exit_code, 0);
  const Outcome outcome = clampctl(
      "diagnose runs/clearance-001.csv runs/staircase-001.csv --holdout runs/staircase-002.csv --json "
      "out.json "
      "--report out.html --save model.toml");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, StartsWith("EXPLAINED"));
  EXPECT_THAT(outcome.output, Not(HasSubstr("\r"))) << "progress, though not on a terminal";
  EXPECT_THAT(outcome.output, Not(HasSubstr("\033")));

  const auto document = nlohmann::json::parse(folder_.read("out.json"));
  EXPECT_EQ(document.at("schema"), "clampd.diagnosis/1");
  EXPECT_EQ(document.at("verdict"), "explained");
  EXPECT_EQ(document.at("runs"), 2);
  ASSERT_EQ(document.at("effects").size(), 1U);
  EXPECT_EQ(document.at("effects")[0].at("name"), "force-offset");
  EXPECT_NEAR(document.at("effects")[0].at("parameters")[0].at("value"), 400.0, 40.0);
  EXPECT_EQ(document.at("gain").at("heldout_runs"), 1);

  EXPECT_THAT(folder_.read("out.html"), HasSubstr("force-offset"));
  EXPECT_THAT(folder_.read("model.toml"), HasSubstr("force-offset"));
  // What was saved drives the simulated brake.
  EXPECT_EQ(clampctl("simulate --manoeuvre clearance --parameters model.toml --out again").exit_code, 0);
}

TEST_F(DiagnoseCommand, GetsDifferentNoiseOfEachManoeuvre) {
  for (const char* manoeuvre : {"optimal", "apply-release"})
    ASSERT_EQ(clampctl(fmt::format("simulate --manoeuvre {} --out runs", manoeuvre)).exit_code, 0);
  const auto first_row = [&](const char* file) {
    const std::string text = folder_.read(file);
    const std::size_t begin = text.find('\n') + 1;
    return text.substr(begin, text.find('\n', begin) - begin);
  };
  EXPECT_NE(first_row("runs/optimal-001.csv"), first_row("runs/apply-release-001.csv"));
  ASSERT_EQ(clampctl("simulate --manoeuvre optimal --out again").exit_code, 0);
  EXPECT_EQ(folder_.read("again/optimal-001.csv"), folder_.read("runs/optimal-001.csv")) << "repeatable";
}

TEST_F(DiagnoseCommand, GivesOnlyTheDocumentOnStandardOutput) {
  ASSERT_EQ(clampctl("simulate --manoeuvre optimal --seed 3 --out runs").exit_code, 0);
  const Outcome outcome = clampctl("diagnose runs/optimal-001.csv --json - --next next.csv");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  const std::size_t start = outcome.output.find('{');
  ASSERT_NE(start, std::string::npos) << outcome.output;
  const auto document = nlohmann::json::parse(outcome.output.substr(start));
  EXPECT_EQ(document.at("verdict"), "adequate") << document.at("summary");
  EXPECT_TRUE(document.at("next_experiment").is_null());
  EXPECT_THAT(outcome.output.substr(0, start), HasSubstr("next.csv is not written"));
  EXPECT_FALSE(exists("next.csv"));
  // One run in one direction shows little; it must say so.
  EXPECT_FALSE(document.at("unseen").empty());
}

struct BadInput {
  const char* name;
  const char* arguments;
  const char* says;  ///< what the message must contain
};

class BadDiagnoseInputs : public DiagnoseCommand, public ::testing::WithParamInterface<BadInput> {
 protected:
  void SetUp() override {
    folder_.write("empty.csv", "");
    folder_.write("short.csv", std::string(kRunHeader) + "0,0,0,0\n0.001,0,0,0\n");
    folder_.write("column.csv", "time_s,torque_Nm,velocity_rad_s\n0,0,0\n0.001,0,0\n");
    folder_.write("word.csv", std::string(kRunHeader) + "0,0,0,0\n0.001,0,zero,0\n");
    folder_.write("bad.toml", "[parameters]\nk2 = \"soft\"\n");
  }
};

TEST_P(BadDiagnoseInputs, AreRefusedWithAMessageAndNothingIsWritten) {
  const Outcome outcome = clampctl(fmt::format("diagnose {}", GetParam().arguments));
  EXPECT_EQ(outcome.exit_code, 2) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr(GetParam().says));
  EXPECT_THAT(outcome.output, Not(HasSubstr("terminate")));
  for (const char* file : {"out.json", "out.html", "out.toml", "out.csv"}) EXPECT_FALSE(exists(file)) << file;
  EXPECT_THAT(folder_.read("word.csv"), StartsWith(kRunHeader)) << "no run is overwritten";
}

INSTANTIATE_TEST_SUITE_P(
    OfEveryKind, BadDiagnoseInputs,
    ::testing::Values(
        BadInput{"NoRun", "--json out.json", "runs"},
        BadInput{"NoFile", "nowhere.csv --json out.json", "nowhere.csv"},
        BadInput{"Empty", "empty.csv --json out.json", "empty.csv"},
        BadInput{"Short", "short.csv --json out.json --report out.html", "short.csv"},
        BadInput{"Column", "column.csv --json out.json", "force_N"},
        BadInput{"Word", "word.csv --json out.json", "word.csv:3"},
        BadInput{"HoldoutNoFile", "short.csv --holdout nowhere.csv --json out.json", "nowhere.csv"},
        BadInput{"HoldoutWord", "short.csv --holdout word.csv --json out.json", "word.csv:3"},
        BadInput{"FittedAndHeldOut", "short.csv --holdout short.csv --json out.json", "held out"},
        BadInput{"Parameters", "short.csv --parameters bad.toml --json out.json", "bad.toml"},
        BadInput{"Model", "short.csv --model bad.toml --json out.json", "bad.toml"},
        BadInput{"ModelMissing", "short.csv --model nowhere.toml --json out.json", "nowhere.toml"},
        BadInput{"Unwritable", "short.csv --json nowhere/out.json", "nowhere"},
        BadInput{"ReportOnStandardOutput", "short.csv --report -", "--report needs the name of a file"},
        BadInput{"SameFile", "short.csv --save out.toml --next out.toml", "name the same file"},
        BadInput{"RunsForTheResult", "--json word.csv short.csv", "word.csv is there already"},
        BadInput{"Threads", "short.csv --threads -1", "--threads"}),
    [](const auto& instance) { return std::string(instance.param.name); });

TEST_F(DiagnoseCommand, SaysWhatToInstallBeforeItComputes) {
  const Outcome outcome = clampctl("diagnose nowhere.csv --report out.html", "PATH=/nonexistent");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("gnuplot-nox"));
}

}  // namespace
}  // namespace clampd
