#include "clampd/identify/information.hpp"

#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "support/excitation.hpp"

namespace clampd {
namespace {

JointInformation strong_information(const SensorNoise& noise) {
  const auto torque = support::strong_torque();
  SensitivitySimulation buffer(torque.size());
  return joint_information({}, BrakeState::Zero(), {torque}, noise, buffer);
}

TEST(Information, ScalesWithTheNoise) {
  const JointInformation once = strong_information({75.0, 1.5});
  const JointInformation twice = strong_information({150.0, 3.0});
  EXPECT_LT((once - 4.0 * twice).norm(), 1e-9 * once.norm());
}

TEST(Information, UnknownInitialStateCostsWhatTheFullInverseSays) {
  JointInformation joint = strong_information({75.0, 1.5});
  const ParameterMatrix unknown = cramer_rao(initial_state_unknown(joint));
  const ParameterMatrix known = cramer_rao(initial_state_known(joint));
  joint(7, 7) += 1.0 / 100.0;
  joint(8, 8) += 1.0 / 10000.0;
  const ParameterMatrix full = joint.inverse().topLeftCorner<7, 7>();
  EXPECT_LT((unknown - full).norm(), 1e-6 * full.norm());
  for (int i = 0; i < 7; ++i) EXPECT_GT(unknown(i, i), known(i, i));
}

TEST(Information, LogDetAndBoundAgree) {
  const ParameterMatrix information = initial_state_known(strong_information({75.0, 1.5}));
  EXPECT_NEAR(log_det(information), -std::log(cramer_rao(information).determinant()), 1e-6);
  EXPECT_FALSE(unidentifiable_parameter(information));
}

TEST(Information, SingularInformationHasNoBound) {
  // At rest in the clearance nothing is learnt; sliding there, nothing about load and stiffness.
  const std::vector<double> rest(50, 0.0);
  const std::vector<double> push(50, 0.2);
  SensitivitySimulation buffer(50);
  for (const auto& torque : {rest, push}) {
    const ParameterMatrix information = initial_state_unknown(
        joint_information(BrakeParameters{}, BrakeState(-90.0, 0.0), {torque}, SensorNoise{}, buffer));
    EXPECT_EQ(log_det(information), -std::numeric_limits<double>::infinity());
    EXPECT_TRUE(cramer_rao(information).array().isNaN().all());
    EXPECT_TRUE(unidentifiable_parameter(information));
  }
}

TEST(Information, OfADivergingRunIsNotANumber) {
  const std::vector<double> torque(300, 3.0);
  SensitivitySimulation buffer(300);
  const JointInformation joint =
      joint_information({}, BrakeState(60.0, 200.0), {torque}, SensorNoise{}, buffer);
  EXPECT_EQ(log_det(initial_state_known(joint)), -std::numeric_limits<double>::infinity());
}

}  // namespace
}  // namespace clampd
