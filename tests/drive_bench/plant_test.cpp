// The generator's physics against closed forms and balances of energy.

#include "tests/drive_bench/plant.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/drive_bench/rig.hpp"

namespace clampd::drive_bench {
namespace {

constexpr double kTau = 2.0 * std::numbers::pi;

/// Advances to `end_s` with a torque that depends on time.
template <class Torque>
void run_until(const Plant& plant, PlantState& state, double end_s, double step_s, Torque torque) {
  while (state.time_s < end_s - 0.5 * step_s)
    advance(plant, state, torque(state.time_s), 0.0, 0.0, 0, step_s);
}
double no_torque(double) {
  return 0.0;
}

TEST(Plant, CoastsToRestAsTheClosedFormOfCoulombAndViscousFrictionSays) {
  Plant plant;
  plant.inertia = 0.02;
  plant.coulomb = 0.3;
  plant.viscous = 0.05;
  PlantState state;
  state.velocity = 40.0;
  const double rate = plant.viscous / plant.inertia, floor = plant.coulomb / plant.viscous;
  run_until(plant, state, 0.2, 1e-4, no_torque);
  EXPECT_NEAR(state.velocity, (40.0 + floor) * std::exp(-rate * 0.2) - floor, 1e-4);
  const double stop_s = std::log1p(40.0 / floor) / rate;
  const double way = (40.0 + floor) / rate * -std::expm1(-rate * stop_s) - floor * stop_s;
  run_until(plant, state, 2.0, 1e-4, no_torque);
  EXPECT_EQ(state.velocity, 0.0);
  EXPECT_NEAR(state.position, way, 1e-3);
}

TEST(Plant, SticksBelowItsFrictionAndBreaksAwayAboveIt) {
  Plant plant;
  plant.coulomb = 2.0;
  plant.stribeck_forward = plant.stribeck_backward = 1.0;
  plant.stribeck_speed = 0.1;
  PlantState state;
  const auto ramp = [](double t) { return 1.5 * t; };  // reaches 3 at 2 s
  run_until(plant, state, 1.99, 1e-3, ramp);
  EXPECT_EQ(state.velocity, 0.0);
  EXPECT_EQ(state.position, 0.0);
  run_until(plant, state, 2.1, 1e-3, ramp);
  EXPECT_GT(state.velocity, 0.0);
}

TEST(Plant, APendulumSwingsWithItsPeriodAndKeepsItsEnergy) {
  Plant plant;
  plant.inertia = 0.5;
  plant.gravity = 4.0;
  PlantState state;
  state.position = 0.05;
  const double energy = stored_energy(plant, state);
  run_until(plant, state, 10.0 * kTau * std::sqrt(plant.inertia / plant.gravity), 1e-4, no_torque);
  EXPECT_NEAR(state.position, 0.05, 1e-4);  // ten periods of small oscillation
  EXPECT_NEAR(stored_energy(plant, state), energy, 1e-6 * plant.gravity);
}

TEST(Plant, AnInertiaThatDependsOnThePositionKeepsItsEnergy) {
  Plant plant;
  plant.inertia_ripple = {2.0, 0.4, 0.3};
  plant.cogging.push_back({3.0, 0.8, 1.0});
  PlantState state;
  state.velocity = 3.0;
  const double energy = stored_energy(plant, state);
  run_until(plant, state, 20.0, 1e-4, no_torque);
  EXPECT_NEAR(stored_energy(plant, state) / energy, 1.0, 1e-5);
}

TEST(Plant, TwoMassesOscillateAtTheirResonanceAndMomentumStays) {
  Plant plant;
  plant.inertia = 2.0;
  plant.load_inertia = 1.0;
  plant.shaft_stiffness = 600.0;
  PlantState state;
  state.position = 0.01;
  const double w = std::sqrt(plant.shaft_stiffness * (1.0 / 2.0 + 1.0));
  run_until(plant, state, kTau / w, 1e-5, no_torque);
  EXPECT_NEAR(state.position - state.load_position, 0.01, 1e-5);
  EXPECT_NEAR(2.0 * state.velocity + state.load_velocity, 0.0, 1e-9);
}

TEST(Plant, PreslidingIsASpringOfLevelOverLengthAndEndsAtTheLevel) {
  Plant plant;
  plant.inertia = 1e-3;
  plant.coulomb = 1.0;
  plant.bristle_length = 0.01;
  PlantState state;
  run_until(plant, state, 1.0, 1e-5, [](double t) { return std::min(0.05, 0.1 * t); });
  EXPECT_NEAR(state.position, -plant.bristle_length * std::log1p(-0.05), 2e-6);
  state = {};
  state.velocity = 0.5;
  run_until(plant, state, 0.2, 1e-5, [](double) { return 1.2; });
  EXPECT_NEAR(state.bristle, 1.0, 1e-6);
}

TEST(Plant, AHystereticCableLosesFourTimesLevelTimesWayInALongCycle) {
  Plant plant;
  plant.inertia = 1.0;
  plant.cable_level = 0.5;
  plant.cable_length = 0.01;
  PlantState state;
  double work = 0.0;  // a slow triangle by a torque that follows it exactly is not needed: drive it by speed
  const double step_s = 1e-3;
  for (int k = 0; k < 4000; ++k) {
    state.velocity = k < 1000 || k >= 3000 ? 1.0 : -1.0;
    const double before = state.cable;
    advance(plant, state, 0.0, 0.0, 0.0, 0, step_s);
    if (k >= 2000) work += plant.cable_level * 0.5 * (before + state.cable) * (k >= 3000 ? 1e-3 : -1e-3);
  }
  EXPECT_NEAR(work, 2.0 * plant.cable_level, 0.05 * plant.cable_level);
}

TEST(Plant, AnEndStopHoldsHalfASwingAndPushesOnItsOwnSideOnly) {
  Plant plant;
  plant.inertia = 2.0;
  plant.stop_stiffness = 50.0;
  plant.stop_place = -0.3;
  plant.stop_side = -1.0;
  PlantState state;
  state.velocity = -1.5;
  const double energy = stored_energy(plant, state), w = std::sqrt(plant.stop_stiffness / plant.inertia);
  run_until(plant, state, 0.1, 1e-4, no_torque);
  EXPECT_NEAR(state.velocity, -1.5, 1e-12);  // not there yet
  run_until(plant, state, 0.2 + 0.25 * kTau / w, 1e-4, no_torque);
  EXPECT_NEAR(state.position, -0.3 - 1.5 / w, 1e-4);
  EXPECT_NEAR(stored_energy(plant, state), energy, 1e-6);
  run_until(plant, state, 3.0, 1e-4, no_torque);
  EXPECT_NEAR(state.velocity, 1.5, 1e-5);
  plant.stop_damping = 0.4;
  state = {};
  state.velocity = -1.5;
  run_until(plant, state, 3.0, 1e-4, no_torque);
  EXPECT_GT(state.velocity, 0.0);
  EXPECT_LT(state.velocity, 1.4);
}

TEST(Plant, KnocksAreHalfSinesWithPausesAndDifferFromRunToRun) {
  LoadSignal load;
  load.knock_level = 2.0;
  load.knock_s = 0.05;
  load.knock_pause_s = 0.2;
  load.seed = 5;
  ASSERT_TRUE(load.is_there());
  const std::vector<double> torque = by_tick(load, 0, 2'000'000, 1e-3);
  double sum = 0.0, most = 0.0, steepest = 0.0, quiet = 0.0;
  for (std::size_t k = 1; k < torque.size(); ++k) {
    sum += std::abs(torque[k]);
    most = std::max(most, std::abs(torque[k]));
    steepest = std::max(steepest, std::abs(torque[k] - torque[k - 1]));
    quiet += torque[k] == 0.0 ? 1.0 : 0.0;
  }
  const auto ticks = static_cast<double>(torque.size());
  EXPECT_NEAR(quiet / ticks, 0.8, 0.01);
  EXPECT_NEAR(sum / ticks, 0.2 * 2.0 * 2.0 / std::numbers::pi, 0.01);  // the mean of a half sine is 2 / pi
  EXPECT_NEAR(most, 3.0, 0.01);
  EXPECT_LE(steepest, 3.0 * std::numbers::pi / 50.0 * 1.001);
  EXPECT_NE(torque, by_tick(load, 1, 2'000'000, 1e-3));
}

TEST(Plant, ASlipClutchCarriesItsLoadAlongUntilItsTorqueAndNoFurther) {
  Plant plant;
  plant.inertia = 1.0;
  plant.load_inertia = 2.0;
  plant.clutch_torque = 0.6;
  plant.clutch_creep = 1e-3;
  PlantState state;
  run_until(plant, state, 2.0, 1e-4, [](double) { return 0.75; });  // the load takes 0.5 of it
  EXPECT_NEAR(state.velocity, 0.25 * 2.0, 2e-3);
  EXPECT_NEAR(state.load_velocity, 0.25 * 2.0, 2e-3);
  state = {};
  run_until(plant, state, 2.0, 1e-4, [](double) { return 1.6; });  // the load would take 1.07 of it
  EXPECT_NEAR(state.velocity, (1.6 - 0.6) * 2.0, 2e-3);
  EXPECT_NEAR(state.load_velocity, 0.6 / 2.0 * 2.0, 2e-3);
  EXPECT_NEAR(state.velocity + 2.0 * state.load_velocity, 1.6 * 2.0, 1e-9);
}

TEST(Plant, APayloadSlowsTheDriveDownWhileItIsCarried) {
  Plant plant;
  plant.inertia = 1.0;
  plant.payload_inertia = 3.0;
  plant.payload_period_s = 2.0;
  plant.payload_share = 0.25;
  plant.payload_start_s = 1.0;  // carried from 1 s to 1.5 s, and again from 3 s
  PlantState state;
  run_until(plant, state, 1.0, 1e-4, [](double) { return 0.8; });
  EXPECT_NEAR(state.velocity, 0.8, 1e-3);
  run_until(plant, state, 1.5, 1e-4, [](double) { return 0.8; });
  EXPECT_NEAR(state.velocity, 0.8 + 0.1, 1e-3);
  run_until(plant, state, 2.9, 1e-4, [](double) { return 0.8; });
  EXPECT_NEAR(state.velocity, 0.9 + 1.12, 1e-3);
  const double energy = stored_energy(plant, state);
  run_until(plant, state, 3.1, 1e-4, no_torque);
  EXPECT_NEAR(stored_energy(plant, state) / energy, 1.0 + 3.0, 1e-9);  // with what it brings
}

TEST(Plant, AboveItsBaseSpeedAMotorHasConstantPower) {
  Plant plant;
  plant.inertia = 0.5;
  plant.base_speed = 2.0;
  PlantState state;
  run_until(plant, state, 1.0, 1e-4, [](double) { return 1.0; });
  EXPECT_NEAR(state.velocity, 2.0, 1e-6);  // full torque so far
  run_until(plant, state, 4.0, 1e-4, [](double) { return 1.0; });
  EXPECT_NEAR(stored_energy(plant, state), 0.5 * 0.5 * 2.0 * 2.0 + 1.0 * 2.0 * 3.0, 1e-3);
  const double before = state.velocity;  // and braking at speed it is as weak
  advance(plant, state, -1.0, 0.0, 0.0, 0, 1e-3);
  EXPECT_NEAR(state.velocity, before - 2.0 / before / 0.5 * 1e-3, 1e-6);
}

TEST(Plant, TheMidpointRuleIsOfSecondOrderWhileTheDriveSlides) {
  Plant plant;
  plant.coulomb = 0.2;
  plant.viscous = 0.5;
  plant.quadratic = 0.3;
  plant.cogging.push_back({2.0, 0.3, 0.0});
  const auto end = [&](double step_s) {
    PlantState state;
    state.velocity = 2.0;
    run_until(plant, state, 1.0, step_s, [](double t) { return 1.0 + 0.5 * std::sin(3.0 * t); });
    return state.position;
  };
  // The torque is held over a step, which costs one order: against a reference with steps much shorter,
  // halving halves.
  const auto with_constant_torque = [&](double step_s) {
    PlantState state;
    state.velocity = 2.0;
    run_until(plant, state, 1.0, step_s, [](double) { return 1.3; });
    return state.position;
  };
  const double exact = with_constant_torque(1e-5);
  const double order = std::log2((with_constant_torque(2e-2) - exact) / (with_constant_torque(1e-2) - exact));
  EXPECT_NEAR(order, 2.0, 0.15);
  EXPECT_NEAR(end(1e-3), end(1e-4), 1e-3);
}

TEST(Rig, EachRowsMeansFulfilTheEquationOfMotion) {
  Plant plant;
  plant.inertia = 3e-3;
  plant.coulomb = 0.4;
  plant.viscous = 0.02;
  plant.speed = 6.0;
  Rig rig;
  rig.tick_s = 1e-3;
  rig.ticks_per_row = 5;
  rig.torque_column = TorqueColumn::Sampled;
  rig.encoder_step = 1e-4;
  rig.torque_limit = 3.0;
  rig.bandwidth_rad_s = 80.0;
  Random random(3);
  const Motion motion = draw_motion({MotionKind::Trapezoids, 6.0, 1.0, rig.tick_s, 5.0, 0.0}, random);
  const Recording run = record(plant, rig, motion, 0, Random(4));
  ASSERT_GT(run.truth.size(), 900u);
  std::size_t sliding = 0;
  for (const Recording::Truth& row : run.truth) {
    if (row.stuck) continue;
    ++sliding;
    const double needed =
        plant.inertia * row.acceleration + plant.viscous * row.velocity + plant.coulomb * row.direction;
    ASSERT_NEAR(needed, row.torque, 2e-4);
  }
  EXPECT_GT(sliding, 500u);
}

TEST(Rig, TheControllerFollowsItsReference) {
  Plant plant;
  plant.inertia = 1e-2;
  plant.coulomb = 0.2;
  plant.speed = 5.0;
  Rig rig;
  rig.torque_limit = 5.0;
  rig.bandwidth_rad_s = 120.0;
  rig.feed_forward = true;
  Random random(5);
  const Motion motion = draw_motion({MotionKind::Sinusoid, 5.0, 1.0, rig.tick_s, 4.0, 0.0}, random);
  const Recording run = record(plant, rig, motion, 0, Random(6));
  double error = 0.0, size = 0.0;
  for (std::size_t k = 1000; k < run.position.size(); ++k) {
    error += std::pow(run.position[k] - motion.position[k + 1], 2);
    size += std::pow(motion.position[k + 1] - motion.position.front(), 2);
  }
  EXPECT_LT(std::sqrt(error / size), 0.05);
}

TEST(Rig, AHeldColumnIsTheTorqueThatActsFromItsRow) {
  Plant plant;
  plant.inertia = 1.0;
  plant.speed = 1.0;
  Rig rig;
  rig.torque_limit = rig.torque_scale = 1.0;
  Random random(7);
  const Motion motion = draw_motion({MotionKind::Coasting, 1.0, 2.0, rig.tick_s, 2.0, 0.0}, random);
  const Recording run = record(plant, rig, motion, 0, Random(8));
  for (std::size_t k = 0; k < run.torque.size(); ++k)
    ASSERT_NEAR(run.torque[k], run.truth[k].acceleration, 1e-9);
}

TEST(Rig, ALateColumnIsTheSameColumnShifted) {
  Plant plant;
  plant.coulomb = 0.1;
  plant.speed = 2.0;
  Rig rig;
  rig.torque_limit = 20.0;
  Random random(9);
  const Motion motion = draw_motion({MotionKind::Multisine, 2.0, 1.0, rig.tick_s, 3.0, 0.0}, random);
  const Recording on_time = record(plant, rig, motion, 0, Random(10));
  rig.torque_late_rows = 7;
  const Recording late = record(plant, rig, motion, 0, Random(10));
  EXPECT_EQ(late.position, on_time.position);
  for (std::size_t k = 7; k < late.torque.size(); ++k) ASSERT_EQ(late.torque[k], on_time.torque[k - 7]);
}

TEST(Motions, PositionVelocityAndAccelerationBelongTogether) {
  for (const MotionKind kind :
       {MotionKind::Sinusoid, MotionKind::Multisine, MotionKind::Trapezoids, MotionKind::SlowSweep,
        MotionKind::SteadySpeeds, MotionKind::RandomMotion, MotionKind::OneDirection}) {
    Random random(11);
    const MotionRequest request{kind, 3.0, 0.5, 1e-3, 10.0, 0.0};
    const Motion motion = draw_motion(request, random);
    double fastest = 0.0, worst = 0.0;
    for (std::size_t k = 1; k < motion.position.size(); ++k) {
      const double difference = (motion.position[k] - motion.position[k - 1]) / request.tick_s;
      worst = std::max(worst, std::abs(difference - 0.5 * (motion.velocity[k] + motion.velocity[k - 1])));
      fastest = std::max(fastest, std::abs(motion.velocity[k]));
    }
    EXPECT_LT(worst, 0.02) << words(kind);
    EXPECT_GT(fastest, 1.0) << words(kind);
    EXPECT_LT(fastest, 9.0) << words(kind);
  }
}

TEST(Motions, OneDirectionNeverTurnsRound) {
  for (std::uint64_t seed = 1; seed < 20; ++seed) {
    Random random(seed);
    const Motion motion = draw_motion({MotionKind::OneDirection, 3.0, 0.5, 1e-3, 10.0, 0.0}, random);
    double least = 0.0, most = 0.0;
    for (const double v : motion.velocity) least = std::min(least, v), most = std::max(most, v);
    EXPECT_EQ(std::min(-least, most), 0.0) << seed;
  }
}

}  // namespace
}  // namespace clampd::drive_bench
