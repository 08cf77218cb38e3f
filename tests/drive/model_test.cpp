#include "clampd/drive/model.hpp"

#include <cmath>
#include <filesystem>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using ::testing::AllOf;
using ::testing::DoubleNear;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pointwise;
using ::testing::StartsWith;

constexpr const char* kSmallest = R"([drive]
kind = "rotary"
[columns]
time = "t"
torque = "i"
position = {column = "count", scale = 0.5, wrap = 8}
)";

std::string error_of(const std::string& text) {
  const Result<DriveModel> model = parse_drive_model(text, "m.toml");
  return model ? "" : model.error().message;
}

TEST(DriveModelFile, HasDefaultsForWhatItDoesNotSay) {
  const Result<DriveModel> model = parse_drive_model(kSmallest, "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->torque_unit, "N m");
  EXPECT_FALSE(model->linear);
  EXPECT_FALSE(model->steady);
  EXPECT_TRUE(std::isnan(model->cut_off_Hz));
  EXPECT_EQ(model->part(DriveTerm::Inertia).use, PartUse::Estimate);
  EXPECT_EQ(model->part(DriveTerm::Cogging).use, PartUse::Candidate);
  EXPECT_FALSE(model->columns.velocity);
}

TEST(DriveModelFile, SwitchesParts) {
  const Result<DriveModel> model = parse_drive_model(
      std::string(kSmallest) +
          "[model]\ninertia = 2.5e-3\nviscous = \"off\"\ntorque-offset = \"estimate\"\ncogging = \"off\"\n"
          "[data]\ncut_off_Hz = 40\ntorque_held = true\n",
      "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->part(DriveTerm::Inertia).use, PartUse::Fixed);
  EXPECT_EQ(model->part(DriveTerm::Inertia).value, 2.5e-3);
  EXPECT_EQ(model->part(DriveTerm::Viscous).use, PartUse::Off);
  EXPECT_EQ(model->part(DriveTerm::TorqueOffset).use, PartUse::Estimate);
  EXPECT_EQ(model->part(DriveTerm::Cogging).use, PartUse::Off);
  EXPECT_EQ(model->cut_off_Hz, 40.0);
  EXPECT_TRUE(model->torque_held);
}

TEST(DriveModelFile, SteadyRunsHaveNoInertiaUnlessAskedFor) {
  const Result<DriveModel> model =
      parse_drive_model(std::string(kSmallest) + "[data]\nsteady = true\n", "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->part(DriveTerm::Inertia).use, PartUse::Off);
}

TEST(DriveModelFile, ErrorsNameFileLineAndKey) {
  EXPECT_THAT(error_of("[drive\n"), StartsWith("m.toml:1:"));
  EXPECT_THAT(error_of("[columns]\ntime=\"t\"\n"), HasSubstr("[drive] is missing"));
  EXPECT_THAT(error_of("[drive]\nkind = \"round\"\n"), StartsWith("m.toml:2:"));
  EXPECT_THAT(error_of("[drive]\nkind = \"round\"\n"),
              HasSubstr("drive.kind must be one of \"rotary\", \"linear\""));
  EXPECT_THAT(
      error_of(std::string(kSmallest) + "[model]\nfriction = \"off\"\n"),
      ::testing::AllOf(StartsWith("m.toml:8:"), HasSubstr("unknown key friction"), HasSubstr("coulomb")));
  EXPECT_THAT(error_of(std::string(kSmallest) + "[model]\ncogging = 3\n"),
              ::testing::AllOf(StartsWith("m.toml:8:"), HasSubstr("cogging must be \"candidate\"")));
  EXPECT_THAT(error_of(std::string(kSmallest) + "[model]\ncoulomb = \"candidate\"\n"),
              HasSubstr("coulomb must be \"estimate\""));
  EXPECT_THAT(error_of(std::string(kSmallest) + "[data]\ncut_off_Hz = -3\n"), HasSubstr("cut_off_Hz"));
  EXPECT_THAT(error_of(std::string(kSmallest) + "[data]\nsteady = \"yes\"\n"), HasSubstr("true or false"));
  EXPECT_THAT(error_of("[drive]\nkind=\"linear\"\n[columns]\ntime=\"t\"\ntorque=\"u\"\n"),
              HasSubstr("columns.position or columns.velocity"));
  EXPECT_THAT(error_of("[drive]\nkind=\"linear\"\n[columns]\ntime=\"t\"\ntorque=\"t\"\nposition=\"x\"\n"),
              HasSubstr("used twice"));
  EXPECT_THAT(error_of("[drive]\nkind=\"linear\"\n[columns]\ntime=\"t\"\ntorque={scale=2}\nposition=\"x\"\n"),
              HasSubstr("columns.torque needs column"));
}

TEST(DriveModelFile, EveryShippedOneReads) {
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(CLAMPD_SOURCE_DIR "/configs/drives")) {
    const Result<DriveModel> model = read_drive_model(entry.path().string());
    EXPECT_TRUE(model) << model.error().message;
    ++files;
  }
  EXPECT_GE(files, 4);
}

TEST(ForeignColumns, AreScaledAndUnwrappedAndMayBeMissing) {
  const Result<DriveModel> model = parse_drive_model(kSmallest, "m.toml");
  ASSERT_TRUE(model);
  const Result<LoadedRun> loaded =
      parse_run("i,t,other,count\n1,0,9,6\n2,1,9,7.5\n3,2,9,1\n4,3,9,7\n", "r.csv", model->columns);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_THAT(loaded->run.torque_Nm, ElementsAre(1, 2, 3, 4));
  EXPECT_THAT(loaded->run.position_rad, ElementsAre(3, 3.75, 4.5, 3.5));
  EXPECT_TRUE(loaded->run.velocity_rad_s.empty());
  EXPECT_TRUE(loaded->run.force_N.empty());
  EXPECT_THAT(loaded->notices, ElementsAre(HasSubstr("\"other\" is ignored")));
}

TEST(ForeignColumns, AreShiftedAndSubtractedAfterLinesThatAreNotRead) {
  const Result<DriveModel> model = parse_drive_model(
      "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\nposition = \"q\"\n"
      "torque = {column = \"front\", minus = \"rear\", scale = 2, offset = -1}\n"
      "[regressors]\ntemperature = {column = \"F\", scale = 0.5, offset = 10}\n"
      "[data]\nskip_lines = 2\n",
      "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  const Result<LoadedRun> loaded = parse_run(
      "logger 7\nt,q,rear,front,F\nt,q,rear,front,F\n0,1,2,5,4\n1,2,4,4,8\n", "r.csv", model->columns);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_THAT(loaded->run.torque_Nm, ElementsAre(5, -1));
  ASSERT_EQ(loaded->run.others.size(), 1u);
  EXPECT_EQ(loaded->run.others.front().name, "temperature");
  EXPECT_THAT(loaded->run.others.front().values, ElementsAre(12, 14));
  EXPECT_THAT(loaded->notices, ::testing::IsEmpty());

  const Result<LoadedRun> missing = parse_run("\n\nt,q,front,F\n0,1,2,5\n", "r.csv", model->columns);
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, HasSubstr("column rear is missing"));
  const Result<LoadedRun> too_short = parse_run("t,q,rear,front,F\n0,1,2,5,4\n", "r.csv", model->columns);
  ASSERT_FALSE(too_short);
  EXPECT_THAT(too_short.error().message, StartsWith("r.csv:"));
}

TEST(ForeignColumns, MayBeSeparatedBySemicolonsOrTabsWithDecimalCommas) {
  const Result<DriveModel> model = parse_drive_model(kSmallest, "m.toml");
  ASSERT_TRUE(model);
  for (const char* text :
       {"i;t;count\n1,5;0;6\n-2,5;0,5;7\n", "i\tt\tcount\r\n1,5\t0\t6\r\n-2.5\t0,5\t7\r\n"}) {
    const Result<LoadedRun> loaded = parse_run(text, "r.csv", model->columns);
    ASSERT_TRUE(loaded) << loaded.error().message;
    EXPECT_THAT(loaded->run.torque_Nm, ElementsAre(1.5, -2.5));
    EXPECT_THAT(loaded->run.time_s, ElementsAre(0, 0.5));
  }
  for (const char* number : {"1.234,5", "1,234.5", "1,2,3"}) {
    const Result<LoadedRun> loaded =
        parse_run("i;t;count\n" + std::string(number) + ";0;6\n", "r.csv", model->columns);
    ASSERT_FALSE(loaded) << number;
    EXPECT_THAT(loaded.error().message, AllOf(StartsWith("r.csv:2:1: "), HasSubstr(number)));
  }
}

TEST(ForeignColumns, ThatAreLateMoveToWhereTheyBelong) {
  const Result<DriveModel> model = parse_drive_model(
      "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\nposition = {column = \"q\", late_s = 0.15}\n"
      "torque = {column = \"u\", late_s = -0.1}\n",
      "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  std::string text = "t,q,u\n";
  for (int k = 0; k < 8; ++k) text += fmt::format("{},{},{}\n", 0.1 * k, 10.0 * k, k * k);
  const Result<LoadedRun> loaded = parse_run(text, "r.csv", model->columns);
  ASSERT_TRUE(loaded) << loaded.error().message;
  // Of 0.0 to 0.7 s: the torque of 0.0 s is that of 0.1 s, the position read at 0.7 s that of 0.55 s.
  EXPECT_THAT(loaded->run.time_s, Pointwise(DoubleNear(1e-9), {0.1, 0.2, 0.3, 0.4, 0.5}));
  EXPECT_THAT(loaded->run.torque_Nm, Pointwise(DoubleNear(1e-9), {0, 1, 4, 9, 16}));
  EXPECT_THAT(loaded->run.position_rad, Pointwise(DoubleNear(1e-9), {25, 35, 45, 55, 65}));

  EXPECT_THAT(error_of("[drive]\nkind = \"rotary\"\n[columns]\ntorque = \"u\"\nposition = \"q\"\n"
                       "time = {column = \"t\", late_s = 1}\n"),
              HasSubstr("time cannot be late"));
  const Result<LoadedRun> none = parse_run("t,q,u\n0,1,2\n0.1,2,3\n", "r.csv", model->columns);
  ASSERT_FALSE(none);
  EXPECT_THAT(none.error().message, HasSubstr("late_s"));
}

class ProposedModel : public ::testing::Test {
 protected:
  Result<ProposedDriveModel> proposed(const std::string& text) {
    folder_.write("run.csv", text);
    return propose_drive_model(folder_.path("run.csv"));
  }
  support::TemporaryDirectory folder_;
};

TEST_F(ProposedModel, TakesNamesAndUnitsAsLoggersWriteThem) {
  const auto file =
      "Logger 3.1\n\nZeit [ms];Strom (A);Drehzahl [rpm];Soll Drehzahl [rpm];Winkel_deg\n"
      "0;1,5;20,5;3;0\n2;1,6;20,3;3;-90\n";
  const Result<ProposedDriveModel> found = proposed(file);
  ASSERT_TRUE(found) << found.error().message;
  const Result<DriveModel> model = parse_drive_model(found->text, "m.toml");
  ASSERT_TRUE(model) << model.error().message << found->text;
  EXPECT_FALSE(model->linear);
  EXPECT_EQ(model->torque_unit, "A");
  const Result<LoadedRun> run = parse_run(file, "run.csv", model->columns);
  ASSERT_TRUE(run) << run.error().message;
  EXPECT_THAT(run->run.time_s, Pointwise(DoubleNear(1e-12), {0.0, 2e-3}));
  EXPECT_THAT(run->run.torque_Nm, ElementsAre(1.5, 1.6));
  EXPECT_THAT(run->run.velocity_rad_s, Pointwise(DoubleNear(1e-6), {20.5 * M_PI / 30, 20.3 * M_PI / 30}));
  EXPECT_THAT(run->run.position_rad, Pointwise(DoubleNear(1e-6), {0.0, -0.5 * M_PI}));
  EXPECT_THAT(found->text, HasSubstr("# \"Soll Drehzahl [rpm]\""));
  EXPECT_THAT(found->notices, ::testing::IsEmpty());
}

TEST_F(ProposedModel, SaysWhatTheNamesLeaveOpen) {
  const Result<ProposedDriveModel> found = proposed("# by hand\nt,tau,encoder_counts\n0,1,2\n1,1,2\n");
  ASSERT_TRUE(found) << found.error().message;
  const Result<DriveModel> model = parse_drive_model(found->text, "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->columns.skip_lines, 0);
  EXPECT_THAT(found->notices, ::testing::UnorderedElementsAre(HasSubstr("\"t\", taken for the time"),
                                                              HasSubstr("\"tau\", taken for the torque"),
                                                              HasSubstr("\"encoder_counts\" counts steps")));
}

TEST_F(ProposedModel, IsLinearByItsUnitsAndTakesNoReferenceForTheMotion) {
  const Result<ProposedDriveModel> found = proposed("time_s,x_ref_mm,x_mm,force_kN\n0,1,2,3\n1,2,3,4\n");
  ASSERT_TRUE(found) << found.error().message;
  const Result<DriveModel> model = parse_drive_model(found->text, "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_TRUE(model->linear);
  EXPECT_EQ(model->torque_unit, "N");
  EXPECT_EQ(model->columns.position->column, "x_mm");
  EXPECT_EQ(model->columns.position->scale, 1e-3);
  EXPECT_EQ(model->columns.torque->scale, 1e3);
}

TEST_F(ProposedModel, ErrorsSayWhatIsMissing) {
  const auto message = [&](const std::string& text) {
    const Result<ProposedDriveModel> found = proposed(text);
    return found ? found->text : found.error().message;
  };
  EXPECT_THAT(message("time_s,temperature,pressure\n0,1,2\n"),
              AllOf(HasSubstr("tells that it is the torque"), HasSubstr("\"temperature\"")));
  EXPECT_THAT(message("time_s,torque_Nm,temperature\n0,1,2\n"), HasSubstr("tells that it is the motion"));
  EXPECT_THAT(message(""), HasSubstr("no line of three names"));
  EXPECT_THAT(message("a,b,c\nx,y,z\n"), HasSubstr("no line of three names"));
  EXPECT_THAT(message("\"a\x01\",torque,pos,time\n1,2,3,4\n"), HasSubstr("# \"a\\u0001\""));
  EXPECT_FALSE(propose_drive_model(folder_.path("none.csv")));
}

TEST(DriveModelFile, RefusesWrongOffsetsAndLines) {
  const std::string columns = "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\nposition = \"q\"\n";
  EXPECT_THAT(error_of(columns + "torque = {column = \"u\", offset = \"1\"}\n"),
              HasSubstr("offset must be a finite number"));
  EXPECT_EQ(error_of(columns + "torque = {column = \"u\", offset = 0}\n"), "");
  EXPECT_THAT(error_of(columns + "torque = {column = \"u\", minus = 3}\n"),
              HasSubstr("minus must be a text"));
  EXPECT_THAT(error_of(columns + "torque = \"u\"\n[data]\nskip_lines = -1\n"), HasSubstr("data.skip_lines"));
  EXPECT_THAT(error_of(columns + "torque = \"u\"\n[data]\nskip_lines = 1.5\n"),
              HasSubstr("data.skip_lines must be a whole number"));
}

TEST(DriveModelFile, RefusesWhatItDoesNotKnowInEverySection) {
  const std::string columns =
      "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\nposition = \"q\"\ntorque = \"u\"\n";
  EXPECT_THAT(error_of(columns + "volocity = \"v\"\n"),
              HasSubstr("m.toml:7:1: unknown key volocity in [columns]; did you mean velocity?"));
  EXPECT_THAT(error_of(columns + "velocity = {column = \"v\", use = \"off\"}\n"),
              HasSubstr("unknown key use in [columns.velocity]"));
  EXPECT_THAT(error_of(columns + "velocity = {column = \"v\", scale = 0}\n"),
              HasSubstr("columns.velocity.scale must not be zero"));
  EXPECT_THAT(error_of(columns + "velocity = \"\"\n"), HasSubstr("columns.velocity must be a text"));
  EXPECT_THAT(error_of(columns + "[date]\nsteady = true\n"), HasSubstr("did you mean data?"));
  EXPECT_THAT(error_of(columns + "[data]\nsteadi = true\n"), HasSubstr("did you mean steady?"));
}

TEST(ForeignColumns, KeepTheMessagesOfRunFiles) {
  const Result<DriveModel> model = parse_drive_model(kSmallest, "m.toml");
  ASSERT_TRUE(model);
  const auto message = [&](const char* text) {
    const Result<LoadedRun> loaded = parse_run(text, "r.csv", model->columns);
    return loaded ? std::string() : loaded.error().message;
  };
  EXPECT_THAT(message(""), HasSubstr("expected a header with t,i,count"));
  EXPECT_THAT(message("t,i\n0,1\n"), HasSubstr("column count is missing"));
  EXPECT_THAT(message("t,i,count\n0,1,x\n"), StartsWith("r.csv:2:5: count is not a finite number"));
  EXPECT_THAT(message("t,i,count\n0,1,2\n0,1,2\n"), HasSubstr("t does not increase"));
}

const std::string kPerFile =
    "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\ntorque = \"u\"\nposition = \"q\"\n"
    "[regressors]\nload = \"F\"\npayload = {per_file = true, use = \"estimate\"}\ntemperature = {per_file = "
    "true}\n";

TEST(FileValues, AreRegressorsInTheirOrder) {
  const Result<DriveModel> model =
      parse_drive_model(kPerFile +
                            "[files.\"a.csv\"]\npayload = 3\ntemperature = "
                            "21.5\n[files.\"b/a.csv\"]\npayload = 5\ntemperature = 40\n",
                        "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  const support::TemporaryDirectory folder;
  std::filesystem::create_directory(folder.path("b"));
  for (const char* name : {"a.csv", "b/a.csv", "other.csv"})
    folder.write(name, "t,u,q,F\n0,1,2,7\n1,1,2,8\n");
  const auto columns = [&](const DriveModel& of, const char* name) {
    const Result<LoadedRun> loaded = read_drive_run(folder.path(name), of);
    EXPECT_TRUE(loaded) << loaded.error().message;
    std::vector<std::vector<double>> values;
    for (std::size_t i = 0; loaded && i < loaded->run.others.size(); ++i) {
      EXPECT_EQ(loaded->run.others[i].name, of.regressors[i].name);
      values.push_back(loaded->run.others[i].values);
    }
    return values;
  };
  using Columns = std::vector<std::vector<double>>;
  EXPECT_EQ(columns(*model, "a.csv"), (Columns{{7, 8}, {3, 3}, {21.5, 21.5}}));
  EXPECT_EQ(columns(*model, "b/a.csv"), (Columns{{7, 8}, {5, 5}, {40, 40}})) << "the name that says more";
  EXPECT_EQ(model->regressors[1].use, PartUse::Estimate);
  const Result<LoadedRun> unknown = read_drive_run(folder.path("other.csv"), *model);
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().message,
              ::testing::AllOf(StartsWith("m.toml: no values for "), HasSubstr("[files.\"other.csv\"]"),
                               HasSubstr("payload")));
  // A saved model has them too.
  FittedDrive fitted;
  fitted.model = *model;
  fitted.terms.push_back({DriveTerm::Inertia, "inertia", {{BasisFunction::Carrier::Acceleration}}, {1.0}});
  const Result<FittedDrive> read = parse_fitted_drive(format_fitted_drive(fitted), "saved.toml");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(columns(read->model, "b/a.csv"), columns(*model, "b/a.csv"));
}

TEST(DriveModelFile, TheLoadsPositionComesLast) {
  const std::string columns =
      "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\ntorque = \"u\"\nload_position = {column = \"l\", "
      "minus = "
      "\"m\", scale = 10}\n";
  const Result<DriveModel> model = parse_drive_model(
      columns + "position = \"q\"\n[regressors]\nz = \"zz\"\na = {per_file = true}\n", "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_TRUE(model->load_position);
  FittedDrive fitted;
  fitted.model = *model;
  fitted.terms.push_back({DriveTerm::Inertia, "inertia", {{BasisFunction::Carrier::Acceleration}}, {1.0}});
  const Result<FittedDrive> read = parse_fitted_drive(format_fitted_drive(fitted), "saved.toml");
  ASSERT_TRUE(read) << read.error().message;
  const ColumnSource& load = read->model.columns.others.back().second;
  EXPECT_EQ(load.column, "l");
  EXPECT_EQ(load.minus, "m");
  EXPECT_EQ(load.scale, 10.0);
  EXPECT_THAT(error_of(columns + "velocity = \"v\"\n"), HasSubstr("load_position needs columns.position"));
  EXPECT_THAT(error_of(columns + "position = \"l\"\n"), HasSubstr("column l is used twice"));
}

TEST(FileValues, ErrorsNameThePlace) {
  EXPECT_THAT(error_of(kPerFile + "[files.\"a.csv\"]\npayload = 3\n"),
              HasSubstr("m.toml:11:1: [files.\"a.csv\"] lacks temperature"));
  EXPECT_THAT(error_of(kPerFile + "[files.\"a.csv\"]\npayload = \"3 kg\"\ntemperature = 1\n"),
              AllOf(StartsWith("m.toml:12:11: "), HasSubstr("payload must be a finite number")));
  EXPECT_THAT(error_of(kPerFile + "[files.\"a.csv\"]\npayload = 3\ntemperature = nan\n"),
              HasSubstr("temperature must be a finite number"));
  EXPECT_THAT(error_of(kPerFile + "[files.\"a.csv\"]\npayload = 3\ntemperature = 1\nvoltage = 4\n"),
              HasSubstr("voltage is no regressor that is per file"));
  EXPECT_THAT(error_of(kPerFile + "[files.a.csv]\npayload = 3\ntemperature = 1\n"),
              HasSubstr("[files.\"a.csv\"]"));
  EXPECT_THAT(error_of(kPerFile + "[files]\n\"a.csv\" = 3\n"), HasSubstr("must be a section"));
  EXPECT_THAT(error_of(kPerFile + "volts = {per_file = true, column = \"v\"}\n"),
              HasSubstr("unknown key column in [regressors.volts]"));
  EXPECT_THAT(error_of(kPerFile + "volts = {per_file = 1}\n"), HasSubstr("per_file must be true"));
}

}  // namespace
}  // namespace clampd
