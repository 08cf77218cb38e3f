// `clampctl diagnose --model` and `clampctl predict` of bare drives as a user runs them: files in, files out.
// The runs are those of an independent simulation whose truth is known.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <sstream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/views/figure.hpp"
#include "drive/recorded_drive.hpp"
#include "drive/two_masses.hpp"
#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;
using DriveRun = clampd::Run;  // testing::Test has a Run of its own

constexpr double kCount_rad = 1e-3;

/// A column of a file beside time, torque and position.
struct FurtherColumn {
  std::string name;
  std::function<double(const DriveRun&, std::size_t)> value;
};

/// Milliseconds, mN m and encoder counts, as loggers write them.
std::string file_of(const DriveRun& run, const std::vector<FurtherColumn>& further = {}) {
  std::string text = "t_ms,torque_mNm,counts";
  for (const FurtherColumn& column : further) text += "," + column.name;
  text += '\n';
  for (std::size_t k = 0; k < run.size(); ++k) {
    text += fmt::format("{},{},{}", 1e3 * run.time_s[k], 1e3 * run.torque_Nm[k],
                        run.position_rad[k] / kCount_rad);
    for (const FurtherColumn& column : further) text += fmt::format(",{}", column.value(run, k));
    text += '\n';
  }
  return text;
}

constexpr const char* kModel = R"([drive]
name = "test drive"
kind = "rotary"
[columns]
time = {column = "t_ms", scale = 1e-3}
torque = {column = "torque_mNm", scale = 1e-3}
position = {column = "counts", scale = 1e-3}
)";

class DriveCommands : public ::testing::Test {
 protected:
  Outcome clampctl(const std::string& arguments) {
    return support::run_command(fmt::format("cd '{}' && '{}' {}", folder_.path(""), CLAMPCTL, arguments));
  }
  static nlohmann::json document_in(const std::string& text) {
    return nlohmann::json::parse(text.substr(text.find('{')));
  }
  static drive_test::RecordedDrive drive(unsigned motion) {
    drive_test::RecordedDrive drive;
    drive.reference_rate = drive_test::trapezoids(motion);
    drive.encoder_step = kCount_rad / drive.length;
    return drive;
  }
  support::TemporaryDirectory folder_;
};

/// Of the rows from `first` on: a drive that is on its way, at a time that is not zero.
DriveRun from_row(DriveRun run, std::size_t first) {
  for (std::vector<double>* column : {&run.time_s, &run.torque_Nm, &run.position_rad})
    column->erase(column->begin(), column->begin() + static_cast<std::ptrdiff_t>(first));
  return run;
}

double relative_error(const nlohmann::json& errors, const std::string& quantity) {
  for (const nlohmann::json& each : errors)
    if (each.at("quantity") == quantity) return each.at("of_standard_deviation");
  return std::nan("");
}

TEST_F(DriveCommands, AModelOfOneRunPredictsAnotherThatIsUnderWay) {
  folder_.write("model.toml", kModel);
  folder_.write("fitted.csv", file_of(drive_test::record(drive(4), 1)));
  const DriveRun whole = drive_test::record(drive(9), 2), other = from_row(whole, 1300);
  folder_.write("other.csv", file_of(other));
  Outcome outcome = clampctl("diagnose fitted.csv --model model.toml --save saved.toml --json out.json");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  const auto diagnosis = nlohmann::json::parse(folder_.read("out.json"));
  for (const auto& parameter : diagnosis.at("parameters_after")) {
    const double truth = parameter.at("name") == "coulomb" ? 0.02 : 1e-3;
    EXPECT_NEAR(parameter.at("value"), truth, 0.02 * truth) << parameter.at("name");
  }

  const std::string report = report::can_draw() ? "--report out.html" : "";
  outcome =
      clampctl("predict other.csv --model saved.toml --json prediction.json --out residuals.csv " + report);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("other.csv"), HasSubstr("rad/s"), Not(HasSubstr("nan"))));
  const auto document = nlohmann::json::parse(folder_.read("prediction.json"));
  EXPECT_EQ(document.at("schema"), "clampd.prediction/1");
  const auto& run = document.at("runs")[0];
  EXPECT_EQ(run.at("rows"), other.size());
  EXPECT_TRUE(run.at("diverged_s").is_null());
  EXPECT_LT(relative_error(run.at("errors"), "velocity"), 0.1);
  EXPECT_LT(relative_error(run.at("limited")[0].at("errors"), "velocity"), 0.05);
  if (!report.empty()) {
    EXPECT_THAT(folder_.read("out.html"), AllOf(HasSubstr("other.csv"), HasSubstr("</html>")));
  }

  // In SI units, from where the drive was, and the residual is the difference.
  std::istringstream residuals(folder_.read("residuals.csv"));
  std::string line;
  std::getline(residuals, line);
  EXPECT_EQ(line,
            "run,time_s,position_measured,position_predicted,position_residual,velocity_measured,"
            "velocity_predicted,velocity_residual");
  std::size_t rows = 0;
  for (; std::getline(residuals, line); ++rows) {
    ASSERT_THAT(line, StartsWith("\"other.csv\","));
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream fields(line.substr(line.find(' ')));
    double time_s, measured, predicted, residual, velocity, predicted_velocity;
    fields >> time_s >> measured >> predicted >> residual >> velocity >> predicted_velocity;
    ASSERT_NEAR(time_s, other.time_s[rows], 1e-9);
    ASSERT_NEAR(measured, other.position_rad[rows], 1e-9);
    ASSERT_NEAR(residual, measured - predicted, 1e-9);
    if (rows == 0) {
      EXPECT_NEAR(predicted, measured, 5.0 * kCount_rad);
      EXPECT_GT(std::abs(predicted_velocity), 1.0) << "it was under way";
      EXPECT_NEAR(predicted_velocity, (whole.position_rad[1320] - whole.position_rad[1280]) / 0.04, 0.5);
    }
  }
  EXPECT_EQ(rows, other.size());
}

TEST_F(DriveCommands, AKnownTorqueIsPartOfThePrediction) {
  folder_.write("model.toml", std::string(kModel) +
                                  "[regressors]\nload = {column = \"load_mNm\", scale = 1e-3, use = "
                                  "\"known-torque\"}\n");
  drive_test::RecordedDrive truth = drive(4);
  truth.gravity = 2.0;  // of the size of friction
  const double unit = truth.inertia * truth.length;
  const FurtherColumn load{"load_mNm", [&](const DriveRun& run, std::size_t k) {
                             return 1e3 * unit * truth.gravity * std::sin(run.position_rad[k]);
                           }};
  folder_.write("fitted.csv", file_of(drive_test::record(truth, 1), {load}));
  truth.reference_rate = drive_test::trapezoids(9);
  folder_.write("other.csv", file_of(drive_test::record(truth, 2), {load}));
  Outcome outcome = clampctl("diagnose fitted.csv --model model.toml --save saved.toml");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, StartsWith("ADEQUATE"));
  outcome = clampctl("predict other.csv --model saved.toml --json -");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  const nlohmann::json limited = document_in(outcome.output).at("runs")[0].at("limited");
  EXPECT_LT(relative_error(limited[0].at("errors"), "velocity"), 0.05);
  EXPECT_LT(relative_error(limited[1].at("errors"), "velocity"), 0.05);

  folder_.write("without.csv", file_of(drive_test::record(truth, 2)));
  outcome = clampctl("predict without.csv --model saved.toml --out residuals.csv");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("without.csv:1:1: column load_mNm is missing"));
  EXPECT_FALSE(std::filesystem::exists(folder_.path("residuals.csv")));
}

TEST_F(DriveCommands, ASavedModelIsSimulated) {
  folder_.write("model.toml", kModel);
  folder_.write("a.csv", file_of(drive_test::record(drive(3), 3)));
  const Outcome fitted = clampctl("diagnose a.csv --model model.toml --save fitted.toml");
  ASSERT_EQ(fitted.exit_code, 0) << fitted.output;
  // The torque of a motion, the motion of that torque: the same motion, by the columns of the model.
  const Outcome torque = clampctl("simulate --parameters fitted.toml --motion a.csv --out torque");
  ASSERT_EQ(torque.exit_code, 0) << torque.output;
  EXPECT_THAT(folder_.read("torque/a.csv"), StartsWith("t_ms,torque_mNm,counts\n"));
  const Outcome motion = clampctl("simulate --parameters fitted.toml --torque torque/a.csv --out motion");
  ASSERT_EQ(motion.exit_code, 0) << motion.output;
  const Outcome predicted = clampctl("predict motion/a.csv --model fitted.toml --json -");
  ASSERT_EQ(predicted.exit_code, 0) << predicted.output;
  for (const auto& error : document_in(predicted.output).at("runs").at(0).at("errors"))
    EXPECT_LT(error.at("of_standard_deviation").get<double>(), 0.02) << error;
}

TEST_F(DriveCommands, SimulateSaysWhatOfABrakeAndADriveDoesNotGoTogether) {
  folder_.write("model.toml", kModel);
  const std::vector<std::pair<const char*, const char*>> wrong{
      {"simulate --out d", "--manoeuvre"},
      {"simulate --torque a.csv --out d", "--parameters"},
      {"simulate --manoeuvre optimal --torque a.csv --out d", "give one of them"},
      {"simulate --parameters model.toml --torque a.csv --seed 1 --out d", "--seed"},
      {"simulate --parameters model.toml --motion a.csv --position 1 --out d",
       "--position requires --torque"},
      {"simulate --parameters model.toml --torque a.csv --out d", "[fitted]"},
  };
  for (const auto& [command, word] : wrong) {
    const Outcome outcome = clampctl(command);
    EXPECT_EQ(outcome.exit_code, 2) << command;
    EXPECT_THAT(outcome.output, HasSubstr(word)) << command;
  }
}

TEST_F(DriveCommands, WhatIsOfTheRunsOfTheFitIsSaid) {
  folder_.write("model.toml", kModel);
  std::string files;
  unsigned number = 0;
  for (const double coulomb : {1.0, 1.6, 0.7, 1.3}) {
    drive_test::RecordedDrive truth = drive(4 + ++number);
    truth.coulomb = coulomb;
    const std::string name = fmt::format("run{}.csv", number);
    folder_.write(name, file_of(drive_test::record(truth, number)));
    files += name + " ";
  }
  Outcome outcome = clampctl(fmt::format("diagnose {} --model model.toml --save saved.toml", files));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  ASSERT_THAT(outcome.output, HasSubstr("friction-drift: "));
  outcome = clampctl("predict run2.csv --model saved.toml");
  EXPECT_THAT(outcome.output, HasSubstr("friction-drift differs from run to run of the fit"));
}

TEST_F(DriveCommands, AModelWithoutInertiaPredictsNothing) {
  folder_.write("model.toml", std::string(kModel) + "[model]\ninertia = \"off\"\n");
  folder_.write("run.csv", file_of(drive_test::record(drive(4), 1)));
  Outcome outcome = clampctl("diagnose run.csv --model model.toml --save saved.toml");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  outcome = clampctl("predict run.csv --model saved.toml --json out.json");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("saved.toml: the fitted model has no positive inertia"));
  outcome = clampctl("predict run.csv --model model.toml --json out.json");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("the section [fitted] is missing"));
  EXPECT_FALSE(std::filesystem::exists(folder_.path("out.json")));
}

TEST_F(DriveCommands, AValueOfEachFileIsARegressor) {
  const std::string regressors =
      std::string(kModel) + "[regressors]\npayload = {per_file = true, use = \"estimate\"}\n";
  std::string model = regressors, runs;
  int number = 0;
  for (const double payload : {1.0, 3.0, 0.0, 2.0}) {
    const std::string name = fmt::format("run{}.csv", ++number);
    drive_test::RecordedDrive truth = drive(4 + static_cast<unsigned>(number));
    DriveRun run = drive_test::record(truth, static_cast<unsigned>(number));
    for (double& torque : run.torque_Nm) torque += 0.005 * payload;
    folder_.write(name, file_of(run));
    runs += name + " ";
    model += fmt::format("[files.\"{}\"]\npayload = {}\n", name, payload);
  }
  folder_.write("model.toml", model);
  Outcome outcome =
      clampctl(fmt::format("diagnose {} --model model.toml --save saved.toml --json out.json", runs));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, StartsWith("ADEQUATE"));
  bool found = false;
  const auto diagnosis = nlohmann::json::parse(folder_.read("out.json"));
  for (const auto& parameter : diagnosis.at("parameters_after"))
    if (parameter.at("name") == "column:payload.factor") {
      found = true;
      EXPECT_NEAR(parameter.at("value"), 0.005, 0.0003);
    }
  EXPECT_TRUE(found);
  outcome = clampctl("predict run2.csv --model saved.toml --json -");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  const nlohmann::json limited = document_in(outcome.output).at("runs")[0].at("limited");
  EXPECT_LT(relative_error(limited[1].at("errors"), "velocity"), 0.05);

  folder_.write("other.csv", folder_.read("run2.csv"));
  for (const char* command :
       {"diagnose run1.csv other.csv --model model.toml", "predict other.csv --model saved.toml",
        "diagnose run1.csv --holdout other.csv --model model.toml"}) {
    outcome = clampctl(command);
    EXPECT_EQ(outcome.exit_code, 2) << command;
    EXPECT_THAT(outcome.output,
                HasSubstr("no values for other.csv: write a section [files.\"other.csv\"] with payload"));
  }
  folder_.write("bad.toml", regressors + "[files.\"run1.csv\"]\npayload = \"heavy\"\n");
  outcome = clampctl("diagnose run1.csv --model bad.toml");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output,
              HasSubstr("bad.toml:11:11: files.\"run1.csv\".payload must be a finite number"));
  outcome = clampctl("diagnose run1.csv --model model.toml");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("payload is to be estimated, but is the same in all fitted runs"));
}

TEST_F(DriveCommands, TheGearIsSaidEverywhere) {
  const std::string model =
      std::string(kModel) + "load_position = {column = \"load_counts\", scale = 0.01}\n";
  folder_.write("model.toml", model);
  drive_test::TwoMasses truth;
  truth.backlash = 0.02;
  DriveRun run = drive_test::record(truth, 1);
  const FurtherColumn load{
      "load_counts",  // behind a gear of ten
      [](const DriveRun& of, std::size_t k) { return of.others.back().values[k] / 0.01; }};
  folder_.write("run.csv", file_of(run, {load}));
  const std::string report = report::can_draw() ? "--report out.html" : "";
  Outcome outcome =
      clampctl("diagnose run.csv --model model.toml --json out.json --save saved.toml " + report);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("gear-backlash: the gear has a backlash of 0.0"));
  const auto document = nlohmann::json::parse(folder_.read("out.json"));
  const auto found = std::ranges::find_if(
      document.at("data"), [](const auto& each) { return each.at("name") == "gear-backlash"; });
  ASSERT_NE(found, document.at("data").end());
  EXPECT_NEAR(found->at("size"), truth.backlash, 0.002);
  EXPECT_GT(found->at("sd"), 0.0);
  EXPECT_EQ(found->at("unit"), "rad");
  if (!report.empty()) {
    EXPECT_THAT(folder_.read("out.html"), HasSubstr("gear-backlash"));
  }
  outcome = clampctl("predict run.csv --model saved.toml");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;

  folder_.write("without.csv", file_of(run));
  outcome = clampctl("diagnose without.csv --model model.toml");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("without.csv:1:1: column load_counts is missing"));
}

/// Names of effects, columns and keys aside.
TEST_F(DriveCommands, ALinearDriveHasForcesAndNoTorques) {
  std::string model = kModel;
  model.replace(model.find("rotary"), 6, "linear");
  model.replace(model.find("kind"), 0, "unit = \"N\"\n");
  folder_.write("model.toml", model);
  drive_test::RecordedDrive truth = drive(4);
  DriveRun run = drive_test::record(truth, 1);
  for (std::size_t k = 0; k < run.size(); ++k)
    run.torque_Nm[k] += 0.005 + 0.006 * std::sin(2.0 * run.position_rad[k]);
  folder_.write("run.csv", file_of(run));
  const std::string report = report::can_draw() ? "--report out.html" : "";
  const Outcome outcome = clampctl("diagnose run.csv --model model.toml --json out.json " + report);
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output,
              AllOf(HasSubstr("% of the force's variation"), HasSubstr("a constant force pulls"),
                    HasSubstr("force ripples"), HasSubstr("in the force balance")));
  const auto expect_no_torque = [](std::string text) {
    for (const char* end : {" ", ".", ",", ";", "'", "<"})
      EXPECT_THAT(text, Not(HasSubstr(std::string(" torque") + end)));
  };
  expect_no_torque(outcome.output);
  const auto document = nlohmann::json::parse(folder_.read("out.json"));
  expect_no_torque(document.at("summary"));
  for (const char* list : {"effects", "data", "unseen_reasons"})
    for (const auto& each : document.at(list)) expect_no_torque(each.dump());
  if (!report.empty()) {
    const std::string html = folder_.read("out.html");
    EXPECT_THAT(html, AllOf(HasSubstr("Measured and modelled force"), Not(HasSubstr("(N m)")),
                            Not(HasSubstr("nominal brake")), Not(HasSubstr("Another torque"))));
  }
}

TEST_F(DriveCommands, ASavedModelIsIdentifiedAnewOnOtherRuns) {
  drive_test::RecordedDrive truth = drive(4);
  folder_.write("model.toml", kModel);
  const auto rippled = [](DriveRun run, double amplitude) {
    for (std::size_t k = 0; k < run.size(); ++k)
      run.torque_Nm[k] += amplitude * std::sin(8.0 * run.position_rad[k]);
    return file_of(run);
  };
  folder_.write("first.csv", rippled(drive_test::record(truth, 1), 0.02));
  folder_.write("second.csv", rippled(drive_test::record(truth, 2), 0.01));
  const Outcome saved = clampctl("diagnose first.csv --model model.toml --save saved.toml");
  ASSERT_THAT(saved.output, HasSubstr("cogging")) << saved.output;
  const Outcome outcome =
      clampctl("identify second.csv --model saved.toml --json out.json --save again.toml");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("cogging.amplitude-1"));
  const auto document = nlohmann::json::parse(folder_.read("out.json"));
  EXPECT_EQ(document.at("schema"), "clampd.identify-drive/1");
  EXPECT_TRUE(document.at("enough"));
  for (const auto& [name, value] : {std::pair{"cogging.amplitude-1", 0.01},
                                    std::pair{"coulomb", truth.coulomb * truth.inertia * truth.length},
                                    std::pair{"inertia", truth.inertia}}) {
    bool found = false;
    for (const auto& each : document.at("parameters"))
      if (each.at("name") == name) {
        found = true;
        EXPECT_NEAR(each.at("value").get<double>(), value, 5.0 * each.at("sd").get<double>()) << name;
        EXPECT_LT(each.at("sd").get<double>(), 0.1 * value) << name;
      }
    EXPECT_TRUE(found) << name;
  }
  EXPECT_EQ(clampctl("predict second.csv --model again.toml").exit_code, 0);

  for (const char* wrong : {"--model saved.toml --method oem", "--model saved.toml --save second.csv",
                            "--model model.toml", "--save x.toml"}) {
    const Outcome refused = clampctl(std::string("identify second.csv ") + wrong);
    EXPECT_EQ(refused.exit_code, 2) << wrong << refused.output;
  }
}

TEST_F(DriveCommands, ANewModelFileIsOneThatADiagnosisReads) {
  const DriveRun run = drive_test::record(drive(4), 1);
  folder_.write("run.csv", format_run(run));
  ASSERT_EQ(clampctl("drive new run.csv --out model.toml").exit_code, 0);
  const Outcome outcome = clampctl("diagnose run.csv --model model.toml");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("of the torque's variation"));
  const std::string model = folder_.read("model.toml");
  EXPECT_EQ(clampctl("drive new run.csv").output, model);
  for (const char* name : {"model.toml", "run.csv"}) {
    const Outcome again = clampctl(std::string("drive new run.csv --out ") + name);
    EXPECT_EQ(again.exit_code, 2);
    EXPECT_THAT(again.output, HasSubstr(name));
  }
  EXPECT_EQ(folder_.read("model.toml"), model);
}

/// However the file is called: no result takes the place of what is read.
TEST_F(DriveCommands, NothingThatIsReadIsOverwritten) {
  const std::string run = file_of(drive_test::record(drive(4), 1));
  folder_.write("model.toml", kModel);
  folder_.write("run.csv", run);
  folder_.write("held.csv", run);
  std::filesystem::create_symlink("run.csv", folder_.path("link.csv"));
  std::filesystem::create_hard_link(folder_.path("model.toml"), folder_.path("same.toml"));
  for (const char* outputs : {"--save model.toml", "--save ./model.toml", "--save same.toml",
                              "--next run.csv", "--next ../{0}/run.csv", "--next held.csv", "--next link.csv",
                              "--json model.toml", "--report model.toml"}) {
    const std::string here = std::filesystem::path(folder_.path("")).parent_path().filename().string();
    const Outcome outcome = clampctl("diagnose run.csv --holdout held.csv --model model.toml " +
                                     fmt::format(fmt::runtime(outputs), here));
    EXPECT_EQ(outcome.exit_code, 2) << outputs;
    EXPECT_THAT(outcome.output, HasSubstr("which is read")) << outputs;
  }
  const Outcome outcome = clampctl("predict run.csv --model model.toml --out ./run.csv");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("--out would overwrite"));
  // A shell that expands `--next *.csv` names the first of the runs.
  EXPECT_EQ(clampctl("diagnose --model model.toml --next *.csv").exit_code, 2);
  EXPECT_EQ(folder_.read("model.toml"), kModel);
  EXPECT_EQ(folder_.read("run.csv"), run);
  EXPECT_EQ(folder_.read("held.csv"), run);
}

}  // namespace
}  // namespace clampd
