#include "clampd/station/stopping.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace clampd {
namespace {

Judgement good() {
  Judgement judgement;
  judgement.verdict = Verdict::Pass;
  judgement.parameters = {{.name = "TC", .unit = "N m", .verdict = ParameterVerdict::Pass}};
  return judgement;
}

TEST(StoppingRule, AFitThatIsNeitherSeenNorRefutedAsksForMoreRuns) {
  const auto enough = [](double p_value) {
    return StoppingRule::is_enough(good(), {}, SystematicRecord{.p_value = p_value});
  };
  EXPECT_TRUE(enough(0.4));
  EXPECT_FALSE(enough(0.01));
  EXPECT_TRUE(enough(1e-5)) << "it does not fit, and that is counted in the uncertainty";
  EXPECT_TRUE(StoppingRule::is_enough(good(), {}, std::nullopt))
      << "where it cannot be told, as with effects in the model";
}

TEST(StoppingRule, AFailWithAnotherLimitInDoubtIsNotDecided) {
  Judgement judgement = good();
  judgement.verdict = Verdict::Fail;
  judgement.parameters.front().verdict = ParameterVerdict::Fail;
  EXPECT_TRUE(StoppingRule::is_enough(judgement, {}, std::nullopt));
  judgement.parameters.push_back({.name = "k2", .unit = "", .verdict = ParameterVerdict::Marginal});
  EXPECT_FALSE(StoppingRule::is_enough(judgement, {}, std::nullopt));
}

TEST(StoppingRule, ReportedDeviationsAreNotWidenedTwice) {
  const StoppingRule rule(2.0, 21);
  Estimate joint;
  EXPECT_EQ(rule.guard_bands(joint).parameters[TC], rule.coverage_factor());
  joint.degrees_of_freedom.setConstant(5.0);
  const double of_interval = rule.guard_bands(joint).parameters[TC];
  EXPECT_GT(of_interval, rule.coverage_factor());
  joint.runs_differ = true;  // a scatter over runs is reported as it is
  EXPECT_GT(rule.guard_bands(joint).parameters[TC], of_interval);
}

}  // namespace
}  // namespace clampd
