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

TEST(Manoeuvres, ShakingGoesToAndFroWithAllTorqueAndEndsAtRest) {
  constexpr double kSwing_rad = 0.3, kTorque_Nm = 2.5;
  const ManoeuvreSegment segments[] = {{.duration_s = 0.2, .force_N = 12e3},
                                       {.duration_s = 0.5, .swing_rad = kSwing_rad, .torque_Nm = kTorque_Nm},
                                       {.duration_s = 0.2}};
  const clampd::Run run = follow_segments("shaking", segments, BrakeParameters{}).value();
  ASSERT_EQ(run.size(), 901u);
  ASSERT_TRUE(build_reference(run, BrakeParameters{}));
  const double from_rad = run.position_rad[200];
  EXPECT_NEAR(run.force_N[200], 12e3, 50.0);
  int all = 0, reversals = 0;
  std::vector<int> at_tenth(10);
  double nearest_rad = from_rad, farthest_rad = from_rad - kSwing_rad;
  for (std::size_t k = 200; k < 700; ++k) {
    ASSERT_LE(std::abs(run.torque_Nm[k]), kTorque_Nm + 1e-12) << k;
    const bool with_all = std::abs(run.torque_Nm[k]) > 0.999 * kTorque_Nm;
    all += with_all;
    nearest_rad = std::min(nearest_rad, run.position_rad[k]);
    if (k > 220) farthest_rad = std::max(farthest_rad, run.position_rad[k]);
    if (!(run.velocity_rad_s[k] * run.velocity_rad_s[k + 1] < 0.0)) continue;
    ++reversals;
    // As fast within the row as in the one before.
    const double slope = run.velocity_rad_s[k] - run.velocity_rad_s[k - 1];
    if (with_all && run.torque_Nm[k] == run.torque_Nm[k - 1])
      ++at_tenth[static_cast<std::size_t>(std::min(9.0, -10.0 * run.velocity_rad_s[k] / slope))];
  }
  EXPECT_GT(all, 400) << "rows of 500; the others turn the torque round";
  // sqrt(2 s (1/a + 1/b)) with a and b of 2.5 N m with 0.32 of load and 0.55 of friction for or against it:
  // there and back take 24.5 ms, and less where the swing is up to 30 % smaller.
  EXPECT_GT(reversals, 2 * 500 / 24.5);
  EXPECT_LT(reversals, 2 * 500 / (24.5 * std::sqrt(0.7)));
  EXPECT_LE(std::count(at_tenth.begin(), at_tenth.end(), 0), 2) << "they come at any time of a row";
  EXPECT_NEAR(nearest_rad, from_rad - kSwing_rad, 0.05 * kSwing_rad);
  EXPECT_NEAR(farthest_rad, from_rad, 0.05 * kSwing_rad);
  EXPECT_EQ(run.velocity_rad_s[700], 0.0);
  EXPECT_NEAR(run.position_rad[900], 0.0, 0.01) << "and on from there";

  for (const double duration_s : {0.06, 0.08, 0.1, 0.15}) {
    const ManoeuvreSegment brief[] = {
        segments[0], {.duration_s = duration_s, .swing_rad = kSwing_rad, .torque_Nm = kTorque_Nm}};
    const clampd::Run rests = follow_segments("brief", brief, BrakeParameters{}).value();
    EXPECT_EQ(rests.velocity_rad_s.back(), 0.0) << duration_s;
  }
  const ManoeuvreSegment far[] = {segments[0],
                                  {.duration_s = 0.05, .swing_rad = 5.0, .torque_Nm = kTorque_Nm}};
  const auto endless = follow_segments("far", far, BrakeParameters{});
  ASSERT_FALSE(endless);
  EXPECT_THAT(endless.error().message, ::testing::HasSubstr("no time for its swings"));

  const ManoeuvreSegment weak[] = {segments[0], {.duration_s = 0.5, .swing_rad = 0.3, .torque_Nm = 0.01}};
  const clampd::Run held = follow_segments("weak", weak, BrakeParameters{}).value();
  EXPECT_EQ(held.position_rad[250], held.position_rad[650]) << "friction is stronger";
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
