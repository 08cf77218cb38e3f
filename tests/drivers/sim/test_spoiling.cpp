#include "drivers/sim/spoiling.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "drivers/sim/simulated_brake.hpp"

namespace clampd::sim {
namespace {

constexpr double kBegin_s = 0.1;

/// Readings of a moving brake, spoiled so; `look` gets each sample and what it would have been.
template <class Look>
void drive(const SpoiledReading& spoiled, const Look& look) {
  PlantConfiguration plant;
  plant.clearance_rad = 0.0;
  plant.sensors.force_noise_N = 30.0;
  plant.sensors.velocity_noise_rad_s = 0.3;
  plant.sensors.torque_noise_Nm = 0.002;
  plant.spoiled = {spoiled};
  SimulatedBrake brake(plant);
  for (int k = 0; k < 300; ++k) {
    brake.command({k % 100 < 60 ? 0.9 : -0.6, true});
    const BrakeFeedback seen = brake.sample();
    look(k, seen, brake.unspoiled());
  }
}

TEST(Spoiling, BeginsAtItsTimeAndTouchesNothingElse) {
  for (std::size_t kind = 0; kind < kSpoilCount; ++kind) {
    SCOPED_TRACE(to_string(static_cast<Spoil>(kind)));
    int differences = 0;
    drive({Reading::Velocity, static_cast<Spoil>(kind), 7.0, kBegin_s},
          [&](int k, const BrakeFeedback& seen, const BrakeFeedback& healthy) {
            EXPECT_EQ(seen.force_N, healthy.force_N);
            EXPECT_EQ(seen.torque_Nm, healthy.torque_Nm);
            EXPECT_EQ(seen.position_rad, healthy.position_rad);
            EXPECT_EQ(seen.sample_index, healthy.sample_index);
            if (k < 100) {
              EXPECT_EQ(seen.velocity_rad_s, healthy.velocity_rad_s);
            }
            differences += seen.velocity_rad_s != healthy.velocity_rad_s;
          });
    EXPECT_EQ(differences, 200);
  }
}

TEST(Spoiling, MayWaitUntilTheBrakeIsClamped) {
  SpoiledReading spoiled{Reading::Torque, Spoil::Offset, 1.0, 0.01};
  spoiled.when.duration_s = 0.02;
  spoiled.when.from_force_N = 2000.0;
  PlantConfiguration plant;
  plant.clearance_rad = 0.0;
  plant.spoiled = {spoiled};
  plant.faults = {{FaultKind::Silent, spoiled.when}};
  SimulatedBrake brake(plant);
  int met = -1, begun = -1, differences = 0;
  // Clamped twice: it misbehaves once.
  for (int k = 0; k < 400; ++k) {
    brake.command({k % 200 < 100 ? 0.9 : -0.6, true});
    const bool differs = brake.sample().torque_Nm != brake.unspoiled().torque_Nm;
    EXPECT_EQ(brake.configuration().fault_active(FaultKind::Silent, brake.truth().time_s), differs);
    if (met < 0 && brake.truth().force_N > 2000.0) met = k;
    if (begun < 0 && differs) begun = k;
    differences += differs;
  }
  ASSERT_GT(met, 0);
  EXPECT_EQ(begun, met + 10);
  EXPECT_EQ(differences, 20);
}

TEST(Spoiling, DoesWhatItsKindSays) {
  double before_N = 0.0;
  drive({Reading::Force, Spoil::Frozen, 0.0, kBegin_s},
        [&](int k, const BrakeFeedback& seen, const BrakeFeedback&) {
          if (k < 100) before_N = seen.force_N;
          EXPECT_TRUE(k < 100 || seen.force_N == before_N);
        });
  drive({Reading::Torque, Spoil::Scaled, 2.0, kBegin_s},
        [](int k, const BrakeFeedback& seen, const BrakeFeedback& healthy) {
          EXPECT_EQ(seen.torque_Nm, (k < 100 ? 1.0 : 2.0) * healthy.torque_Nm);
        });
  drive({Reading::Position, Spoil::Offset, 3.0, kBegin_s, 0.1},
        [](int k, const BrakeFeedback& seen, const BrakeFeedback& healthy) {
          EXPECT_EQ(seen.position_rad, healthy.position_rad + (k >= 100 && k < 200 ? 3.0 : 0.0));
        });
  std::vector<double> healthy_rad_s;
  drive({Reading::Velocity, Spoil::Late, 20.0, kBegin_s},
        [&](int k, const BrakeFeedback& seen, const BrakeFeedback& healthy) {
          healthy_rad_s.push_back(healthy.velocity_rad_s);
          if (k >= 100) {
            EXPECT_EQ(seen.velocity_rad_s, healthy_rad_s[static_cast<std::size_t>(k) - 20]);
          }
        });
  double squares = 0.0;
  drive({Reading::Force, Spoil::Noisy, 1000.0, kBegin_s},
        [&](int, const BrakeFeedback& seen, const BrakeFeedback& healthy) {
          squares += std::pow(seen.force_N - healthy.force_N, 2);
        });
  EXPECT_NEAR(std::sqrt(squares / 200.0), 1000.0, 200.0);
}

TEST(Spoiling, AnEncoderSpoilsPositionAndVelocity) {
  BrakeFeedback last;
  drive({Reading::Encoder, Spoil::Frozen, 0.0, kBegin_s},
        [&](int k, const BrakeFeedback& seen, const BrakeFeedback&) {
          if (k >= 100) {
            EXPECT_EQ(seen.position_rad, last.position_rad);
            EXPECT_EQ(seen.velocity_rad_s, last.velocity_rad_s);
          }
          last = seen;
        });
}

}  // namespace
}  // namespace clampd::sim
