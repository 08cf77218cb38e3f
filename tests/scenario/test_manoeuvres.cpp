#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/experiment/manoeuvres.hpp"
#include "tests/scenario/scenario.hpp"

namespace clampd {
namespace {

TEST(Manoeuvres, EachIsATrajectoryOfTheNominalBrakeAndIsTracked) {
  for (const ManoeuvreInfo& info : manoeuvres()) {
    SCOPED_TRACE(info.name);
    const auto run = make_manoeuvre(info.name, BrakeParameters{}, scenario::shipped_trajectory());
    ASSERT_TRUE(run.has_value()) << run.error().message;
    const auto reference = build_reference(*run, BrakeParameters{});
    ASSERT_TRUE(reference.has_value()) << reference.error().message;
    for (const char* brake : {"plant.toml", "brakes/used.toml"}) {
      const auto plant = sim::read_plant_configuration(scenario::config(brake)).value();
      const SimulatedCheck check = simulate_check(plant, *reference, BrakeParameters{}, {.repeats = 2});
      EXPECT_EQ(check.fault, FaultCause::None);
      EXPECT_EQ(check.runs.size(), 2u);
      EXPECT_LT(check.force_max_N, 30e3);
      EXPECT_LT(check.speed_max_rad_s, 300.0);
      EXPECT_LT(scenario::tracking_error(check, *reference).rms_N, 40.0) << brake;
    }
  }
}

TEST(Manoeuvres, DoWhatTheirDescriptionsSay) {
  const auto make = [](const char* name) { return make_manoeuvre(name, BrakeParameters{}, {}).value(); };
  const auto highest = [](const clampd::Run& run) {
    return *std::max_element(run.force_N.begin(), run.force_N.end());
  };

  const clampd::Run apply_release = make("apply-release");
  EXPECT_NEAR(highest(apply_release), 20e3, 50.0);
  EXPECT_NEAR(apply_release.time_s.back(), 0.8, 1e-9);
  EXPECT_LT(apply_release.force_N.back(), 5.0);

  const clampd::Run sinusoid = make("sinusoid");
  double lowest_N = 1e9;
  for (std::size_t k = 150; k < 1150; ++k) lowest_N = std::min(lowest_N, sinusoid.force_N[k]);
  EXPECT_NEAR(highest(sinusoid), 20e3, 50.0);
  EXPECT_NEAR(lowest_N, 5e3, 50.0);

  const clampd::Run slow_sinusoid = make("slow-sinusoid");
  EXPECT_NEAR(highest(slow_sinusoid), 20e3, 50.0);
  EXPECT_NEAR(slow_sinusoid.time_s.back(), 2.35, 1e-9);
  EXPECT_NEAR(slow_sinusoid.force_N[150 + 667], 5e3, 50.0) << "after one cycle of 1.5 Hz";
  EXPECT_NEAR(slow_sinusoid.force_N[150 + 1000], 20e3, 50.0) << "half a cycle later";

  const clampd::Run clearance = make("clearance");
  EXPECT_EQ(highest(clearance), 0.0);
  EXPECT_LT(*std::min_element(clearance.velocity_rad_s.begin(), clearance.velocity_rad_s.end()), -40.0);
  EXPECT_GT(*std::max_element(clearance.velocity_rad_s.begin(), clearance.velocity_rad_s.end()), 40.0);

  const clampd::Run staircase = make("staircase");
  EXPECT_NEAR(staircase.force_N[200], 5e3, 50.0) << "first landing";
  EXPECT_EQ(staircase.velocity_rad_s[200], 0.0);
}

TEST(Manoeuvres, ErrorsSayWhatAndWhatElse) {
  const auto unknown = make_manoeuvre("loop", BrakeParameters{}, {});
  ASSERT_FALSE(unknown.has_value());
  EXPECT_THAT(unknown.error().message, ::testing::HasSubstr("staircase"));
  BrakeParameters weak;
  weak.theta[k2] *= 0.5;
  const auto unreachable = make_manoeuvre("step", weak, {});
  ASSERT_FALSE(unreachable.has_value());
  EXPECT_THAT(unreachable.error().message, ::testing::HasSubstr("cannot reach"));
  BrakeParameters heavy;
  heavy.fixed.inertia_kg_m2 *= 10.0;
  EXPECT_FALSE(make_manoeuvre("step", heavy, {}).has_value());
}

TEST(Simulation, IsRepeatableAndSaysWhyItFailed) {
  const Reference reference = scenario::shipped_reference();
  const auto first = simulate_manoeuvre(scenario::noisy_plant(), reference, BrakeParameters{}, 2);
  const auto second = simulate_manoeuvre(scenario::noisy_plant(), reference, BrakeParameters{}, 2);
  ASSERT_TRUE(first.has_value() && second.has_value());
  ASSERT_EQ(first->size(), 2u);
  EXPECT_EQ(first->at(1).force_N, second->at(1).force_N);
  EXPECT_EQ(first->at(0).name, "repeat 1");
  EXPECT_NE(first->at(0).force_N, first->at(1).force_N);

  sim::PlantConfiguration no_pads = scenario::shipped_plant();
  no_pads.brake.theta[k1] = 0.0;
  no_pads.brake.theta[k2] = 0.1;
  const auto failed = simulate_manoeuvre(no_pads, reference, BrakeParameters{});
  ASSERT_FALSE(failed.has_value());
  EXPECT_THAT(failed.error().message, ::testing::HasSubstr("sequence-timeout in phase approach"));
}

}  // namespace
}  // namespace clampd
