#include "clampd/control/motion_observer.hpp"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

namespace clampd {
namespace {

TEST(MotionObserver, StartsFromWhatIsKnown) {
  MotionObserver observer;
  observer.reset({.position_rad = 7.0, .velocity_rad_s = -20.0, .friction_excess_Nm = 0.1});
  EXPECT_EQ(observer.state().position_rad, 7.0);
  EXPECT_EQ(observer.state().velocity_rad_s, -20.0);
  EXPECT_EQ(observer.state().friction_excess_Nm, 0.1);
  observer.reset({.position_rad = 3.0});
  EXPECT_EQ(observer.position_rad(), 3.0);
  EXPECT_EQ(observer.velocity_rad_s(), 0.0);
  EXPECT_EQ(observer.state().friction_excess_Nm, 0.0);
}

TEST(MotionObserver, LearnsWhatTheFrictionExceedsTheNominalOneBy) {
  const NominalDrive drive;
  constexpr double kExcess_Nm = 0.05, kForce_N = 5e3, kStep_s = 1e-5;
  double position_rad = 2.0, velocity_rad_s = 0.0;
  MotionObserver observer;
  observer.reset({.position_rad = position_rad});
  for (int k = 0; k < 400; ++k) {
    const double torque_Nm = 0.7;  // it slides one way throughout
    observer.predict(drive, torque_Nm, kForce_N);
    for (int i = 0; i < 100; ++i) {
      const double friction_Nm = drive.dry_friction_Nm(velocity_rad_s, kForce_N) + kExcess_Nm +
                                 drive.viscous_Nm_s_rad * velocity_rad_s;
      const double acceleration_rad_s2 =
          (torque_Nm - drive.ratio_m_rad * kForce_N - friction_Nm) / drive.inertia_kg_m2;
      position_rad += kStep_s * velocity_rad_s;
      velocity_rad_s = std::max(0.0, velocity_rad_s + kStep_s * acceleration_rad_s2);
    }
    observer.correct(position_rad, velocity_rad_s);
  }
  EXPECT_GT(velocity_rad_s, 10.0);
  EXPECT_NEAR(observer.state().friction_excess_Nm, kExcess_Nm, 0.01);
  EXPECT_NEAR(observer.velocity_rad_s(), velocity_rad_s, 1.0);
}

TEST(MotionObserver, PredictsASlowSampleAsItsMilliseconds) {
  const NominalDrive slow{.period_s = 5e-3}, fast;
  for (const double torque_Nm : {0.9, -1.2, 0.2}) {
    MotionObserver once, often;
    for (MotionObserver* observer : {&once, &often})
      observer->reset({.position_rad = 3.0, .velocity_rad_s = 20.0, .friction_excess_Nm = 0.02});
    once.predict(slow, torque_Nm, 4e3);
    for (int k = 0; k < 5; ++k) often.predict(fast, torque_Nm, 4e3);
    EXPECT_NEAR(once.velocity_rad_s(), often.velocity_rad_s(), 1e-9);
    EXPECT_NEAR(once.position_rad(), often.position_rad(), 1e-9);
  }
}

}  // namespace
}  // namespace clampd
