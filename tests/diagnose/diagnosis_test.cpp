#include "clampd/diagnose/diagnosis.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "clampd/identify/prediction_error.hpp"
#include "support/blind/blind_set.hpp"

namespace clampd {
namespace {

struct Sealed {
  blind::Answer answer;
  std::vector<clampd::Run> runs;
};

Sealed sealed(const blind::Request& request) {
  Result<blind::BlindSet> set = blind::make_set(request);
  EXPECT_TRUE(set);
  return {set->answer, std::move(set->runs)};
}

/// Of the independent brake, without an effect.
Sealed faultless(std::uint64_t seed) {
  blind::Request request;
  request.kind = blind::Kind::None;
  request.generator = blind::Generator::Independent;
  request.seed = seed;
  return sealed(request);
}

Diagnosis spoken(std::span<const clampd::Run> runs, DiagnoseOptions options = {}) {
  Result<Diagnosis> diagnosis = diagnose(runs, options);
  EXPECT_TRUE(diagnosis) << diagnosis.error().message;
  return *diagnosis;
}

bool names(const Diagnosis& diagnosis, const std::string& effect) {
  for (const auto& group : diagnosis.rivals)
    if (group.size() <= 3 && std::find(group.begin(), group.end(), effect) != group.end()) return true;
  return std::any_of(diagnosis.effects.begin(), diagnosis.effects.end(),
                     [&](const NamedEffect& named) { return named.name == effect; });
}

/// An effect's name as a test's.
std::string label_of(std::string effect) {
  std::replace(effect.begin(), effect.end(), '-', '_');
  return effect;
}

/// One that is plainly there, in either generator: a fixed small sample of the bench's.
struct Hidden {
  const char* effect;
  blind::Generator generator;
  std::uint64_t seed;
};
class HiddenEffects : public ::testing::TestWithParam<Hidden> {};
INSTANTIATE_TEST_SUITE_P(Sample, HiddenEffects,
                         ::testing::Values(Hidden{"force-lag", blind::Generator::Independent, 509},
                                           Hidden{"friction-drift", blind::Generator::Independent, 506},
                                           Hidden{"backlash", blind::Generator::Independent, 507},
                                           Hidden{"channel-skew", blind::Generator::Independent, 1300095},
                                           Hidden{"quadratic-drag", blind::Generator::Independent, 502},
                                           Hidden{"torque-gain", blind::Generator::Station, 1014},
                                           Hidden{"cogging", blind::Generator::Station, 1024},
                                           Hidden{"outliers", blind::Generator::Independent, 1011},
                                           Hidden{"pad-relaxation", blind::Generator::Station, 1038}),
                         [](const auto& hidden) { return label_of(hidden.param.effect); });

TEST_P(HiddenEffects, AreNamedAndTheirRemovalLeavesNoise) {
  blind::Request request;
  request.effect = GetParam().effect;
  request.generator = GetParam().generator;
  request.seed = GetParam().seed;
  const Sealed hidden = sealed(request);
  const Diagnosis diagnosis = spoken(hidden.runs);
  EXPECT_TRUE(diagnosis.verdict == DiagnosisVerdict::Explained ||
              diagnosis.verdict == DiagnosisVerdict::Ambiguous)
      << to_string(diagnosis.verdict);
  EXPECT_TRUE(names(diagnosis, hidden.answer.effects.front().name)) << diagnosis.summary;
  ASSERT_TRUE(diagnosis.gain);
  EXPECT_LT(diagnosis.gain->after.misfit, 1.1);
  EXPECT_GT(diagnosis.gain->after.log_likelihood_per_sample,
            diagnosis.gain->before.log_likelihood_per_sample);
  EXPECT_FALSE(diagnosis.model.effects.empty());
}

/// Drives that compute a row's torque from the readings of that row.
class FeedbackInTheRow : public ::testing::TestWithParam<std::uint64_t> {};
INSTANTIATE_TEST_SUITE_P(Sample, FeedbackInTheRow, ::testing::Values(1, 2, 3));

TEST_P(FeedbackInTheRow, IsNoEffect) {
  blind::Request request;
  request.kind = blind::Kind::None;
  request.feedback = true;
  request.seed = GetParam();
  const Diagnosis diagnosis = spoken(sealed(request).runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Adequate) << diagnosis.summary;
}

/// A Coulomb friction that differs by direction contains a torque offset where the brake only slides: its fit
/// must not end below the offset's, and so fall out of the rivals.
class ContainingModel : public ::testing::TestWithParam<std::uint64_t> {};
INSTANTIATE_TEST_SUITE_P(Sample, ContainingModel, ::testing::Values(1, 2, 4, 5));

TEST_P(ContainingModel, IsNotLostBesideTheOneThatItContains) {
  blind::Request request;
  request.effect = "friction-asymmetry";
  request.generator = blind::Generator::Station;
  request.seed = GetParam();
  const Diagnosis diagnosis = spoken(sealed(request).runs);
  EXPECT_TRUE(names(diagnosis, "friction-asymmetry")) << diagnosis.summary;
}

class HiddenPairs : public ::testing::TestWithParam<std::uint64_t> {};
// The last: a hum, of which harmonics are sought, though not as those of a cogging.
INSTANTIATE_TEST_SUITE_P(Sample, HiddenPairs, ::testing::Values(1001, 1004, 930043));

TEST_P(HiddenPairs, AreBothNamed) {
  blind::Request request;
  request.kind = blind::Kind::Pair;
  request.seed = GetParam();
  const Sealed hidden = sealed(request);
  const Diagnosis diagnosis = spoken(hidden.runs);
  ASSERT_EQ(hidden.answer.effects.size(), 2u);
  for (const blind::HiddenEffect& effect : hidden.answer.effects)
    EXPECT_TRUE(names(diagnosis, effect.name)) << effect.name << ": " << diagnosis.summary;
}

/// A brake whose Stribeck velocity is 0.4 of nominal: output errors from the nominal one get lost, and a
/// filter that believes in much torque noise calls where they ended white.
TEST(LostStart, CostsNeitherTheEstimateNorTheDiagnosis) {
  const Sealed hidden = faultless(410005);
  const ParameterVector& truth = hidden.answer.brake.theta;
  EXPECT_LT(truth[ws], 0.5 * nominal_parameters()[ws]) << "so that the test can fail";
  const Estimate estimate = identify_prediction_error(hidden.runs, {});
  ASSERT_TRUE(estimate.converged()) << estimate.message;
  for (Eigen::Index i = 0; i < truth.size(); ++i)
    EXPECT_NEAR(estimate.parameters.theta[i], truth[i], 0.03 * std::abs(truth[i]))
        << kParameterTable[static_cast<std::size_t>(i)].name;
  const Diagnosis diagnosis = spoken(hidden.runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Adequate) << diagnosis.summary;
}

/// Far stronger than any on the bench, so that the base model is led far away.
struct Strong {
  const char* effect;
  void (*onto_physics)(blind::Physics&);
};
class StrongEffects : public ::testing::TestWithParam<Strong> {};
INSTANTIATE_TEST_SUITE_P(Sample, StrongEffects,
                         ::testing::Values(Strong{"friction-drift",
                                                  [](blind::Physics& p) { p.friction_drift.per_run = 0.05; }},
                                           Strong{"channel-skew",
                                                  [](blind::Physics& p) {
                                                    p.skewed = blind::Channel::Velocity;
                                                    p.skew_samples = 3.0;
                                                  }},
                                           Strong{"stiffness-hysteresis",
                                                  [](blind::Physics& p) {
                                                    p.hysteresis = {.law = blind::Loop::SignLike,
                                                                    .share = 0.08,
                                                                    .travel_rad = 0.2};
                                                  }},
                                           Strong{"presliding",
                                                  [](blind::Physics& p) {
                                                    p.presliding = {.law = blind::Bristles::ElastoPlastic,
                                                                    .travel_rad = 0.006,
                                                                    .damping = 0.3};
                                                  }}),
                         [](const auto& strong) { return label_of(strong.param.effect); });

TEST_P(StrongEffects, AreNamedAloneAndLeaveTheParametersRight) {
  blind::Request request;
  request.effect = GetParam().effect;
  request.seed = 77;
  blind::Answer answer = blind::draw_answer(request);
  answer.effects.front().onto_physics = GetParam().onto_physics;
  const Result<blind::BlindSet> set = blind::simulate(answer);
  ASSERT_TRUE(set);
  const Diagnosis diagnosis = spoken(set->runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Explained) << diagnosis.summary;
  ASSERT_EQ(diagnosis.effects.size(), 1u) << diagnosis.summary;
  EXPECT_EQ(diagnosis.effects.front().name, GetParam().effect);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const EstimatedParameter& found = diagnosis.parameters_after[i];
    EXPECT_NEAR(found.value, answer.brake.theta[static_cast<Eigen::Index>(i)], 4.0 * found.sd) << found.name;
  }
}

class FaultlessSets : public ::testing::TestWithParam<std::uint64_t> {};
INSTANTIATE_TEST_SUITE_P(Sample, FaultlessSets, ::testing::Values(100, 101, 102));

TEST_P(FaultlessSets, AreAdequate) {
  blind::Request request;
  request.kind = blind::Kind::None;
  request.generator = GetParam() % 2 == 0 ? blind::Generator::Independent : blind::Generator::Station;
  request.seed = GetParam();
  const Sealed hidden = sealed(request);
  const Diagnosis diagnosis = spoken(hidden.runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Adequate) << diagnosis.summary;
  EXPECT_TRUE(diagnosis.effects.empty());
  const ParameterVector& truth = hidden.answer.brake.theta;
  for (std::size_t i = 0; i < kParameterCount; ++i)
    EXPECT_NEAR(diagnosis.parameters_after[i].value, truth[static_cast<Eigen::Index>(i)],
                4.0 * diagnosis.parameters_after[i].sd)
        << diagnosis.parameters_after[i].name;
}

/// All runs of a check have the same zeros, found from a few hundred noisy readings: the runs know them
/// better.
TEST(Diagnosis, NamesNoOffsetThatTheTareMayHaveLeft) {
  Sealed hidden = faultless(100);
  for (clampd::Run& run : hidden.runs) {
    for (double& force_N : run.force_N) force_N += 8.0;
    for (double& velocity_rad_s : run.velocity_rad_s) velocity_rad_s -= 0.1;
  }
  const ParameterVector& truth = hidden.answer.brake.theta;
  for (const bool expected : {false, true}) {
    DiagnoseOptions options;
    options.tare_sd = expected ? SensorNoise{4.0, 0.06} : SensorNoise{0.4, 0.006};
    const Diagnosis diagnosis = spoken(hidden.runs, options);
    EXPECT_EQ(names(diagnosis, "force-offset"), !expected) << diagnosis.summary;
    EXPECT_EQ(names(diagnosis, "velocity-offset"), !expected) << diagnosis.summary;
    EXPECT_EQ(diagnosis.verdict, expected ? DiagnosisVerdict::Adequate : DiagnosisVerdict::Explained);
    EXPECT_EQ(std::ranges::count_if(
                  diagnosis.notices,
                  [](const std::string& notice) { return notice.find("tare") != std::string::npos; }),
              expected ? 2 : 0);
    for (std::size_t i = 0; i < kParameterCount; ++i)
      EXPECT_NEAR(diagnosis.parameters_after[i].value, truth[static_cast<Eigen::Index>(i)],
                  4.0 * diagnosis.parameters_after[i].sd)
          << kParameterTable[i].name;
  }
}

/// As of a drive that sets its zero when it is switched on.
TEST(Diagnosis, DoesNotBelieveATorqueWhileOffThatTheRunsRefute) {
  const Sealed hidden = faultless(100);
  DiagnoseOptions options;
  options.torque_while_off = TorqueWhileOff{0.004, 0.0002, 3000};
  const Diagnosis diagnosis = spoken(hidden.runs, options);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Adequate) << diagnosis.summary;
  EXPECT_FALSE(diagnosis.torque_while_off);
  ASSERT_FALSE(diagnosis.notices.empty());
  EXPECT_NE(diagnosis.notices.back().find("is left out"), std::string::npos) << diagnosis.notices.back();
}

TEST(Diagnosis, SaysThatSomethingIsWrongWhereNoCandidateIsTheCause) {
  blind::Request request;
  request.kind = blind::Kind::OffList;
  request.effect = "sampling-jitter";
  request.seed = 1003;
  const Sealed hidden = sealed(request);
  const Diagnosis diagnosis = spoken(hidden.runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
  EXPECT_TRUE(diagnosis.misfit.location);
}

/// A bus that loses a sample now and then, and a station that takes the last value for it.
TEST(Diagnosis, SaysThatAReadingWasHeld) {
  Sealed set = faultless(1020);
  for (clampd::Run& run : set.runs)
    for (std::size_t k = 60; k + 4 < run.size(); k += 97)
      std::fill_n(run.velocity_rad_s.begin() + static_cast<std::ptrdiff_t>(k) + 1, 4, run.velocity_rad_s[k]);
  const Diagnosis diagnosis = spoken(set.runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
  EXPECT_EQ(diagnosis.misfit.location, Location::VelocityReading);
  ASSERT_FALSE(diagnosis.misfit.dependences.empty());
  EXPECT_EQ(diagnosis.misfit.dependences.front().variable, "repetition");
}

/// A resolution that is finer than the noise repeats values, too, and there is nothing wrong with it.
TEST(Diagnosis, DoesNotTakeAResolutionForReadingsThatWereHeld) {
  Sealed set = faultless(1020);
  for (clampd::Run& run : set.runs) {
    for (double& velocity : run.velocity_rad_s) velocity = 0.05 * std::round(velocity / 0.05);
    for (double& force : run.force_N) force = 5.0 * std::round(force / 5.0);
  }
  const Diagnosis diagnosis = spoken(set.runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Adequate) << diagnosis.summary;
}

/// A root of the speed instead of a constant: two effects make up for it, and leave a brake without friction.
TEST(Diagnosis, ABrakeWithoutFrictionIsNoExplanation) {
  blind::Request request;
  request.kind = blind::Kind::OffList;
  request.effect = "root-friction";
  request.generator = blind::Generator::Independent;
  request.seed = 1300006;
  const Diagnosis diagnosis = spoken(sealed(request).runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
  EXPECT_EQ(diagnosis.misfit.location, Location::TorqueBalance);
  const EstimatedParameter& coulomb = diagnosis.parameters_after[TC];
  EXPECT_LT(coulomb.value, 0.1 * nominal_parameters()[TC]) << "so that the test can fail";
}

TEST(Diagnosis, IsTheSameWithAnyNumberOfThreads) {
  blind::Request request;
  request.effect = "force-lag";
  request.seed = 509;
  const Sealed hidden = sealed(request);
  const std::span<const clampd::Run> few(hidden.runs.data(), 4);
  DiagnoseOptions one, two;
  one.threads = 1;
  two.threads = 2;
  const Diagnosis a = spoken(few, one);
  const Diagnosis b = spoken(few, two);
  EXPECT_EQ(a.summary, b.summary);
  ASSERT_EQ(a.candidates.size(), b.candidates.size());
  for (std::size_t i = 0; i < a.candidates.size(); ++i) {
    EXPECT_EQ(a.candidates[i].name, b.candidates[i].name);
    EXPECT_EQ(a.candidates[i].significance_nats, b.candidates[i].significance_nats);
  }
}

TEST(Diagnosis, OneRunDoesItsBestAndSaysWhatItCannotShow) {
  blind::Request request;
  request.kind = blind::Kind::None;
  request.seed = 103;
  const Sealed hidden = sealed(request);
  const Diagnosis diagnosis = spoken(std::span(hidden.runs.data(), 1));
  EXPECT_FALSE(diagnosis.gain);
  EXPECT_FALSE(diagnosis.notices.empty());
  EXPECT_TRUE(std::any_of(diagnosis.unseen.begin(), diagnosis.unseen.end(),
                          [](const UnseenEffect& unseen) { return unseen.name == "friction-drift"; }));
}

TEST(Diagnosis, HeldOutRunsJudgeAndAreNotFitted) {
  blind::Request request;
  request.effect = "force-lag";
  request.seed = 509;
  const Sealed hidden = sealed(request);
  DiagnoseOptions options;
  options.heldout = std::span(hidden.runs).subspan(6, 3);  // another manoeuvre
  options.views = true;
  const Diagnosis diagnosis = spoken(std::span(hidden.runs).first(6), options);
  ASSERT_TRUE(diagnosis.gain);
  ASSERT_EQ(diagnosis.gain->runs.size(), 3u);
  EXPECT_EQ(diagnosis.gain->runs.front(), hidden.runs[6].name);
  EXPECT_LT(diagnosis.gain->after.rms_force_N, diagnosis.gain->before.rms_force_N);
  ASSERT_EQ(diagnosis.views.size(), 6u);
  EXPECT_EQ(diagnosis.views[0].force.after.size(), hidden.runs[0].size());
}

TEST(Diagnosis, RefusesWhatItCannotUseInWords) {
  EXPECT_FALSE(diagnose({}, {}));
  blind::Request request;
  request.kind = blind::Kind::None;
  request.seed = 104;
  Sealed hidden = sealed(request);
  std::vector<clampd::Run> runs{hidden.runs[0]};
  runs[0].force_N.clear();
  auto refused = diagnose(runs, {});
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("force"), std::string::npos);
  runs[0] = hidden.runs[0];
  runs[0].velocity_rad_s[5] = std::numeric_limits<double>::quiet_NaN();
  refused = diagnose(runs, {});
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find(runs[0].name), std::string::npos);
}

}  // namespace
}  // namespace clampd
