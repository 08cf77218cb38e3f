#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/base/clock.hpp"
#include "drivers/sim/simulated_brake.hpp"

namespace clampd::sim {
namespace {

/// 0.3 s of torque that accelerates, clamps, stops under load, and releases half way.
double demanding_torque(int k) {
  if (k < 40) return 1.5;
  if (k < 100) return 0.7;
  if (k < 180) return 0.2;
  return -0.6;
}

PlantConfiguration at_contact() {
  PlantConfiguration configuration;
  configuration.clearance_rad = 0.0;
  return configuration;
}

TEST(SimulatedBrake, IsDeterministicGivenItsSeed) {
  PlantConfiguration configuration = at_contact();
  configuration.sensors = {30.0, 0.3, 0.002, 1e-3, 1.0, 0.02, 1e-4, 1e-3, 35.0, 0.1};
  SimulatedBrake first(configuration), second(configuration);
  configuration.seed = 2;
  SimulatedBrake other(configuration);
  int differences = 0;
  for (int k = 0; k < 300; ++k) {
    for (SimulatedBrake* brake : {&first, &second, &other}) brake->command({demanding_torque(k), true});
    const BrakeFeedback a = first.sample(), b = second.sample(), c = other.sample();
    ASSERT_EQ(a.force_N, b.force_N);
    ASSERT_EQ(a.velocity_rad_s, b.velocity_rad_s);
    ASSERT_EQ(a.torque_Nm, b.torque_Nm);
    ASSERT_EQ(a.position_rad, b.position_rad);
    differences += a.force_N != c.force_N;
    EXPECT_EQ(a.sample_index, k);
    EXPECT_EQ(a.brake_time_ns, k * kPeriod_ns);
  }
  EXPECT_GT(differences, 250);
}

TEST(SimulatedBrake, TruthConvergesWithTheStep) {
  // Twenty times finer steps must not change the force, also not behind the zero crossing under load.
  const auto final_force = [](double step_s) {
    PlantConfiguration configuration = at_contact();
    configuration.step_s = step_s;
    SimulatedBrake brake(configuration);
    std::vector<double> force_N;
    for (int k = 0; k < 300; ++k) {
      brake.command({demanding_torque(k), true});
      force_N.push_back(brake.sample().force_N);
    }
    return force_N;
  };
  const auto fine = final_force(1e-6), shipped = final_force(PlantConfiguration{}.step_s);
  double worst_N = 0.0, highest_N = 0.0;
  for (std::size_t k = 0; k < fine.size(); ++k) {
    worst_N = std::max(worst_N, std::abs(fine[k] - shipped[k]));
    highest_N = std::max(highest_N, fine[k]);
  }
  EXPECT_GT(highest_N, 15000.0);
  EXPECT_LT(worst_N, 0.05);
  RecordProperty("worst_force_difference_N", std::to_string(worst_N));
}

TEST(SimulatedBrake, ClampedAtRestItHoldsItselfAndReleasesOnlyAgainstItsFriction) {
  SimulatedBrake brake(at_contact());
  for (int k = 0; k < 300; ++k) {
    brake.command({k < 40 ? 1.5 : k < 90 ? 0.6 : 0.0, true});
    brake.sample();
  }
  const double held_N = brake.truth().force_N;
  ASSERT_GT(held_N, 10000.0);
  ASSERT_EQ(brake.truth().velocity_rad_s, 0.0);
  for (int k = 0; k < 1000; ++k) {
    brake.command({0.0, false});
    brake.sample();
  }
  EXPECT_EQ(brake.truth().force_N, held_N) << "mus > N: the clamped brake is self-locking";

  // Break-away by (5): release needs T < N F - Ts, further closing T > N F + Ts.
  const BrakeParameters nominal;
  const double load_Nm = nominal.fixed.ratio_m_rad * held_N;
  const double static_Nm = nominal.theta[Ts0] + nominal.theta[mus] * held_N;
  const auto moves = [&](double torque_Nm) {
    SimulatedBrake copy = brake;
    for (int k = 0; k < 20; ++k) {
      copy.command({torque_Nm, true});
      copy.sample();
    }
    return copy.truth().force_N != held_N;
  };
  EXPECT_FALSE(moves(load_Nm - static_Nm + 1e-6));
  EXPECT_TRUE(moves(load_Nm - static_Nm - 1e-6));
  EXPECT_FALSE(moves(load_Nm + static_Nm - 1e-6));
  EXPECT_TRUE(moves(load_Nm + static_Nm + 1e-6));
}

TEST(SimulatedBrake, LosesEnergyWhenNothingDrivesIt) {
  // 1/2 J v^2 + N * integral of F dx never grows at zero torque.
  const BrakeParameters nominal;
  SimulatedBrake brake(at_contact());
  for (int k = 0; k < 70; ++k) {
    brake.command({2.0, true});
    brake.sample();
  }
  brake.command({0.0, false});
  brake.sample();
  const auto energy_J = [&] {
    const Truth& t = brake.truth();
    const double x = std::max(0.0, t.position_rad);
    const double stored = (0.25 * nominal.theta[k1] * x + nominal.theta[k2] / 3.0) * x * x * x;
    return 0.5 * nominal.fixed.inertia_kg_m2 * t.velocity_rad_s * t.velocity_rad_s +
           nominal.fixed.ratio_m_rad * stored;
  };
  double last_J = energy_J();
  ASSERT_GT(last_J, 1.0);
  for (int k = 0; k < 500; ++k) {
    brake.command({0.0, false});
    brake.sample();
    ASSERT_LE(energy_J(), last_J + 1e-12);
    last_J = energy_J();
  }
  EXPECT_EQ(brake.truth().velocity_rad_s, 0.0);
}

TEST(SimulatedBrake, FreeMotionFollowsTheEquationOfMotion) {
  // In the clearance, F = 0. Once v >> ws the level is TC + (Ts0 - TC) / (1 + (v/ws)^2); compare with a plain
  // quadrature of J v' = T - Tf(v) in micro steps.
  PlantConfiguration configuration;
  configuration.clearance_rad = 26.0;
  SimulatedBrake brake(configuration);
  const ParameterVector theta = nominal_parameters();
  double v = 0.0, x = -26.0;
  for (int k = 0; k < 50; ++k) {
    brake.command({0.5, true});
    brake.sample();
    EXPECT_NEAR(brake.truth().velocity_rad_s, v, 1e-3);
    EXPECT_NEAR(brake.truth().position_rad, x, 1e-4);
    for (int i = 0; i < 10000; ++i) {
      const double r = v / theta[ws];
      const double friction = theta[Tv] * v + theta[TC] + (theta[Ts0] - theta[TC]) / (1.0 + r * r);
      const double next = v + 1e-7 / 2.91e-4 * (0.5 - friction);
      x += 0.5e-7 * (v + next);
      v = next;
    }
    ASSERT_LT(x, 0.0);
  }
}

TEST(SimulatedBrake, CommandActsFromTheNextSampleOnAndIsLimited) {
  SimulatedBrake brake(at_contact());
  EXPECT_EQ(brake.sample().torque_Nm, 0.0);
  brake.command({0.5, true});
  EXPECT_EQ(brake.truth().torque_Nm, 0.0);
  EXPECT_EQ(brake.sample().torque_Nm, 0.5);
  brake.command({0.1, true});
  brake.command({9.0, true});
  EXPECT_EQ(brake.sample().torque_Nm, 3.0) << "the newest command counts, limited";
  brake.command({-9.0, true});
  EXPECT_EQ(brake.sample().torque_Nm, -3.0);
  brake.command({1.0, false});
  const BrakeFeedback disabled = brake.sample();
  EXPECT_EQ(disabled.torque_Nm, 0.0);
  EXPECT_FALSE(disabled.drive_enabled);
  brake.command({std::nan(""), true});
  EXPECT_EQ(brake.sample().torque_Nm, 0.0);
}

TEST(SimulatedBrake, ToldASpeedItTakesItUpWithinItsTorqueAndReportsThat) {
  PlantConfiguration configuration;
  configuration.torque_limit_Nm = 1.0;
  SimulatedBrake brake(configuration);
  const auto tell = [&](double velocity_rad_s, bool enable = true) {
    brake.command({.enable = enable,
                   .velocity_rad_s = velocity_rad_s,
                   .commanded = CommandedQuantity::Velocity});
    const BrakeFeedback feedback = brake.sample();
    EXPECT_LE(std::abs(feedback.torque_Nm), configuration.torque_limit_Nm);
    EXPECT_EQ(feedback.torque_Nm, brake.truth().torque_Nm);
    return feedback;
  };
  for (int k = 0; k < 60; ++k) tell(50.0);
  EXPECT_NEAR(tell(50.0).velocity_rad_s, 50.0, 0.5) << "friction leaves no error";
  double least_rad_s = 50.0;
  for (int k = 0; k < 60; ++k) least_rad_s = std::min(least_rad_s, tell(0.0).velocity_rad_s);
  EXPECT_NEAR(tell(0.0).velocity_rad_s, 0.0, 0.1);
  EXPECT_GT(least_rad_s, -20.0) << "the integral waited while the torque was limited";
  tell(50.0);
  EXPECT_NE(tell(50.0).torque_Nm, 0.0);
  EXPECT_EQ(tell(50.0, false).torque_Nm, 0.0) << "disabled is no torque, not speed zero";
  EXPECT_FALSE(tell(50.0, false).drive_enabled);
}

TEST(SimulatedBrake, TheWatchdogEndsASpeedToo) {
  SimulatedBrake brake(PlantConfiguration{});
  brake.command({.enable = true, .velocity_rad_s = 30.0, .commanded = CommandedQuantity::Velocity});
  BrakeFeedback feedback;
  for (int k = 0; k < 21; ++k) feedback = brake.sample();
  EXPECT_TRUE(feedback.watchdog_tripped);
  EXPECT_EQ(feedback.torque_Nm, 0.0);
}

TEST(SimulatedBrake, WatchdogZeroesTheTorqueAndLatchesUntilDisabled) {
  SimulatedBrake brake(at_contact());
  brake.command({0.3, true});
  int zero_after_ms = -1;
  for (int k = 0; k < 30; ++k) {
    const BrakeFeedback feedback = brake.sample();
    if (feedback.torque_Nm == 0.0 && zero_after_ms < 0) zero_after_ms = k;
    EXPECT_EQ(feedback.watchdog_tripped, feedback.torque_Nm == 0.0);
  }
  // The command may have come just after the sample before the one that latched it.
  EXPECT_EQ(zero_after_ms, 19);
  brake.command({0.3, true});
  BrakeFeedback feedback = brake.sample();
  EXPECT_TRUE(feedback.watchdog_tripped) << "an enabled command alone must not restart the brake";
  EXPECT_EQ(feedback.torque_Nm, 0.0);
  brake.command({0.0, false});
  EXPECT_FALSE(brake.sample().watchdog_tripped);
  brake.command({0.3, true});
  EXPECT_EQ(brake.sample().torque_Nm, 0.3);
}

TEST(SimulatedBrake, ASilentStationThatNeverEnabledIsNoFault) {
  SimulatedBrake brake(at_contact());
  for (int k = 0; k < 100; ++k) EXPECT_FALSE(brake.sample().watchdog_tripped);
}

TEST(SimulatedBrake, ReadingsCarryNoiseOffsetAndQuantisationAsConfigured) {
  PlantConfiguration configuration;  // at rest in the clearance
  configuration.encoder_zero_rad = 17.3;
  configuration.sensors = {75.0, 1.5, 0.0142, 0.0, 1.0, 0.02, 1e-4, 1e-3, 35.0, 0.5};
  SimulatedBrake brake(configuration);
  const int n = 20000;
  double force = 0, force2 = 0, velocity = 0, velocity2 = 0, torque2 = 0;
  for (int k = 0; k < n; ++k) {
    const BrakeFeedback r = brake.sample();
    force += r.force_N - 35.0, force2 += (r.force_N - 35.0) * (r.force_N - 35.0);
    velocity += r.velocity_rad_s - 0.5, velocity2 += (r.velocity_rad_s - 0.5) * (r.velocity_rad_s - 0.5);
    torque2 += r.torque_Nm * r.torque_Nm;
    EXPECT_NEAR(r.force_N, std::round(r.force_N), 1e-9);
    EXPECT_NEAR(r.velocity_rad_s / 0.02, std::round(r.velocity_rad_s / 0.02), 1e-6);
    EXPECT_DOUBLE_EQ(r.position_rad, 11.3);
  }
  const double mean_tolerance = 5.0 / std::sqrt(n), sd_tolerance = 5.0 / std::sqrt(2.0 * n);
  EXPECT_NEAR(force / n, 0.0, 75.0 * mean_tolerance);
  EXPECT_NEAR(std::sqrt(force2 / n) / 75.0, 1.0, sd_tolerance);
  EXPECT_NEAR(velocity / n, 0.0, 1.5 * mean_tolerance);
  EXPECT_NEAR(std::sqrt(velocity2 / n) / 1.5, 1.0, sd_tolerance);
  EXPECT_NEAR(std::sqrt(torque2 / n) / 0.0142, 1.0, sd_tolerance);
  EXPECT_EQ(brake.truth().velocity_rad_s, 0.0);
}

TEST(SimulatedBrake, EndStopsHoldAtFullTorque) {
  PlantConfiguration configuration;
  SimulatedBrake brake(configuration);
  for (int k = 0; k < 2000; ++k) {
    brake.command({-3.0, true});
    brake.sample();
    ASSERT_GE(brake.truth().position_rad, -configuration.open_stop_rad);
  }
  EXPECT_EQ(brake.truth().position_rad, -configuration.open_stop_rad);
  configuration.brake.theta[k2] *= 0.5;  // turns over at 33 rad and pulls: only the end stop holds it
  SimulatedBrake soft(configuration);
  for (int k = 0; k < 2000; ++k) {
    soft.command({3.0, true});
    soft.sample();
    ASSERT_TRUE(std::isfinite(soft.truth().force_N));
  }
  EXPECT_EQ(soft.truth().position_rad, configuration.closed_stop_rad);
}

}  // namespace
}  // namespace clampd::sim
