#include <cmath>
#include <functional>

#include <gtest/gtest.h>

#include "clampd/brake/simulation.hpp"
#include "support/excitation.hpp"

namespace clampd {
namespace {

struct Case {
  const char* name;
  std::vector<double> blocks_Nm;
  BrakeState initial;
  int rests;      ///< at least so many rows at rest after the first
  int reversals;  ///< at least so many sign changes of the velocity from row to row
};

std::vector<double> torque_of(const Case& run) {
  std::vector<double> torque;
  for (const double block : run.blocks_Nm) torque.insert(torque.end(), support::kBlockSamples, block);
  return torque;
}

class Sensitivity : public ::testing::TestWithParam<Case> {};

/// Central differences, extrapolated to step zero (Richardson). The smallest steps at which rounding stays
/// below the tolerance, so that no event moves across a row in between.
Eigen::MatrixXd differences(const std::function<Eigen::VectorXd(double)>& outputs, double step) {
  const auto central = [&](double h) { return Eigen::VectorXd((outputs(h) - outputs(-h)) / (2.0 * h)); };
  return (4.0 * central(0.5 * step) - central(step)) / 3.0;
}

TEST_P(Sensitivity, IsTheDerivativeOfTheDiscreteMap) {
  const Case& run = GetParam();
  const std::vector<double> torque = torque_of(run);
  const auto rows = static_cast<Eigen::Index>(torque.size());
  SensitivitySimulation sensitive(torque.size());
  simulate({}, run.initial, {torque}, sensitive);
  ASSERT_TRUE(sensitive.complete());
  int rests = 0;
  int reversals = 0;
  for (std::size_t k = 1; k < torque.size(); ++k) {
    rests += sensitive.velocity_rad_s[k] == 0.0;
    reversals += sensitive.velocity_rad_s[k] * sensitive.velocity_rad_s[k - 1] < 0.0;
  }
  ASSERT_GE(rests, run.rests);
  ASSERT_GE(reversals, run.reversals);

  double worst = 0.0;
  for (int column = 0; column < kSensitivityColumns; ++column) {
    if (column == kInitialVelocityColumn && run.initial[1] == 0.0 &&
        paper_brake({}).breakaway_sign(run.initial[0], torque[0]) != 0.0)
      continue;  // one-sided at rest: the derivative is that of the direction of breakaway
    const auto outputs = [&](double change) {
      BrakeParameters parameters;
      BrakeState initial = run.initial;
      if (column < kInitialPositionColumn)
        parameters.theta[column] *= 1.0 + change;
      else
        initial[column - kInitialPositionColumn] += change;
      Simulation simulation(torque.size());
      simulate(parameters, initial, {torque}, simulation);
      Eigen::VectorXd stacked(2 * rows);
      stacked << Eigen::Map<const Eigen::VectorXd>(simulation.force_N.data(), rows),
          Eigen::Map<const Eigen::VectorXd>(simulation.velocity_rad_s.data(), rows);
      return stacked;
    };
    const Eigen::VectorXd expected = differences(outputs, 2e-5);
    for (const bool force : {true, false}) {
      const Eigen::VectorXd mine =
          force ? sensitive.force_sensitivity.col(column) : sensitive.velocity_sensitivity.col(column);
      const Eigen::VectorXd theirs = force ? expected.head(rows) : expected.tail(rows);
      const double scale = theirs.cwiseAbs().maxCoeff();
      if (scale == 0.0) {
        EXPECT_EQ(mine.cwiseAbs().maxCoeff(), 0.0);
        continue;
      }
      const double error = (mine - theirs).cwiseAbs().maxCoeff() / scale;
      worst = std::max(worst, error);
      EXPECT_LT(error, 1e-6) << (force ? "force" : "velocity") << " by column " << column;
    }
  }
  std::printf("%s: largest relative difference %.1e\n", run.name, worst);
}

INSTANTIATE_TEST_SUITE_P(
    Runs, Sensitivity,
    ::testing::Values(
        Case{"sliding", {0.4, 0.9, 1.2, 0.9, 0.8}, BrakeState(0.01, 5.0), 0, 0},
        Case{"reversals under load",
             {1.22, 0.63, 0.97, 0.11, -0.9, -1.09, 1.19, -0.64},
             BrakeState(0.01, 5.0),
             0,
             3},
        Case{"stick and breakaway",
             {1.37, 0.13, -0.04, 0, 0, 0.32, -0.8, 0, 0, -0.67},
             BrakeState(0.5, 2.0),
             40,
             0},
        Case{"clearance and back",
             {0.48, 0.34, 0.23, 0.1, 0.05, -0.74, -0.52, -0.38, -0.24, -0.42},
             BrakeState(-1.5, 1.0),
             0,
             1},
        Case{"from rest", {0.71, 0.89, -0.18, 0.56, 0.0, -0.14, -0.23, -0.64}, BrakeState(0.0, 0.0), 0, 1}),
    [](const auto& instance) {
      std::string name = instance.param.name;
      for (char& letter : name)
        if (letter == ' ') letter = '_';
      return name;
    });

TEST(SensitivitySimulation, HasTheStatesOfThePlainOne) {
  const auto torque = support::strong_torque();
  Simulation plain(torque.size());
  SensitivitySimulation sensitive(torque.size());
  simulate({}, BrakeState::Zero(), {torque}, plain);
  simulate({}, BrakeState::Zero(), {torque}, sensitive);
  for (std::size_t k = 0; k < torque.size(); ++k) {
    EXPECT_NEAR(plain.force_N[k], sensitive.force_N[k], 1e-6);
    EXPECT_NEAR(plain.velocity_rad_s[k], sensitive.velocity_rad_s[k], 1e-8);
  }
}

TEST(Tangent, StepsChainToTheTangentOfTheWhole) {
  // What a Kalman filter and an adjoint need: derivatives of single steps, from identity, including the
  // torque's.
  const PaperBrake brake = paper_brake({});
  const double torque[] = {0.9, -0.4, -1.5, -1.5, 0.2};
  using T = Tangent<PaperBrake::kParameters>;
  BrakeState state(10.0, 12.0);
  T whole = T::identity();
  Eigen::Matrix2d transition = Eigen::Matrix2d::Identity();
  for (const double value : torque) {
    const BrakeState before = state;
    state = advance_with_tangent(brake, before, whole, value, 1e-3);
    T step = T::identity();
    advance_with_tangent(brake, before, step, value, 1e-3);
    Eigen::Matrix2d of_step;
    of_step << step.position[T::kPosition], step.position[T::kVelocity], step.velocity[T::kPosition],
        step.velocity[T::kVelocity];
    transition = of_step * transition;

    const double h = 1e-5;
    const BrakeState by_torque =
        (advance(brake, before, value + h, 1e-3) - advance(brake, before, value - h, 1e-3)) / (2 * h);
    EXPECT_NEAR(step.velocity[T::kTorque], by_torque[1], 1e-5 + 1e-6 * std::abs(by_torque[1]));
    EXPECT_NEAR(step.position[T::kTorque], by_torque[0], 1e-7 + 1e-6 * std::abs(by_torque[0]));
  }
  EXPECT_NEAR(transition(0, 0), whole.position[T::kPosition], 1e-9);
  EXPECT_NEAR(transition(1, 1), whole.velocity[T::kVelocity], 1e-9);
}

}  // namespace
}  // namespace clampd
