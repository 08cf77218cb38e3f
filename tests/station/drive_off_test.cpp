#include "clampd/station/drive_off.hpp"

#include <cstdint>

#include <gtest/gtest.h>

namespace clampd {
namespace {

Sample sample_at(std::int64_t index, StationState state) {
  Sample sample;
  sample.sample_index = index;
  sample.brake_time_ns = 1'001'000 * index;
  sample.state = state;
  sample.torque_Nm = 1e-3 * static_cast<double>(index);
  return sample;
}

TEST(DriveOffReadings, AreTheLatestOnceTheCurrentHasDiedAway) {
  DriveOffReadings readings(100);
  std::int64_t index = 0;
  for (; index < 500; ++index) readings.consume(sample_at(index, StationState::Idle));
  EXPECT_EQ(readings.rows(), 100U);
  const clampd::Run run = readings.run();
  EXPECT_EQ(run.torque_Nm.front(), 0.4);
  EXPECT_EQ(run.torque_Nm.back(), 0.499);
  EXPECT_EQ(run.time_s.front(), 0.0);
  EXPECT_NEAR(run.time_s.back(), 99 * 1.001e-3, 1e-12);
  EXPECT_EQ(run.drive_enabled, std::vector<double>(100, 0.0));
  EXPECT_EQ(run.force_N.size(), 100U);

  // With the drive on they are those of another time, and so after a gap.
  for (const StationState on :
       {StationState::Armed, StationState::Running, StationState::Releasing, StationState::Fault}) {
    readings.consume(sample_at(index++, on));
    EXPECT_EQ(readings.rows(), 0U);
    const std::int64_t off = index;
    while (readings.rows() == 0 && index < off + 1000)
      readings.consume(sample_at(index++, StationState::Idle));
    EXPECT_GT(index - off, 20);
    EXPECT_LT(index - off, 200);
  }
  ++index;
  readings.consume(sample_at(index++, StationState::Idle));
  EXPECT_EQ(readings.rows(), 0U);
  EXPECT_TRUE(readings.run().time_s.empty());
}

}  // namespace
}  // namespace clampd
