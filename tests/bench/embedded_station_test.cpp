// Whole checks of the simulated brake in virtual time, against its truth.

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/archive/json.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/bench/check_conductor.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "drivers/can/brake_node.hpp"
#include "drivers/sim/simulated_brake.hpp"
#include "support/encoder_sheet.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::bench {
namespace {

using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(EmbeddedStation, TwentyRepeatsWithinThirtySecondsOfBenchTime) {
  const CheckRecord record = check(plant(1), 20);
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  EXPECT_EQ(record.runs.size(), 20U);
  EXPECT_LE(record.duration_s, 30.0);
  EXPECT_EQ(record.timing.skipped, 0U);
  EXPECT_EQ(record.timing.lost_samples, 0U);
  EXPECT_GT(record.timing.bus_load, 0.3);
  EXPECT_LT(record.timing.bus_load, 0.5);
}

/// Of a brake whose encoder reads so much at contact, found so far open.
CheckRecord check_of_clearance(double encoder_zero_rad, double clearance_rad, double force_offset_N) {
  PreparedStation station = prepared();
  station.configuration.check.diagnose =
      false;  // which a FAIL would ask for, and which is not what is tested
  station.sheet = support::encoder_sheet();
  sim::PlantConfiguration brake = plant(1);
  brake.encoder_zero_rad = encoder_zero_rad;
  brake.clearance_rad = clearance_rad;
  brake.sensors.force_offset_N = force_offset_N;
  return EmbeddedStation(std::move(station), brake).run_check(request(6), nullptr, nullptr).value();
}

TEST(EmbeddedStation, TellsWhereThePadsTouchAndHowFarOpenItFoundTheBrake) {
  for (const auto& [zero_rad, clearance_rad, offset_N] :
       {std::tuple{17.3, 6.0, 35.0}, {-203.4, 4.5, -300.0}, {440.0, 25.0, 0.0}, {17.3, -20.0, 35.0}}) {
    SCOPED_TRACE(fmt::format("contact at {}, found {} rad open", zero_rad, clearance_rad));
    const CheckRecord record = check_of_clearance(zero_rad, clearance_rad, offset_N);
    ASSERT_TRUE(record.found_rad);
    EXPECT_NEAR(*record.found_rad, zero_rad - clearance_rad, 1e-3) << "before anything moved";
    ASSERT_TRUE(record.sheet);
    ASSERT_EQ(record.sheet->characteristics.size(), 2U) << record.reason;
    const CharacteristicRecord &contact = record.sheet->characteristics[0],
                               &open = record.sheet->characteristics[1];
    EXPECT_NEAR(contact.value, zero_rad, 4.0 * contact.sd);
    EXPECT_LT(contact.sd, 0.05);
    EXPECT_FALSE(contact.verdict);
    EXPECT_NEAR(open.value, clearance_rad, 4.0 * open.sd);
    const bool is_within = clearance_rad > 4.0 && clearance_rad < 8.0;
    EXPECT_EQ(open.verdict, is_within ? ParameterVerdict::Pass : ParameterVerdict::Fail);
    EXPECT_EQ(record.verdict, is_within ? Verdict::Pass : Verdict::Fail) << record.reason;
  }
}

TEST(EmbeddedStation, GoesOnWhileTheClearanceIsInDoubt) {
  PreparedStation station = prepared();
  station.configuration.check.repeats_most = 8;
  station.sheet =
      parse_sheet("revision = \"1\"\n[[characteristic]]\nkind = \"clearance\"\nunit = \"rad\"\nlower = 6\n",
                  "sheet.toml")
          .value();
  CheckRequest asked = request(0);
  asked.repeats_auto = true;
  const CheckRecord record =
      EmbeddedStation(std::move(station), plant(1)).run_check(asked, nullptr, nullptr).value();
  EXPECT_EQ(record.runs.size(), 8U) << "it stands where its limit is";
  EXPECT_THAT(record.stopping.value().reason, HasSubstr("clearance in doubt"));
  EXPECT_TRUE(record.marginal);
}

TEST(EmbeddedStation, StandsByWithTheDriveOff) {
  sim::PlantConfiguration brake = plant(1);
  brake.effects.torque_offset_Nm = 0.05;
  EmbeddedStation station(prepared(), brake);
  ASSERT_TRUE(station.run_check(request(1), nullptr, nullptr));
  const auto off = station.stand_by(400);
  ASSERT_TRUE(off) << off.error().message;
  EXPECT_EQ(off->size(), 400U);
  EXPECT_FALSE(is_driven(*off));
  const auto torque = torque_while_off(std::span(&*off, 1));
  ASSERT_TRUE(torque);
  EXPECT_NEAR(torque->mean_Nm, 0.05, 5.0 * torque->sd_Nm);
}

TEST(EmbeddedStation, AnExperimentHasTheTimeThatItTakes) {
  PreparedStation prepared_station = prepared();
  prepared_station.configuration.check.deadline_s = 6.0;
  EmbeddedStation station(std::move(prepared_station), plant(1));
  const auto one = station.run_check(request(1), nullptr, nullptr);
  ASSERT_TRUE(one);
  EXPECT_EQ(one->verdict, Verdict::Pass) << one->reason;
  constexpr std::uint32_t kRepeats = 6;
  const auto slow = make_manoeuvre("slow-sinusoid", BrakeParameters{}, {}).value();
  ASSERT_TRUE(station.use_trajectory(slow));
  const auto experiment = station.run_check(request(kRepeats), nullptr, nullptr);
  ASSERT_TRUE(experiment);
  EXPECT_EQ(experiment->runs.size(), kRepeats) << experiment->reason;
  EXPECT_NE(experiment->verdict, Verdict::Timeout);
  EXPECT_GT(experiment->duration_s, kRepeats * 2.35);
}

TEST(CheckConductor, RemembersTheTorqueBeforeTheCheckForTheRecord) {
  sim::PlantConfiguration configuration = plant(1);
  configuration.effects.torque_offset_Nm = 0.05;
  Bench bench(configuration, WorkerMode::Synchronous);
  const auto advance = [&] {
    bench.advance();
    return bench.pump();
  };
  for (int check = 0; check < 2; ++check) {
    for (int k = 0; k < 4000; ++k) ASSERT_FALSE(advance());
    ASSERT_TRUE(bench.begin(1));
    std::optional<CheckRecord> record;
    while (!record) record = advance();
    EXPECT_EQ(record->fault, FaultCause::None) << record->reason;
    ASSERT_TRUE(record->torque_while_off);
    EXPECT_EQ(record->torque_while_off->rows, 3000U);
    EXPECT_NEAR(record->torque_while_off->mean_Nm, 0.05, 5.0 * record->torque_while_off->sd_Nm);
    EXPECT_NEAR(check_json(*record)["torque_while_off"]["mean_Nm"], record->torque_while_off->mean_Nm, 1e-12);
  }
}

TEST(EmbeddedStation, AnOperatorStopAborts) {
  const CheckRecord record =
      check(plant(1), 20, [](CheckPhase, std::uint32_t repeat, std::uint32_t) { return repeat < 3; });
  EXPECT_EQ(record.verdict, Verdict::Aborted);
  EXPECT_EQ(record.fault, FaultCause::OperatorStop);
  EXPECT_LT(record.runs.size(), 20U);
}

struct WireFaultCase {
  sim::FaultKind kind;
  FaultCause cause;
};

class WireFaults : public ::testing::TestWithParam<WireFaultCase> {};

TEST_P(WireFaults, EndInErrorWithTheCauseNamed) {
  sim::PlantConfiguration brake = plant(1);
  brake.faults.push_back({GetParam().kind, 4.0, 1000.0});
  const CheckRecord record = check(brake, 20);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_EQ(record.fault, GetParam().cause) << to_string(record.fault);
  ASSERT_FALSE(record.flight_recorder.empty());
  // Judged by what the brake saw: its torque is zero within 5 ms of the first fault sample.
  for (const Sample& sample : record.flight_recorder)
    if (sample.brake_time_ns > 4'005'000'000) {
      EXPECT_EQ(sample.torque_command_Nm, 0.0);
    }
}

INSTANTIATE_TEST_SUITE_P(
    OnTheWire, WireFaults,
    ::testing::Values(WireFaultCase{sim::FaultKind::CorruptCrc, FaultCause::FeedbackCorrupt},
                      WireFaultCase{sim::FaultKind::FrozenCounter, FaultCause::FeedbackFrozen},
                      WireFaultCase{sim::FaultKind::ImpossibleValues, FaultCause::FeedbackImplausible},
                      WireFaultCase{sim::FaultKind::Silent, FaultCause::FeedbackStale}));

TEST(EmbeddedStation, ABrakeThatItsModelDoesNotExplainIsNoFail) {
  sim::PlantConfiguration brake = plant(1);
  ASSERT_TRUE(sim::set_effect(brake.effects, "force-lag", 0.01));
  const CheckRecord record = check(brake, 4);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("explain"));
  // And its cause is named.
  ASSERT_TRUE(record.cause);
  EXPECT_EQ(record.cause->verdict, "explained");
  EXPECT_THAT(record.cause->effects, ::testing::ElementsAre("force-lag"));
  EXPECT_EQ(record.cause->location, "force-reading");
  EXPECT_THAT(record.reason, HasSubstr("comes 10 ms late"));
  EXPECT_EQ(check_json(record).at("cause").at("effect"), "force-lag");
}

// Its drag takes so much of TC's place that TC is in doubt, though the runs are explained to a few percent of
// the noise. Neither more repeats nor another method would help.
TEST(EmbeddedStation, WhatTheModelLacksIsNamedWhereItLeavesALimitInDoubt) {
  sim::PlantConfiguration brake = plant(1);
  ASSERT_TRUE(sim::set_effect(brake.effects, "quadratic-drag", 2e-6));
  const CheckRecord record = check(brake, 8);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("does not explain all of this brake's motion"));
  EXPECT_THAT(record.reason, ::testing::Not(HasSubstr("method")));
  ASSERT_TRUE(record.cause) << record.reason;
  EXPECT_THAT(record.cause->effects, ::testing::ElementsAre("quadratic-drag"));
}

TEST(CheckConductor, ConcludesBesideItsCalls) {
  sim::PlantConfiguration configured = plant(1);
  ASSERT_TRUE(sim::set_effect(configured.effects, "force-lag", 0.012));
  Bench bench(configured, WorkerMode::Background);
  while (bench.core.status().state.load() == StationState::Init) bench.advance();
  const auto begun = bench.begin(4);
  ASSERT_TRUE(begun) << begun.error().message;
  while (!bench.conductor.concluding()) {
    bench.advance();
    ASSERT_FALSE(bench.pump());
  }
  // The runs are being diagnosed, which takes far longer than this.
  EXPECT_TRUE(bench.conductor.busy());
  EXPECT_EQ(bench.conductor.progress().recorded, 4u);
  EXPECT_FALSE(bench.begin(4));
  std::optional<CheckRecord> record;
  while (!record) {
    bench.advance();
    record = bench.pump();
  }
  EXPECT_FALSE(bench.conductor.busy());
  EXPECT_FALSE(bench.conductor.concluding());
  EXPECT_EQ(record->verdict, Verdict::Error);
  EXPECT_EQ(record->runs.size(), 4u);
  EXPECT_TRUE(record->cause) << record->reason;
  EXPECT_TRUE(bench.begin(4)) << "ready for the next";
  bench.core.requests().stop(bench.now_ns);
  while (!bench.conductor.concluding()) {
    bench.advance();
    bench.pump();
  }
}

TEST(PreparedStation, RefusesAMappingWithoutASignalThatACheckNeeds) {
  for (const char* role : {"torque_command", "enable", "force", "velocity", "torque", "position"}) {
    StationConfiguration configuration;
    configuration.file = "station.toml";
    configuration.can.mapping = {{role, ""}};
    const auto station = prepare_station(configuration);
    ASSERT_FALSE(station) << role;
    EXPECT_NE(station.error().message.find(std::string("station.toml: [can.mapping] ") + role + " is empty"),
              std::string::npos)
        << station.error().message;
  }
  for (const char* role : {"enabled", "watchdog", "fault", "counter", "sample_clock"}) {
    StationConfiguration configuration;
    configuration.can.mapping = {{role, ""}};
    const auto station = prepare_station(configuration);
    EXPECT_TRUE(station) << station.error().message;
  }
  StationConfiguration both;
  both.can.mapping = {{"velocity_command", "BrakeFeedback.Velocity"}};
  const auto told_twice = prepare_station(both);
  ASSERT_FALSE(told_twice);
  EXPECT_THAT(told_twice.error().message, HasSubstr("but a brake is told one of the two"));
  StationConfiguration without_crc;
  without_crc.can.mapping = {{"crc", ""}};
  const auto refused = prepare_station(without_crc);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("\"none\" if the brake's frames carry none"));
  without_crc.can.protection.checksum = "none";
  EXPECT_TRUE(prepare_station(without_crc));
  without_crc.can.protection.checksum = "crc32";
  const auto unknown = prepare_station(without_crc);
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().message,
              HasSubstr("[can.protection] checksum is \"crc32\"; there are sae-j1850, e2e-1a"));
}

// One frame of CAN FD with AUTOSAR's profile 7 in place of the two classic ones, and a brake that has to be
// woken.
StationConfiguration can_fd_station() {
  StationConfiguration configuration;
  configuration.can.dbc = CLAMPD_SOURCE_DIR "/tests/hil/guest/brake_fd.dbc";
  configuration.can.data_bitrate = 4'000'000;
  configuration.can.protection.checksum = "e2e-7";
  configuration.can.mapping = {{"torque_command", "Command.Torque"},
                               {"enable", "Command.Enable"},
                               {"force", "Feedback.Force"},
                               {"velocity", "Feedback.Velocity"},
                               {"torque", "Feedback.Torque"},
                               {"position", "Feedback.Position"},
                               {"sample_clock", "Feedback.Clock"},
                               {"enabled", ""},
                               {"watchdog", ""},
                               {"fault", ""},
                               {"counter", "Counter"},
                               {"crc", "Crc"}};
  configuration.can.startup = {{"ModeRequest", {{"Mode", 3.0}, {"Key", 165.0}}, 20.0}};
  return configuration;
}

TEST(EmbeddedStation, ChecksABrakeThatSpeaksCanFd) {
  StationConfiguration configuration = can_fd_station();
  auto station = prepare_station(configuration);
  ASSERT_TRUE(station) << station.error().message;
  EmbeddedStation bench(*std::move(station), plant(1));
  const auto record = bench.run_check(request(3), nullptr, nullptr);
  ASSERT_TRUE(record) << record.error().message;
  EXPECT_EQ(record->verdict, Verdict::Pass) << record->reason;
  EXPECT_EQ(record->timing.lost_samples, 0U);
  EXPECT_GT(record->timing.bus_load, 0.1);
  EXPECT_LT(record->timing.bus_load, 0.5);

  configuration.can.startup.front().signals.front().second = 16.0;
  const auto refused = prepare_station(configuration);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("start-up frame 1: ModeRequest.Mode cannot be 16"));
}

using Mapping = std::vector<std::pair<std::string, std::string>>;
const Mapping kWithoutClock = {{"sample_clock", ""}};
const Mapping kWithoutClockAndCounter = {{"sample_clock", ""}, {"counter", ""}};

// A brake that sends no clock: its instants are told by the arrivals. Where it samples unevenly, and nothing
// tells, the readings are noisier, and so are the estimates.
TEST(EmbeddedStation, ChecksABrakeThatSendsNoClock) {
  for (const auto& [mapping, jitter_s] : {std::pair(kWithoutClock, 0.0), std::pair(kWithoutClock, 10e-6),
                                          std::pair(kWithoutClockAndCounter, 0.0)}) {
    StationConfiguration configuration;
    configuration.can.mapping = mapping;
    auto station = prepare_station(configuration);
    ASSERT_TRUE(station) << station.error().message;
    sim::PlantConfiguration brake = plant(1);
    brake.sampling_jitter_s = jitter_s;
    EmbeddedStation bench(*std::move(station), brake);
    const auto record = bench.run_check(request(8), nullptr, nullptr);
    ASSERT_TRUE(record) << record.error().message;
    EXPECT_EQ(record->verdict, Verdict::Pass) << jitter_s << ": " << record->reason;
    EXPECT_EQ(record->timing.lost_samples, 0U);
    for (const RunRecord& run : record->runs)
      for (std::size_t k = 1; k < run.run.size(); ++k)
        EXPECT_NEAR(run.run.time_s[k] - run.run.time_s[k - 1], kPeriod_s, 2e-6) << jitter_s << " " << k;
    const BrakeParameters truth;
    for (std::size_t i = 0; i < record->parameters.size(); ++i)
      EXPECT_NEAR(record->parameters[i].value, truth.theta[i], 4.5 * record->parameters[i].sd)
          << jitter_s << " " << record->parameters[i].name;
  }
}

// A brake that samples more often than the station decides, and one that wants a command more often. Torque
// changes within the rows of such a check.
TEST(EmbeddedStation, ChecksABrakeWithFasterFrames) {
  for (const auto& [feedback_ms, command_ms] :
       {std::pair(0.5, 0.5), std::pair(0.5, 1.0), std::pair(1.0, 0.2), std::pair(0.25, 0.25)}) {
    StationConfiguration configuration = can_fd_station();
    configuration.can.data_bitrate = 8'000'000;
    configuration.can.feedback_cycle_ms = feedback_ms;
    configuration.can.command_cycle_ms = command_ms;
    for (const bool clocked : {true, false}) {
      for (auto& [role, signal] : configuration.can.mapping)
        if (role == "sample_clock" && !clocked) signal.clear();
      auto station = prepare_station(configuration);
      ASSERT_TRUE(station) << station.error().message;
      EmbeddedStation bench(*std::move(station), plant(1));
      const auto record = bench.run_check(request(8), nullptr, nullptr);
      ASSERT_TRUE(record) << record.error().message;
      const auto which = fmt::format("{} ms, {} ms, {}", feedback_ms, command_ms, clocked);
      EXPECT_EQ(record->verdict, Verdict::Pass) << which << ": " << record->reason;
      EXPECT_EQ(record->timing.lost_samples, 0U) << which;
      EXPECT_EQ(record->runs.front().run.size(), 300U) << which;
      const BrakeParameters truth;
      for (std::size_t i = 0; i < record->parameters.size(); ++i)
        EXPECT_NEAR(record->parameters[i].value, truth.theta[i], 4.5 * record->parameters[i].sd)
            << which << " " << record->parameters[i].name;
    }
  }
}

TEST(PreparedStation, RefusesFramesThatNoBusOfItsBitRateCarries) {
  StationConfiguration configuration = can_fd_station();
  configuration.can.feedback_cycle_ms = configuration.can.command_cycle_ms = 0.2;
  const auto refused = prepare_station(configuration);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("% of a bus at 1000000 bit/s, with readings every 0.2 ms"));
}

// Nothing in its frames tells whether they are new, and from some instant on they are the same ones again and
// again: only the readings contradict what the brake is told to do.
TEST(EmbeddedStation, ChecksABrakeWithSlowerFrames) {
  for (const auto& [feedback_ms, command_ms] :
       {std::pair{2.0, 2.0}, {5.0, 5.0}, {1.0, 2.0}, {0.5, 2.0}, {5.0, 1.0}, {5.0, 0.2}}) {
    SCOPED_TRACE(fmt::format("readings every {} ms, commands every {} ms", feedback_ms, command_ms));
    StationConfiguration configuration;
    configuration.can.feedback_cycle_ms = feedback_ms;
    configuration.can.command_cycle_ms = command_ms;
    configuration.check.method = Method::PredictionError;
    Result<PreparedStation> station = prepare_station(configuration);
    ASSERT_TRUE(station) << station.error().message;
    EmbeddedStation embedded(std::move(*station), plant(3));
    const auto record = embedded.run_check(request(20), nullptr, nullptr);
    ASSERT_TRUE(record) << record.error().message;
    EXPECT_EQ(record->verdict, Verdict::Pass) << record->reason;
    ASSERT_EQ(record->runs.size(), 20U);
    const double period_ms = std::max(feedback_ms, command_ms);
    EXPECT_EQ(record->runs.front().run.size(), static_cast<std::size_t>(std::lround(300.0 / period_ms)));
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const double truth = plant(3).brake.theta[static_cast<Eigen::Index>(i)];
      EXPECT_LT(std::abs(record->parameters[i].value - truth), 4.5 * record->parameters[i].sd)
          << record->parameters[i].name;
    }
  }
}

/// A tare of a load cell that has drifted beyond what its signal tells would be none.
TEST(EmbeddedStation, AForceThatItsSignalCannotTellIsAnError) {
  sim::PlantConfiguration brake = plant(1);
  brake.spoiled = {{sim::Reading::Force, sim::Spoil::Offset, -4100.0, 0.05}};
  const CheckRecord record = check(brake, 20);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("stand at the end of a signal's range"));
}

TEST(EmbeddedStation, FramesThatAreSentAgainAndAgainEndACheck) {
  StationConfiguration configuration;
  configuration.can.mapping = kWithoutClockAndCounter;
  const rt::SupervisorSettings limits;
  constexpr int kInstants = 60;
  for (int i = 0; i < kInstants; ++i) {
    auto prepared_station = prepare_station(configuration);
    ASSERT_TRUE(prepared_station) << prepared_station.error().message;
    const PreparedStation station = *std::move(prepared_station);
    can::EmbeddedBus bus;
    can::CanBrake port(bus.end(can::EmbeddedBus::End::Station), station.codec);
    sim::SimulatedBrake brake(plant(static_cast<std::uint64_t>(i)));
    can::BrakeNode<sim::SimulatedBrake> node(bus.end(can::EmbeddedBus::End::Brake), station.codec, brake);
    rt::ControlCore core(port, station.supervisor);
    CheckConductor conductor(station, core, nullptr, WorkerMode::Synchronous);
    std::int64_t now_ns = 0;
    const auto advance = [&](can::WireFault fault) {
      node.tick(now_ns, fault);
      core.tick(now_ns + kPeriod_ns / 2, 0, 0);
      now_ns += kPeriod_ns;
      EXPECT_LT(std::abs(brake.truth().velocity_rad_s), 1.2 * limits.speed_limit_rad_s) << i;
      EXPECT_LT(brake.truth().force_N, 1.1 * limits.force_limit_N) << i;
    };
    while (core.status().state.load() != StationState::Idle) advance(can::WireFault::None);
    ASSERT_TRUE(conductor.begin(request(1), {now_ns, now_ns}));
    // A check of one repeat drives the brake for some 2.4 s.
    const std::int64_t frozen_ns = now_ns + 40 * i * kPeriod_ns;
    std::optional<CheckRecord> record;
    double torque_Nm = 0.0;
    while (!record) {
      if (now_ns <= frozen_ns) torque_Nm = brake.truth().torque_Nm;
      advance(now_ns < frozen_ns ? can::WireFault::None : can::WireFault::FrozenCounter);
      record = conductor.pump({now_ns, now_ns});
    }
    if (now_ns < frozen_ns) break;  // over before
    EXPECT_EQ(record->verdict, Verdict::Error) << i << ": " << record->reason;
    if (std::abs(torque_Nm) > 0.2) {
      EXPECT_LE(core.status().fault_time_ns.load() - frozen_ns, 15 * kPeriod_ns) << i;
    }
    const std::int64_t off_ns = now_ns + 3 * kPeriod_ns;
    while (now_ns < off_ns) advance(can::WireFault::FrozenCounter);
    EXPECT_EQ(brake.truth().torque_Nm, 0.0) << i;
  }
}

constexpr const char* kBacklashModel = "[[effect]]\nname = \"backlash\"\nplay = 0.2\n";

class ExtendedCheck : public ::testing::Test {
 protected:
  Result<PreparedStation> prepare() {
    StationConfiguration configuration;
    configuration.check.model = folder_.path("extended.toml");
    configuration.limits_file = folder_.path("limits.toml");
    return prepare_station(configuration);
  }
  void write_limits(const std::string& further) {
    folder_.write("limits.toml", std::string(kBuiltinLimits) + further);
  }
  CheckRecord check_play(double play_rad) {
    sim::PlantConfiguration brake = plant(3);
    EXPECT_TRUE(sim::set_effect(brake.effects, "backlash", play_rad));
    Result<PreparedStation> station = prepare();
    EXPECT_TRUE(station) << station.error().message;
    const Result<CheckRecord> record =
        EmbeddedStation(std::move(*station), brake).run_check(request(8), nullptr, nullptr);
    EXPECT_TRUE(record);
    return *record;
  }
  support::TemporaryDirectory folder_;
};

TEST_F(ExtendedCheck, FailsABrakeForItsBacklashAndForNothingElse) {
  folder_.write("extended.toml", kBacklashModel);
  write_limits("[effects.backlash]\nplay = {lower = 0.0, upper = 0.3}\n");
  for (const double play_rad : {0.0, 0.15, 0.5}) {
    const CheckRecord record = check_play(play_rad);
    EXPECT_EQ(record.verdict, play_rad < 0.3 ? Verdict::Pass : Verdict::Fail) << record.reason;
    EXPECT_FALSE(record.marginal);
    EXPECT_EQ(record.method, "pem");
    ASSERT_EQ(record.parameters.size(), 8U);
    for (std::size_t i = 0; i < 7; ++i)
      EXPECT_EQ(record.parameters[i].verdict, ParameterVerdict::Pass) << record.parameters[i].name;
    const ParameterRecord& play = record.parameters[7];
    EXPECT_EQ(play.name, "backlash.play");
    EXPECT_EQ(play.unit, "rad");
    EXPECT_NEAR(play.value, play_rad, 4.0 * play.sd);
    EXPECT_LT(play.sd, 0.03);
    if (play_rad > 0.3) {
      EXPECT_THAT(record.reason,
                  ::testing::MatchesRegex("backlash\\.play is 0\\.[45].* rad, above its upper limit "
                                          "0\\.3 rad\\."));
    }
  }
}

TEST_F(ExtendedCheck, IsPreparedOnlyFromAModelThatFitsTheLimits) {
  write_limits("");
  EXPECT_THAT(prepare().error().message, HasSubstr("extended.toml"));
  folder_.write("extended.toml", "[[effect]]\nname = \"backlsh\"\nplay = 0.2\n");
  EXPECT_THAT(prepare().error().message, HasSubstr("extended.toml:1: there is no effect"));
  folder_.write("extended.toml", "[parameters]\n");
  EXPECT_THAT(prepare().error().message, HasSubstr("has no [[effect]]"));
  folder_.write("extended.toml", std::string("[fixed]\ninertia_kg_m2 = 3e-4\n") + kBacklashModel);
  EXPECT_THAT(prepare().error().message, HasSubstr("J = 0.0003"));
  folder_.write("extended.toml", kBacklashModel);
  EXPECT_TRUE(prepare());
  write_limits("[effects.force-lag]\ntime_constant = {lower = 0.0, upper = 1e-3}\n");
  EXPECT_THAT(prepare().error().message, HasSubstr("[effects.force-lag] has limits"));
}

TEST(EmbeddedStation, TakesAsManyRepeatsAsTheBrakeNeeds) {
  EmbeddedStation station(prepared(), plant(5));
  for (const char* serial : {"A", "B"}) {  // what was enough for one brake is not for the next
    const Result<CheckRecord> record =
        station.run_check({.serial = serial, .repeats_auto = true}, nullptr, nullptr);
    ASSERT_TRUE(record);
    EXPECT_EQ(record->verdict, Verdict::Pass) << record->reason;
    EXPECT_EQ(record->runs.size(), 4u);
    EXPECT_EQ(record->stopping.value().reason, "every limit decided after 4 runs");
    EXPECT_LT(record->duration_s, 4.0);
  }
}

TEST(EmbeddedStation, FurtherRunsFollowTheTrajectoryThatTellsMostOfWhatIsInDoubt) {
  sim::PlantConfiguration brake = plant(5);
  brake.brake.theta[TC] = 0.1526;  // closer to its upper limit than four runs can tell
  const auto check = [&brake](const PreparedStation& station) {
    return EmbeddedStation(station, brake).run_check({.serial = "A", .repeats_auto = true}, nullptr, nullptr).value();
  };
  const CheckRecord record = check(prepared());
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  const StoppingRecord& stopping = record.stopping.value();
  EXPECT_THAT(stopping.reason, HasSubstr("of the runs chosen for what was in doubt"));
  ASSERT_EQ(stopping.trajectories.size(), 3U);
  EXPECT_EQ(stopping.trajectories.front(), record.trajectory_sha256);
  ASSERT_EQ(stopping.followed.size(), record.runs.size());
  ASSERT_GT(record.runs.size(), 5U);
  EXPECT_THAT(std::vector(stopping.followed.begin(), stopping.followed.begin() + 5), Each(0))
      << "the first look is at four runs, while the fifth is driven";
  EXPECT_EQ(stopping.followed.at(5), 1) << "closing slowly shows the sliding friction";

  StationConfiguration configuration;
  configuration.check.further_trajectories.emplace();
  const CheckRecord without = check(prepare_station(configuration).value());
  EXPECT_THAT(without.stopping->followed, IsEmpty()) << "there was no choice";
  EXPECT_LT(record.runs.size(), without.runs.size());
}

TEST(EmbeddedStation, RefusesFurtherTrajectoriesOfAnotherLength) {
  StationConfiguration configuration;
  clampd::Run shorter = parse_run(std::string(kBuiltinTrajectory), "trajectory.csv")->run;
  for (auto* column : {&shorter.time_s, &shorter.torque_Nm, &shorter.velocity_rad_s, &shorter.force_N,
                       &shorter.position_rad})
    column->resize(200);
  const std::string file = testing::TempDir() + "/further-short.csv";
  std::ofstream(file) << format_run(shorter);
  configuration.check.further_trajectories = {file};
  const Result<PreparedStation> station = prepare_station(configuration);
  ASSERT_FALSE(station);
  EXPECT_THAT(station.error().message, HasSubstr("as many rows as the check's own, 300, not 200"));
}

TEST(EmbeddedStation, RefusesARequestBeforeAnythingMoves) {
  EmbeddedStation station(prepared(), plant(1));
  CheckRequest asked = request(20);
  asked.serial = "line\nbreak";
  EXPECT_FALSE(station.run_check(asked, nullptr, nullptr));
}

}  // namespace
}  // namespace clampd::bench
