#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/scenario/scenario.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

class ReferenceTest : public ::testing::Test {
 protected:
  void refused(const std::string& what) {
    const auto reference = build_reference(run_, brake_, options_);
    ASSERT_FALSE(reference.has_value()) << what;
    EXPECT_THAT(reference.error().message, HasSubstr(what));
  }

  clampd::Run run_ = scenario::shipped_trajectory();
  BrakeParameters brake_;
  ReferenceOptions options_;
};

TEST_F(ReferenceTest, ShippedTrajectoryHasHeadroomForOtherBrakes) {
  // A brake from a corner of Table II needs up to 0.3 N m more friction and 15 % more speed for the same
  // force.
  const auto reference = build_reference(run_, brake_);
  ASSERT_TRUE(reference.has_value()) << reference.error().message;
  ASSERT_EQ(reference->rows.size(), 300u);
  double force_max_N = 0.0;
  for (const ReferenceRow& row : reference->rows) {
    EXPECT_LE(std::abs(row.torque_Nm), 2.4);
    EXPECT_LE(std::abs(row.velocity_rad_s), 260.0);
    EXPECT_LE(row.force_N, 25e3);
    EXPECT_GT(row.gain_position, 0.0);
    EXPECT_GT(row.gain_velocity, 0.02) << "must outweigh the Stribeck slope of -0.018 N m s/rad";
    force_max_N = std::max(force_max_N, row.force_N);
  }
  EXPECT_GT(force_max_N, 10e3);
}

TEST_F(ReferenceTest, ASlowStationTakesEachOfItsRowsFromTheTrajectory) {
  for (const std::size_t per_period : {2u, 5u}) {
    options_.period_s = 1e-3 * static_cast<double>(per_period);
    const auto reference = build_reference(run_, brake_, options_);
    ASSERT_TRUE(reference) << reference.error().message;
    ASSERT_EQ(reference->rows.size(), 300 / per_period);
    for (std::size_t k = 0; k < reference->rows.size(); ++k) {
      EXPECT_EQ(reference->rows[k].torque_Nm, run_.torque_Nm[k * per_period]);
      EXPECT_EQ(reference->rows[k].position_rad, run_.position_rad[k * per_period]);
    }
  }
}

TEST_F(ReferenceTest, ATorqueThatASlowStationCannotReplayIsRefused) {
  options_.period_s = 8e-3;
  refused("row 20: the torque changes within the station's period of 8 ms");
  refused("clampctl design --block 16");
}

TEST_F(ReferenceTest, StiffnessIsTheSlopeOfTheForce) {
  const auto reference = build_reference(run_, brake_);
  ASSERT_TRUE(reference.has_value());
  for (const ReferenceRow& row : reference->rows) {
    const double x = std::max(0.0, row.position_rad);
    EXPECT_NEAR(row.stiffness_N_rad, (2.0 * brake_.theta[k2] + 3.0 * brake_.theta[k1] * x) * x, 1e-6);
  }
}

TEST_F(ReferenceTest, RefusesWhatBreaksALimit) {
  options_.force_limit_N = 10e3;
  refused("force_N");
  options_ = {};
  options_.velocity_limit_rad_s = 100.0;
  refused("velocity_rad_s");
  options_ = {};
  options_.torque_limit_Nm = 1.0;
  refused("torque_Nm");
  options_ = {};
  run_.velocity_rad_s[20] = std::nan("");
  refused("row 20");
}

TEST_F(ReferenceTest, RefusesAnotherBrakesTrajectory) {
  brake_.theta[mus] *= 1.5;
  refused("another brake");
  brake_ = {};
  brake_.theta[k2] *= 1.1;
  refused("another brake");
}

TEST_F(ReferenceTest, RefusesTornTrajectories) {
  run_.position_rad.clear();
  refused("position_rad");
  run_ = scenario::shipped_trajectory();
  run_.time_s[100] += 0.5e-3;
  refused("1 ms");
  run_ = scenario::shipped_trajectory();
  run_.torque_Nm[150] += 0.5;
  refused("row 151");
  run_ = scenario::shipped_trajectory();
  for (auto* column :
       {&run_.time_s, &run_.torque_Nm, &run_.velocity_rad_s, &run_.force_N, &run_.position_rad})
    column->erase(column->begin(), column->begin() + 50);
  refused("starts at rest");
  run_ = {};
  refused("rows");
}

TEST_F(ReferenceTest, RefusesImpossibleOptions) {
  options_.tracking_force_N = 0.0;
  refused("tracking_force_N");
  options_ = {};
  options_.force_limit_N = std::nan("");
  refused("force_limit_N");
}

}  // namespace
}  // namespace clampd
