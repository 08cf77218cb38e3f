// Whole checks of the simulated brake in virtual time, against its truth.

#include <cmath>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/sim/plant_configuration.hpp"
#include "tools/assembly/builtin.hpp"
#include "tools/assembly/embedded_station.hpp"
#include "tools/assembly/prepared_station.hpp"

namespace clampd::assembly {
namespace {

using ::testing::HasSubstr;

PreparedStation prepared() {
  Result<PreparedStation> station = prepare_station(StationConfiguration{});
  EXPECT_TRUE(station) << station.error().message;
  return std::move(*station);
}

sim::PlantConfiguration plant(std::uint64_t seed) {
  Result<sim::PlantConfiguration> read = sim::parse_plant_configuration(kBuiltinPlant, "plant.toml");
  EXPECT_TRUE(read) << read.error().message;
  read->seed = seed;
  return *read;
}

CheckRequest request(std::uint32_t repeats) {
  CheckRequest asked;
  asked.serial = "TEST-1";
  asked.repeats = repeats;
  return asked;
}

CheckRecord check(const sim::PlantConfiguration& brake, std::uint32_t repeats,
                  const EmbeddedStation::Progress& progress = nullptr) {
  EmbeddedStation station(prepared(), brake);
  Result<CheckRecord> record = station.run_check(request(repeats), nullptr, progress);
  EXPECT_TRUE(record);
  return *record;
}

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

/// Guard bands rest on the reported standard deviations: over many brakes, the errors in units of them must
/// be of unit size. The noise of each brake is its own; the torque reading is noisy, so that the Cramér-Rao
/// figure alone would fail.
TEST(EmbeddedStation, ReportedUncertaintyIsHonest) {
  constexpr int kChecks = 24;
  const ParameterVector nominal = nominal_parameters();
  ParameterVector squares = ParameterVector::Zero();
  for (int i = 0; i < kChecks; ++i) {
    sim::PlantConfiguration brake = plant(1000 + static_cast<std::uint64_t>(i));
    brake.sensors.torque_noise_Nm = 0.01;
    for (Eigen::Index p = 0; p < nominal.size(); ++p)
      brake.brake.theta[p] *=
          1.0 + 0.1 * std::sin(1.7 * static_cast<double>(i) + 2.3 * static_cast<double>(p));
    const CheckRecord record = check(brake, 20);
    ASSERT_EQ(record.parameters.size(), kParameterCount) << record.reason;
    for (Eigen::Index p = 0; p < nominal.size(); ++p) {
      const ParameterRecord& parameter = record.parameters[static_cast<std::size_t>(p)];
      const double error = (parameter.value - brake.brake.theta[p]) / parameter.sd;
      EXPECT_LT(std::abs(error), 5.0) << parameter.name << " in check " << i;
      squares[p] += error * error;
    }
  }
  for (Eigen::Index p = 0; p < nominal.size(); ++p) {
    const double rms = std::sqrt(squares[p] / kChecks);
    const auto name = kParameterTable[static_cast<std::size_t>(p)].name;
    RecordProperty(std::string("normalised_error_rms_") + std::string(name), std::to_string(rms));
    EXPECT_LT(rms, 1.6) << name;  // 24 draws of a unit normal: below 1.45 in 99.9 % of all cases
    EXPECT_GT(rms, 0.5) << name;
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
  const CheckRecord record = check(brake, 10);
  EXPECT_EQ(record.verdict, Verdict::Error);
  EXPECT_THAT(record.reason, HasSubstr("explain"));
}

TEST(EmbeddedStation, RefusesARequestBeforeAnythingMoves) {
  EmbeddedStation station(prepared(), plant(1));
  CheckRequest asked = request(20);
  asked.serial = "line\nbreak";
  EXPECT_FALSE(station.run_check(asked, nullptr, nullptr));
}

}  // namespace
}  // namespace clampd::assembly
