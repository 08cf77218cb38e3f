// The gear between motor and load, against an independent simulation of two masses.

#include <algorithm>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/drive/diagnosis.hpp"
#include "drive/two_masses.hpp"

namespace clampd {
namespace {

using DriveRun = Run;  // testing::Test has a Run of its own
using drive_test::TwoMasses;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<DataFinding> findings_of(const std::vector<DriveRun>& runs) {
  const Result<DriveModel> model = parse_drive_model(
      "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\ntorque = \"u\"\nposition = \"q\"\n"
      "load_position = {column = \"load\", scale = 10}\n[data]\ntorque_held = true\n",
      "m.toml");
  EXPECT_TRUE(model) << model.error().message;
  const Result<DriveDiagnosis> diagnosis = diagnose_drive(runs, *model, {});
  EXPECT_TRUE(diagnosis) << diagnosis.error().message;
  std::vector<DataFinding> found;
  for (const DataFinding& finding : diagnosis->data)
    if (finding.column == "load") found.push_back(finding);
  return found;
}

std::vector<std::string> names(const std::vector<DataFinding>& findings) {
  std::vector<std::string> result;
  for (const DataFinding& finding : findings) result.push_back(finding.name);
  return result;
}

void expect_within(const DataFinding& finding, double truth, double sds, double slack) {
  EXPECT_GT(finding.sd, 0.0) << finding.words;
  EXPECT_NEAR(finding.size, truth, sds * finding.sd + slack * truth) << finding.words;
  EXPECT_LT(finding.sd, 0.5 * truth) << finding.words;
}

TEST(Gear, PlayIsMeasured) {
  for (const double backlash : {0.002, 0.02}) {
    TwoMasses drive;
    drive.backlash = backlash;
    const std::vector<DataFinding> found = findings_of({record(drive, 1), record(drive, 2)});
    ASSERT_THAT(names(found), ElementsAre("gear-backlash")) << backlash;
    expect_within(found.front(), backlash, 3.0, 0.1);
    EXPECT_EQ(found.front().unit, "rad");
    EXPECT_THAT(found.front().words, HasSubstr("sign of the torque"));
  }
}

TEST(Gear, ComplianceIsMeasured) {
  for (const double stiffness : {10.0, 40.0}) {
    TwoMasses drive;
    drive.stiffness = stiffness;
    const std::vector<DataFinding> found = findings_of({record(drive, 1), record(drive, 2)});
    ASSERT_THAT(names(found), ElementsAre("gear-compliance")) << stiffness;
    expect_within(found.front(), stiffness, 3.0, 0.05);
    EXPECT_EQ(found.front().unit, "N m/rad");
  }
}

TEST(Gear, BothAtOnce) {
  TwoMasses drive;
  drive.backlash = 0.01;
  drive.stiffness = 30.0;
  const std::vector<DataFinding> found = findings_of({record(drive, 3), record(drive, 4)});
  ASSERT_THAT(names(found), ElementsAre("gear-backlash", "gear-compliance"));
  expect_within(found[0], drive.backlash, 3.0, 0.2);
  expect_within(found[1], drive.stiffness, 3.0, 0.1);
}

TEST(Gear, NoiseAndCoarseEncodersAreNoPlay) {
  for (unsigned seed = 1; seed <= 6; ++seed) {
    TwoMasses drive;
    drive.stiffness = 20'000.0;
    drive.damping = 0.3;
    drive.motor_step = seed % 2 == 0 ? 1e-3 : 3e-3;
    drive.load_step = seed % 3 == 0 ? 2e-2 : 7e-3;
    drive.position_noise = seed % 2 == 0 ? 1e-3 : 0.0;
    EXPECT_THAT(names(findings_of({record(drive, seed), record(drive, seed + 100)})), IsEmpty()) << seed;
  }
}

// Friction alone has one size: what twists by it might as well be loose.
TEST(Gear, WhereTheTorqueHasOneSizeNothingMoreIsSaid) {
  TwoMasses drive;
  drive.stiffness = 40.0;
  drive.ramp = 4.0;
  drive.fastest = 3.0;
  drive.motor_viscous = drive.load_viscous = 0.0;
  drive.motor_step = drive.load_step = 5e-4;
  const std::vector<DataFinding> found = findings_of({record(drive, 8), record(drive, 9)});
  ASSERT_THAT(names(found), ElementsAre("gear-play"));
  EXPECT_NEAR(found.front().size, 2.0 * drive.load_coulomb / drive.stiffness, 2e-4);
}

TEST(Gear, ALateReadingIsADelay) {
  for (const int rows : {3, 8}) {
    TwoMasses drive;
    drive.stiffness = 20'000.0;
    drive.damping = 0.3;
    drive.load_rows_late = rows;
    const std::vector<DataFinding> found = findings_of({record(drive, 5), record(drive, 6)});
    ASSERT_THAT(names(found), ElementsAre("load-delay")) << rows;
    EXPECT_NEAR(found.front().size, 1e-3 * rows, 1e-4);
    EXPECT_THAT(found.front().words, HasSubstr("later"));
  }
}

TEST(Gear, PlayOfALateReadingIsPlayAndADelay) {
  TwoMasses drive;
  drive.backlash = 0.005;
  drive.load_rows_late = 5;
  const std::vector<DataFinding> found = findings_of({record(drive, 11), record(drive, 12)});
  ASSERT_THAT(names(found), ElementsAre("load-delay", "gear-backlash"));
  EXPECT_NEAR(found[0].size, 5e-3, 1e-4);
  expect_within(found[1], drive.backlash, 3.0, 0.1);
}

TEST(Gear, AnotherRatioIsSaid) {
  TwoMasses drive;
  std::vector<DriveRun> runs{record(drive, 7)};
  for (double& load : runs.front().others.front().values) load *= 1.01;
  std::vector<DataFinding> found = findings_of(runs);
  ASSERT_THAT(names(found), ElementsAre("gear-ratio"));
  EXPECT_NEAR(found.front().size, 1.01, 1e-4);
  for (double& load : runs.front().others.front().values) load *= -0.1;
  found = findings_of(runs);
  ASSERT_THAT(names(found), ElementsAre("gear-ratio"));
  EXPECT_THAT(found.front().words, HasSubstr("nothing can be told"));
}

}  // namespace
}  // namespace clampd
