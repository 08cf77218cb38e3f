// What a user sees of the programs: exit codes, messages, and that nothing half-written stays behind.

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::Outcome;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class CommandLine : public ::testing::Test {
 protected:
  /// Runs in the test's folder, which is also where results go.
  Outcome run(const std::string& command) {
    return support::run_command("cd '" + folder_.path("") + "' && STATE_DIRECTORY='" + folder_.path("state") +
                                "' " + command);
  }
  Outcome clampctl(const std::string& arguments) { return run(std::string(CLAMPCTL) + " " + arguments); }

  void write(const std::string& name, const std::string& text) { folder_.write(name, text); }
  std::string read(const std::string& name) { return folder_.read(name); }
  bool exists(const std::string& name) { return std::filesystem::exists(folder_.path(name)); }

  support::TemporaryDirectory folder_;
};

constexpr const char* kRunHeader = "time_s,torque_Nm,velocity_rad_s,force_N\n";

TEST_F(CommandLine, ListsTheEffectsThatADiagnosisKnows) {
  const Outcome text = clampctl("effects");
  EXPECT_EQ(text.exit_code, 0) << text.output;
  EXPECT_THAT(text.output, AllOf(HasSubstr("pad-damping"), HasSubstr("friction-power")));
  const Outcome outcome = clampctl("effects --json");
  const auto document = nlohmann::json::parse(outcome.output);
  EXPECT_EQ(document.at("schema"), "clampd.effects/1");
  const auto names = [&document](const char* kind) {
    std::vector<std::string> found;
    for (const auto& effect : document.at(kind)) found.push_back(effect.at("name"));
    return found;
  };
  EXPECT_THAT(names("brake"), AllOf(Contains("cogging"), Contains("channel-skew"), Not(Contains("gravity"))));
  EXPECT_THAT(names("drive"), AllOf(Contains("gravity"), Contains("column:NAME"), Not(Contains("inertia"))));
  for (const auto& effect : document.at("brake")) EXPECT_FALSE(effect.at("parameters").empty()) << effect;
}

TEST_F(CommandLine, ChecksABrakeAsOftenAsItNeeds) {
  const Outcome outcome = clampctl("run --serial GOOD-1 --repeats auto --json check.json");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  const auto document = nlohmann::json::parse(read("check.json"));
  EXPECT_EQ(document.at("verdict"), "PASS");
  const auto& stopping = document.at("stopping");
  EXPECT_EQ(stopping.at("rule"), "auto");
  EXPECT_EQ(stopping.at("most"), 21);
  EXPECT_EQ(stopping.at("reason"), "every limit decided after 4 runs");
  EXPECT_GT(stopping.at("coverage_factor"), 2.0);
  EXPECT_EQ(document.at("repeats"), 4);
  EXPECT_EQ(document.at("runs").size(), 4u);
  EXPECT_THAT(clampctl("results last").output, HasSubstr("every limit decided after 4 runs"));
}

TEST_F(CommandLine, ChecksAGoodBrake) {
  const Outcome outcome = clampctl("run --serial GOOD-1 --repeats 8 --json check.json");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("PASS"), HasSubstr("GOOD-1"), HasSubstr("SIMULATED")));

  const auto document = nlohmann::json::parse(read("check.json"));
  EXPECT_EQ(document.at("schema"), "clampd.check/1");
  EXPECT_EQ(document.at("verdict"), "PASS");
  EXPECT_EQ(document.at("serial"), "GOOD-1");
  EXPECT_EQ(document.at("repeats"), 8);
  EXPECT_EQ(document.at("timing").at("skipped"), 0);
  EXPECT_EQ(document.at("timing").at("lost_samples"), 0);
  EXPECT_TRUE(document.at("cause").is_null());
  const std::vector<std::string> names{"k1", "k2", "TC", "Ts0", "Tv", "mus", "ws"};
  ASSERT_EQ(document.at("parameters").size(), names.size());
  for (std::size_t i = 0; i < names.size(); ++i) {
    const auto& parameter = document.at("parameters")[i];
    EXPECT_EQ(parameter.at("name"), names[i]);
    EXPECT_GT(parameter.at("sd"), 0.0);
    EXPECT_LT(parameter.at("lower"), parameter.at("upper"));
    EXPECT_EQ(parameter.at("verdict"), "pass");
  }

  const Outcome listed = clampctl("results --json");
  EXPECT_EQ(listed.exit_code, 0);
  EXPECT_EQ(nlohmann::json::parse(listed.output).at("checks").at(0).at("record"), document.at("record"));
  const Outcome shown = clampctl("results last");
  EXPECT_EQ(shown.exit_code, 0);
  EXPECT_THAT(shown.output, HasSubstr("GOOD-1"));
}

TEST_F(CommandLine, FailsASoftBrakeAndNamesTheParameter) {
  write("soft.toml", "[parameters_normalised]\nk2 = 0.7\n");
  const Outcome outcome =
      clampctl("run --serial SOFT-1 --repeats 8 --simulated-brake soft.toml --json check.json");
  EXPECT_EQ(outcome.exit_code, 1) << outcome.output;
  const auto document = nlohmann::json::parse(read("check.json"));
  EXPECT_EQ(document.at("verdict"), "FAIL");
  EXPECT_THAT(document.at("reason").get<std::string>(), HasSubstr("k2"));
  for (const auto& parameter : document.at("parameters"))
    EXPECT_EQ(parameter.at("verdict"), parameter.at("name") == "k2" ? "fail" : "pass") << parameter;
}

TEST_F(CommandLine, ABrakeThatStopsSendingIsAnErrorOfTheStation) {
  write("silent.toml",
        "[sensors]\nforce_noise_N = 30.0\nvelocity_noise_rad_s = 0.3\n"
        "[[fault]]\nkind = \"silent\"\nat_s = 3.0\nduration_s = 100.0\n");
  const Outcome outcome = clampctl("run --serial MUTE-1 --simulated-brake silent.toml --json check.json");
  EXPECT_EQ(outcome.exit_code, 3) << outcome.output;
  EXPECT_EQ(nlohmann::json::parse(read("check.json")).at("verdict"), "ERROR");
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("ERROR"), HasSubstr("stopped sending")));
}

TEST_F(CommandLine, ALogOfFramesIsCheckedAgainstTheConfiguration) {
  ASSERT_EQ(clampctl("run --serial GOOD-1 --repeats 3").exit_code, 0);
  ASSERT_EQ(clampctl("results last --candump frames.log").exit_code, 0);
  const Outcome understood = clampctl("can check frames.log --json");
  EXPECT_EQ(understood.exit_code, 0) << understood.output;
  const auto document = nlohmann::json::parse(understood.output);
  EXPECT_EQ(document.at("schema"), "clampd.can-check/1");
  EXPECT_EQ(document.at("understood"), true);
  EXPECT_EQ(document.at("expected").at(1).at("message"), "BrakeFeedback");
  EXPECT_GT(document.at("samples"), 800);

  write("other.toml", "[can.protection]\nchecksum = \"e2e-1a\"\n");
  const Outcome misunderstood = clampctl("can check frames.log --config other.toml");
  EXPECT_EQ(misunderstood.exit_code, 3) << misunderstood.output;
  EXPECT_THAT(misunderstood.output, AllOf(HasSubstr("[can.protection] checksum = \"sae-j1850\""),
                                          HasSubstr("does not understand this brake yet")));
}

TEST_F(CommandLine, SimulatesAndIdentifies) {
  const Outcome simulated = clampctl("simulate --manoeuvre optimal --seed 5 --repeats 3 --out runs");
  EXPECT_EQ(simulated.exit_code, 0) << simulated.output;
  const Outcome identified =
      clampctl("identify runs/optimal-001.csv runs/optimal-002.csv runs/optimal-003.csv --json fit.json");
  EXPECT_EQ(identified.exit_code, 0) << identified.output;
  const auto document = nlohmann::json::parse(read("fit.json"));
  EXPECT_EQ(document.at("schema"), "clampd.identify/1");
  EXPECT_EQ(document.at("method"), "oem");
  EXPECT_EQ(document.at("runs"), 3);
  EXPECT_TRUE(document.at("converged"));
  ASSERT_EQ(document.at("parameters").size(), 7U);
  ASSERT_EQ(document.at("covariance_normalised").size(), 7U);
  for (const auto& parameter : document.at("parameters"))
    EXPECT_NEAR(parameter.at("normalised"), 1.0, 0.3) << parameter;
  EXPECT_LT(document.at("noise").at("torque_Nm"), 0.02);
}

TEST_F(CommandLine, IdentifiesWithTheModelThatADiagnosisSaved) {
  ASSERT_EQ(clampctl("simulate --manoeuvre optimal --effect force-lag=0.004 --seed 5 --repeats 4 --out runs")
                .exit_code,
            0);
  const std::string files =
      "runs/optimal-001.csv runs/optimal-002.csv runs/optimal-003.csv runs/optimal-004.csv";
  const Outcome diagnosed = clampctl("diagnose " + files + " --save model.toml");
  ASSERT_EQ(diagnosed.exit_code, 0) << diagnosed.output;
  const Outcome identified = clampctl("identify " + files + " --model model.toml --json fit.json");
  ASSERT_EQ(identified.exit_code, 0) << identified.output;
  EXPECT_THAT(identified.output, AllOf(HasSubstr("Prediction error method"),
                                       HasSubstr("force-lag.time_constant"), HasSubstr("one-step")));
  const auto document = nlohmann::json::parse(read("fit.json"));
  EXPECT_EQ(document.at("method"), "pem");
  EXPECT_TRUE(document.at("converged"));
  ASSERT_EQ(document.at("parameters").size(), 7U);
  for (const auto& parameter : document.at("parameters")) {
    const double error = parameter.at("normalised").get<double>() - 1.0;
    EXPECT_LT(std::abs(error), 4.0 * parameter.at("normalised_sd").get<double>()) << parameter;
  }
  ASSERT_EQ(document.at("effects").size(), 1U);
  EXPECT_EQ(document.at("effects")[0].at("name"), "force-lag");
  const auto& lag = document.at("effects")[0].at("parameters")[0];
  EXPECT_EQ(lag.at("name"), "time_constant");
  EXPECT_EQ(lag.at("unit"), "s");
  EXPECT_NEAR(lag.at("value"), 0.004, 4.0 * lag.at("sd").get<double>());
  // The base model's document is as it was.
  ASSERT_EQ(clampctl("identify runs/optimal-001.csv --json base.json").exit_code, 0);
  EXPECT_FALSE(nlohmann::json::parse(read("base.json")).contains("effects"));
}

TEST_F(CommandLine, ChecksByAnExtendedModelAndNamesCauses) {
  write("limits.toml", [] {
    std::ifstream shipped(CLAMPD_SOURCE_DIR "/configs/limits.toml");
    return std::string(std::istreambuf_iterator<char>(shipped), {}) +
           "[effects.backlash]\nplay = {lower = 0.0, upper = 0.3}\n";
  }());
  write("model.toml", "[[effect]]\nname = \"backlash\"\nplay = 0.2\n");
  write("station.toml", "[check]\nmodel = \"model.toml\"\n[limits]\nfile = \"limits.toml\"\n");
  write("loose.toml", "[effects]\nbacklash = 0.5\n");
  const Outcome loose = clampctl(
      "run --config station.toml --serial LOOSE --repeats 8 --simulated-brake loose.toml --json check.json");
  EXPECT_EQ(loose.exit_code, 1) << loose.output;
  EXPECT_THAT(loose.output, HasSubstr("backlash.play is"));
  auto document = nlohmann::json::parse(read("check.json"));
  EXPECT_EQ(document.at("parameters").back().at("name"), "backlash.play");
  EXPECT_EQ(document.at("parameters").back().at("verdict"), "fail");
  EXPECT_TRUE(document.at("cause").is_null());

  write("late.toml", "[effects]\nforce-lag = 0.012\n");
  const Outcome late =
      clampctl("run --serial LATE --repeats 4 --simulated-brake late.toml --json check.json");
  EXPECT_EQ(late.exit_code, 3) << late.output;
  document = nlohmann::json::parse(read("check.json"));
  EXPECT_EQ(document.at("cause").at("effect"), "force-lag");
  EXPECT_EQ(document.at("cause").at("location"), "force-reading");
  EXPECT_THAT(document.at("reason").get<std::string>(), HasSubstr("comes 12 ms late"));
  // Kept with the result.
  const Outcome shown = clampctl("results last --json");
  EXPECT_EQ(nlohmann::json::parse(shown.output).at("cause"), document.at("cause"));
}

TEST_F(CommandLine, IdentifiesByPredictionErrorsWithParametersHeld) {
  ASSERT_EQ(clampctl("simulate --manoeuvre optimal --seed 5 --out runs").exit_code, 0);
  const Outcome identified = clampctl(
      "identify runs/optimal-001.csv --method pem --robust --hold k1 ws --profile TC --noise-torque 0.002 "
      "--json fit.json");
  EXPECT_EQ(identified.exit_code, 0) << identified.output;
  EXPECT_THAT(identified.output, HasSubstr("one-step prediction errors"));
  const auto document = nlohmann::json::parse(read("fit.json"));
  EXPECT_EQ(document.at("method"), "pem");
  EXPECT_EQ(document.at("noise").at("torque_Nm"), 0.002);
  for (const auto& parameter : document.at("parameters"))
    if (parameter.at("held")) {
      EXPECT_EQ(parameter.at("normalised"), 1.0) << parameter;
      EXPECT_EQ(parameter.at("sd"), 0.0) << parameter;
    }
  const auto& profile = document.at("profiles").at(0);
  EXPECT_EQ(profile.at("name"), "TC");
  EXPECT_LT(profile.at("lower"), profile.at("upper"));
}

TEST_F(CommandLine, NamesWhatARunCannotTell) {
  ASSERT_EQ(clampctl("simulate --manoeuvre clearance --out runs").exit_code, 0);
  const Outcome identified = clampctl("identify runs/clearance-001.csv --json fit.json");
  EXPECT_EQ(identified.exit_code, 0) << identified.output;
  EXPECT_THAT(identified.output, HasSubstr("k2    not identifiable from these data"));
  const auto document = nlohmann::json::parse(read("fit.json"));
  EXPECT_FALSE(document.at("converged"));
  EXPECT_TRUE(document.at("parameters").at(1).at("value").is_null());
  EXPECT_FALSE(document.at("parameters").at(2).at("value").is_null());
}

const std::string kShippedSheet = CLAMPD_SOURCE_DIR "/configs/sheet.toml";

TEST_F(CommandLine, TellsWhatASheetAsksForFromRunsOnDisk) {
  ASSERT_EQ(clampctl("simulate --manoeuvre optimal --repeats 4 --seed 5 --out runs").exit_code, 0);
  const Outcome identified = clampctl("identify runs/*.csv --sheet " + kShippedSheet + " --json fit.json");
  EXPECT_EQ(identified.exit_code, 0) << identified.output;
  EXPECT_THAT(identified.output, HasSubstr("holding-margin at force_N 20000"));
  const auto sheet = nlohmann::json::parse(read("fit.json")).at("sheet");
  ASSERT_EQ(sheet.size(), 11u);
  for (std::size_t i = 0; i < 9; ++i) {
    EXPECT_EQ(sheet[i].at("verdict"), "pass") << sheet[i];
    EXPECT_GT(sheet[i].at("sd"), 0.0);
    EXPECT_FALSE(sheet[i].at("misfit_marked"));
  }
  EXPECT_EQ(sheet[9].at("kind"), "contact-point");
  EXPECT_NEAR(sheet[9].at("value"), 0.0, 4.0 * sheet[9].at("sd").get<double>())
      << "simulated runs count from there";
  EXPECT_TRUE(sheet[10].at("value").is_null());
  EXPECT_THAT(sheet[10].at("why").get<std::string>(),
              HasSubstr("where the check found the brake is not on record"));
  EXPECT_EQ(sheet[6].at("kind"), "holding-margin");
  EXPECT_NEAR(sheet[6].at("value"), 0.2308, 4.0 * sheet[6].at("sd").get<double>()) << "of the nominal brake";
  // Without one the document is as it was.
  ASSERT_EQ(clampctl("identify runs/optimal-001.csv --json base.json").exit_code, 0);
  EXPECT_FALSE(nlohmann::json::parse(read("base.json")).contains("sheet"));
}

TEST_F(CommandLine, NoCharacteristicHasANumberThatTheRunsDoNotGive) {
  ASSERT_EQ(clampctl("simulate --manoeuvre clearance --out runs").exit_code, 0);
  const Outcome identified = clampctl("identify runs/clearance-001.csv --hold k1 k2 mus --sheet " +
                                      kShippedSheet + " --json fit.json");
  EXPECT_EQ(identified.exit_code, 0) << identified.output;
  EXPECT_THAT(identified.output, HasSubstr("not known"));
  const auto partly = nlohmann::json::parse(read("fit.json"));
  for (const auto& line : partly.at("sheet")) {
    const bool is_without_load = line.at("kind") == "drag";
    EXPECT_NE(line.at("value").is_null(), is_without_load) << line;
    if (!is_without_load) {
      EXPECT_THAT(line.at("why").get<std::string>(), HasSubstr("was held")) << line;
    }
  }
  const Outcome nothing =
      clampctl("identify runs/clearance-001.csv --sheet " + kShippedSheet + " --json fit.json");
  EXPECT_EQ(nothing.exit_code, 0) << nothing.output;
  const auto unknown = nlohmann::json::parse(read("fit.json"));
  for (const auto& line : unknown.at("sheet")) EXPECT_TRUE(line.at("value").is_null()) << line;
}

TEST_F(CommandLine, ChecksByASheet) {
  write("sheet.toml",
        "revision = \"9\"\n[[characteristic]]\nname = \"response\"\nkind = \"apply-time\"\nunit = \"s\"\n"
        "force_N = 20000\nshare = 0.9\nclearance_rad = 6\nupper = 0.14\n"
        "[[characteristic]]\nkind = \"drag\"\nunit = \"N m\"\nspeed_rad_s = 50\nupper = 0.2\n");
  write("station.toml", "[sheet]\nfile = \"sheet.toml\"\n");
  const Outcome slow = clampctl("run --config station.toml --serial SLOW --repeats 4 --json check.json");
  EXPECT_EQ(slow.exit_code, 1) << slow.output;
  auto document = nlohmann::json::parse(read("check.json"));
  EXPECT_THAT(document.at("reason").get<std::string>(),
              HasSubstr("response is 0.1458 s, above its upper limit 0.14 s."));
  EXPECT_EQ(document.at("sheet").at("revision"), "9");
  EXPECT_EQ(document.at("sheet").at("characteristics")[0].at("verdict"), "fail");
  EXPECT_EQ(document.at("sheet").at("characteristics")[1].at("verdict"), "pass");
  EXPECT_EQ(document.at("parameters").size(), 7u);
  // On record as it was.
  const Outcome shown = clampctl("results last --json --config station.toml");
  EXPECT_EQ(nlohmann::json::parse(shown.output).at("sheet"), document.at("sheet"));
  EXPECT_EQ(clampctl("report SLOW --out report.html --config station.toml").exit_code, 0);
  EXPECT_THAT(read("report.html"), AllOf(HasSubstr("response"), HasSubstr("apply-time: force_N 20000")));

  write("late.toml", "[effects]\nforce-lag = 0.0005\n");
  ASSERT_NE(
      clampctl("run --config station.toml --serial LATE --repeats 12 --simulated-brake late.toml --json "
               "check.json")
          .exit_code,
      2);
  document = nlohmann::json::parse(read("check.json"));
  EXPECT_TRUE(document.at("systematic_misfit").at("marked")) << document;
  for (const auto& line : document.at("sheet").at("characteristics"))
    EXPECT_TRUE(line.at("misfit_marked")) << line;
}

TEST_F(CommandLine, SimulationsRepeatBitForBit) {
  for (const char* folder : {"a", "b"})
    ASSERT_EQ(clampctl("simulate --manoeuvre step --seed 9 --out " + std::string(folder)).exit_code, 0);
  EXPECT_EQ(read("a/step-001.csv"), read("b/step-001.csv"));
  ASSERT_EQ(clampctl("simulate --manoeuvre step --seed 10 --out c").exit_code, 0);
  EXPECT_NE(read("a/step-001.csv"), read("c/step-001.csv"));
}

struct BadInput {
  const char* name;
  const char* arguments;
  const char* says;  ///< what the message must contain
};

class BadInputs : public CommandLine, public ::testing::WithParamInterface<BadInput> {
 protected:
  void SetUp() override {
    write("empty.csv", "");
    write("header.csv", kRunHeader);
    write("column.csv", "time_s,torque_Nm,velocity_rad_s\n0,0,0\n0.001,0,0\n");
    write("word.csv", std::string(kRunHeader) + "0,0,0,0\n0.001,0,zero,0\n");
    write("backwards.csv", std::string(kRunHeader) + "0,0,0,0\n0.001,0,0,0\n0.0005,0,0,0\n");
    write("impossible.toml",
          "revision=\"1\"\n[parameters_normalised]\nk1={lower=0.5,upper=1.5}\nk2={lower=2.0,upper=1.0}\n"
          "TC={lower=0.5,upper=1.5}\nTs0={lower=0.5,upper=1.5}\nTv={lower=0.5,upper=1.5}\n"
          "mus={lower=0.5,upper=1.5}\nws={lower=0.5,upper=1.5}\n");
    write("limits.toml", "[limits]\nfile = \"impossible.toml\"\n");
    write("unknown_key.toml", "[check]\nrepeat = 5\n");
    write("not.toml", "this is = = not toml\n");
    write("not.dbc", "BO_ nonsense\n");
    write("dbc.toml", "[can]\ndbc = \"not.dbc\"\n");
    write("interface.toml", "[can]\ninterface = \"can77\"\n");
    write("trajectory.toml", "[check]\ntrajectory = \"word.csv\"\n");
    write("plant.toml", "[parameters]\nk2 = \"soft\"\n");
    write("effect.toml", "[[effect]]\nname = \"magic\"\n");
    write("model.toml", "[check]\nmodel = \"effect.toml\"\n");
    write("sheet.toml", "revision=\"1\"\n[[characteristic]]\nkind=\"drag\"\nunit=\"mN m\"\nspeed_rad_s=50\n");
    write("sheet_station.toml", "[sheet]\nfile = \"sheet.toml\"\n");
    write("good_model.toml", "[[effect]]\nname = \"backlash\"\nplay = 0.2\n");
    write("good_sheet.toml",
          "revision=\"1\"\n[[characteristic]]\nkind=\"drag\"\nunit=\"N m\"\nspeed_rad_s=50\n");
    write("sheet_model.toml", "[check]\nmodel = \"good_model.toml\"\n[sheet]\nfile = \"good_sheet.toml\"\n");
    write("occupied", "a file where a folder is wanted\n");
  }
};

TEST_P(BadInputs, AreRefusedWithAMessageAndNothingIsWritten) {
  const Outcome outcome = clampctl(GetParam().arguments);
  EXPECT_EQ(outcome.exit_code, 2) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr(GetParam().says));
  EXPECT_THAT(outcome.output, Not(HasSubstr("terminate")));
  EXPECT_FALSE(exists("out.json"));
  EXPECT_FALSE(exists("out"));
}

INSTANTIATE_TEST_SUITE_P(
    OfEveryCommand, BadInputs,
    ::testing::Values(
        BadInput{"NoCommand", "", "name a command"}, BadInput{"UnknownCommand", "clamp", "clamp"},
        BadInput{"UnknownOption", "run --serial A --fast", "--fast"},
        BadInput{"NoSerial", "run --json out.json", "--serial"},
        BadInput{"EmptySerial", "run --serial '' --json out.json", "serial"},
        BadInput{"NoRepeats", "run --serial A --repeats 0 --json out.json", "repeats"},
        BadInput{"FewRepeats", "run --serial A --repeats few --json out.json",
                 "--repeats: must be a whole number from 1 to 200, or auto"},
        BadInput{"ManyRepeats", "run --serial A --repeats many --json out.json", "many"},
        BadInput{"RunNoConfiguration", "run --serial A --config nowhere.toml --json out.json",
                 "nowhere.toml"},
        BadInput{"RunNotToml", "run --serial A --config not.toml --json out.json", "not.toml:1"},
        BadInput{"RunUnknownKey", "run --serial A --config unknown_key.toml --json out.json",
                 "unknown_key.toml:2"},
        BadInput{"RunImpossibleLimits", "run --serial A --config limits.toml --json out.json", "k2"},
        BadInput{"RunUnreadableDbc", "run --serial A --config dbc.toml --json out.json", "not.dbc:1"},
        BadInput{"RunBadTrajectory", "run --serial A --config trajectory.toml --json out.json", "word.csv:3"},
        BadInput{"RunBadPlant", "run --serial A --simulated-brake plant.toml --json out.json", "plant.toml"},
        BadInput{"RunNoInterface", "run --serial A --config interface.toml --json out.json", "can77"},
        BadInput{"RunUnwritable", "run --serial A --json nowhere/out.json", "nowhere"},
        BadInput{"RunBadSheet", "run --serial A --config sheet_station.toml --json out.json",
                 "sheet.toml:4:6: drag is in N m"},
        BadInput{"RunSheetAndModel", "run --serial A --config sheet_model.toml --json out.json",
                 "a sheet cannot count backlash"},
        BadInput{"IdentifyBadSheet", "identify word.csv --sheet sheet.toml --json out.json",
                 "sheet.toml:4:6: drag is in N m"},
        BadInput{"IdentifyNoFile", "identify nowhere.csv --json out.json", "nowhere.csv"},
        BadInput{"IdentifyFolder", "identify . --json out.json", "."},
        BadInput{"IdentifyEmpty", "identify empty.csv --json out.json", "empty.csv"},
        BadInput{"IdentifyHeaderOnly", "identify header.csv --json out.json", "header.csv"},
        BadInput{"IdentifyColumn", "identify column.csv --json out.json", "force_N"},
        BadInput{"IdentifyWord", "identify word.csv --json out.json", "word.csv:3"},
        BadInput{"IdentifyBackwards", "identify backwards.csv --json out.json", "backwards.csv:4"},
        BadInput{"IdentifyMethod", "identify word.csv --method magic --json out.json", "magic"},
        BadInput{"IdentifyParameters", "identify word.csv --parameters plant.toml --json out.json", ""},
        BadInput{"IdentifyNoModel", "identify word.csv --model nowhere.toml --json out.json", "nowhere.toml"},
        BadInput{"IdentifyBadModel", "identify word.csv --model effect.toml --json out.json",
                 "effect.toml:1"},
        BadInput{"IdentifyModelByOem", "identify word.csv --model effect.toml --method oem --json out.json",
                 "--model and --method oem exclude each other"},
        BadInput{"IdentifyModelAndParameters",
                 "identify word.csv --model effect.toml --parameters plant.toml --json out.json",
                 "--parameters"},
        BadInput{"RunBadModel", "run --serial A --config model.toml --json out.json", "effect.toml:1"},
        BadInput{"DesignNegative", "design --duration -1 --json out.json", "duration"},
        BadInput{"DesignObjective", "design --objective beautiful --json out.json", "beautiful"},
        BadInput{"SimulateNoManoeuvre", "simulate --out out", "--manoeuvre"},
        BadInput{"SimulateUnknownManoeuvre", "simulate --manoeuvre dance --out out", "dance"},
        BadInput{"SimulateUnknownEffect", "simulate --manoeuvre step --effect magic=1 --out out", "magic"},
        BadInput{"SimulateEffectValue", "simulate --manoeuvre step --effect cogging=much --out out", "much"},
        BadInput{"SimulateBadPlant", "simulate --manoeuvre step --parameters plant.toml --out out",
                 "plant.toml"},
        BadInput{"SimulateIntoAFile", "simulate --manoeuvre step --out occupied", "occupied"},
        BadInput{"StatusWithoutDaemon", "status", "no daemon is configured"},
        BadInput{"ResultsNone", "results", "simulated.sqlite"},
        BadInput{"ResultsVerdict", "results --verdict GOOD", "GOOD"},
        BadInput{"DoctorInterface", "doctor --interface can77 --seconds 0.5", "can77"},
        BadInput{"DoctorConfiguration", "doctor --config not.toml", "not.toml"},
        BadInput{"CanCheckNoLog", "can check nowhere.log", "nowhere.log"},
        BadInput{"CanCheckNoFrames", "can check word.csv", "no CAN frame in its"},
        BadInput{"CanCheckDbc", "can check word.csv --dbc nowhere.dbc", "nowhere.dbc"},
        BadInput{"CanNothing", "can", "subcommand"}),
    [](const auto& instance) { return std::string(instance.param.name); });

/// What the programs say where there is no interface can77, or no CAN in the kernel at all.
const auto kNoInterface = AnyOf(HasSubstr("no interface can77"), HasSubstr("no raw CAN socket"));

TEST_F(CommandLine, TheDaemonRefusesBadInput) {
  write("interface.toml", "[can]\ninterface = \"can77\"\n");
  const auto refused = [this](const std::string& arguments, int exit_code,
                              const ::testing::Matcher<const std::string&>& says) {
    const Outcome outcome = run(std::string(CLAMPD) + " " + arguments);
    EXPECT_EQ(outcome.exit_code, exit_code) << outcome.output;
    EXPECT_THAT(outcome.output, says);
  };
  refused("--fast", 2, HasSubstr("--fast"));
  refused("--config nowhere.toml", 2, HasSubstr("nowhere.toml"));
  refused("--config interface.toml", 3, kNoInterface);  // it may yet come: the service tries again
}

TEST_F(CommandLine, ThePlantRefusesBadInput) {
  const std::string configs = std::string(CLAMPD_SOURCE_DIR) + "/configs/";
  const std::string complete =
      "--interface can77 --dbc " + configs + "brake.dbc --config " + configs + "plant.toml";
  const auto refused = [this](const std::string& arguments,
                              const ::testing::Matcher<const std::string&>& says) {
    const Outcome outcome = run(std::string(CLAMPD_PLANT) + " " + arguments);
    EXPECT_EQ(outcome.exit_code, 2) << outcome.output;
    EXPECT_THAT(outcome.output, says);
  };
  refused("--interface can77", HasSubstr("is required"));
  refused(complete + " --fast", HasSubstr("--fast"));
  refused("--interface can77 --dbc nowhere.dbc --config " + configs + "plant.toml", HasSubstr("nowhere.dbc"));
  refused("--interface can77 --dbc " + configs + "brake.dbc --config nowhere.toml",
          HasSubstr("nowhere.toml"));
  refused(complete, kNoInterface);
}

TEST_F(CommandLine, HelpAndVersionAreNoErrors) {
  for (const char* arguments : {"--help", "--version", "run --help", "identify --help", "design --help",
                                "simulate --help", "status --help", "results --help", "doctor --help"}) {
    const Outcome outcome = clampctl(arguments);
    EXPECT_EQ(outcome.exit_code, 0) << arguments;
    EXPECT_THAT(outcome.output, Not(IsEmpty()));
  }
}

}  // namespace
}  // namespace clampd
