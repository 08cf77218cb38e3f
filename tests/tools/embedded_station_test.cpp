// Whole checks of the simulated brake in virtual time, against its truth.

#include <cmath>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tools/embedded_check.hpp"

namespace clampd::assembly {
namespace {

using ::testing::HasSubstr;

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
