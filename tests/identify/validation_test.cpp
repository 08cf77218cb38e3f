#include "clampd/identify/validation.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "support/excitation.hpp"

namespace clampd {
namespace {

TEST(Portmanteau, AlarmsAtItsLevelOnWhiteNoiseAndAlwaysOnColouredNoise) {
  std::mt19937_64 generator(3);
  std::normal_distribution<double> normal;
  constexpr int kSeries = 1000;
  int white_alarms = 0;
  int coloured_alarms = 0;
  for (int i = 0; i < kSeries; ++i) {
    std::vector<double> white(300), coloured(300);
    double state = 0.0;
    for (std::size_t k = 0; k < white.size(); ++k) {
      white[k] = normal(generator);
      state = 0.6 * state + normal(generator);
      coloured[k] = state;
    }
    white_alarms += portmanteau(white).p_value < 0.05;
    coloured_alarms += portmanteau(coloured).p_value < 0.05;
  }
  EXPECT_NEAR(white_alarms, 0.05 * kSeries, 25);
  EXPECT_EQ(coloured_alarms, kSeries);
}

TEST(Portmanteau, HasNothingToSayOfShortOrConstantSeries) {
  EXPECT_EQ(portmanteau({}).p_value, 1.0);
  EXPECT_EQ(portmanteau(std::vector<double>{1.0, 2.0}).p_value, 1.0);
  EXPECT_EQ(portmanteau(std::vector<double>(100, 3.0)).p_value, 1.0);
  EXPECT_EQ(portmanteau(std::vector<double>{1, 2, 1, 2, 1, 2, 1, 2}).lags, 2);
}

TEST(AssessRun, TellsARightModelFromAWrongOne) {
  const auto torque = support::strong_torque();
  Simulation simulation(torque.size());
  simulate({}, BrakeState::Zero(), {torque}, simulation);
  std::mt19937_64 generator(4);
  const clampd::Run run =
      support::noisy_run(torque, simulation.force_N, simulation.velocity_rad_s, 75.0, 1.5, generator);
  const RunMisfit right = assess_run(run, {}, BrakeState::Zero(), {75.0, 1.5});
  ASSERT_TRUE(right.simulated);
  EXPECT_NEAR(right.force.chi_square_per_sample, 1.0, 0.3);
  EXPECT_NEAR(right.velocity.rms, 1.5, 0.2);
  EXPECT_GT(right.force.whiteness.p_value, 1e-3);
  BrakeParameters wrong;
  wrong.theta[k2] *= 0.9;
  const RunMisfit misfit = assess_run(run, wrong, BrakeState::Zero(), {75.0, 1.5});
  EXPECT_GT(misfit.force.chi_square_per_sample, 2.0);
  EXPECT_LT(misfit.force.whiteness.p_value, 1e-9);
}

}  // namespace
}  // namespace clampd
