#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "clampd/control/stiffness_curve.hpp"
#include "clampd/control/stiffness_estimate.hpp"

namespace clampd {
namespace {

constexpr double kReach_rad = 6.0;

TEST(StiffnessCurve, FindsWhereItHasAForce) {
  const NominalDrive drive;
  const StiffnessCurve nominal = drive.stiffness();
  int found = 0;
  for (const double cubic : {0.6, 1.0, 1.3})
    for (const double quadratic : {0.8, 1.0, 1.2}) {
      const StiffnessCurve curve{cubic * nominal.cubic_N_rad3, quadratic * nominal.quadratic_N_rad2};
      const double inflection_rad = curve.quadratic_N_rad2 / (-3.0 * curve.cubic_N_rad3);
      for (double nominal_rad = 0.5; nominal_rad < 30.0; nominal_rad += 0.5) {
        const double u =
            curve.position_for(nominal.force_N(nominal_rad), nominal_rad, drive.quadratic_N_rad2, kReach_rad);
        const bool held_back = std::abs(u - nominal_rad) > kReach_rad - 1e-9 || u > 1.59 * inflection_rad;
        if (held_back) continue;
        ++found;
        ASSERT_NEAR(curve.force_N(u), nominal.force_N(nominal_rad), 0.1)
            << cubic << ", " << quadratic << " at " << nominal_rad;
      }
    }
  EXPECT_GT(found, 450) << "of 531";
}

TEST(StiffnessCurve, NeverSendsTheMotorFarBeyondTheNominalPosition) {
  const NominalDrive drive;
  const StiffnessCurve soft{drive.cubic_N_rad3, 0.7 * drive.quadratic_N_rad2};
  for (const StiffnessCurve& curve : {drive.stiffness(), soft})
    for (const double target_N : {0.0, 100.0, 5e3, 20e3, 30e3, 1e6})
      for (const double nominal_rad : {-3.0, 0.0, 0.1, 5.0, 20.0, 36.0}) {
        const double u = curve.position_for(target_N, nominal_rad, drive.quadratic_N_rad2, kReach_rad);
        EXPECT_LE(std::abs(u - nominal_rad), kReach_rad + 1e-9);
      }
  EXPECT_EQ(soft.position_for(0.0, -3.0, drive.quadratic_N_rad2, kReach_rad), -3.0)
      << "in the clearance a position is a position";
}

TEST(StiffnessEstimate, LearnsTheCurveAndWhereItBegins) {
  const NominalDrive drive;
  StiffnessEstimate estimate;
  const double contact_rad = 5.0;
  const auto force_N = [](double u) { return 0.9 * 35.2 * u * u - 0.8 * 0.354 * u * u * u; };
  estimate.start(drive, contact_rad + 3.2, force_N(3.2));
  for (int k = 0; k < 300; ++k) {
    const double u = 3.2 + 27.0 * k / 300.0;
    estimate.learn(contact_rad + u, force_N(u), 100.0);
  }
  EXPECT_NEAR(estimate.contact_rad(), contact_rad, 0.1);
  for (const double u : {5.0, 10.0, 20.0, 30.0}) {
    EXPECT_NEAR(estimate.curve().force_N(u), force_N(u), 20.0 + 0.02 * force_N(u));
    const double nominal_rad = u * 0.95;
    EXPECT_NEAR(estimate.curve().position_for(force_N(u), nominal_rad, drive.quadratic_N_rad2, kReach_rad), u,
                0.2);
  }
  const double once_N = estimate.curve().force_N(20.0);
  estimate.learn(contact_rad + 20.0, 1e6, 100.0);
  EXPECT_NEAR(estimate.curve().force_N(20.0), once_N, 0.05 * once_N) << "a spike moves little";
}

}  // namespace
}  // namespace clampd
