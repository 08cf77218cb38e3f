#include "clampd/experiment/certification.hpp"

#include <cmath>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/experiment/optimal_design.hpp"
#include "experiment/designs.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

/// -log det M by the exact sensitivities of simulate().
double exact_logdet(const std::vector<double>& torque_Nm) {
  SensitivitySimulation buffer(torque_Nm.size());
  return criterion_of(initial_state_known(joint_information(BrakeParameters{}, BrakeState::Zero(),
                                                            Excitation{.torque_Nm = torque_Nm}, SensorNoise{},
                                                            buffer)))
      .logdet;
}

Certification certify_blocks(const std::vector<double>& blocks_Nm, const DesignLimits& limits,
                             double error_of_claim = 0.0) {
  const std::vector<double> torque_Nm = expand_blocks(blocks_Nm, 20);
  return certify(BrakeParameters{}, BrakeState::Zero(), torque_Nm, SensorNoise{}, limits,
                 exact_logdet(torque_Nm) + error_of_claim);
}

TEST(Certification, ConfirmsCriterionAndOutputs) {
  const Certification certification = certify_blocks(testing::kGoodBlocks_Nm, DesignLimits{});
  EXPECT_TRUE(certification.granted()) << certification.objection;
  EXPECT_NEAR(certification.criterion.logdet, exact_logdet(expand_blocks(testing::kGoodBlocks_Nm, 20)), 1e-3);
  EXPECT_LT(certification.force_difference_N, 0.1);
  EXPECT_LT(certification.velocity_difference_rad_s, 0.01);
}

TEST(Certification, RefusesAWrongClaim) {
  EXPECT_THAT(certify_blocks(testing::kGoodBlocks_Nm, DesignLimits{}, -0.2).objection, HasSubstr("log det"));
}

TEST(Certification, RefusesEachBrokenLimit) {
  const auto objection = [](auto change) {
    DesignLimits limits;
    change(limits);
    return certify_blocks(testing::kGoodBlocks_Nm, limits).objection;
  };
  EXPECT_THAT(objection([](DesignLimits& limits) { limits.torque_Nm = 2.99; }), HasSubstr("torque"));
  EXPECT_THAT(objection([](DesignLimits& limits) { limits.force_N = 28000.0; }), HasSubstr("force"));
  EXPECT_THAT(objection([](DesignLimits& limits) { limits.velocity_rad_s = 299.0; }), HasSubstr("speed"));
  EXPECT_THAT(objection([](DesignLimits& limits) { limits.end_velocity_rad_s = 1.0; }),
              HasSubstr("at the end"));
  EXPECT_THAT(objection([](DesignLimits& limits) { limits.amplification_rad_s_Nm = 1000.0; }),
              HasSubstr("torque error"));
}

TEST(Certification, RefusesWhatHangsOnTheThirdDecimal) {
  DesignLimits limits;
  limits.amplification_rad_s_Nm = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(certify_blocks(testing::kCreepingBlocks_Nm, limits).granted());
}

TEST(Certification, SurvivesARunThatLeavesTheModel) {
  const Certification certification =
      certify_blocks(std::vector<double>(60, 3.0), DesignLimits{.force_N = 1e9, .velocity_rad_s = 1e9});
  EXPECT_FALSE(certification.granted());
}

}  // namespace
}  // namespace clampd
