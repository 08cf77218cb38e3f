#include "clampd/station/run_collector.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "station/sample_stream.hpp"

namespace clampd {
namespace {

using ::testing::DoubleNear;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr std::int32_t kRows = 30;

std::vector<CollectedRun> collect(RunCollector& collector, const std::vector<Sample>& samples) {
  std::vector<CollectedRun> runs;
  for (const Sample& sample : samples)
    if (auto run = collector.consume(sample)) runs.push_back(std::move(*run));
  return runs;
}

TEST(RunCollector, CutsTheStreamIntoTaredRunsOnTheBrakesClock) {
  RunCollector collector(kRows);
  const auto samples = support::sample_stream(
      {.rows = kRows, .repeats = 3, .force_offset_N = 120.0, .velocity_offset_rad_s = -0.5});
  const auto runs = collect(collector, samples);
  EXPECT_THAT(collector.problem(), IsEmpty());
  ASSERT_EQ(runs.size(), 3u);
  for (std::size_t i = 0; i < runs.size(); ++i) {
    EXPECT_EQ(runs[i].repeat, i);
    EXPECT_EQ(runs[i].run.name, "repeat " + std::to_string(i + 1));
    ASSERT_EQ(runs[i].run.size(), static_cast<std::size_t>(kRows));
    for (std::size_t k = 0; k < runs[i].run.size(); ++k) {
      // the stream's brake clock runs 0.1 % fast and its arrival times jitter: only the former may show
      EXPECT_NEAR(runs[i].run.time_s[k], 1.001e-3 * static_cast<double>(k), 1e-12);
      EXPECT_NEAR(runs[i].run.force_N[k], support::stream_force_N(static_cast<int>(k)), 1e-9);
      EXPECT_NEAR(runs[i].run.velocity_rad_s[k], support::stream_velocity_rad_s(static_cast<int>(k)), 1e-9);
      EXPECT_EQ(runs[i].run.torque_Nm[k], support::stream_torque_Nm(static_cast<int>(k)));
    }
    EXPECT_EQ(runs[i].run.position_rad.size(), runs[i].run.size());
    EXPECT_NEAR(runs[i].tracking_rms_N, support::kStreamTrackingError_N, 1e-9);
    EXPECT_NEAR(runs[i].tracking_max_N, support::kStreamTrackingError_N, 1e-9);
  }
  EXPECT_EQ(collector.samples_lost(), 0u);
  EXPECT_NEAR(collector.duration_s(), 1.001e-3 * static_cast<double>(collector.samples() - 1), 1e-9);
}

TEST(RunCollector, KeepsWhereTheCheckFoundTheBrake) {
  std::vector<Sample> samples = support::sample_stream({.rows = kRows, .repeats = 1});
  const auto first = static_cast<std::size_t>(
      std::find_if(samples.begin(), samples.end(),
                   [](const Sample& sample) { return sample.phase != CheckPhase::None; }) -
      samples.begin());
  samples[first].position_rad = 1e4 + 0.125;
  RunCollector collector(kRows);
  collect(collector, {samples.begin(), samples.begin() + static_cast<std::ptrdiff_t>(first)});
  EXPECT_FALSE(collector.found_rad()) << "what comes before the check is none of it";
  collect(collector, {samples.begin() + static_cast<std::ptrdiff_t>(first), samples.end()});
  EXPECT_EQ(collector.found_rad(), 1e4 + 0.125);

  samples[first].position_rad = std::nan("");
  RunCollector without(kRows);
  collect(without, samples);
  EXPECT_FALSE(without.found_rad())
      << "a reading that is none, and a later one would be of a brake that moves";
}

TEST(RunCollector, EstimatesTheNoiseAtRest) {
  RunCollector collector(kRows);
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  for (const Sample& clean : support::sample_stream({.rows = kRows, .repeats = 0, .tare = 5000})) {
    Sample sample = clean;
    sample.force_N = 1e6 + 75.0 * normal(random);
    sample.velocity_rad_s = 1.5 * normal(random);
    collector.consume(sample);
  }
  // 5000 samples: the sd of a mean is sd / 71, of an sd about sd / 100; four of each
  EXPECT_NEAR(collector.tare().force_offset_N, 1e6, 4 * 75.0 / 71);
  EXPECT_NEAR(collector.tare().force_sd_N, 75.0, 4 * 0.75);
  EXPECT_NEAR(collector.tare().velocity_offset_rad_s, 0.0, 4 * 1.5 / 71);
  EXPECT_NEAR(collector.tare().velocity_sd_rad_s, 1.5, 4 * 0.015);
}

TEST(RunCollector, GivesNoRunWithAGapInIt) {
  RunCollector collector(kRows);
  auto samples = support::sample_stream({.rows = kRows, .repeats = 3});
  const auto victim = std::find_if(samples.begin(), samples.end(), [](const Sample& sample) {
    return sample.repeat == 1 && sample.trajectory_index == 12;
  });
  samples.erase(victim, victim + 2);
  const auto runs = collect(collector, samples);
  EXPECT_EQ(collector.samples_lost(), 2u);
  EXPECT_THAT(collector.problem(), HasSubstr("samples are missing after row 12 of repeat 2"));
  ASSERT_EQ(runs.size(), 2u);
  EXPECT_EQ(runs[0].repeat, 0);
  EXPECT_EQ(runs[1].repeat, 2);
}

TEST(RunCollector, CountsAGapBetweenRunsAndKeepsThem) {
  RunCollector collector(kRows);
  auto samples = support::sample_stream({.rows = kRows, .repeats = 2});
  const auto victim = std::find_if(samples.begin(), samples.end(),
                                   [](const Sample& sample) { return sample.phase == CheckPhase::Return; });
  samples.erase(victim);
  EXPECT_EQ(collect(collector, samples).size(), 2u);
  EXPECT_EQ(collector.samples_lost(), 1u);
  EXPECT_THAT(collector.problem(), IsEmpty());
}

TEST(RunCollector, RefusesARunThatEndsEarly) {
  for (const bool idle : {false, true}) {
    RunCollector collector(kRows + 1);
    auto samples = support::sample_stream({.rows = kRows, .repeats = 1});
    if (idle)  // the check is aborted: whatever comes next belongs to no phase
      for (Sample& sample : samples)
        if (sample.phase == CheckPhase::Return) sample.phase = CheckPhase::None;
    EXPECT_TRUE(collect(collector, samples).empty());
    EXPECT_EQ(collector.problem(), "repeat 1 ended after 30 of 31 rows");
  }
}

TEST(RunCollector, RefusesARunWithoutItsBeginning) {
  RunCollector collector(kRows);
  auto samples = support::sample_stream({.rows = kRows, .repeats = 1});
  std::erase_if(samples, [](const Sample& sample) { return sample.trajectory_index == 0; });
  EXPECT_TRUE(collect(collector, samples).empty());
  EXPECT_EQ(collector.problem(), "repeat 1 began with row 1");
}

TEST(RunCollector, RefusesAClockThatStandsStill) {
  RunCollector collector(kRows);
  auto samples = support::sample_stream({.rows = kRows, .repeats = 1});
  for (std::size_t i = 1; i < samples.size(); ++i)
    if (samples[i].trajectory_index == 5) samples[i].brake_time_ns = samples[i - 1].brake_time_ns;
  EXPECT_TRUE(collect(collector, samples).empty());
  EXPECT_THAT(collector.problem(), HasSubstr("clock stands still in row 5 of repeat 1"));
}

}  // namespace
}  // namespace clampd
