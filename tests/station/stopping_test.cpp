#include "clampd/station/stopping.hpp"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/experiment/reference.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/sequential.hpp"
#include "support/encoder_sheet.hpp"

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
  const StoppingRule rule(2.0, 21, false);
  Estimate joint;
  EXPECT_EQ(rule.guard_bands(joint).parameters[TC], rule.coverage_factor());
  joint.degrees_of_freedom.setConstant(5.0);
  const double of_interval = rule.guard_bands(joint).parameters[TC];
  EXPECT_GT(of_interval, rule.coverage_factor());
  joint.runs_differ = true;  // a scatter over runs is reported as it is
  EXPECT_GT(rule.guard_bands(joint).parameters[TC], of_interval);
}

/// Whoever chooses runs learns more between two looks, so that they hang together less: wider guard bands, that
/// hold for every schedule of such runs.
TEST(StoppingRule, ChosenRunsAskForWiderGuardBands) {
  const double chosen = StoppingRule(2.0, 21, true).coverage_factor();
  EXPECT_GT(chosen, StoppingRule(2.0, 21, false).coverage_factor());
  for (const double times : {2.0, 8.0, 16.0})
    for (const int from : {4, 7, 10}) {
      std::vector<double> information;
      for (int runs = 4; runs <= 21; ++runs)
        information.push_back(runs <= from ? runs : from + times * (runs - from));
      EXPECT_GE(chosen, statistics::repeated_look_factor(statistics::normal_upper_tail(2.0), information))
          << times << " times from run " << from;
    }
  EXPECT_EQ(StoppingRule(2.0, 4, true).coverage_factor(), StoppingRule(2.0, 4, false).coverage_factor())
      << "with a single look there is nothing to choose";
}

/// A set whose trajectories are the shipped ones.
class NextTrajectory : public ::testing::Test {
 protected:
  static Reference shipped(const std::string& name) {
    return build_reference(read_run(CLAMPD_SOURCE_DIR "/configs/" + name + ".csv").value().run, {}).value();
  }

  std::uint8_t asked(std::initializer_list<const char*> in_doubt) const {
    Judgement judgement = good();
    judgement.parameters.clear();
    for (const char* name : in_doubt)
      judgement.parameters.push_back({.name = name, .unit = "", .verdict = ParameterVerdict::Marginal});
    return next_trajectory_for(judgement, joint_, runs_, set_, sheet_);
  }

  Estimate joint_ = [] {
    Estimate estimate;
    estimate.termination = Termination::Converged;
    estimate.noise_force_N = 45.0;
    estimate.noise_velocity_rad_s = 1.0;
    estimate.noise_torque_Nm = 0.0142;
    return estimate;
  }();
  std::vector<RunRecord> runs_ = std::vector<RunRecord>(4);
  std::vector<Characteristic> sheet_;
  TrajectorySet set_{{shipped("trajectory"), shipped("trajectory-sliding"), shipped("trajectory-breakaway")}, {}, 3.0};
};

TEST_F(NextTrajectory, IsTheOneThatTellsMostOfWhatIsInDoubt) {
  EXPECT_EQ(asked({}), 0);
  EXPECT_EQ(asked({"TC"}), 1);
  EXPECT_EQ(asked({"Ts0"}), 2);
  EXPECT_EQ(asked({"k1"}), 0);
  set_ = TrajectorySet();
  EXPECT_EQ(asked({"TC"}), 0) << "there is no choice";
}

TEST_F(NextTrajectory, CountsLinesOfTheSheet) {
  sheet_ = parse_sheet(R"(revision = "1"
[[characteristic]]
kind = "drag"
unit = "N m"
speed_rad_s = 50
upper = 0.1
)",
                       "sheet.toml")
               .value()
               .characteristics;
  Judgement judgement = good();
  judgement.characteristics = {{.name = "drag", .kind = "drag", .unit = "N m", .verdict = ParameterVerdict::Marginal}};
  EXPECT_EQ(next_trajectory_for(judgement, joint_, runs_, set_, sheet_), 1) << "friction at constant speed";
}

TEST_F(NextTrajectory, CountsWhatTheEncoderTells) {
  sheet_ = support::encoder_sheet().characteristics;
  const Reference reference = shipped("trajectory");
  for (RunRecord& record : runs_) {
    for (const ReferenceRow& row : reference.rows) {
      record.run.time_s.push_back(1e-3 * static_cast<double>(record.run.size()));
      record.run.torque_Nm.push_back(row.torque_Nm);
      record.run.velocity_rad_s.push_back(row.velocity_rad_s);
      record.run.force_N.push_back(row.force_N);
      record.run.position_rad.push_back(17.3 + row.position_rad);
    }
    joint_.initial_states.emplace_back(reference.rows.front().position_rad, 0.0);
  }
  // They depend on k1 and k2, as what asks for the check's own trajectory.
  ASSERT_EQ(asked({"k1"}), 0);
  for (const std::size_t line : {0u, 1u}) {
    Judgement judgement = good();
    judgement.characteristics.resize(2);
    judgement.characteristics[line].verdict = ParameterVerdict::Marginal;
    EXPECT_EQ(next_trajectory_for(judgement, joint_, runs_, set_, sheet_), 0);
    judgement.parameters[0].verdict = ParameterVerdict::Marginal;
    EXPECT_EQ(next_trajectory_for(judgement, joint_, runs_, set_, sheet_), 1)
        << "friction is in doubt too, and that it tells nothing of the encoder is no reason against a run "
           "for it";
  }
  for (RunRecord& record : runs_) record.run.position_rad.clear();
  Judgement judgement = good();
  judgement.characteristics.resize(2);
  judgement.characteristics[0].verdict = ParameterVerdict::Marginal;
  EXPECT_EQ(next_trajectory_for(judgement, joint_, runs_, set_, sheet_), 0) << "nothing is known of it";
}

}  // namespace
}  // namespace clampd
