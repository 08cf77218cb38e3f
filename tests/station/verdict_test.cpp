#include "clampd/station/verdict.hpp"

#include <limits>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include "clampd/base/nan.hpp"
#include "support/shipped_limits.hpp"

namespace clampd {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

CheckFacts good_facts() {
  CheckFacts facts;
  facts.repeats_planned = 20;
  facts.repeats_recorded = 20;
  facts.estimated = true;
  facts.estimate = nominal_parameters();
  facts.sd = 0.01 * nominal_parameters().cwiseAbs();
  facts.tracking_rms_N = 200.0;
  facts.misfit_force = 1.0;
  facts.misfit_velocity = 1.0;
  return facts;
}

Judgement judged(const CheckFacts& facts) {
  return judge(facts, support::shipped_limits(), ValiditySettings{});
}

TEST(JudgeParameter, GuardBandsAtBothLimits) {
  const LimitInterval limits{10.0, 20.0};
  const auto at = [&](double value) { return judge_parameter(value, 0.5, limits, 2.0); };
  EXPECT_EQ(at(15.0), ParameterVerdict::Pass);
  EXPECT_EQ(at(11.01), ParameterVerdict::Pass);
  EXPECT_EQ(at(10.99), ParameterVerdict::Marginal);
  EXPECT_EQ(at(9.01), ParameterVerdict::Marginal);
  EXPECT_EQ(at(8.99), ParameterVerdict::Fail);
  EXPECT_EQ(at(18.99), ParameterVerdict::Pass);
  EXPECT_EQ(at(19.01), ParameterVerdict::Marginal);
  EXPECT_EQ(at(20.99), ParameterVerdict::Marginal);
  EXPECT_EQ(at(21.01), ParameterVerdict::Fail);
  EXPECT_EQ(judge_parameter(10.0, 0.0, limits, 2.0), ParameterVerdict::Marginal) << "exactly at a limit";
}

TEST(Judge, ANominalBrakePasses) {
  const Judgement judgement = judged(good_facts());
  EXPECT_EQ(judgement.verdict, Verdict::Pass);
  EXPECT_FALSE(judgement.marginal);
  EXPECT_EQ(judgement.reason, "All seven parameters are within their limits.");
  ASSERT_EQ(judgement.parameters.size(), kParameterCount);
  EXPECT_EQ(judgement.parameters[k2].name, "k2");
  EXPECT_EQ(judgement.parameters[k2].unit, "N/rad^2");
}

TEST(Judge, GuardBandsOfItsOwnTakeThePlaceOfTheLimits) {
  CheckFacts facts = good_facts();
  facts.estimate[k2] *= 0.875;  // 2.5 sd within the lower limit
  EXPECT_FALSE(judged(facts).marginal);
  facts.guard_bands = GuardBands{ParameterVector::Constant(2.6), 2.6};
  EXPECT_TRUE(judged(facts).marginal);
  facts.guard_bands->parameters[k2] = 2.4;
  EXPECT_FALSE(judged(facts).marginal) << "each parameter has its own";
}

/// Two lines with limits and one without, of the given estimates.
std::vector<CharacteristicRecord> sheet_of(const CharacteristicEstimate& time,
                                           const CharacteristicEstimate& margin) {
  const Result<Sheet> sheet = parse_sheet(R"(revision = "1"
[[characteristic]]
name = "response"
kind = "apply-time"
unit = "s"
force_N = 20000
share = 0.9
clearance_rad = 6
upper = 0.15
[[characteristic]]
name = "holding"
kind = "holding-margin"
unit = "N m"
force_N = 20000
lower = 0
upper = 0.4
[[characteristic]]
kind = "drag"
unit = "N m"
speed_rad_s = 50
)",
                                          "sheet.toml");
  EXPECT_TRUE(sheet) << sheet.error().message;
  return judge_sheet(sheet->characteristics,
                     {time, margin, {CharacteristicEstimate::State::Known, 0.1, 0.01, ""}}, 2.0);
}

TEST(JudgeSheet, CountsInTheVerdictByTheSameRule) {
  using State = CharacteristicEstimate::State;
  const CharacteristicEstimate good_time{State::Known, 0.14, 1e-3, ""},
      good_margin{State::Known, 0.2, 0.01, ""};
  const auto with = [](const CharacteristicEstimate& time, const CharacteristicEstimate& margin) {
    CheckFacts facts = good_facts();
    facts.characteristics = sheet_of(time, margin);
    return judged(facts);
  };
  const Judgement pass = with(good_time, good_margin);
  EXPECT_EQ(pass.verdict, Verdict::Pass) << pass.reason;
  EXPECT_EQ(pass.reason, "All seven parameters and 2 of the sheet are within their limits.");
  EXPECT_EQ(pass.parameters.size(), kParameterCount);
  ASSERT_EQ(pass.characteristics.size(), 3u);
  EXPECT_EQ(pass.characteristics[0].verdict, ParameterVerdict::Pass);
  EXPECT_FALSE(pass.characteristics[2].verdict) << "it has no limits";

  const Judgement slow = with({State::Known, 0.153, 1e-3, ""}, good_margin);
  EXPECT_EQ(slow.verdict, Verdict::Fail);
  EXPECT_FALSE(slow.marginal);
  EXPECT_EQ(slow.reason, "response is 0.153 s, above its upper limit 0.15 s.");

  const Judgement near = with({State::Known, 0.149, 1e-3, ""}, good_margin);
  EXPECT_EQ(near.verdict, Verdict::Pass);
  EXPECT_TRUE(near.marginal && near.undecided);
  EXPECT_THAT(near.reason, HasSubstr("response is 0.149 s, close to its upper limit 0.15 s"));

  const Judgement slightly = with(good_time, {State::Known, -0.001, 0.01, ""});
  EXPECT_EQ(slightly.verdict, Verdict::Fail);
  EXPECT_TRUE(slightly.marginal);

  const Judgement wide = with(good_time, {State::Known, 0.2, 0.2, ""});
  EXPECT_EQ(wide.verdict, Verdict::Error);
  EXPECT_THAT(wide.reason, HasSubstr("holding is too uncertain to be judged"));
}

TEST(JudgeSheet, WhatIsNotReachedFailsAndWhatIsNotKnownIsAnError) {
  using State = CharacteristicEstimate::State;
  const CharacteristicEstimate good_margin{State::Known, 0.2, 0.01, ""};
  CheckFacts facts = good_facts();
  facts.characteristics =
      sheet_of({State::NotReached, kNaN, kNaN, "this brake does not get there"}, good_margin);
  EXPECT_EQ(judged(facts).verdict, Verdict::Fail);
  EXPECT_EQ(judged(facts).reason, "response is not reached.");
  facts.characteristics = sheet_of({State::Unknown, kNaN, kNaN, "it needs ws"}, good_margin);
  EXPECT_EQ(judged(facts).verdict, Verdict::Error);
  EXPECT_EQ(judged(facts).reason, "response is not known, so that it cannot be judged: it needs ws.");
}

TEST(Judge, ASoftCaliperFailsByName) {
  CheckFacts facts = good_facts();
  facts.estimate[k2] *= 0.7;
  facts.tracking_rms_N = 4000.0;  // which is the brake's own doing
  const Judgement judgement = judged(facts);
  EXPECT_EQ(judgement.verdict, Verdict::Fail);
  EXPECT_FALSE(judgement.marginal);
  EXPECT_EQ(judgement.reason, "k2 is 24.64 N/rad^2, below its lower limit 29.92 N/rad^2.");
  EXPECT_EQ(judgement.parameters[k2].verdict, ParameterVerdict::Fail);
  EXPECT_EQ(judgement.parameters[k1].verdict, ParameterVerdict::Pass);
}

TEST(Judge, NamesEveryFailingParameter) {
  CheckFacts facts = good_facts();
  facts.estimate[k2] *= 1.4;
  facts.estimate[TC] *= 3.0;
  const Judgement judgement = judged(facts);
  EXPECT_THAT(judgement.reason, HasSubstr("k2 is 49.28 N/rad^2, above its upper limit 40.48 N/rad^2; TC is"));
}

TEST(Judge, AMarginalValueIsDecidedByItselfAndMarked) {
  CheckFacts inside = good_facts();
  inside.estimate[k2] = 0.86 * 35.2;
  const Judgement passes = judged(inside);
  EXPECT_EQ(passes.verdict, Verdict::Pass);
  EXPECT_TRUE(passes.marginal);
  EXPECT_EQ(passes.parameters[k2].verdict, ParameterVerdict::Marginal);
  EXPECT_THAT(passes.reason, HasSubstr("k2 is 30.27 N/rad^2, close to its lower limit"));

  CheckFacts outside = good_facts();
  outside.estimate[k2] = 0.84 * 35.2;
  const Judgement fails = judged(outside);
  EXPECT_EQ(fails.verdict, Verdict::Fail);
  EXPECT_TRUE(fails.marginal);
  EXPECT_THAT(fails.reason, HasSubstr("below its lower limit"));
}

TEST(Judge, AClearFailureIsNotMarginal) {
  CheckFacts facts = good_facts();
  facts.estimate[k2] = 0.84 * 35.2;
  facts.estimate[TC] *= 3.0;
  const Judgement judgement = judged(facts);
  EXPECT_EQ(judgement.verdict, Verdict::Fail);
  EXPECT_FALSE(judgement.marginal);
  EXPECT_THAT(judgement.reason, testing::StartsWith("TC is"));
}

TEST(Judge, AnUncertaintyThatCouldNeverPassIsTheStationsFault) {
  CheckFacts facts = good_facts();
  facts.sd[k2] = 0.2 * 35.2;
  const Judgement judgement = judged(facts);
  EXPECT_EQ(judgement.verdict, Verdict::Error);
  EXPECT_THAT(judgement.reason, HasSubstr("k2 is too uncertain"));
  EXPECT_THAT(judgement.reason, HasSubstr("more repeats, or less noise."));
  // More repeats would not help there.
  facts.misfit_counts = true;
  EXPECT_THAT(judged(facts).reason, AllOf(HasSubstr("k2 is too uncertain"),
                                          HasSubstr("does not explain all of this brake's motion"),
                                          Not(HasSubstr("more repeats"))));
}

LimitSet with_play_limits(double lower = 0.0, double upper = 0.3) {
  LimitSet limits = support::shipped_limits();
  limits.effects = {{"backlash", "play", {lower, upper}}};
  return limits;
}

Judgement judged_play(double value, double sd, const LimitSet& limits = with_play_limits()) {
  CheckFacts facts = good_facts();
  facts.effects = {{"backlash", "play", "rad", value, sd}};
  return judge(facts, limits, ValiditySettings{});
}

TEST(Judge, AnEffectIsJudgedLikeAnyOtherParameter) {
  const Judgement passes = judged_play(0.1, 0.02);
  EXPECT_EQ(passes.verdict, Verdict::Pass);
  EXPECT_FALSE(passes.marginal);
  EXPECT_EQ(passes.reason, "All 8 parameters are within their limits.");

  const Judgement fails = judged_play(0.52, 0.02);
  EXPECT_EQ(fails.verdict, Verdict::Fail);
  EXPECT_EQ(fails.reason, "backlash.play is 0.52 rad, above its upper limit 0.3 rad.");

  const Judgement marginal = judged_play(0.29, 0.02);
  EXPECT_EQ(marginal.verdict, Verdict::Pass);
  EXPECT_TRUE(marginal.marginal);
  EXPECT_THAT(marginal.reason, HasSubstr("close to its upper limit 0.3 rad"));
}

TEST(Judge, ALimitWhereNoValueCanBeBeyondNeedsNoGuardBand) {
  EXPECT_FALSE(judged_play(0.0, 0.02).marginal) << "no play at all is best";
  EXPECT_EQ(judged_play(0.0, 0.02).parameters.back().lower, 0.0) << "as given";
  EXPECT_TRUE(judged_play(0.11, 0.02, with_play_limits(0.1, 0.3)).marginal) << "but this one does";
  // One guard band may take nearly all of the interval, two may not.
  EXPECT_EQ(judged_play(0.2, 0.12).verdict, Verdict::Pass);
  EXPECT_THAT(judged_play(0.2, 0.16).reason, HasSubstr("backlash.play is too uncertain"));
}

TEST(Judge, AnEffectWithoutAnEstimateIsNeverPassed) {
  for (const double factor : {1.0, 0.7}) {
    CheckFacts facts = good_facts();
    facts.estimate[k2] *= factor;
    EXPECT_EQ(judge(facts, with_play_limits(), ValiditySettings{}).verdict, Verdict::Error);
    facts.effects = {{"backlash", "play", "rad", kNaN, kNaN}};
    const Judgement judgement = judge(facts, with_play_limits(), ValiditySettings{});
    EXPECT_EQ(judgement.verdict, Verdict::Error);
    EXPECT_THAT(judgement.reason, HasSubstr("backlash.play could not be identified"));
    EXPECT_FALSE(judgement.unexplained);
  }
}

TEST(Judge, SaysWhetherTheModelIsTheProblem) {
  EXPECT_FALSE(judged(good_facts()).unexplained);
  CheckFacts facts = good_facts();
  facts.misfit_velocity = 100.0;
  EXPECT_TRUE(judged(facts).unexplained);
  facts.fault = FaultCause::BusOff;
  EXPECT_FALSE(judged(facts).unexplained);
}

struct Invalid {
  std::string label;
  void (*spoil)(CheckFacts&);
  Verdict verdict;
  std::string says;
};
void PrintTo(const Invalid& invalid, std::ostream* out) {
  *out << invalid.label;
}

class JudgeInvalid : public ::testing::TestWithParam<Invalid> {};

TEST_P(JudgeInvalid, IsNeverAPassNorAFail) {
  for (const double factor : {1.0, 0.7}) {  // a brake that would pass, and one that would fail
    CheckFacts facts = good_facts();
    facts.estimate[k2] *= factor;
    GetParam().spoil(facts);
    const Judgement judgement = judged(facts);
    EXPECT_EQ(judgement.verdict, GetParam().verdict);
    EXPECT_FALSE(judgement.marginal);
    EXPECT_THAT(judgement.reason, HasSubstr(GetParam().says));
    EXPECT_EQ(judgement.reason.back(), '.');
  }
}

INSTANTIATE_TEST_SUITE_P(
    Causes, JudgeInvalid,
    ::testing::Values(
        Invalid{"operator",
                [](CheckFacts& f) {
                  f.fault = FaultCause::OperatorStop;
                  f.fault_verdict = Verdict::Aborted;
                },
                Verdict::Aborted, "operator"},
        Invalid{"deadline",
                [](CheckFacts& f) {
                  f.fault = FaultCause::DeadlinePassed;
                  f.fault_verdict = Verdict::Timeout;
                },
                Verdict::Timeout, "deadline"},
        Invalid{"refused", [](CheckFacts& f) { f.refusal = "It came too late."; }, Verdict::Error,
                "too late"},
        Invalid{"phase",
                [](CheckFacts& f) {
                  f.fault = FaultCause::SequenceTimeout;
                  f.fault_verdict = Verdict::Timeout;
                  f.fault_text = "A step of the check did not end in time.";
                },
                Verdict::Timeout, "in time"},
        Invalid{"bus_off",
                [](CheckFacts& f) {
                  f.fault = FaultCause::BusOff;
                  f.repeats_recorded = 3;
                },
                Verdict::Error, "bus-off"},
        Invalid{"fault_words",
                [](CheckFacts& f) {
                  f.fault = FaultCause::LinkDown;
                  f.fault_text = "Plug the cable in.";
                },
                Verdict::Error, "Plug the cable in."},
        Invalid{"lost", [](CheckFacts& f) { f.samples_lost = 1; }, Verdict::Error, "1 samples got lost"},
        Invalid{"skipped", [](CheckFacts& f) { f.ticks_skipped = 6; }, Verdict::Error,
                "missed 6 of its ticks"},
        Invalid{"problem", [](CheckFacts& f) { f.problem = "repeat 2 ended after 7 of 300 rows"; },
                Verdict::Error, "repeat 2 ended"},
        Invalid{"few", [](CheckFacts& f) { f.repeats_recorded = 19; }, Verdict::Error, "Only 19 of 20"},
        Invalid{"no_fit",
                [](CheckFacts& f) {
                  f.estimated = false;
                  f.estimate_text = "singular";
                },
                Verdict::Error, "identified from the runs: singular"},
        Invalid{"nan_value", [](CheckFacts& f) { f.estimate[3] = kNaN; }, Verdict::Error, "identified"},
        Invalid{"nan_sd", [](CheckFacts& f) { f.sd[0] = kNaN; }, Verdict::Error, "identified"},
        Invalid{"misfit_force", [](CheckFacts& f) { f.misfit_force = 5.0; }, Verdict::Error,
                "explain the measured force: the misfit is 5.0 times"},
        Invalid{"misfit_velocity", [](CheckFacts& f) { f.misfit_velocity = 9.0; }, Verdict::Error,
                "measured velocity"},
        Invalid{"misfit_nan", [](CheckFacts& f) { f.misfit_force = kNaN; }, Verdict::Error,
                "measured force"}),
    [](const auto& input) { return input.param.label; });

TEST(Judge, EveryFaultIsInvalid) {
  for (std::size_t i = 1; i < kFaultCauseCount; ++i) {
    CheckFacts facts = good_facts();
    facts.fault = static_cast<FaultCause>(i);
    const Judgement judgement = judged(facts);
    EXPECT_NE(judgement.verdict, Verdict::Pass) << to_string(facts.fault);
    EXPECT_NE(judgement.verdict, Verdict::Fail) << to_string(facts.fault);
    EXPECT_FALSE(judgement.reason.empty());
  }
}

TEST(Judge, AGoodBrakeThatWasNotDrivenRightIsNotPassed) {
  CheckFacts facts = good_facts();
  facts.tracking_rms_N = 1501.0;
  const Judgement judgement = judged(facts);
  EXPECT_EQ(judgement.verdict, Verdict::Error);
  EXPECT_THAT(judgement.reason, HasSubstr("did not follow the trajectory: 1501 N rms off (1500 N allowed)"));
  facts.tracking_rms_N = kNaN;
  EXPECT_EQ(judged(facts).verdict, Verdict::Error);
}

TEST(ExitCode, IsThatOfTheContract) {
  EXPECT_EQ(exit_code(Verdict::Pass), 0);
  EXPECT_EQ(exit_code(Verdict::Fail), 1);
  EXPECT_EQ(exit_code(Verdict::Error), 3);
  EXPECT_EQ(exit_code(Verdict::Aborted), 4);
  EXPECT_EQ(exit_code(Verdict::Timeout), 5);
}

}  // namespace
}  // namespace clampd
