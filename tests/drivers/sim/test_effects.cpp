#include <cmath>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/sim/simulated_brake.hpp"

namespace clampd::sim {
namespace {

std::vector<BrakeFeedback> readings(const Effects& effects) {
  PlantConfiguration configuration;
  configuration.clearance_rad = 0.0;
  configuration.effects = effects;
  SimulatedBrake brake(configuration);
  std::vector<BrakeFeedback> result;
  for (int k = 0; k < 600; ++k) {
    if (k == 300) brake.begin_run(3);
    const int j = k % 300;
    brake.command({j < 60 ? 2.0 : j < 140 ? 1.2 : j < 200 ? 0.5 : -1.2 + 0.006 * (j - 200), true});
    result.push_back(brake.sample());
  }
  return result;
}

TEST(Effects, EachOneShowsInTheReadingsAndKeepsThemFinite) {
  const auto base = readings({});
  const double values[kEffectTable.size()] = {0.02, 0.05, 2e-3, 1e-5, 0.02, 2e-6, 0.02, 0.1,
                                              0.1,  0.1,  0.05, 0.05, 5.0,  0.05, 0.5,  1e-3,
                                              200., 5e-3, 1e4,  100., 5e-3, 1.5,  0.05};
  for (std::size_t i = 0; i < kEffectTable.size(); ++i) {
    Effects effects;
    ASSERT_TRUE(set_effect(effects, kEffectTable[i].name, values[i]).has_value());
    const auto changed = readings(effects);
    double difference = 0.0;
    for (std::size_t k = 0; k < base.size(); ++k) {
      ASSERT_TRUE(std::isfinite(changed[k].force_N) && std::isfinite(changed[k].velocity_rad_s));
      difference += std::abs(changed[k].force_N - base[k].force_N) / 100.0 +
                    std::abs(changed[k].velocity_rad_s - base[k].velocity_rad_s) +
                    std::abs(changed[k].torque_Nm - base[k].torque_Nm);
    }
    EXPECT_GT(difference, 1.0) << kEffectTable[i].name;
  }
}

TEST(Effects, ReadingEffectsDoWhatTheirTableSays) {
  const auto base = readings({});
  Effects offset;
  offset.torque_offset_Nm = 0.02;
  Effects gain;
  gain.torque_gain = 0.1;
  Effects skew;
  skew.channel_skew = 2.0;
  Effects clip;
  clip.force_saturation_N = 5000.0;
  const auto with_offset = readings(offset), with_gain = readings(gain), skewed = readings(skew),
             clipped = readings(clip);
  double highest_N = 0.0;
  for (std::size_t k = 2; k < base.size(); ++k) {
    EXPECT_NEAR(with_offset[k].torque_Nm, base[k].torque_Nm + 0.02, 1e-12);
    EXPECT_NEAR(with_gain[k].torque_Nm, base[k].torque_Nm * 1.1, 1e-12);
    EXPECT_DOUBLE_EQ(skewed[k].force_N, base[k - 2].force_N);
    EXPECT_DOUBLE_EQ(clipped[k].force_N, std::min(base[k].force_N, 5000.0));
    EXPECT_EQ(with_offset[k].force_N, base[k].force_N);
    highest_N = std::max(highest_N, base[k].force_N);
  }
  EXPECT_GT(highest_N, 6000.0);
}

/// A lag is a delay of a reading that grows evenly; of the torque it takes so much time of it from the
/// motion.
TEST(Effects, LagsAreAsLongAsTheirTimeConstant) {
  constexpr double kLag_s = 50e-6;
  const auto velocities = [](double Effects::*lag_s) {
    PlantConfiguration configuration;
    configuration.sensors = {};
    configuration.clearance_rad = configuration.open_stop_rad;
    if (lag_s != nullptr) configuration.effects.*lag_s = kLag_s;
    SimulatedBrake brake(configuration);
    std::vector<double> seen;
    for (int k = 0; k < 6; ++k) {
      brake.command({0.5, true});
      seen.push_back(brake.sample().velocity_rad_s);
    }
    return seen;
  };
  const std::vector<double> at_once = velocities(nullptr);
  const double per_s = (at_once[5] - at_once[3]) / 2e-3;
  const double lost_per_s = 0.5 / FixedParameters{}.inertia_kg_m2;
  EXPECT_NEAR((at_once[4] - velocities(&Effects::velocity_lag_s)[4]) / per_s, kLag_s, 0.03 * kLag_s);
  EXPECT_NEAR((at_once[4] - velocities(&Effects::torque_lag_s)[4]) / lost_per_s, kLag_s, 0.03 * kLag_s);
}

TEST(Effects, BacklashHoldsTheForceAtReversal) {
  // Held under load, then turned back by less than the lost motion: the force must not fall.
  PlantConfiguration configuration;
  configuration.clearance_rad = 0.0;
  configuration.effects.backlash_rad = 2.0;
  SimulatedBrake brake(configuration);
  for (int k = 0; k < 200; ++k) {
    brake.command({k < 60 ? 2.0 : 0.0, true});
    brake.sample();
  }
  const double held_N = brake.truth().force_N, held_rad = brake.truth().position_rad;
  ASSERT_GT(held_N, 1000.0);
  while (brake.truth().position_rad > held_rad - 1.5) {
    brake.command({-0.6, true});
    brake.sample();
  }
  EXPECT_NEAR(brake.truth().force_N, held_N, 1e-6);
  while (brake.truth().position_rad > held_rad - 3.0) {
    brake.command({-0.6, true});
    brake.sample();
  }
  EXPECT_LT(brake.truth().force_N, held_N - 100.0);
}

TEST(Effects, AssignmentsAreParsedStrictly) {
  Effects effects;
  EXPECT_TRUE(set_effect(effects, "cogging=0.02").has_value());
  EXPECT_DOUBLE_EQ(effects.cogging_Nm, 0.02);
  for (const char* bad : {"cogging", "cogging=", "cogging=0.02x", "=1", "cogging=nan", "cogging=-1"})
    EXPECT_FALSE(set_effect(effects, bad).has_value()) << bad;
  const auto unknown = set_effect(effects, "coging=0.02");
  ASSERT_FALSE(unknown.has_value());
  EXPECT_THAT(unknown.error().message,
              ::testing::AllOf(::testing::HasSubstr("coging"), ::testing::HasSubstr("cogging"),
                               ::testing::HasSubstr("outliers")));
}

}  // namespace
}  // namespace clampd::sim
