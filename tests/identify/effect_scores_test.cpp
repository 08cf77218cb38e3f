#include "clampd/identify/effect_scores.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "clampd/statistics/symmetric.hpp"
#include "reanalysis/scored_line.hpp"

namespace clampd {
namespace {

Eigen::Index index_of(const EffectScores& scores, std::string_view effect) {
  return std::find_if(scores.directions.begin(), scores.directions.end(),
                      [&](const EffectDirection& direction) {
                        return info_of(*direction.effect.effect).name == effect;
                      }) -
         scores.directions.begin();
}

TEST(EffectScores, AreOfTheSameDirectionsForAnyRuns) {
  EXPECT_TRUE(support::scored_check(1, 3, {}).directions == effects_with_strengths());
}

// Of what the brake has, the score over the information is the strength, within what one check knows.
TEST(EffectScores, TellTheStrengthThatABrakeHas) {
  for (const auto& [effect, size] :
       {std::pair{"force-lag", 2e-4}, {"backlash", 0.012}, {"torque-gain", 0.0015}, {"pad-damping", 0.15}}) {
    const EffectScores scores = support::scored_check(5, 5, {{effect, size}});
    const Eigen::Index at = index_of(scores, effect);
    const double information = scores.information(at, at);
    ASSERT_GT(information, 0.0) << effect;
    const double sd = 1.0 / std::sqrt(information);
    EXPECT_GT(size, 4.0 * sd) << effect << ": the test would tell nothing";
    EXPECT_NEAR(scores.score[at] / information, size, 3.5 * sd + 0.1 * size) << effect;
  }
}

// Two strengths at once, each of which moves the other's score: only the joint information tells them apart.
TEST(EffectScores, TellTwoStrengthsApart) {
  const EffectScores scores = support::scored_check(6, 5, {{"force-lag", 3e-4}, {"torque-gain", 0.003}});
  const std::vector<Eigen::Index> two{index_of(scores, "force-lag"), index_of(scores, "torque-gain")};
  const Eigen::Matrix2d covariance = Eigen::MatrixXd(scores.information(two, two)).inverse();
  const Eigen::Vector2d found = covariance * scores.score(two);
  EXPECT_NEAR(found[0], 3e-4, 3.5 * std::sqrt(covariance(0, 0)) + 3e-5);
  EXPECT_NEAR(found[1], 0.003, 3.5 * std::sqrt(covariance(1, 1)) + 3e-4);
}

// Effects are linearised a few at a time, but their information is that of all together.
TEST(EffectScores, HaveOneInformationForAllEffects) {
  const EffectScores scores = support::scored_check(7, 3, {});
  const Eigen::VectorXd root = scores.information.diagonal().cwiseMax(1e-300).cwiseSqrt();
  const Eigen::MatrixXd correlation = scores.information.cwiseQuotient(root * root.transpose());
  EXPECT_LE(correlation.cwiseAbs().maxCoeff(), 1.0 + 1e-9);
  EXPECT_TRUE(scores.information.isApprox(scores.information.transpose(), 1e-12));
  EXPECT_GT(statistics::spectrum_of(correlation).values.minCoeff(), -1e-6);
}

TEST(EffectScores, NeedRunsThatTheBaseModelFits) {
  EXPECT_FALSE(score_effects({}, BrakeParameters{}));
  clampd::Run still;
  for (int k = 0; k < 50; ++k) {
    still.time_s.push_back(k * 1e-3);
    still.torque_Nm.push_back(1e6);
    still.velocity_rad_s.push_back(std::nan(""));
    still.force_N.push_back(0.0);
  }
  EXPECT_FALSE(score_effects({&still, 1}, BrakeParameters{}));
}

}  // namespace
}  // namespace clampd
