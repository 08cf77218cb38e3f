#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/drive/diagnosis.hpp"

/// Data that others measured; sources and licences stand beside them.
namespace clampd {
namespace {

using DriveRun = Run;  // testing::Test has a Run of its own

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using ::testing::Not;

fs::path data_folder() {
  if (const char* shared = std::getenv("CLAMPD_SHARED")) return fs::path(shared) / "data";
  return fs::path(CLAMPD_SOURCE_DIR) / "../shared/data";
}

class MeasuredDrives : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!fs::exists(data_folder()))
      GTEST_SKIP() << "no measured data at " << data_folder() << "; set CLAMPD_SHARED";
  }

  static DriveModel model(const std::string& name) {
    const Result<DriveModel> read = read_drive_model(CLAMPD_SOURCE_DIR "/configs/drives/" + name);
    EXPECT_TRUE(read) << read.error().message;
    return *read;
  }

  static std::vector<DriveRun> runs(const std::string& folder, const std::string& part,
                                    const DriveModel& model) {
    std::vector<std::string> files;
    for (const auto& entry : fs::directory_iterator(data_folder() / folder))
      if (entry.path().filename().string().find(part) != std::string::npos)
        files.push_back(entry.path().string());
    std::sort(files.begin(), files.end());
    std::vector<DriveRun> result;
    for (const std::string& file : files) {
      Result<LoadedRun> loaded = read_run(file, model.columns);
      EXPECT_TRUE(loaded) << loaded.error().message;
      result.push_back(std::move(loaded->run));
    }
    EXPECT_FALSE(result.empty()) << folder << " " << part;
    return result;
  }

  static Diagnosis diagnosed(std::span<const DriveRun> runs, const DriveModel& model,
                             std::span<const DriveRun> heldout = {}) {
    DiagnoseOptions options;
    options.heldout = heldout;
    Result<Diagnosis> diagnosis = diagnose_drive(runs, model, options);
    EXPECT_TRUE(diagnosis) << diagnosis.error().message;
    return std::move(*diagnosis);
  }

  static std::vector<std::string> names(const Diagnosis& diagnosis) {
    std::vector<std::string> result;
    for (const NamedEffect& effect : diagnosis.effects) result.push_back(effect.name);
    return result;
  }

  static const NamedEffect& effect(const Diagnosis& diagnosis, const std::string& name) {
    for (const NamedEffect& each : diagnosis.effects)
      if (each.name == name) return each;
    ADD_FAILURE() << "no effect " << name << ": " << diagnosis.summary;
    static const NamedEffect none;
    return none;
  }

  static EstimatedParameter find(const std::vector<EstimatedParameter>& parameters, const std::string& name) {
    for (const EstimatedParameter& parameter : parameters)
      if (parameter.name == name) return parameter;
    ADD_FAILURE() << "no parameter " << name;
    return {};
  }

  static void expect_published(const EstimatedParameter& parameter, double published) {
    EXPECT_GT(parameter.sd, 0.0) << parameter.name;
    EXPECT_LT(parameter.sd, 0.05 * published) << parameter.name << ": an uncertainty that says nothing";
    EXPECT_NEAR(parameter.value, published, 2.0 * parameter.sd) << parameter.name;
  }

  static double statistic(const std::vector<MisfitTest>& tests, const std::string& name) {
    for (const MisfitTest& test : tests)
      if (test.name == name) return test.statistic;
    ADD_FAILURE() << "no test " << name;
    return std::numeric_limits<double>::quiet_NaN();
  }

  static double order_amplitude(const NamedEffect& cogging, double order, const std::string& direction = "") {
    for (int k = 1;; ++k) {
      const std::string number = "-" + std::to_string(k);
      const auto has = [&](const EstimatedParameter& p) { return p.name == "order" + number; };
      if (std::none_of(cogging.parameters.begin(), cogging.parameters.end(), has)) return 0.0;
      if (find(cogging.parameters, "order" + number).value == order)
        return find(cogging.parameters, "amplitude" + direction + number).value;
    }
  }
};

// Janot, Gautier and Brunot 2019: symmetric friction leaves 4.0834 %, friction of its own in each
// direction 3.1117 %, as a command that acts when it is given, filtered at 40 Hz.
TEST_F(MeasuredDrives, EmpsTheAuthorsModelsAreReproduced) {
  DriveModel emps = model("emps.toml");
  emps.torque_held = false;
  emps.cut_off_Hz = 40.0;
  for (DrivePart& part : emps.parts)
    if (part.use == PartUse::Candidate) part.use = PartUse::Off;
  const auto part = [&](DriveTerm term) -> DrivePart& { return emps.parts[static_cast<std::size_t>(term)]; };
  const auto set = runs("emps", "emps.csv", emps);

  part(DriveTerm::TorqueOffset).use = PartUse::Estimate;
  const Diagnosis symmetric = diagnosed(set, emps);
  EXPECT_NEAR(statistic(symmetric.misfit.tests_after, "relative torque error"), 0.0408, 0.0025);
  EXPECT_NEAR(find(symmetric.parameters_after, "inertia").value, 95.1089, 0.3);
  EXPECT_NEAR(find(symmetric.parameters_after, "viscous").value, 203.5034, 2.0);
  EXPECT_NEAR(find(symmetric.parameters_after, "coulomb").value, 20.3935, 0.2);
  EXPECT_NEAR(find(symmetric.parameters_after, "torque-offset.offset").value, -3.1648, 0.1);

  part(DriveTerm::TorqueOffset).use = PartUse::Off;
  part(DriveTerm::FrictionAsymmetry).use = PartUse::Estimate;
  const Diagnosis asymmetric = diagnosed(set, emps);
  EXPECT_NEAR(statistic(asymmetric.misfit.tests_after, "relative torque error"), 0.0311, 0.0025);
  const auto& parameters = asymmetric.parameters_after;
  expect_published(find(parameters, "inertia"), 95.1540);
  expect_published(find(parameters, "friction-asymmetry.viscous-forward"), 166.7061);
  expect_published(find(parameters, "friction-asymmetry.coulomb-forward"), 20.1440);
  expect_published(find(parameters, "friction-asymmetry.viscous-backward"), 240.4236);
  expect_published(find(parameters, "friction-asymmetry.coulomb-backward"), 20.6277);
}

TEST_F(MeasuredDrives, EmpsFrictionDiffersByDirection) {
  const DriveModel emps = model("emps.toml");
  const Diagnosis diagnosis = diagnosed(runs("emps", "emps.csv", emps), emps);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Explained);
  EXPECT_THAT(diagnosis.rivals, ElementsAre(ElementsAre("friction-asymmetry", "torque-offset")));
  EXPECT_THAT(diagnosis.notices, Contains(HasSubstr("may as well be a constant torque")));
  const NamedEffect& asymmetry = effect(diagnosis, "friction-asymmetry");
  EXPECT_LT(asymmetry.p_value, 1e-6);
  expect_published(find(diagnosis.parameters_after, "inertia"), 95.1540);
  expect_published(find(asymmetry.parameters, "viscous-forward"), 166.7061);
  expect_published(find(asymmetry.parameters, "coulomb-forward"), 20.1440);
  expect_published(find(asymmetry.parameters, "viscous-backward"), 240.4236);
  expect_published(find(asymmetry.parameters, "coulomb-backward"), 20.6277);
  EXPECT_LE(statistic(diagnosis.misfit.tests_after, "relative torque error"), 0.032);
  ASSERT_TRUE(diagnosis.gain);
  EXPECT_LE(diagnosis.gain->after.torque_error_relative, 0.032) << "also where it was left out of the fit";
  EXPECT_GT(diagnosis.gain->before.torque_error_relative, 0.07);
  // Of the ripple of one screw turn, 50 Hz at the highest speed, the filter leaves too little for what is
  // learned at some speeds to help at the others.
  EXPECT_THAT(names(diagnosis), Not(Contains("cogging")));
}

// A lead screw: friction falls up to about 5 rad/s and then rises (Stribeck), more in one direction than in
// the other, and ripples once and twice a turn.
TEST_F(MeasuredDrives, LeadScrewHasStribeckFriction) {
  const DriveModel screw = model("screw_steady.toml");
  const Diagnosis diagnosis = diagnosed(runs("screw_drives", "driveNo1__steady", screw), screw);
  EXPECT_THAT(names(diagnosis), IsSupersetOf({"friction-shape", "torque-offset", "cogging"}));
  EXPECT_THAT(diagnosis.rivals, ElementsAre(ElementsAre("torque-offset", "friction-asymmetry")));
  EXPECT_NEAR(find(effect(diagnosis, "torque-offset").parameters, "offset").value, -3.8e-4, 0.3e-4);
  const EstimatedParameter rise = find(effect(diagnosis, "friction-shape").parameters, "rise");
  EXPECT_GT(rise.value, 5.0 * rise.sd);
  EXPECT_NEAR(find(diagnosis.parameters_after, "viscous").value, 4.7e-5, 1e-5);
  EXPECT_GT(order_amplitude(effect(diagnosis, "cogging"), 1.0, "-backward"), 1e-4);
  EXPECT_GT(order_amplitude(effect(diagnosis, "cogging"), 2.0, "-forward"), 1e-4);
  EXPECT_LT(statistic(diagnosis.misfit.tests_after, "relative torque error"), 0.02);
}

// An anti-backlash screw: dry friction nearly twice as high and flat, and a ripple once a turn of a fifth of
// it forward.
TEST_F(MeasuredDrives, AntiBacklashScrewHasMoreDryFrictionAndNoStribeck) {
  const DriveModel screw = model("screw_steady.toml");
  const Diagnosis diagnosis = diagnosed(runs("screw_drives", "driveNo2__steady", screw), screw);
  EXPECT_THAT(names(diagnosis), ElementsAre("torque-offset", "cogging"));
  EXPECT_THAT(diagnosis.rivals, ElementsAre(ElementsAre("torque-offset", "friction-asymmetry")));
  EXPECT_NEAR(find(diagnosis.parameters_after, "coulomb").value, 4.6e-3, 0.2e-3);
  const double forward = order_amplitude(effect(diagnosis, "cogging"), 1.0, "-forward");
  EXPECT_NEAR(forward, 1.1e-3, 0.2e-3);
  EXPECT_GT(forward, 1.5 * order_amplitude(effect(diagnosis, "cogging"), 1.0, "-backward"));
}

TEST_F(MeasuredDrives, StartsAndStopsAgreeWithTheMaps) {
  const DriveModel screw = model("screw_start_stop.toml");
  for (const auto& [drive, coulomb] : {std::pair{"driveNo1__start", 2.65e-3}, {"driveNo2__start", 4.65e-3}}) {
    const Diagnosis diagnosis = diagnosed(runs("screw_drives", drive, screw), screw);
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Ambiguous) << diagnosis.summary;
    ASSERT_EQ(diagnosis.rivals.size(), 1u);
    EXPECT_THAT(diagnosis.rivals.front(),
                ::testing::UnorderedElementsAre("torque-offset", "friction-asymmetry"));
    EXPECT_NEAR(find(diagnosis.parameters_after, "coulomb").value, coulomb, 0.15e-3);
  }
}

// Seven periods a turn with harmonics. The current of the compensated runs carries the map: it ripples as
// before, while the motion that it is meant for does so much less.
TEST_F(MeasuredDrives, CoggingAndItsCompensation) {
  const DriveModel motor = model("cogging_motor.toml");
  const auto plain = runs("cogging", "__nocomp", motor);
  const auto compensated = runs("cogging", "__comp", motor);
  const Diagnosis without = diagnosed(plain, motor);
  const NamedEffect& cogging = effect(without, "cogging");
  EXPECT_EQ(find(cogging.parameters, "order-1").value, 7.0);
  EXPECT_NEAR(order_amplitude(cogging, 7.0), 0.8, 0.1);
  EXPECT_NEAR(order_amplitude(cogging, 14.0), 0.2, 0.05);
  EXPECT_GT(order_amplitude(cogging, 28.0), 0.1);
  EXPECT_LT(statistic(without.misfit.tests_after, "relative torque error"),
            0.3 * statistic(without.misfit.tests_before, "relative torque error"));

  const Diagnosis with = diagnosed(compensated, motor);
  EXPECT_NEAR(order_amplitude(effect(with, "cogging"), 7.0), order_amplitude(cogging, 7.0), 0.05);
  EXPECT_LT(statistic(with.misfit.tests_after, "unevenness of the motion"),
            0.5 * statistic(without.misfit.tests_after, "unevenness of the motion"));

  const Diagnosis both = diagnosed(plain, motor, compensated);
  EXPECT_THAT(names(both), Contains("cogging"));
  EXPECT_THAT(both.notices, Contains(HasSubstr("there the drive compensates it")));
  EXPECT_LT(both.gain->after.rms_torque_Nm, 0.4 * both.gain->before.rms_torque_Nm)
      << "the ripple learned in one set predicts the current of the other";
}

}  // namespace
}  // namespace clampd
