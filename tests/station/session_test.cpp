#include "clampd/station/session.hpp"

#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/base/nan.hpp"
#include "clampd/brake/stiffness.hpp"
#include "clampd/record/checksum.hpp"
#include "station/sample_stream.hpp"
#include "support/encoder_sheet.hpp"
#include "support/eventually.hpp"
#include "support/shipped_limits.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

using Runs = std::span<const Run>;  // inside a TEST, plain Run is a member of testing::Test

constexpr std::int32_t kRows = 30;

/// An estimator that found `theta` with 1 % uncertainty.
Estimator finds(const ParameterVector& theta, double force_rms_N = 5.0) {
  return [=](Runs runs, const EstimatorOptions&) {
    Estimate summary;
    summary.termination = Termination::Converged;
    summary.parameters.theta = theta;
    summary.covariance_normalised = 1e-4 * ParameterMatrix::Identity();
    summary.covariance_over_runs = ParameterMatrix::Constant(kNaN);
    summary.force_rms_N = force_rms_N;
    summary.velocity_rms_rad_s = 0.1;
    summary.run_force_rms_N.assign(runs.size(), force_rms_N);
    return summary;
  };
}

class Session : public ::testing::TestWithParam<WorkerMode> {
 protected:
  CheckRecord check(const std::vector<Sample>& stream, const Estimator& estimator,
                    CheckOutcome outcome = {}) {
    CheckSession session(configuration, limits, request, context, estimator, GetParam(),
                         [this](Runs runs, const DiagnoseOptions& options) {
                           ++diagnosed;
                           EXPECT_EQ(runs.size(), 3u);
                           EXPECT_EQ(options.nominal.theta, configuration.model.theta);
                           EXPECT_FALSE(options.views);
                           EXPECT_EQ(options.torque_while_off, context.torque_while_off);
                           EXPECT_TRUE(options.tare_sd);
                           tare_sd = options.tare_sd.value_or(SensorNoise{});
                           return diagnosis;
                         });
    for (const Sample& sample : stream) session.consume(sample);
    outcome.stopped_utc_ns = context.started_utc_ns + 5'000'000'000;
    return session.finish(std::move(outcome));
  }

  StationConfiguration configuration;
  LimitSet limits = support::shipped_limits();
  Result<Diagnosis> diagnosis = Diagnosis{};  ///< what every diagnosis says
  int diagnosed = 0;
  SensorNoise tare_sd;
  CheckRequest request{.serial = "S-1", .repeats = 3, .operator_name = "", .part_number = "P", .batch = ""};
  CheckContext context{.trajectory_rows = kRows,
                       .trajectory_sha256 = "abc",
                       .software_version = "1.2.3",
                       .started_utc_ns = 1'795'218'067'123'000'000,
                       .torque_while_off = TorqueWhileOff{0.003, 0.0002, 3000}};
  std::vector<Sample> samples = support::sample_stream({.rows = kRows, .repeats = 3});
};

TEST_P(Session, AGoodBrakePassesWithAFullRecord) {
  configuration.name = "line 3";
  configuration.operator_name = "Jo";
  configuration.instruments = {{"load \"cell\"", "LC\\1", "2026-05-04"}};
  CheckOutcome outcome;
  outcome.timing.ticks = 1000;
  outcome.timing.lateness_histogram = {1, 2};
  const CheckRecord record = check(samples, finds(nominal_parameters()), outcome);
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  EXPECT_THAT(record.id, StartsWith("20261120T234107123Z-"));
  EXPECT_EQ(record.serial, "S-1");
  EXPECT_EQ(record.part_number, "P");
  EXPECT_EQ(record.operator_name, "Jo");
  EXPECT_EQ(record.station, "line 3");
  EXPECT_EQ(record.software_version, "1.2.3");
  EXPECT_EQ(record.trajectory_sha256, "abc");
  EXPECT_EQ(record.limits_file, support::shipped_limits().file);
  EXPECT_EQ(record.limits_sha256.size(), 64u);
  EXPECT_EQ(record.instruments, R"([{"name":"load \"cell\"","serial":"LC\\1","calibrated":"2026-05-04"}])");
  EXPECT_TRUE(record.simulated);
  EXPECT_EQ(record.started, "2026-11-20T23:41:07.123Z");
  EXPECT_EQ(record.stopped, "2026-11-20T23:41:12.123Z");
  EXPECT_GT(record.duration_s, 0.2);
  EXPECT_EQ(record.repeats, 3u);
  ASSERT_EQ(record.runs.size(), 3u);
  EXPECT_NEAR(record.tracking_rms_N, support::kStreamTrackingError_N, 1e-9);
  EXPECT_EQ(record.covariance_normalised.size(), 49u);
  EXPECT_EQ(record.timing.ticks, 1000u);
  ASSERT_EQ(record.parameters.size(), 7u);
  EXPECT_NEAR(record.parameters[k2].sd, 0.01 * 35.2, 1e-12);
  EXPECT_NEAR(record.parameters[k1].sd, 0.01 * 0.354, 1e-12) << "positive although k1 is negative";
}

TEST_P(Session, ASoftCaliperFails) {
  ParameterVector soft = nominal_parameters();
  soft[k2] *= 0.7;
  const CheckRecord record = check(samples, finds(soft));
  EXPECT_EQ(record.verdict, Verdict::Fail);
  EXPECT_THAT(record.reason, StartsWith("k2 is"));
}

TEST_P(Session, AFaultEndsInAnErrorWithWhatWasRecorded) {
  samples.resize(130);  // in the second repeat
  CheckOutcome outcome;
  outcome.fault = FaultCause::FeedbackStale;
  outcome.fault_text = "The brake went silent.";
  outcome.flight_recorder.assign(samples.end() - 10, samples.end());
  const CheckRecord record = check(samples, finds(nominal_parameters()), outcome);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_EQ(record.reason, "The brake went silent.");
  EXPECT_EQ(record.fault, FaultCause::FeedbackStale);
  EXPECT_EQ(record.runs.size(), 1u);
  EXPECT_EQ(record.flight_recorder.size(), 10u);
}

TEST_P(Session, AFaultBeforeTheFirstSampleStillMakesARecord) {
  CheckOutcome outcome;
  outcome.fault = FaultCause::FeedbackMissing;
  const CheckRecord record = check({}, finds(nominal_parameters()), outcome);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_TRUE(record.runs.empty());
  EXPECT_EQ(record.duration_s, 0.0);
}

TEST_P(Session, ALostSampleIsAnError) {
  samples.erase(samples.begin() + 70);
  const CheckRecord record = check(samples, finds(nominal_parameters()));
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_EQ(record.timing.lost_samples, 1u);
}

TEST_P(Session, SamplesThatThePortLostAreAnErrorToo) {
  CheckOutcome outcome;
  outcome.health.lost_samples = 1;
  outcome.timing.lost_samples = 2;
  const CheckRecord record = check(samples, finds(nominal_parameters()), outcome);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_EQ(record.timing.lost_samples, 3u);
}

TEST_P(Session, AFitThatDoesNotExplainTheRunsIsAnError) {
  const CheckRecord record = check(samples, finds(nominal_parameters(), 5000.0));
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("does not explain the measured force"));
}

TEST_P(Session, RunsThatTheModelDoesNotExplainGetTheirCause) {
  diagnosis->verdict = DiagnosisVerdict::Ambiguous;
  diagnosis->summary = "The reading of clamp force comes late.";
  NamedEffect lag;
  lag.name = "force-lag";
  lag.location = Location::ForceReading;
  diagnosis->effects = {lag};
  diagnosis->rivals = {{"force-lag", "pad-damping"}};
  const CheckRecord record = check(samples, finds(nominal_parameters(), 5000.0));
  EXPECT_EQ(record.verdict, Verdict::Error) << "whatever the cause, nothing is said about the brake";
  EXPECT_THAT(record.reason, HasSubstr("does not explain the measured force"));
  EXPECT_THAT(record.reason, HasSubstr("allowed). The reading of clamp force comes late."));
  const CauseRecord expected{
      "ambiguous", {"force-lag"}, "force-reading", {{"force-lag", "pad-damping"}}, diagnosis->summary};
  ASSERT_TRUE(record.cause);
  EXPECT_EQ(*record.cause, expected);
}

TEST_P(Session, TheDiagnosisKnowsHowWellTheZerosAreKnown) {
  samples = support::sample_stream(
      {.rows = kRows, .repeats = 3, .force_offset_N = 200.0, .velocity_offset_rad_s = -4.0});
  int tared = 0;
  for (Sample& sample : samples) {
    if (sample.phase != CheckPhase::Tare) continue;
    sample.force_N += tared % 2 == 0 ? 30.0 : -30.0;
    sample.velocity_rad_s += tared++ % 2 == 0 ? 0.5 : -0.5;
  }
  const CheckRecord record = check(samples, finds(nominal_parameters(), 5000.0));
  EXPECT_EQ(diagnosed, 1);
  EXPECT_EQ(record.torque_while_off, context.torque_while_off);
  EXPECT_NEAR(record.tare_force_N, 200.0, 1e-9);
  EXPECT_NEAR(record.tare_velocity_rad_s, -4.0, 1e-9);
  EXPECT_NEAR(record.tare_force_sd_N, 30.0 / std::sqrt(tared), 0.02 * 30.0);
  EXPECT_NEAR(record.tare_velocity_sd_rad_s, 0.5 / std::sqrt(tared), 0.02 * 0.5);
  EXPECT_EQ(tare_sd.force_N, record.tare_force_sd_N);
  EXPECT_EQ(tare_sd.velocity_rad_s, record.tare_velocity_sd_rad_s);
}

TEST_P(Session, WhatNoEffectExplainsIsLocated) {
  diagnosis->verdict = DiagnosisVerdict::Unexplained;
  diagnosis->misfit.location = Location::Stiffness;
  const CheckRecord record = check(samples, finds(nominal_parameters(), 5000.0));
  ASSERT_TRUE(record.cause);
  EXPECT_TRUE(record.cause->effects.empty());
  EXPECT_EQ(record.cause->location, "stiffness");
}

TEST_P(Session, ADiagnosisNeverLosesTheResult) {
  diagnosis = failure("a reading is not a finite number");
  const CheckRecord failed = check(samples, finds(nominal_parameters(), 5000.0));
  EXPECT_EQ(failed.verdict, Verdict::Error);
  EXPECT_THAT(failed.reason, HasSubstr("does not explain"));
  EXPECT_THAT(failed.reason, HasSubstr("The cause could not be sought: a reading is not a finite number."));
  EXPECT_FALSE(failed.cause);
  EXPECT_EQ(failed.runs.size(), 3u);

  diagnosis = Diagnosis{};  // adequate
  const CheckRecord noisy = check(samples, finds(nominal_parameters(), 5000.0));
  EXPECT_THAT(noisy.reason, HasSubstr("no cause but noise"));
  EXPECT_FALSE(noisy.cause);
}

/// A diagnosis that puts this effect forward, and the parameters that are left then.
Diagnosis names(const char* effect, const ParameterVector& after) {
  Diagnosis diagnosis;
  diagnosis.verdict = DiagnosisVerdict::Explained;
  diagnosis.summary = "Something is late.";
  NamedEffect named;
  named.name = effect;
  named.location = info_of(*find_effect(effect)).location;
  diagnosis.effects = {named};
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double value = after[static_cast<Eigen::Index>(i)];
    diagnosis.parameters_after.push_back({std::string(kParameterTable[i].name),
                                          std::string(kParameterTable[i].unit), value,
                                          0.01 * std::abs(value)});
  }
  return diagnosis;
}

TEST_P(Session, ABrakeDoesNotFailForHowItIsRead) {
  ParameterVector soft = nominal_parameters();
  soft[k2] *= 0.7;
  diagnosis = names("force-lag", nominal_parameters());
  const CheckRecord misread = check(samples, finds(soft));
  EXPECT_EQ(misread.verdict, Verdict::Error);
  EXPECT_THAT(misread.reason, StartsWith("The station reads the brake wrongly"));
  EXPECT_THAT(misread.reason, HasSubstr("Something is late."));
  EXPECT_THAT(misread.reason, HasSubstr("k2 is"));
  ASSERT_TRUE(misread.cause);
  EXPECT_EQ(misread.cause->location, "force-reading");

  diagnosis = names("force-lag", soft);
  EXPECT_EQ(check(samples, finds(soft)).verdict, Verdict::Fail) << "it fails read rightly too";
  diagnosis = names("backlash", nominal_parameters());
  const CheckRecord worn = check(samples, finds(soft));
  EXPECT_EQ(worn.verdict, Verdict::Fail) << "that is the brake itself";
  EXPECT_TRUE(worn.cause);
  diagnosis = names("force-lag", nominal_parameters());
  diagnosis->rivals = {{"force-lag", "pad-damping"}};
  EXPECT_EQ(check(samples, finds(soft)).verdict, Verdict::Fail) << "it may be the brake itself";
  // A load cell that shows half the force makes the very runs of another gear with half the stiffness.
  diagnosis = names("ratio-error", soft);
  const CheckRecord scaled = check(samples, finds(soft));
  EXPECT_EQ(scaled.verdict, Verdict::Error);
  EXPECT_THAT(scaled.reason, HasSubstr("Check the load cell's scale"));
  EXPECT_THAT(scaled.reason, HasSubstr("k2 is"));
  diagnosis = names("backlash", soft);
  diagnosis->rivals = {{"backlash", "ratio-error"}};
  EXPECT_EQ(check(samples, finds(soft)).verdict, Verdict::Error);
  diagnosis = Diagnosis{};  // adequate
  const CheckRecord plain = check(samples, finds(soft));
  EXPECT_EQ(plain.verdict, Verdict::Fail);
  EXPECT_FALSE(plain.cause);
  EXPECT_THAT(plain.reason, Not(HasSubstr("diagnosis")));
}

TEST_P(Session, DiagnosesWhatFailsOrIsUnexplainedAndOnlyIfWanted) {
  check(samples, finds(nominal_parameters()));
  EXPECT_EQ(diagnosed, 0);
  configuration.check.diagnose = false;
  EXPECT_FALSE(check(samples, finds(nominal_parameters(), 5000.0)).cause);
  EXPECT_EQ(diagnosed, 0);
  configuration.check.diagnose = true;
  check(samples, finds(nominal_parameters(), 5000.0));
  EXPECT_EQ(diagnosed, 1);
}

TEST_P(Session, AnEffectIsJudgedWithTheTaresUncertainty) {
  limits.effects = {{"backlash", "play", {0.0, 0.3}}};
  const auto with_play = [](double value, double by_force) -> Estimator {
    return [=](Runs runs, const EstimatorOptions& options) {
      Estimate summary = finds(nominal_parameters())(runs, options);
      summary.effects = {{"backlash", "play", "rad", value, 0.01, {by_force, 0.0}}};
      return summary;
    };
  };
  const CheckRecord failed = check(samples, with_play(0.52, 0.0));
  EXPECT_EQ(failed.verdict, Verdict::Fail);
  EXPECT_EQ(failed.reason, "backlash.play is 0.52 rad, above its upper limit 0.3 rad.");
  ASSERT_EQ(failed.parameters.size(), 8u);
  EXPECT_EQ(failed.parameters[7].name, "backlash.play");
  EXPECT_DOUBLE_EQ(failed.parameters[7].sd, 0.01);
  EXPECT_EQ(check(samples, with_play(0.1, 0.0)).verdict, Verdict::Pass);
  for (std::size_t i = 0; i < samples.size(); ++i)
    if (samples[i].phase == CheckPhase::Tare) samples[i].force_N += i % 2 == 0 ? 1.0 : -1.0;
  EXPECT_DOUBLE_EQ(check(samples, with_play(0.1, 0.0)).parameters[7].sd, 0.01);
  EXPECT_GT(check(samples, with_play(0.1, 1.0)).parameters[7].sd, 0.02);
}

TEST_P(Session, WithoutATareThereIsNoVerdict) {
  std::erase_if(samples, [](const Sample& sample) { return sample.phase == CheckPhase::Tare; });
  const CheckRecord record = check(samples, finds(nominal_parameters()));
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("not tared"));
}

TEST_P(Session, AFitThatDoesNotConvergeIsAnErrorWithItsReason) {
  const CheckRecord record = check(samples, [](Runs, const EstimatorOptions&) {
    Estimate summary;
    summary.termination = Termination::NotIdentifiable;
    summary.message = "the information matrix is singular";
    summary.parameters.theta.setConstant(kNaN);
    return summary;
  });
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("the information matrix is singular"));
  EXPECT_TRUE(record.parameters.empty());
}

TEST_P(Session, WhereTheOutputErrorsGotLostTheOtherMethodIsAdvised) {
  const Estimator lost = [](Runs runs, const EstimatorOptions& options) {
    Estimate summary = finds(nominal_parameters())(runs, options);
    summary.method = Method::PredictionError;
    summary.message = "the output error method does not explain these runs";
    return summary;
  };
  const CheckRecord record = check(samples, lost);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("the output error method does not explain these runs"));
  EXPECT_THAT(record.reason, HasSubstr("method = \"pem\""));
  configuration.check.method = Method::PredictionError;
  EXPECT_EQ(check(samples, lost).verdict, Verdict::Pass);
}

/// As many repeats as this brake needs. The stream goes on as long as the session does not have enough.
class AutomaticSession : public Session {
 protected:
  static constexpr std::uint16_t kMost = 12;

  void SetUp() override {
    request.repeats = 0;
    request.repeats_auto = true;
    configuration.check.repeats_most = kMost;
    configuration.check.diagnose = false;
  }

  /// What the loop would do: no run begins once there are enough. Runs come no faster than they are
  /// identified.
  CheckRecord drive(const Estimator& estimator, const CheckOutcome& outcome = {}) {
    CheckSession session(configuration, limits, request, context, estimator, GetParam());
    EXPECT_TRUE(session.progress().repeats_auto);
    EXPECT_EQ(session.progress().repeats, kMost);
    std::int64_t left_out = 0;
    for (Sample sample : support::sample_stream({.rows = kRows, .repeats = kMost})) {
      if (session.has_enough() && sample.phase == CheckPhase::Trajectory) {
        ++left_out;
        continue;
      }
      sample.sample_index -= left_out;
      const std::uint32_t recorded = session.progress().recorded;
      session.consume(sample);
      if (session.progress().recorded > recorded) settle(session);
    }
    return session.finish(outcome);
  }

  /// Until the worker has fitted what its look is about. A run that comes while it still judges is not
  /// counted if these were enough.
  void settle(const CheckSession& session) {
    const std::uint32_t runs = session.progress().recorded;
    const std::uint32_t looks = runs < StoppingRule::kFirstLook ? 0 : runs - StoppingRule::kFirstLook + 1;
    EXPECT_TRUE(support::eventually([&] { return session.has_enough() || fits >= runs + looks; }));
  }

  /// An estimator whose standard deviations fall with the number of runs, and who counts its fits.
  Estimator of(const ParameterVector& theta, double sd_of_one) {
    return [=, this](Runs runs, const EstimatorOptions& options) {
      Estimate estimate = finds(theta)(runs, options);
      estimate.covariance_normalised *= std::pow(sd_of_one / 0.01, 2) / static_cast<double>(runs.size());
      adjust(estimate, runs.size());
      ++fits;
      return estimate;
    };
  }

  std::function<void(Estimate&, std::size_t)> adjust = [](Estimate&, std::size_t) {};
  std::atomic<std::uint32_t> fits{0};
};

TEST_P(AutomaticSession, EndsWithTheFirstLookThatDecidesEveryLimit) {
  const CheckRecord record = drive(of(nominal_parameters(), 0.01));
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  EXPECT_FALSE(record.marginal);
  EXPECT_EQ(record.runs.size(), 4u) << "fewer cannot show whether the model fits";
  EXPECT_EQ(record.repeats, 4u);
  ASSERT_TRUE(record.stopping);
  EXPECT_EQ(record.stopping->reason, "every limit decided after 4 runs");
  EXPECT_EQ(record.stopping->most, kMost);
  EXPECT_GT(record.stopping->coverage_factor, limits.guard_band_k) << "it may look again and again";
}

TEST_P(AutomaticSession, GoesOnWhileTheSheetIsInDoubt) {
  context.sheet = *parse_sheet(R"(revision = "7"
[[characteristic]]
name = "holding"
kind = "holding-margin"
unit = "N m"
force_N = 20000
upper = 0.235
)",
                               "sheet.toml");
  // 0.0042 N m below its limit, and known to 0.0036 N m by one run.
  const CheckRecord record = drive(of(nominal_parameters(), 0.005));
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  EXPECT_FALSE(record.marginal);
  EXPECT_GT(record.runs.size(), 4u);
  EXPECT_LT(record.runs.size(), kMost);
}

TEST_P(AutomaticSession, GoesOnWhileALimitIsInDoubtAndFailsWithWhatItThenKnows) {
  ParameterVector soft = nominal_parameters();
  soft[k2] *= 0.82;  // the limit is 0.85: decided once 0.03 are more than 2.5 sd
  const CheckRecord record = drive(of(soft, 0.03));
  EXPECT_EQ(record.verdict, Verdict::Fail);
  EXPECT_FALSE(record.marginal);
  const double factor = record.stopping.value().coverage_factor;
  EXPECT_EQ(record.runs.size(), static_cast<std::size_t>(std::ceil(factor * factor)));
}

TEST_P(AutomaticSession, TheMostThatIsAllowedEndsInAMarkedVerdictThatNamesTheDoubt) {
  ParameterVector soft = nominal_parameters();
  soft[k2] *= 0.851;
  const CheckRecord record = drive(of(soft, 0.03));
  EXPECT_EQ(record.verdict, Verdict::Pass);
  EXPECT_TRUE(record.marginal);
  EXPECT_EQ(record.runs.size(), kMost);
  EXPECT_EQ(record.stopping.value().reason, "the most that was allowed: 12; k2 in doubt");
}

TEST_P(AutomaticSession, RunsThatDifferAreNotEnoughUntilTheirScatterIsKnown) {
  adjust = [](Estimate& estimate, std::size_t runs) {
    estimate.runs_agree_p = 1e-6;
    estimate.runs_differ = runs >= 8;
    if (estimate.runs_differ) estimate.degrees_of_freedom.setConstant(static_cast<double>(runs - 1));
  };
  const CheckRecord record = drive(of(nominal_parameters(), 0.01));
  EXPECT_EQ(record.stopping.value().reason, "every limit decided after 8 runs");
}

TEST_P(AutomaticSession, DeviationsFromFewDegreesOfFreedomAskForMore) {
  ParameterVector soft = nominal_parameters();
  soft[k2] *= 0.82;
  const std::size_t known = drive(of(soft, 0.03)).runs.size();
  fits = 0;
  adjust = [](Estimate& estimate, std::size_t) { estimate.degrees_of_freedom.setConstant(6.0); };
  EXPECT_GT(drive(of(soft, 0.03)).runs.size(), known);
}

TEST_P(AutomaticSession, RunsThatTheModelDoesNotExplainAreNeverEnough) {
  adjust = [](Estimate& estimate, std::size_t) { estimate.force_rms_N = 1e4; };
  const CheckRecord record = drive(of(nominal_parameters(), 0.01));
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_EQ(record.runs.size(), kMost);
  EXPECT_EQ(record.stopping.value().reason,
            "the most that was allowed: 12; they say nothing about the brake");
}

TEST_P(AutomaticSession, AStopAfterTheLookThatWasEnoughIsStillAStop) {
  CheckOutcome outcome;
  outcome.fault = FaultCause::OperatorStop;
  outcome.fault_verdict = Verdict::Aborted;
  const CheckRecord record = drive(of(nominal_parameters(), 0.01), outcome);
  EXPECT_EQ(record.verdict, Verdict::Aborted);
  EXPECT_EQ(record.stopping.value().reason, "the check was ended before its time");
}

TEST_P(AutomaticSession, LostSamplesAfterTheLookStillMakeAnError) {
  CheckOutcome outcome;
  outcome.health.lost_samples = 1;
  EXPECT_EQ(drive(of(nominal_parameters(), 0.01), outcome).verdict, Verdict::Error);
}

TEST_P(AutomaticSession, ANumberThatIsAskedForIsThatNumber) {
  request.repeats_auto = false;
  configuration.check.repeats_auto = true;
  EXPECT_TRUE(planned_repeats(request, configuration.check).automatic);
  request.repeats = 3;
  EXPECT_FALSE(planned_repeats(request, configuration.check).automatic);
  const CheckRecord record = check(samples, finds(nominal_parameters()));
  EXPECT_EQ(record.repeats, 3u);
  EXPECT_FALSE(record.stopping);
}

INSTANTIATE_TEST_SUITE_P(Modes, AutomaticSession,
                         ::testing::Values(WorkerMode::Background, WorkerMode::Synchronous),
                         [](const auto& mode) {
                           return mode.param == WorkerMode::Background ? "background" : "synchronous";
                         });

TEST_P(Session, TheSheetGoesWithTheRecordAndCountsInTheVerdict) {
  EXPECT_FALSE(check(samples, finds(nominal_parameters())).sheet) << "the station has none";
  context.sheet = *parse_sheet(R"(revision = "7"
[[characteristic]]
kind = "holding-margin"
unit = "N m"
force_N = 20000
upper = 0.2
)",
                               "sheet.toml");
  const CheckRecord record = check(samples, finds(nominal_parameters()));
  ASSERT_TRUE(record.sheet);
  EXPECT_EQ(record.sheet->revision, "7");
  EXPECT_EQ(record.sheet->file, "sheet.toml");
  EXPECT_EQ(record.sheet->sha256, context.sheet->sha256);
  EXPECT_FALSE(record.sheet->misfit_marked);
  ASSERT_EQ(record.sheet->characteristics.size(), 1u);
  const CharacteristicRecord& margin = record.sheet->characteristics[0];
  EXPECT_NEAR(margin.value, 0.2308, 1e-9);
  EXPECT_NEAR(margin.sd, 0.01 * std::hypot(4.68e-2, 0.71), 1e-9) << "the tare adds nothing to this estimate";
  EXPECT_EQ(margin.verdict, ParameterVerdict::Fail);
  EXPECT_EQ(record.verdict, Verdict::Fail);
  EXPECT_THAT(record.reason,
              HasSubstr("holding-margin at force_N 20000 is 0.2308 N m, above its upper limit 0.2 N m"));
}

TEST_P(Session, KeepsWhereItFoundTheBrakeAndSaysWhatTheEncoderTells) {
  context.sheet = support::encoder_sheet();
  // Pads that are pressed as far as the force says, from an encoder that reads 17.3 rad at contact.
  const PolynomialStiffness stiffness(nominal_parameters().data());
  for (Sample& sample : samples)
    if (sample.trajectory_index >= 0) {
      const double x = 0.5 * sample.trajectory_index;
      sample.position_rad = 17.3 + x;
      sample.force_N = stiffness.force_N(x);
    }
  const Estimator estimator = [find = finds(nominal_parameters())](std::span<const clampd::Run> runs,
                                                                   const EstimatorOptions& options) {
    Estimate estimate = find(runs, options);
    estimate.initial_states.assign(runs.size(), Eigen::Vector2d(0.2, 0.0));
    return estimate;
  };
  const CheckRecord record = check(samples, estimator);
  EXPECT_EQ(record.found_rad, 9.0);
  ASSERT_TRUE(record.sheet);
  ASSERT_EQ(record.sheet->characteristics.size(), 2u) << record.reason;
  EXPECT_NEAR(record.sheet->characteristics[0].value, 17.3, 1e-6);
  EXPECT_NEAR(record.sheet->characteristics[1].value, 8.3, 1e-6);
  EXPECT_EQ(record.sheet->characteristics[1].verdict.has_value(), true);
  EXPECT_EQ(check({}, estimator).found_rad, std::nullopt) << "no sample came";
}

TEST_P(Session, WithoutAnEstimateTheSheetIsEmpty) {
  context.sheet =
      *parse_sheet("revision = \"7\"\n[[characteristic]]\nkind = \"drag\"\nunit = \"N m\"\nspeed_rad_s = 9\n",
                   "sheet.toml");
  const CheckRecord record = check({}, finds(nominal_parameters()));
  EXPECT_EQ(record.verdict, Verdict::Error);
  ASSERT_TRUE(record.sheet);
  EXPECT_TRUE(record.sheet->characteristics.empty());
}

TEST_P(Session, ShowsItsProgress) {
  CheckSession session(configuration, limits, request, context, finds(nominal_parameters()), GetParam());
  EXPECT_EQ(session.progress().repeats, 3u);
  EXPECT_EQ(session.progress().recorded, 0u);
  for (const Sample& sample : samples) session.consume(sample);
  EXPECT_EQ(session.progress().recorded, 3u);
  EXPECT_GT(session.progress().samples, 90u);
  session.finish({});
  EXPECT_EQ(session.progress().identified, 3u);
}

TEST_P(Session, TheSearchForACauseIsHeardOfKeptAndCanBeGivenUp) {
  bool give_up = false;
  const auto searched = [&](CheckSession& session) {
    double heard = 0.0;
    session.watch_search(
        {[&heard](double share, const std::string&) { heard = share; }, [&give_up] { return give_up; }});
    for (const Sample& sample : samples) session.consume(sample);
    EXPECT_EQ(session.progress().cause_searched, 0.0);
    const std::string reason = session.finish({}).reason;
    EXPECT_EQ(heard, 0.4);
    EXPECT_EQ(session.progress().cause_searched, 0.4);
    return reason;
  };
  const Diagnoser diagnoser = [](Runs, const DiagnoseOptions& options) -> Result<Diagnosis> {
    options.progress(0.4, "trying every effect");
    if (options.given_up()) return failure("the search was given up");
    Diagnosis found;
    found.summary = "found";
    return found;
  };
  const auto session = [&] {
    return std::make_unique<CheckSession>(configuration, limits, request, context,
                                          finds(nominal_parameters(), 1e4), GetParam(), diagnoser);
  };
  const auto explained = session();
  searched(*explained);
  const std::optional<Diagnosis> kept = explained->take_diagnosis();
  ASSERT_TRUE(kept);
  EXPECT_EQ(kept->summary, "found");
  give_up = true;
  const auto ended = session();
  EXPECT_THAT(searched(*ended), HasSubstr("the search was given up"));
  EXPECT_FALSE(ended->take_diagnosis());
}

INSTANTIATE_TEST_SUITE_P(Modes, Session, ::testing::Values(WorkerMode::Background, WorkerMode::Synchronous),
                         [](const auto& mode) {
                           return mode.param == WorkerMode::Background ? "background" : "synchronous";
                         });

TEST(CheckRequest, IsCheckedBeforeAnythingMoves) {
  EXPECT_TRUE(validate({.serial = "S-1", .repeats = 200}));
  EXPECT_THAT(validate({.serial = " "}).error().message, HasSubstr("serial number is empty"));
  EXPECT_THAT(validate({.serial = std::string(81, 'x')}).error().message, HasSubstr("longer than 80"));
  EXPECT_THAT(validate({.serial = "a\nb"}).error().message, HasSubstr("control characters"));
  EXPECT_THAT(validate({.serial = "M\xFCller"}).error().message, HasSubstr("is no UTF-8"));
  EXPECT_TRUE(validate({.serial = "M\xC3\xBCller"}));
  EXPECT_TRUE(validate({.serial = " X\r\n"})) << "as a scanner types it";
  EXPECT_EQ(normalised({.serial = " X\r\n", .operator_name = "\tJo "}).serial, "X");
  EXPECT_EQ(normalised({.serial = " X\r\n", .operator_name = "\tJo "}).operator_name, "Jo");
  EXPECT_THAT(validate({.serial = "a", .repeats = 201}).error().message, HasSubstr("too many"));
  EXPECT_TRUE(validate({.serial = "a", .repeats_auto = true}));
  EXPECT_THAT(validate({.serial = "a", .repeats = 3, .repeats_auto = true}).error().message,
              HasSubstr("one of the two"));
  EXPECT_THAT(validate({.serial = "a", .operator_name = "\x1b[31m"}).error().message,
              HasSubstr("the operator"));
}

}  // namespace
}  // namespace clampd
