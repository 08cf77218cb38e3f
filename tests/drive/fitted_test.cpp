#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/drive/model.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

DriveModel model_with_columns() {
  const Result<DriveModel> model = parse_drive_model(R"([drive]
name = "a \"quoted\" drive"
kind = "linear"
unit = "A"
[columns]
time = "t"
torque = {column = "i", scale = 0.1, offset = -0.3}
position = {column = "x", scale = 1e-6, wrap = 4294967296}
drive_enabled = "on"
[regressors]
load = {column = "cell_2", minus = "cell_1", scale = 2.5, offset = 7}
temperature = {column = "T", use = "off"}
gravity = {column = "g", use = "known-torque"}
[model]
inertia = 0.125
cogging = "off"
gravity = "estimate"
[data]
torque_held = true
cut_off_Hz = 33.3
good_enough = 0.031
skip_lines = 3
)",
                                                     "m.toml");
  EXPECT_TRUE(model) << model.error().message;
  return *model;
}

/// Every term with every function of the state that there is, with numbers that have no short decimal form.
FittedDrive every_function(unsigned seed) {
  using Carrier = BasisFunction::Carrier;
  using Factor = BasisFunction::Factor;
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> uniform(0.5, 2.0);
  const std::vector<std::pair<DriveTerm, std::vector<std::pair<Carrier, Factor>>>> terms{
      {DriveTerm::Inertia, {{Carrier::Acceleration, Factor::One}}},
      {DriveTerm::Viscous, {{Carrier::Velocity, Factor::One}}},
      {DriveTerm::Coulomb, {{Carrier::Direction, Factor::One}}},
      {DriveTerm::TorqueOffset, {{Carrier::One, Factor::One}}},
      {DriveTerm::FrictionAsymmetry, {{Carrier::Sliding, Factor::One}, {Carrier::Sliding, Factor::Power}}},
      {DriveTerm::FrictionShape, {{Carrier::Direction, Factor::Stribeck}}},
      {DriveTerm::Presliding,
       {{Carrier::Direction, Factor::Reversal}, {Carrier::Velocity, Factor::Reversal}}},
      {DriveTerm::Cogging, {{Carrier::One, Factor::Cosine}, {Carrier::One, Factor::Sine}}},
      {DriveTerm::LoadPosition,
       {{Carrier::One, Factor::Place},
        {Carrier::One, Factor::PlaceSquared},
        {Carrier::One, Factor::PlaceCubed}}},
      {DriveTerm::InertiaPosition,
       {{Carrier::Acceleration, Factor::Place}, {Carrier::Acceleration, Factor::Sine}}},
      {DriveTerm::FrictionDrift,
       {{Carrier::Direction, Factor::Time},
        {Carrier::Direction, Factor::TimeDecay},
        {Carrier::Velocity, Factor::Run},
        {Carrier::Direction, Factor::InRun}}},
      {DriveTerm::Regressor, {{Carrier::One, Factor::Column}, {Carrier::One, Factor::ColumnSize}}},
      {DriveTerm::LoadFriction,
       {{Carrier::Direction, Factor::Load}, {Carrier::Direction, Factor::StaticLoad}}},
      {DriveTerm::TorqueSaturation, {{Carrier::One, Factor::Balance}, {Carrier::One, Factor::BalancePower}}},
  };
  FittedDrive drive;
  drive.model = model_with_columns();
  Eigen::Index coefficients = 0;
  for (const auto& [term, functions] : terms) {
    FittedTerm fitted{term, std::string(name_of(term)), {}, {}};
    if (term == DriveTerm::Regressor) fitted.name += ":temperature";
    for (const auto& [carrier, factor] : functions) {
      const bool column = factor == Factor::Column || factor == Factor::ColumnSize;
      const double power = factor == Factor::BalancePower ? 2.0 : 0.0;  // it needs more than 1
      fitted.functions.push_back({carrier, factor, uniform(random), power + uniform(random),
                                  column                   ? 1
                                  : factor == Factor::Sine ? 2
                                                           : -1});
      fitted.coefficients.push_back(uniform(random) / 3.0);
      ++coefficients;
    }
    drive.terms.push_back(std::move(fitted));
  }
  drive.covariance = Eigen::MatrixXd::Zero(coefficients, coefficients);
  for (Eigen::Index i = 0; i < coefficients; ++i)
    for (Eigen::Index j = 0; j <= i; ++j)
      drive.covariance(i, j) = drive.covariance(j, i) = 1e-9 * uniform(random);
  drive.lag_s = -1.0 / 3000.0;
  drive.settling_s = 1.0 / 700.0;
  drive.cut_off_Hz = 100.0 / 3.0;
  drive.slow_speed = 1e-5 / 7.0;
  drive.error_rms = 0.02 / 9.0;
  return drive;
}

TEST(FittedDriveFile, GivesTheSameTorqueWhenItIsReadBack) {
  const FittedDrive drive = every_function(1);
  const Result<FittedDrive> read = parse_fitted_drive(format_fitted_drive(drive), "saved.toml");
  ASSERT_TRUE(read) << read.error().message;
  std::mt19937_64 random(2);
  std::normal_distribution<double> normal;
  std::vector<double> columns(3);
  for (int i = 0; i < 200; ++i) {
    for (double& column : columns) column = 3.0 * normal(random);
    DriveState state{std::abs(normal(random)), i % 5, 2.0 * normal(random), normal(random),
                     10.0 * normal(random)};
    state.direction = i % 7 == 0 ? 0.0 : std::copysign(1.0, state.velocity);
    state.travel = std::abs(normal(random));
    state.columns = columns;
    const double torque = torque_of(drive, state);
    ASSERT_TRUE(std::isfinite(torque));
    EXPECT_DOUBLE_EQ(torque_of(*read, state), torque);
  }
}

TEST(FittedDriveFile, KeepsWhatASimulationNeedsBesides) {
  const FittedDrive drive = every_function(3);
  const Result<FittedDrive> read = parse_fitted_drive(format_fitted_drive(drive), "saved.toml");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->lag_s, drive.lag_s);
  EXPECT_EQ(read->settling_s, drive.settling_s);
  EXPECT_EQ(read->cut_off_Hz, drive.cut_off_Hz);
  EXPECT_EQ(read->slow_speed, drive.slow_speed);
  EXPECT_EQ(read->error_rms, drive.error_rms);
  EXPECT_EQ(read->covariance, drive.covariance);
  const DriveModel &model = read->model, &before = drive.model;
  EXPECT_EQ(model.name, before.name);
  EXPECT_EQ(model.linear, before.linear);
  EXPECT_EQ(model.torque_unit, before.torque_unit);
  EXPECT_EQ(model.torque_held, before.torque_held);
  EXPECT_EQ(model.good_enough, before.good_enough);
  EXPECT_EQ(model.cut_off_Hz, before.cut_off_Hz);
  EXPECT_EQ(model.columns.skip_lines, 3);
  EXPECT_EQ(model.columns.torque->offset, -0.3);
  EXPECT_EQ(model.columns.position->wrap, 4294967296.0);
  EXPECT_EQ(model.part(DriveTerm::Inertia).value, 0.125);
  EXPECT_EQ(model.part(DriveTerm::Cogging).use, PartUse::Off);
  ASSERT_EQ(model.regressors.size(), 3u);
  for (const DriveRegressor& wanted : before.regressors) {
    const auto found = std::find_if(model.regressors.begin(), model.regressors.end(),
                                    [&](const DriveRegressor& each) { return each.name == wanted.name; });
    ASSERT_NE(found, model.regressors.end()) << wanted.name;
    EXPECT_EQ(found->use, wanted.use) << wanted.name;
    EXPECT_EQ(found->known_torque, wanted.known_torque) << wanted.name;
  }
}

TEST(FittedDriveFile, ErrorsSayWhatIsWrongAndWhere) {
  const std::string good = format_fitted_drive(every_function(4));
  const auto error_of = [](const std::string& text) {
    const Result<FittedDrive> read = parse_fitted_drive(text, "saved.toml");
    return read ? std::string() : read.error().message;
  };
  const auto replaced = [&](const std::string& what, const std::string& by) {
    std::string text = good;
    const std::size_t at = text.find(what);
    EXPECT_NE(at, std::string::npos) << what;
    return at == std::string::npos ? text : text.replace(at, what.size(), by);
  };
  EXPECT_EQ(error_of(good), "");
  EXPECT_THAT(
      error_of("[drive]\nkind = \"linear\"\n[columns]\ntime = \"t\"\ntorque = \"u\"\nposition = \"x\"\n"),
      HasSubstr("[fitted] is missing"));
  EXPECT_THAT(error_of(replaced("torque-offset'", "torque-ofset'")), StartsWith("saved.toml:"));
  EXPECT_THAT(error_of(replaced("lag_s = ", "lag_s = nan #")), HasSubstr("lag_s must be a finite number"));
  EXPECT_THAT(error_of(replaced("lag_s = ", "leg_s = ")), HasSubstr("did you mean lag_s?"));
  EXPECT_THAT(error_of(replaced("factor = 'power'", "factor = 'powder'")),
              HasSubstr("factor must be one of one, power, "));
  EXPECT_THAT(error_of(replaced("coefficients = [ ", "coefficients = [ nan, ")),
              HasSubstr("coefficients must hold finite numbers only"));
  EXPECT_THAT(error_of(replaced("coefficients = [ ", "coefficients = [ 1, ")),
              HasSubstr("needs as many functions as coefficients"));
  EXPECT_THAT(error_of(replaced("covariance = [", "covariance = [ [1.0], ")),
              HasSubstr("one for each coefficient"));
  EXPECT_THAT(error_of(replaced("covariance = [", "covariance = [ ['1.0'], ")),
              HasSubstr("covariance must hold finite numbers only"));
}

}  // namespace
}  // namespace clampd
