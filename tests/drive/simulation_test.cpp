#include "clampd/drive/simulation.hpp"

#include <cmath>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using DriveRun = Run;  // testing::Test has a Run of its own
using ::testing::AllOf;
using ::testing::Each;
using ::testing::HasSubstr;
using Carrier = BasisFunction::Carrier;
using Factor = BasisFunction::Factor;

FittedDrive pendulum() {
  FittedDrive drive;
  drive.model.file = "model.toml";
  const auto add = [&](DriveTerm term, BasisFunction function, double coefficient) {
    drive.terms.push_back({term, std::string(name_of(term)), {function}, {coefficient}});
  };
  add(DriveTerm::Inertia, {Carrier::Acceleration}, 0.02);
  add(DriveTerm::Viscous, {Carrier::Velocity}, 0.03);
  add(DriveTerm::Coulomb, {Carrier::Direction}, 0.1);
  add(DriveTerm::Gravity, {Carrier::One, Factor::Sine, 1.0}, 0.4);
  return drive;
}

double turn(double time_s) {
  return 1.5 * (1.0 - std::cos(2.0 * std::numbers::pi * time_s));
}

DriveRun to_and_fro() {
  DriveRun run;
  run.name = "motion.csv";
  for (int k = 0; k <= 2000; ++k) {
    run.time_s.push_back(1e-3 * k);
    run.position_rad.push_back(turn(1e-3 * k));
  }
  return run;
}

TEST(DriveSimulation, TheTorqueOfAMotionIsThatOfTheBalance) {
  const Result<DriveRun> run = simulate_drive_torque(to_and_fro(), pendulum());
  ASSERT_TRUE(run) << run.error().message;
  const double w = 2.0 * std::numbers::pi;
  for (std::size_t k = 2; k + 2 < run->size(); ++k) {
    const double phase = w * run->time_s[k], velocity = 1.5 * w * std::sin(phase);
    if (std::abs(velocity) < 0.05) continue;
    EXPECT_NEAR(run->torque_Nm[k],
                0.02 * 1.5 * w * w * std::cos(phase) + 0.03 * velocity + std::copysign(0.1, velocity) +
                    0.4 * std::sin(run->position_rad[k]),
                1e-4)
        << k;
  }
}

TEST(DriveSimulation, AMotionUnderItsOwnTorqueIsThatMotion) {
  DriveRun torque = *simulate_drive_torque(to_and_fro(), pendulum());
  torque.position_rad.clear();
  torque.velocity_rad_s.clear();
  const Result<DriveRun> run = simulate_drive_motion(torque, pendulum(), 0.0);
  ASSERT_TRUE(run) << run.error().message;
  for (std::size_t k = 0; k < run->size(); ++k)  // of 3 rad, in an open loop
    ASSERT_NEAR(run->position_rad[k], turn(run->time_s[k]), 0.1) << k;
}

TEST(DriveSimulation, DampedBristlesHoldAMotionBackAfterAReversal) {
  FittedDrive drive = pendulum();
  drive.model.torque_held = true;
  // Their damping has a time constant of 10 us, far less than a step without them would be.
  const BasisFunction spring{Carrier::Direction, Factor::Reversal, 0.05};
  BasisFunction damping = spring;
  damping.carrier = Carrier::Velocity;
  drive.terms.push_back({DriveTerm::Presliding, "presliding", {spring, damping}, {0.2, -200.0}});
  DriveRun torque = to_and_fro();
  torque.position_rad.clear();
  for (const double time_s : torque.time_s)
    torque.torque_Nm.push_back(1.0 * std::cos(2.0 * std::numbers::pi * time_s));
  const Result<DriveRun> run = simulate_drive_motion(torque, drive, 0.0);
  ASSERT_TRUE(run) << run.error().message;
  drive.terms.back().coefficients[1] = 0.0;
  const Result<DriveRun> free = simulate_drive_motion(torque, drive, 0.0);
  ASSERT_TRUE(free) << free.error().message;
  const auto at = [](const DriveRun& of, double time_s) {
    return of.position_rad[static_cast<std::size_t>(1e3 * time_s)];
  };
  // The first motion comes from no reversal, the way back does.
  EXPECT_NEAR(at(*run, 0.2), at(*free, 0.2), 0.05);
  EXPECT_GT(at(*run, 0.9), at(*free, 0.9) + 0.2);
  for (std::size_t k = 1; k < run->size(); ++k)
    ASSERT_LT(std::abs(run->position_rad[k] - run->position_rad[k - 1]), 0.05) << k;
}

TEST(DriveSimulation, TheTorqueIsAskedForBeforeItHasToAct) {
  const DriveRun acting = *simulate_drive_torque(to_and_fro(), pendulum());
  FittedDrive late = pendulum();
  late.lag_s = 0.004;
  const DriveRun early = *simulate_drive_torque(to_and_fro(), late);
  for (std::size_t k = 0; k + 4 < early.size(); ++k)
    ASSERT_NEAR(early.torque_Nm[k], acting.torque_Nm[k + 4], 1e-9) << k;
  FittedDrive slow = pendulum();
  slow.settling_s = 0.01;
  const DriveRun asked = *simulate_drive_torque(to_and_fro(), slow);
  const std::vector<double> follows = settled(asked.time_s, asked.torque_Nm, slow.settling_s);
  for (std::size_t k = 100; k < follows.size(); ++k)
    if (std::abs(acting.velocity_rad_s[k]) > 1.0) {
      ASSERT_NEAR(follows[k], acting.torque_Nm[k], 0.01) << k;
    }
}

TEST(DriveSimulation, ADriveThatIsHeldStaysWhereFrictionHoldsIt) {
  DriveRun torque = to_and_fro();
  torque.position_rad.clear();
  torque.torque_Nm.assign(torque.size(), 0.0);
  const Result<DriveRun> run = simulate_drive_motion(torque, pendulum(), 0.2);
  ASSERT_TRUE(run) << run.error().message;
  EXPECT_THAT(run->position_rad, Each(0.2)) << "0.4 sin(0.2) = 0.079 < 0.1";
  EXPECT_THAT(run->velocity_rad_s, Each(0.0));
}

TEST(DriveSimulation, WhatNoDriveStandsIsSaid) {
  FittedDrive runaway = pendulum();
  runaway.terms[1].coefficients[0] = -5.0;
  DriveRun torque = to_and_fro();
  torque.position_rad.clear();
  torque.torque_Nm.assign(torque.size(), 1.0);
  const Result<DriveRun> run = simulate_drive_motion(torque, runaway, 0.0);
  ASSERT_FALSE(run);
  EXPECT_THAT(run.error().message, AllOf(HasSubstr("motion.csv"), HasSubstr("leaves all bounds")));
  FittedDrive massless = pendulum();
  massless.terms.erase(massless.terms.begin());
  EXPECT_FALSE(simulate_drive_motion(torque, massless, 0.0));
}

constexpr const char* kModel = R"([drive]
name = "d"
kind = "rotary"
[columns]
time = {column = "t_ms", scale = 1e-3}
torque = {column = "i", scale = 0.5, offset = 0.1}
position = {column = "counts", scale = 0.01, wrap = 100}
velocity = {column = "speed", late_s = 0.01}
drive_enabled = "on"
[regressors]
load = {column = "cell_2", minus = "cell_1", scale = 2.0}
[data]
skip_lines = 2
)";

TEST(DriveSimulation, WhatIsWrittenReadsAsTheSameRun) {
  const Result<DriveModel> model = parse_drive_model(kModel, "m.toml");
  ASSERT_TRUE(model) << model.error().message;
  DriveRun run = to_and_fro();
  for (std::size_t k = 0; k < run.size(); ++k) {
    run.torque_Nm.push_back(0.01 * static_cast<double>(k));
    run.velocity_rad_s.push_back(std::sin(0.003 * static_cast<double>(k)));
  }
  run.others = {{"load", run.torque_Nm}};
  support::TemporaryDirectory folder;
  folder.write("run.csv", format_drive_run(run, *model));
  const Result<LoadedRun> read = read_drive_run(folder.path("run.csv"), *model);
  ASSERT_TRUE(read) << read.error().message;
  // The delay costs a few rows at the end.
  ASSERT_GT(read->run.size(), run.size() - 20);
  for (std::size_t k = 20; k < read->run.size(); ++k) {
    ASSERT_NEAR(read->run.torque_Nm[k], run.torque_Nm[k], 1e-9);
    ASSERT_NEAR(read->run.position_rad[k] - read->run.position_rad[20],
                run.position_rad[k] - run.position_rad[20], 1e-9);
    ASSERT_NEAR(read->run.velocity_rad_s[k], run.velocity_rad_s[k], 1e-5);
    ASSERT_NEAR(read->run.others.front().values[k], run.torque_Nm[k], 1e-9);
  }
}

TEST(DriveSimulation, OneColumnOfMotionIsEnoughAndATorqueNeedsNone) {
  const Result<DriveModel> model = parse_drive_model(kModel, "m.toml");
  ASSERT_TRUE(model);
  support::TemporaryDirectory folder;
  const auto write = [&](const std::string& name, const std::string& header) {
    std::string text = "\n\n" + header + "\n";
    for (int k = 0; k < 20; ++k) text += std::to_string(k) + "," + std::to_string(k) + ",3,1\n";
    folder.write(name, text);
    return folder.path(name);
  };
  const Result<LoadedRun> position = read_drive_motion(write("a.csv", "t_ms,counts,cell_2,cell_1"), *model);
  ASSERT_TRUE(position) << position.error().message;
  EXPECT_TRUE(position->run.velocity_rad_s.empty());
  EXPECT_DOUBLE_EQ(position->run.position_rad[7], 0.07);
  const Result<LoadedRun> velocity = read_drive_motion(write("b.csv", "t_ms,speed,cell_2,cell_1"), *model);
  ASSERT_TRUE(velocity) << velocity.error().message;
  EXPECT_TRUE(velocity->run.position_rad.empty());
  const Result<LoadedRun> torque = read_drive_torque(write("c.csv", "t_ms,i,cell_2,cell_1"), *model);
  ASSERT_TRUE(torque) << torque.error().message;
  EXPECT_DOUBLE_EQ(torque->run.torque_Nm[7], 3.6);
  EXPECT_DOUBLE_EQ(torque->run.others.front().values[7], 4.0);
  const Result<LoadedRun> neither = read_drive_motion(write("d.csv", "t_ms,i,cell_2,cell_1"), *model);
  ASSERT_FALSE(neither);
  EXPECT_THAT(neither.error().message, HasSubstr("counts"));
}

}  // namespace
}  // namespace clampd
