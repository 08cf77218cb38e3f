#include "clampd/diagnose/effect_scores.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "reanalysis/scored_line.hpp"

namespace clampd {
namespace {

const EffectScore& score_named(const std::vector<EffectScore>& scores, std::string_view effect) {
  return *std::find_if(scores.begin(), scores.end(), [&](const EffectScore& score) {
    return info_of(*score.effect.effect).name == effect;
  });
}

TEST(EffectScores, AreOfTheSameDirectionsForAnyRuns) {
  const std::vector<EffectScore> asked = effects_with_strengths();
  const std::vector<EffectScore> answered = support::scored_check(1, 3, {});
  ASSERT_EQ(answered.size(), asked.size());
  for (std::size_t i = 0; i < asked.size(); ++i) {
    EXPECT_EQ(answered[i].effect.effect, asked[i].effect.effect);
    EXPECT_EQ(answered[i].effect.values, asked[i].effect.values);
    EXPECT_EQ(answered[i].parameter, asked[i].parameter);
  }
}

// Of what the brake has, the score over the information is the strength, within what one check knows.
TEST(EffectScores, TellTheStrengthThatABrakeHas) {
  for (const auto& [effect, size] :
       {std::pair{"force-lag", 2e-4}, {"backlash", 0.012}, {"torque-gain", 0.0015}, {"pad-damping", 0.15}}) {
    const EffectScore score = score_named(support::scored_check(5, 5, {{effect, size}}), effect);
    ASSERT_GT(score.information, 0.0) << effect;
    const double sd = 1.0 / std::sqrt(score.information);
    EXPECT_GT(size, 4.0 * sd) << effect << ": the test would tell nothing";
    EXPECT_NEAR(score.score / score.information, size, 3.5 * sd + 0.1 * size) << effect;
  }
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
