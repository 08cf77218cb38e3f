#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include "clampd/brake/euler.hpp"
#include "clampd/brake/simulation.hpp"
#include "support/excitation.hpp"
#include "support/reference_brake.hpp"

namespace clampd {
namespace {

constexpr std::size_t kRows = 300;

std::vector<double> blocks(std::initializer_list<double> torques_Nm, std::size_t samples = 20) {
  std::vector<double> torque;
  for (const double value : torques_Nm) torque.insert(torque.end(), samples, value);
  return torque;
}

Simulation simulated(const std::vector<double>& torque_Nm, const BrakeState& initial = BrakeState::Zero(),
                     const BrakeParameters& parameters = {}) {
  Simulation simulation(torque_Nm.size());
  simulate(parameters, initial, {torque_Nm}, simulation);
  return simulation;
}

/// Samples at which the velocity has just crossed or reached zero with at least this force.
int loaded_crossings(const Simulation& simulation, double force_N) {
  int crossings = 0;
  for (std::size_t k = 1; k < simulation.force_N.size(); ++k)
    crossings += simulation.force_N[k] > force_N && simulation.velocity_rad_s[k - 1] != 0.0 &&
                 simulation.velocity_rad_s[k] * simulation.velocity_rad_s[k - 1] <= 0.0;
  return crossings;
}

double largest_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double largest = 0.0;
  for (std::size_t k = 0; k < a.size(); ++k) largest = std::max(largest, std::abs(a[k] - b[k]));
  return largest;
}

TEST(Integrator, MatchesTheFineReferenceOverHardRuns) {
  // Random runs of 0.3 s that cross zero velocity at least twice under more than 5 kN, within the paper's
  // limits.
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  double worst_N = 0.0;
  double worst_rad_s = 0.0;
  int compared = 0;
  for (int draw = 0; draw < 4000 && compared < 12; ++draw) {
    std::vector<double> torque;
    for (int block = 0; block < 15; ++block) {
      const double value = 3.0 * uniform(generator);
      torque.insert(torque.end(), 20, block < 4 ? std::abs(value) : value);
    }
    const Simulation run = simulated(torque);
    const bool legal = run.complete() &&
                       *std::max_element(run.force_N.begin(), run.force_N.end()) < 30000.0 &&
                       std::all_of(run.velocity_rad_s.begin(), run.velocity_rad_s.end(),
                                   [](double v) { return std::abs(v) < 300.0; });
    if (!legal || loaded_crossings(run, 5000.0) < 2) continue;
    const auto reference = support::simulate_reference({}, 0.0, 0.0, torque);
    worst_N = std::max(worst_N, largest_difference(run.force_N, reference.force_N));
    worst_rad_s = std::max(worst_rad_s, largest_difference(run.velocity_rad_s, reference.velocity_rad_s));
    ++compared;
  }
  RecordProperty("max_force_error_N", std::to_string(worst_N));
  std::printf("largest error over %d hard runs: %.3f N, %.4f rad/s\n", compared, worst_N, worst_rad_s);
  EXPECT_EQ(compared, 12);
  EXPECT_LT(worst_N, 1.0);
  EXPECT_LT(worst_rad_s, 0.05);
}

TEST(Integrator, MatchesTheFineReferenceFromTheClearanceThroughContactAndBack) {
  const auto torque = blocks(
      {0.42, 0.36, 0.34, 0.05, 0.17, 0.11, -0.33, -0.37, 0.21, -0.72, -0.11, -0.5, -0.05, 0.39, -0.14});
  const Simulation run = simulated(torque, BrakeState(-2.0, 0.0));
  ASSERT_GT(*std::max_element(run.force_N.begin(), run.force_N.end()), 500.0);
  ASSERT_LT(*std::min_element(run.position_rad.begin() + 100, run.position_rad.end()), 0.0);
  const auto reference = support::simulate_reference({}, -2.0, 0.0, torque);
  EXPECT_LT(largest_difference(run.force_N, reference.force_N), 1.0);
}

TEST(Integrator, MatchesTheFineReferenceAtTheCornersOfTableII) {
  // Mean and three standard deviations either way of the paper's estimates.
  const double mean[] = {0.82, 0.92, 1.66, 0.925, 2.3, 0.95, 0.42};
  const double sd[] = {0.065, 0.05, 0.11, 0.11, 0.25, 0.1, 0.12};
  for (int corner = 0; corner < 8; ++corner) {
    BrakeParameters parameters;
    for (int i = 0; i < 7; ++i)
      parameters.theta[i] *= mean[i] + ((corner * (2 * i + 1) >> (i % 3)) % 2 == 0 ? -2.0 : 2.0) * sd[i];
    const auto torque =
        blocks({0.8, 1.2, 1.0, 0.5, 0.3, -0.6, 1.2, 1.3, -0.4, -0.7, 0.9, 1.4, 0.2, -0.3, -1.0});
    const Simulation run = simulated(torque, BrakeState::Zero(), parameters);
    const auto reference = support::simulate_reference(parameters, 0.0, 0.0, torque);
    EXPECT_LT(largest_difference(run.force_N, reference.force_N), 1.0) << "corner " << corner;
  }
}

TEST(Integrator, IsOfFourthOrderWhileSliding) {
  const PaperBrake brake = paper_brake({});
  const auto end_force = [&](int steps) {
    BrakeState state(5.0, 60.0);
    for (int i = 0; i < steps; ++i) state = advance(brake, state, 0.8, 0.064 / steps);
    return brake.read(state).force_N;
  };
  const double exact = end_force(8192);
  const double order = std::log2(std::abs(end_force(16) - exact) / std::abs(end_force(32) - exact));
  EXPECT_NEAR(order, 4.0, 0.4);
}

TEST(Integrator, KeepsItsOrderThroughReversalAndStick) {
  // The zero crossing is located in the Runge-Kutta map itself, so an event costs no order.
  const PaperBrake brake = paper_brake({});
  for (const double torque : {-1.2, 0.3}) {  // reverses under load; comes to rest
    const auto end_force = [&](int steps) {
      BrakeState state(18.0, 60.0);
      for (int i = 0; i < steps; ++i) state = advance(brake, state, torque, 0.048 / steps);
      return brake.read(state).force_N;
    };
    const double exact = end_force(16384);
    const double order = std::log2(std::abs(end_force(12) - exact) / std::abs(end_force(48) - exact)) / 2.0;
    EXPECT_GT(order, 3.0) << torque;
  }
}

TEST(Integrator, SticksExactlyAndBreaksAwayExactly) {
  const PaperBrake brake = paper_brake({});
  const double x = 25.0;
  const double force = brake.stiffness().force_N(x);
  const double limit = 2.63e-5 * force + brake.friction().holding_Nm(force);
  BrakeState state(x, 0.0);
  for (int i = 0; i < 1000; ++i) state = advance(brake, state, limit - 1e-9, 1e-3);
  EXPECT_EQ(state[0], x);
  EXPECT_EQ(state[1], 0.0);
  state = advance(brake, state, limit + 1e-3, 1e-3);
  EXPECT_GT(state[1], 0.0);
}

TEST(Integrator, SelfLockingBrakeKeepsItsForceAtZeroTorque) {
  // Forward Euler creeps by hundreds of newtons here, whatever its epsilon.
  const auto torque = blocks({1.2, 1.2, 1.2, 1.2, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0});
  const Simulation run = simulated(torque);
  EXPECT_GT(run.force_N.back(), 8000.0);
  EXPECT_EQ(run.velocity_rad_s.back(), 0.0);
  EXPECT_EQ(run.force_N.back(), run.force_N[250]);
}

TEST(Integrator, LosesEnergyToFrictionOnly) {
  // Coasting in the clearance: kinetic energy falls monotonically, to rest, and never turns.
  const PaperBrake brake = paper_brake({});
  BrakeState state(-100.0, 50.0);
  double last = state[1];
  for (int i = 0; i < 2000; ++i) {
    state = advance(brake, state, 0.0, 1e-3);
    EXPECT_LE(state[1], last);
    EXPECT_GE(state[1], 0.0);
    last = state[1];
  }
  EXPECT_EQ(last, 0.0);
}

TEST(Simulation, CutsIrregularGapsIntoStepsOfAtMostAMillisecond) {
  const std::vector<double> torque{0.5, 0.7, 0.9, 0.2, 0.0};
  const std::vector<double> time{0.0, 0.001, 0.0135, 0.014, 0.034};
  Simulation irregular(5);
  simulate({}, BrakeState::Zero(), {torque, kMaxStep_s, time}, irregular);
  ASSERT_TRUE(irregular.complete());
  const PaperBrake brake = paper_brake({});
  BrakeState state = BrakeState::Zero();
  for (std::size_t k = 0; k + 1 < time.size(); ++k) {
    EXPECT_NEAR(irregular.velocity_rad_s[k], state[1], 1e-4);
    for (int i = 0; i < 64; ++i) state = advance(brake, state, torque[k], (time[k + 1] - time[k]) / 64);
  }
  EXPECT_NEAR(irregular.velocity_rad_s[4], state[1], 1e-4);
  EXPECT_EQ(steps_in(1e-3), 1);
  EXPECT_EQ(steps_in(0.001000000001), 1);
  EXPECT_EQ(steps_in(0.0125), 13);
  EXPECT_EQ(steps_in(0.0), 0);
  EXPECT_EQ(steps_in(2.0), 0);
  EXPECT_EQ(steps_in(std::numeric_limits<double>::quiet_NaN()), 0);
}

TEST(Simulation, CallsAGapThatIsTooLongTheEndOfTheValidRows) {
  const std::vector<double> torque(3, 0.5);
  const std::vector<double> time{0.0, 0.001, 5.0};
  Simulation run(3);
  simulate({}, BrakeState::Zero(), {torque, kMaxStep_s, time}, run);
  EXPECT_EQ(run.valid_rows, 2u);
  EXPECT_TRUE(std::isnan(run.force_N[2]));
}

TEST(Simulation, ReportsDivergenceBeyondTheTurningPointOfTheStiffness) {
  const std::vector<double> torque(300, 3.0);
  Simulation run(300);
  SensitivitySimulation sensitive(300);
  simulate({}, BrakeState(60.0, 200.0), {torque}, run);
  simulate({}, BrakeState(60.0, 200.0), {torque}, sensitive);
  EXPECT_FALSE(run.complete());
  EXPECT_EQ(run.valid_rows, sensitive.valid_rows);
  EXPECT_GT(run.valid_rows, 10u);
  EXPECT_TRUE(std::isfinite(run.force_N[run.valid_rows - 1]));
  EXPECT_TRUE(std::isnan(run.force_N[run.valid_rows]));
  EXPECT_TRUE(std::isnan(sensitive.force_sensitivity(static_cast<Eigen::Index>(run.valid_rows), 0)));
}

TEST(Simulation, SurvivesAnyFiniteInputWithinTheParameterBounds) {
  std::mt19937_64 generator(7);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  for (int draw = 0; draw < 400; ++draw) {
    BrakeParameters parameters;
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const auto& info = kParameterTable[i];
      const double u = draw % 4 == 0 ? std::round(uniform(generator)) : uniform(generator);
      parameters.theta[static_cast<Eigen::Index>(i)] = info.lower > 0.0
                                                           ? info.lower * std::pow(info.upper / info.lower, u)
                                                           : info.lower + u * (info.upper - info.lower);
    }
    std::vector<double> torque(60);
    const double size = std::pow(10.0, 8.0 * uniform(generator) - 2.0);
    for (double& value : torque) value = size * (2.0 * uniform(generator) - 1.0);
    const BrakeState initial(400.0 * uniform(generator) - 200.0,
                             draw % 3 == 0 ? 0.0 : 2e3 * uniform(generator) - 1e3);
    Simulation run(torque.size());
    SensitivitySimulation sensitive(torque.size());
    simulate(parameters, initial, {torque}, run);
    simulate(parameters, initial, {torque}, sensitive);
    for (std::size_t k = 0; k < torque.size(); ++k) {
      EXPECT_EQ(std::isfinite(run.force_N[k]), k < run.valid_rows);
      EXPECT_EQ(std::isfinite(run.velocity_rad_s[k]), k < run.valid_rows);
    }
  }
}

TEST(Euler, AgreesWithTheSetValuedModelWhileSliding) {
  std::vector<BrakeState> states(kRows * 100);
  const std::vector<double> torque(states.size(), 0.5);
  simulate_euler({}, BrakeState(0.0, 20.0), torque, 1e-5, 50.0, states);
  const Simulation run = simulated(std::vector<double>(kRows, 0.5), BrakeState(0.0, 20.0));
  for (std::size_t k = 0; k < 40; ++k) EXPECT_NEAR(states[k * 100][1], run.velocity_rad_s[k], 0.05) << k;
}

TEST(Euler, CannotResolveLockUpAtOneMillisecond) {
  // Small epsilon creeps, large epsilon chatters: both figures are why the product does not use it.
  const PolynomialStiffness stiffness(BrakeParameters().theta.data());
  const double x = 30.0;
  std::vector<BrakeState> states(kRows);
  const std::vector<double> torque(kRows, 0.0);
  simulate_euler({}, BrakeState(x, 0.0), torque, 1e-3, 0.6, states);
  EXPECT_GT(stiffness.force_N(x) - stiffness.force_N(states.back()[0]), 100.0);
  simulate_euler({}, BrakeState(x, 0.0), torque, 1e-3, 100.0, states);
  double chatter = 0.0;
  for (const BrakeState& state : states) chatter = std::max(chatter, std::abs(state[1]));
  EXPECT_GT(chatter, 1.0);
}

}  // namespace
}  // namespace clampd
