#include "clampd/drive/prediction.hpp"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drive/recorded_drive.hpp"

namespace clampd {
namespace {

using DriveRun = Run;  // testing::Test has a Run of its own
using ::testing::HasSubstr;

FittedDrive drive_of(double inertia, double viscous, double coulomb) {
  using Carrier = BasisFunction::Carrier;
  FittedDrive drive;
  drive.model.file = "model.toml";
  const auto add = [&](DriveTerm term, Carrier carrier, double coefficient) {
    drive.terms.push_back({term, std::string(name_of(term)), {{carrier}}, {coefficient}});
  };
  add(DriveTerm::Inertia, Carrier::Acceleration, inertia);
  add(DriveTerm::Viscous, Carrier::Velocity, viscous);
  add(DriveTerm::Coulomb, Carrier::Direction, coulomb);
  return drive;
}

DriveRun constant_torque(double torque, double rate_Hz, double duration_s) {
  DriveRun run;
  run.name = "run";
  for (int k = 0; k <= static_cast<int>(duration_s * rate_Hz); ++k) {
    run.time_s.push_back(k / rate_Hz);
    run.torque_Nm.push_back(torque);
    run.position_rad.push_back(0.0);
  }
  return run;
}

PredictedRun predicted(const DriveRun& run, const FittedDrive& drive) {
  Result<std::vector<PredictedRun>> result = predict_drive(std::span(&run, 1), drive);
  EXPECT_TRUE(result) << result.error().message;
  return std::move(result->front());
}

// From rest under a constant torque: v = (T - TC) / Tv (1 - exp(-Tv t / J)).
TEST(DrivePrediction, TheSpeedUpIsTheExactOneAtAnySampling) {
  for (const double rate_Hz : {25.0, 1000.0, 10'000.0})
    for (const auto& [inertia, viscous] : {std::pair{1e-6, 2e-6}, {0.02, 0.1}, {0.02, 4.0}, {100.0, 300.0}}) {
      const FittedDrive drive = drive_of(inertia, viscous, 0.5 * viscous);
      const PredictedRun run = predicted(constant_torque(2.0 * viscous, rate_Hz, 1.0), drive);
      const std::vector<double>& velocity = run.quantities.back().predicted;
      for (std::size_t k = 1; k < velocity.size(); ++k) {
        const double exact = 1.5 * (1.0 - std::exp(-viscous / inertia * run.time_s[k]));
        ASSERT_NEAR(velocity[k], exact, 0.02 * 1.5)
            << rate_Hz << " Hz, J " << inertia << ", at " << run.time_s[k];
      }
      EXPECT_NEAR(velocity.back(), 1.5 * (1.0 - std::exp(-viscous / inertia)), 0.01);
    }
}

TEST(DrivePrediction, DryFrictionHoldsExactlyAndNeverDrives) {
  for (const double rate_Hz : {25.0, 10'000.0}) {
    const FittedDrive drive = drive_of(1e-3, 1e-3, 0.2);
    for (const double torque : {0.19, -0.19}) {
      const PredictedRun still = predicted(constant_torque(torque, rate_Hz, 1.0), drive);
      EXPECT_EQ(still.quantities.front().predicted.back(), 0.0) << rate_Hz;
      EXPECT_EQ(still.quantities.back().predicted.back(), 0.0) << rate_Hz;
    }
  }
}

// The drive of another simulation: its torque alone gives its motion, and a model with a tenth more friction
// does not.
TEST(DrivePrediction, TheTrueModelPredictsAndAWrongOneDoesNot) {
  drive_test::RecordedDrive truth;
  truth.reference_rate = drive_test::trapezoids(4);
  truth.torque_noise = 0.0;
  truth.encoder_step = 1e-6;
  truth.duration_s = 5.0;
  const DriveRun run = drive_test::record(truth, 4);
  const double unit = truth.inertia * truth.length;
  FittedDrive drive = drive_of(truth.inertia, truth.inertia * truth.viscous, unit * truth.coulomb);
  drive.model.torque_held = true;
  const PredictedRun right = predicted(run, drive);
  ASSERT_EQ(right.quantities.size(), 2u);
  EXPECT_LT(error_of(right.quantities[0]).of_standard_deviation, 0.05);
  EXPECT_LT(error_of(right.quantities[1]).of_standard_deviation, 0.03);
  ASSERT_EQ(right.limited.size(), 2u);
  EXPECT_LT(error_of(right.limited[0].quantities[1]).of_standard_deviation, 0.02);
  drive.terms[2].coefficients[0] *= 1.1;
  const PredictedRun wrong = predicted(run, drive);
  EXPECT_GT(error_of(wrong.quantities[0]).of_standard_deviation,
            3.0 * error_of(right.quantities[0]).of_standard_deviation);
  EXPECT_GT(error_of(wrong.quantities[0]).rms, error_of(wrong.limited[0].quantities[0]).rms)
      << "an open loop drifts";
}

TEST(DrivePrediction, ALateTorqueIsMovedBack) {
  drive_test::RecordedDrive truth;
  truth.reference_rate = drive_test::sines(1.0);
  truth.torque_noise = 0.0;
  truth.encoder_step = 1e-6;
  truth.duration_s = 4.0;
  DriveRun run = drive_test::record(truth, 4);
  // The reading of a row is the torque of 10 rows before.
  run.torque_Nm.insert(run.torque_Nm.begin(), 10, run.torque_Nm.front());
  run.torque_Nm.resize(run.size());
  FittedDrive drive =
      drive_of(truth.inertia, truth.inertia * truth.viscous, truth.inertia * truth.length * truth.coulomb);
  drive.model.torque_held = true;
  const double as_read = error_of(predicted(run, drive).limited[0].quantities[1]).rms;
  double least = as_read;
  for (const double lag_s : {0.01, -0.01}) {
    drive.lag_s = lag_s;
    least = std::min(least, error_of(predicted(run, drive).limited[0].quantities[1]).rms);
  }
  EXPECT_LT(least, 0.5 * as_read);
}

TEST(DrivePrediction, WhatCannotBeSimulatedIsAnError) {
  const DriveRun run = constant_torque(1.0, 100.0, 1.0);
  const auto message = [&](const FittedDrive& drive, const DriveRun& of) {
    const Result<std::vector<PredictedRun>> result = predict_drive(std::span(&of, 1), drive);
    return result ? std::string("no error") : result.error().message;
  };
  FittedDrive drive = drive_of(0.0, 1.0, 1.0);
  EXPECT_THAT(message(drive, run), HasSubstr("model.toml: the fitted model has no positive inertia"));
  drive = drive_of(1.0, 1.0, 1.0);
  drive.model.steady = true;
  EXPECT_THAT(message(drive, run), HasSubstr("steady speeds"));
  drive.model.steady = false;
  drive.model.regressors.push_back({.name = "load"});
  EXPECT_THAT(message(drive, run), HasSubstr("run: the model needs the column load"));
  drive.model.regressors.clear();
  DriveRun few = run;
  for (std::vector<double>* column : {&few.time_s, &few.torque_Nm, &few.position_rad}) column->resize(4);
  EXPECT_THAT(message(drive, few), HasSubstr("4 rows are too few"));
}

TEST(Prediction, ErrorsAreThoseOfTheRowsThatCount) {
  const double none = std::numeric_limits<double>::quiet_NaN();
  const PredictionError error =
      error_of({"force", "N", {1.0, -1.0, 1.0, -1.0, 9.0}, {1.5, -0.5, 1.5, -0.5, none}});
  EXPECT_DOUBLE_EQ(error.rms, 0.5);
  EXPECT_DOUBLE_EQ(error.of_standard_deviation, 0.5);
  EXPECT_DOUBLE_EQ(error.fit_percent, 50.0);
  EXPECT_TRUE(std::isnan(error_of({"force", "N", {2.0, 2.0}, {1.0, 3.0}}).fit_percent))
      << "a constant has no fit";
  PredictedRun run;
  run.name = "a,b.csv";
  run.time_s = {0.0, 0.1};
  run.quantities = {{"force", "N", {1.0, 2.0}, {0.5, none}}};
  EXPECT_EQ(format_residuals(std::span(&run, 1)),
            "run,time_s,force_measured,force_predicted,force_residual\n\"a,b.csv\",0,1,0.5,0.5\n\"a,b.csv\","
            "0.1,2,,\n");
}

}  // namespace
}  // namespace clampd
