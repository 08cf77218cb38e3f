#include "clampd/drive/data_check.hpp"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drive/recorded_drive.hpp"
#include "support/shared_data.hpp"

namespace clampd {
namespace {

using drive_test::record;
using drive_test::RecordedDrive;
using drive_test::sines;
using drive_test::steady;
using drive_test::trapezoids;
using DriveRun = Run;  // testing::Test has a Run of its own
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

DriveModel model_of(const DriveRun& run, bool linear = false) {
  DriveModel model;
  model.linear = linear;
  model.torque_unit = linear ? "N" : "N m";
  model.columns.time = {"time"};
  model.columns.torque = ColumnSource{"torque"};
  if (!run.position_rad.empty()) model.columns.position = ColumnSource{"position"};
  if (!run.velocity_rad_s.empty()) model.columns.velocity = ColumnSource{"speed"};
  for (std::size_t i = 0; i < kDriveTermCount; ++i)
    model.parts[i].use = i < 3 ? PartUse::Estimate : PartUse::Candidate;
  return model;
}

CheckedData checked(const DriveRun& run) {
  const DriveModel model = model_of(run);
  Result<CheckedData> data = check_data(std::span(&run, 1), model);
  EXPECT_TRUE(data) << data.error().message;
  return data.value_or(CheckedData{});
}

std::vector<std::string> names(const CheckedData& data) {
  std::vector<std::string> result;
  for (const DataFinding& finding : data.findings) result.push_back(finding.name);
  return result;
}

const DataFinding& finding(const CheckedData& data, const std::string& name) {
  for (const DataFinding& each : data.findings)
    if (each.name == name) return each;
  ADD_FAILURE() << "no " << name << " but " << ::testing::PrintToString(names(data));
  static const DataFinding none;
  return none;
}

/// Drives that differ in size, friction, sampling and motion, one a seed.
RecordedDrive any_drive(unsigned seed, bool with_velocity = false) {
  RecordedDrive drive;
  drive.with_velocity = with_velocity;
  drive.velocity_noise = 0.01;
  drive.reference_rate = seed % 3 == 0 ? sines(0.8) : trapezoids(seed);
  if (seed % 2 == 1) drive.inertia = 50.0, drive.length = 0.3;
  if (seed % 4 == 1) drive.coulomb = 5.0;
  if (seed % 6 == 2) drive.rate_Hz = 250.0, drive.duration_s = 20.0;
  if (seed % 6 == 3) drive.rate_Hz = 4000.0, drive.duration_s = 7.0;
  return drive;
}

void scale(std::vector<double>& values, double factor) {
  for (double& value : values) value *= factor;
}

std::vector<double> delayed(const DriveRun& run, const std::vector<double>& values, double delay_s) {
  std::vector<double> result;
  for (const double time_s : run.time_s) {
    const auto after = std::upper_bound(run.time_s.begin() + 1, run.time_s.end() - 1, time_s - delay_s);
    const auto k = static_cast<std::size_t>(after - run.time_s.begin());
    const double share =
        std::clamp((time_s - delay_s - run.time_s[k - 1]) / (run.time_s[k] - run.time_s[k - 1]), 0.0, 1.0);
    result.push_back(values[k - 1] + share * (values[k] - values[k - 1]));
  }
  return result;
}

double largest_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double largest = a.size() == b.size() ? 0.0 : std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i)
    largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

double quantile_of(std::vector<double> values, double share) {
  std::ranges::sort(values);
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

double range_of(const std::vector<double>& values) {
  const auto [least, most] = std::ranges::minmax(values);
  return most - least;
}

// Nothing is found where nothing is wrong, on drives that have hardly anything in common.
TEST(DataCheck, GoodDataHaveNoFindings) {
  std::vector<std::pair<std::string, RecordedDrive>> drives;
  const auto add = [&](const std::string& what, auto change) {
    for (const unsigned seed : {1u, 2u}) {
      RecordedDrive drive;
      drive.reference_rate = trapezoids(seed);
      change(drive);
      drives.emplace_back(what, drive);
    }
  };
  add("plain", [](RecordedDrive&) {});
  add("light", [](RecordedDrive& drive) { drive.inertia = 1e-6; });
  add("heavy", [](RecordedDrive& drive) { drive.inertia = 100.0, drive.length = 0.2; });
  add("friction", [](RecordedDrive& drive) { drive.coulomb = 10.0, drive.viscous = 5.0; });
  add("hardly any friction", [](RecordedDrive& drive) { drive.coulomb = 0.05, drive.viscous = 0.02; });
  add("10 kHz", [](RecordedDrive& drive) { drive.rate_Hz = 10'000.0, drive.duration_s = 6.0; });
  add("100 Hz",
      [](RecordedDrive& drive) { drive.rate_Hz = 100.0, drive.bandwidth = 12.0, drive.duration_s = 40.0; });
  add("50 Hz, slow", [](RecordedDrive& drive) {
    drive.rate_Hz = 50.0, drive.bandwidth = 6.0, drive.duration_s = 60.0, drive.reference_rate = sines(0.2);
  });
  add("late controller", [](RecordedDrive& drive) { drive.delay_rows = 3; });
  add("pendulum", [](RecordedDrive& drive) {
    drive.gravity = 3.0, drive.length = 2.0, drive.reference_rate = sines(0.5);
  });
  add("velocity", [](RecordedDrive& drive) { drive.with_velocity = true, drive.velocity_noise = 0.01; });
  add("coarse encoder", [](RecordedDrive& drive) { drive.encoder_step = 2e-3; });
  add("ideal encoder", [](RecordedDrive& drive) { drive.encoder_step = 0.0; });
  add("fast sines", [](RecordedDrive& drive) { drive.reference_rate = sines(4.0); });
  add("noisy torque", [](RecordedDrive& drive) { drive.torque_noise = 0.5; });
  add("sharp ramps", [](RecordedDrive& drive) { drive.reference_rate = trapezoids(3, 0.02); });
  for (const auto& [what, drive] : drives) {
    const CheckedData data = checked(record(drive, 7));
    EXPECT_THAT(names(data), IsEmpty()) << what << ": " << data.findings.front().words;
    EXPECT_TRUE(data.runs.empty()) << what << " was mended";
  }
}

TEST(DataCheck, VelocityInAnotherUnitIsConvertedAndSaid) {
  for (unsigned seed = 11; seed < 17; ++seed) {
    const DriveRun good = record(any_drive(seed, true), seed);
    DriveRun bad = good;
    scale(bad.velocity_rad_s, 60.0 / (2.0 * M_PI));
    const CheckedData data = checked(bad);
    EXPECT_NEAR(finding(data, "velocity-scale").size, 9.549, 0.02) << seed;
    EXPECT_THAT(finding(data, "velocity-scale").words, HasSubstr("rpm"));
    ASSERT_EQ(data.runs.size(), 1u);
    EXPECT_LT(largest_difference(data.runs[0].velocity_rad_s, good.velocity_rad_s),
              1e-9 * range_of(bad.velocity_rad_s));
    bad = good;
    scale(bad.velocity_rad_s, 1.0 / 125.0);
    const CheckedData gear = checked(bad);
    EXPECT_NEAR(finding(gear, "velocity-scale").size, 0.008, 1e-5) << seed;
    EXPECT_TRUE(gear.stops()) << "no unit explains 125";
  }
}

TEST(DataCheck, WhicheverOfPositionAndVelocityHasTheWrongSignIsNegated) {
  for (unsigned seed = 11; seed < 17; ++seed) {
    const DriveRun good = record(any_drive(seed, true), seed);
    for (const bool position : {false, true}) {
      DriveRun bad = good;
      scale(position ? bad.position_rad : bad.velocity_rad_s, -1.0);
      const CheckedData data = checked(bad);
      EXPECT_THAT(names(data), ElementsAre("velocity-sign")) << seed;
      EXPECT_EQ(finding(data, "velocity-sign").column, position ? "position" : "speed") << seed;
      ASSERT_EQ(data.runs.size(), 1u);
      EXPECT_EQ(data.runs[0].velocity_rad_s, good.velocity_rad_s) << seed;
      EXPECT_EQ(data.runs[0].position_rad, good.position_rad) << seed;
    }
  }
}

TEST(DataCheck, DelaysOfVelocityAndTorqueAreMeasured) {
  for (unsigned seed = 11; seed < 17; ++seed) {
    const DriveRun good = record(any_drive(seed, true), seed);
    DriveRun bad = good;
    bad.velocity_rad_s = delayed(good, good.velocity_rad_s, 0.02);
    EXPECT_NEAR(finding(checked(bad), "velocity-delay").size, 0.02, 0.001) << seed;
    for (const double delay_s : {0.015, -0.012}) {
      bad = good;
      bad.torque_Nm = delayed(good, good.torque_Nm, delay_s);
      EXPECT_NEAR(finding(checked(bad), "torque-delay").size, delay_s, 0.004) << seed;
    }
  }
}

TEST(DataCheck, TorqueOfTheWrongSignIsNegated) {
  for (unsigned seed = 11; seed < 17; ++seed)
    for (const bool by_velocity : {false, true}) {
      DriveRun bad = record(any_drive(seed, by_velocity), seed);
      if (by_velocity) bad.position_rad.clear();
      scale(bad.torque_Nm, -1.0);
      EXPECT_THAT(names(checked(bad)), ElementsAre("torque-sign")) << seed;
    }
}

TEST(DataCheck, OfReadingsThatAreRenewedSlowlyOnlyTheNewOnesAreUsed) {
  for (unsigned seed = 11; seed < 17; ++seed) {
    const DriveRun good = record(any_drive(seed), seed);
    for (const auto column : {&DriveRun::torque_Nm, &DriveRun::position_rad}) {
      DriveRun bad = good;
      for (std::size_t i = 0; i < bad.size(); ++i)
        if (i % 8 != 0) (bad.*column)[i] = (bad.*column)[i - 1];
      const CheckedData data = checked(bad);
      EXPECT_EQ(finding(data, "held-readings").size, 8.0) << seed;
      ASSERT_EQ(data.runs.size(), 1u);
      EXPECT_NEAR(static_cast<double>(data.runs[0].size()), static_cast<double>(good.size()) / 8.0,
                  0.05 * static_cast<double>(good.size()));
      std::size_t stale = 0;  // rows that do not read what was true at their time
      for (std::size_t i = 0; i < data.runs[0].size(); ++i) {
        const auto row = std::ranges::find(good.time_s, data.runs[0].time_s[i]) - good.time_s.begin();
        stale += (data.runs[0].*column)[i] != (good.*column)[static_cast<std::size_t>(row)] ? 1 : 0;
      }
      EXPECT_LT(stale, data.runs[0].size() / 20) << seed;
    }
  }
}

TEST(DataCheck, LostSamplesAreInterpolated) {
  for (unsigned seed = 11; seed < 17; ++seed) {
    const DriveRun good = record(any_drive(seed), seed);
    DriveRun bad = good;
    std::mt19937 random(seed);
    for (std::size_t i = 1; i < bad.size(); ++i)
      if (random() % 30 == 0) bad.torque_Nm[i] = bad.torque_Nm[i - 1];
    const CheckedData data = checked(bad);
    EXPECT_THAT(names(data), ElementsAre("held-readings")) << seed;
    EXPECT_NEAR(finding(data, "held-readings").size, static_cast<double>(good.size()) / 30.0,
                static_cast<double>(good.size()) / 100.0)
        << seed;
  }
}

TEST(DataCheck, SingleBadSamplesAreReplaced) {
  for (unsigned seed = 11; seed < 17; ++seed) {
    const DriveRun good = record(any_drive(seed), seed);
    DriveRun bad = good;
    bad.position_rad[good.size() / 3] = 0.0;
    bad.position_rad[good.size() / 2] = -1e6;  // decides every mean
    bad.position_rad[good.size() / 2 + 1] = -1e6;
    bad.position_rad[good.size() / 5] += 0.2 * range_of(good.position_rad);
    CheckedData data = checked(bad);
    EXPECT_THAT(names(data), ElementsAre("spikes")) << seed;
    ASSERT_EQ(data.runs.size(), 1u);
    EXPECT_LT(largest_difference(data.runs[0].position_rad, good.position_rad),
              0.01 * range_of(good.position_rad))
        << seed;
    bad = good;
    for (std::size_t k = 1; k < 10; ++k)
      bad.torque_Nm[k * good.size() / 10] = (k % 2 == 0 ? 3.0 : -3.0) * range_of(good.torque_Nm);
    data = checked(bad);
    EXPECT_THAT(names(data), ElementsAre("spikes")) << seed;
    EXPECT_GE(finding(data, "spikes").size, 6.0) << seed << ": of nine, those in pauses aside";
  }
}

TEST(DataCheck, CountersThatWrapAreUnwrappedAndJumpsTakenOut) {
  for (const unsigned seed : {12u, 14u, 16u, 18u}) {
    const DriveRun good = record(any_drive(seed), seed);
    for (const double modulus : {2.0 * M_PI, 4.096}) {
      DriveRun bad = good;
      for (double& x : bad.position_rad) x -= modulus * std::floor(x / modulus);
      const CheckedData data = checked(bad);
      EXPECT_THAT(names(data), ElementsAre("wrap")) << seed;
      EXPECT_NEAR(finding(data, "wrap").size, modulus, 0.01) << seed;
      ASSERT_EQ(data.runs.size(), 1u);
      EXPECT_NEAR(range_of(data.runs[0].position_rad), range_of(good.position_rad),
                  0.1 * range_of(good.position_rad))
          << seed;
    }
    DriveRun bad = good;
    const double jump = 0.3 * range_of(good.position_rad);
    for (std::size_t i = good.size() / 2; i < good.size(); ++i) bad.position_rad[i] += jump;
    const CheckedData data = checked(bad);
    EXPECT_THAT(names(data), ElementsAre("jump")) << seed;
    ASSERT_EQ(data.runs.size(), 1u);
    EXPECT_LT(largest_difference(data.runs[0].position_rad, good.position_rad), 0.02 * jump) << seed;
  }
}

TEST(DataCheck, AClippedTorqueContradictsTheMotionAndALimitedOneDoesNot) {
  for (const unsigned seed : {14u, 16u, 20u}) {
    DriveRun bad = record(any_drive(seed), seed);
    const double level = 0.3 * quantile_of(bad.torque_Nm, 0.999);
    for (double& torque : bad.torque_Nm) torque = std::clamp(torque, -level, level);
    const auto rows =
        std::ranges::count_if(bad.torque_Nm, [level](double torque) { return std::abs(torque) == level; });
    const CheckedData data = checked(bad);
    EXPECT_TRUE(data.stops()) << seed;
    EXPECT_EQ(finding(data, "clipped").size, static_cast<double>(rows)) << seed;
    DriveModel command = model_of(bad);
    command.torque_held = true;
    const Result<CheckedData> commanded = check_data(std::span(&bad, 1), command);
    EXPECT_EQ(finding(*commanded, "clipped").severity, DataSeverity::Note) << "a limit may be true, " << seed;
  }
  RecordedDrive limited = any_drive(12);
  limited.reference_rate = sines(1.0);
  limited.torque_limit = 5.0;
  limited.torque_noise = 0.0;
  const CheckedData data = checked(record(limited, 12));
  EXPECT_EQ(finding(data, "clipped").severity, DataSeverity::Note);
  EXPECT_NEAR(range_of(record(limited, 12).torque_Nm),
              2.0 * limited.torque_limit * limited.inertia * limited.length, 1e-9);
}

TEST(DataCheck, TimeStampsThatScatterAreToldFromSamplingThatDoes) {
  const RecordedDrive drive = any_drive(12, false);
  DriveRun stamps = record(drive, 12);
  const std::vector<double> true_times = stamps.time_s;
  std::mt19937 random(3);
  std::uniform_real_distribution<double> scatter(-3e-4, 3e-4);
  for (double& time_s : stamps.time_s) time_s += scatter(random);
  const CheckedData data = checked(stamps);
  EXPECT_EQ(finding(data, "time-jitter").severity, DataSeverity::Mended);
  ASSERT_EQ(data.runs.size(), 1u);
  EXPECT_LT(largest_difference(data.runs[0].time_s, true_times), 1.5e-4) << "half of the scatter";
  RecordedDrive irregular = drive;
  irregular.interval_jitter = 0.3;
  const CheckedData sampled = checked(record(irregular, 12));
  EXPECT_EQ(finding(sampled, "time-jitter").severity, DataSeverity::Note);
  EXPECT_TRUE(sampled.runs.empty());
}

TEST(DataCheck, GapsAreNoJumps) {
  DriveRun run = record(any_drive(12), 12);
  for (std::vector<double>* column : {&run.time_s, &run.torque_Nm, &run.position_rad})
    column->erase(column->begin() + 5000, column->begin() + 5600);
  EXPECT_THAT(names(checked(run)), ElementsAre("time-gap"));
}

TEST(DataCheck, TooFewRowsForTheMotionStopWhereTheInertiaIsAsked) {
  const DriveRun fast = record(any_drive(16), 16);
  DriveRun run;
  for (std::size_t i = 0; i < fast.size(); i += 100) {
    run.time_s.push_back(fast.time_s[i]);
    run.torque_Nm.push_back(fast.torque_Nm[i]);
    run.position_rad.push_back(fast.position_rad[i]);
  }
  EXPECT_TRUE(checked(run).stops());
  EXPECT_EQ(checked(run).findings.front().name, "sampling-too-slow");
  DriveModel model = model_of(run);
  model.parts[0].use = PartUse::Off;
  const Result<CheckedData> without = check_data(std::span(&run, 1), model);
  EXPECT_EQ(finding(*without, "sampling-too-slow").severity, DataSeverity::Note);
}

TEST(DataCheck, AnEncoderTooCoarseForTheMotionIsSaid) {
  RecordedDrive drive = any_drive(12);
  drive.encoder_step = 0.05;
  drive.bandwidth = 20.0;
  EXPECT_NEAR(finding(checked(record(drive, 12)), "resolution").size, 0.05 * drive.length, 1e-9);
}

TEST(DataCheck, StandstillSurvivesASingleBadSample) {
  RecordedDrive drive = any_drive(12);
  drive.reference_rate = [](double) { return 0.0; };
  DriveRun run = record(drive, 12);
  run.position_rad[1000] = 50.0;
  const CheckedData data = checked(run);
  ASSERT_TRUE(data.stops());
  EXPECT_EQ(data.findings.front().name, "standstill");
}

TEST(DataCheck, WhatTheMotionCannotShowIsSaid) {
  RecordedDrive drive = any_drive(12);
  drive.reference_rate = steady(0.5);
  EXPECT_THAT(names(checked(record(drive, 12))),
              ElementsAre("one-direction", "one-speed", "no-acceleration"));
  drive.reference_rate = trapezoids(5, 0.15, 0.2);
  EXPECT_THAT(names(checked(record(drive, 12))), ElementsAre("one-direction"));
}

TEST(DataCheck, RunsOfWhichNoneReversesAreSaid) {
  RecordedDrive drive = any_drive(12);
  drive.reference_rate = trapezoids(5, 0.15, 0.2);
  std::vector<DriveRun> runs{record(drive, 12)};
  const auto forward = drive.reference_rate;
  drive.reference_rate = [forward](double t) { return -forward(t); };
  runs.push_back(record(drive, 13));
  const DriveModel model = model_of(runs.front());
  const Result<CheckedData> apart = check_data(runs, model);
  EXPECT_THAT(names(*apart), ElementsAre("one-direction"));
  drive.reference_rate = trapezoids(6);
  runs.push_back(record(drive, 14));
  EXPECT_THAT(names(*check_data(runs, model)), IsEmpty()) << "one that reverses";
}

TEST(DataCheck, AMotionOfAFewRowsAPeriodIsNoNoise) {
  const auto sampled = [](double rows_a_period) {
    DriveRun run;
    for (int i = 0; i < 500; ++i) {
      const double phase = 2.0 * M_PI * i / rows_a_period;
      run.time_s.push_back(0.1 * i);
      run.position_rad.push_back(std::sin(phase) + 0.2 * std::sin(0.31 * phase));
      run.torque_Nm.push_back(0.3 * std::copysign(1.0, std::cos(phase)) - std::sin(phase));
    }
    return run;
  };
  EXPECT_EQ(finding(checked(sampled(9.3)), "sampling-too-slow").severity, DataSeverity::Stop);
  EXPECT_THAT(names(checked(sampled(60.3))), Not(Contains("sampling-too-slow")));
}

TEST(DataCheck, ColumnsInAnotherUnitByName) {
  const DriveRun good = record(any_drive(12), 12);
  DriveRun bad = good;
  scale(bad.position_rad, 180.0 / M_PI);
  DriveModel model = model_of(bad);
  model.columns.position->column = "angle [deg]";
  Result<CheckedData> data = check_data(std::span(&bad, 1), model);
  EXPECT_EQ(finding(*data, "unit").severity, DataSeverity::Mended);
  ASSERT_EQ(data->runs.size(), 1u);
  EXPECT_LT(largest_difference(data->runs[0].position_rad, good.position_rad), 1e-9);
  for (double& x : bad.position_rad) x = std::round(100.0 * x);
  model.columns.position->column = "position";
  data = check_data(std::span(&bad, 1), model);
  EXPECT_TRUE(data->stops());
  EXPECT_THAT(data->findings.front().words, HasSubstr("counts the steps of an encoder"));
}

TEST(DataCheck, SwappedColumnsAndReadingsThatAreNoneStop) {
  DriveRun run = record(any_drive(12, true), 12);
  std::swap(run.torque_Nm, run.velocity_rad_s);
  EXPECT_THAT(stop_message(checked(run)), HasSubstr("the columns of torque and velocity are swapped"));
  run = record(any_drive(12), 12);
  std::ranges::fill(run.torque_Nm, 0.0);
  EXPECT_THAT(stop_message(checked(run)), HasSubstr("reads 0 in every row"));
  run.torque_Nm[17] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(stop_message(checked(run)), HasSubstr("the first in row 18"));
}

TEST(DataCheck, OneFindingAKindAndColumn) {
  std::vector<DriveRun> runs;
  for (unsigned r = 0; r < 4; ++r) {
    runs.push_back(record(any_drive(12, true), r, "run " + std::to_string(r + 1)));
    if (r != 2) scale(runs.back().velocity_rad_s, -1.0);
  }
  const Result<CheckedData> data = check_data(runs, model_of(runs[0]));
  EXPECT_THAT(names(*data), ElementsAre("velocity-sign"));
  EXPECT_THAT(data->findings[0].words, HasSubstr("in 3 of 4 runs"));
  EXPECT_EQ(data->runs.size(), 4u);
}

TEST(DataCheck, WrongShapesAreErrors) {
  EXPECT_FALSE(check_data({}, DriveModel{}));
  DriveRun run = record(any_drive(12), 12, "axis.csv");
  run.torque_Nm.pop_back();
  const Result<CheckedData> data = check_data(std::span(&run, 1), model_of(run));
  ASSERT_FALSE(data);
  EXPECT_THAT(data.error().message, HasSubstr("axis.csv: its columns differ in length"));
  for (const std::size_t rows : {1u, 2u, 3u, 19u, 25u, 60u, 120u}) {  // however short: an answer
    DriveRun few = record(any_drive(12, true), 12);
    for (std::vector<double>* column : {&few.time_s, &few.torque_Nm, &few.position_rad, &few.velocity_rad_s})
      column->resize(rows);
    EXPECT_TRUE(check_data(std::span(&few, 1), model_of(few))) << rows;
  }
}

/// Data that others measured: what is said of them is true, and nothing else is.
class MeasuredData : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = support::shared_data("data");
    if (!std::filesystem::exists(folder_))
      GTEST_SKIP() << "no measured data at " << folder_ << "; set CLAMPD_SHARED";
  }

  std::vector<std::string> found(const std::string& folder, const std::string& part,
                                 const DriveModel& model) const {
    std::vector<DriveRun> runs;
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / folder)) {
      if (entry.path().filename().string().find(part) == std::string::npos) continue;
      Result<LoadedRun> loaded = read_run(entry.path().string(), model.columns);
      EXPECT_TRUE(loaded) << loaded.error().message;
      runs.push_back(std::move(loaded->run));
    }
    const Result<CheckedData> data = check_data(runs, model);
    EXPECT_TRUE(data) << data.error().message;
    return names(*data);
  }

  static DriveModel configured(const std::string& name) {
    return *read_drive_model(std::string(CLAMPD_SOURCE_DIR "/configs/drives/") + name);
  }

  std::filesystem::path folder_;
};

TEST_F(MeasuredData, HaveNoFalseFindings) {
  EXPECT_THAT(found("emps", "emps.csv", configured("emps.toml")), IsEmpty());
  for (const char* drive : {"driveNo1__steady_state", "driveNo2__steady_state"})
    EXPECT_THAT(found("screw_drives", drive, configured("screw_steady.toml")), IsEmpty());
  // 25 rows a second, and whole accelerations within three of them.
  for (const char* drive : {"driveNo1__start", "driveNo2__start"})
    EXPECT_THAT(found("screw_drives", drive, configured("screw_start_stop.toml")),
                ElementsAre("sampling-too-slow"));
  // Irregular stamps; with its cogging compensated the motor turns forward only.
  EXPECT_THAT(found("cogging", "__nocomp", configured("cogging_motor.toml")), ElementsAre("time-jitter"));
  EXPECT_THAT(found("cogging", "__comp", configured("cogging_motor.toml")),
              ElementsAre("time-jitter", "one-direction"));
  DriveModel axis = configured("emps.toml");
  axis.linear = axis.torque_held = false;
  axis.torque_unit = "N m";
  axis.columns.torque = {"torque_Nm"};
  axis.columns.velocity = ColumnSource{"velocity_rad_s"};
  axis.columns.position = ColumnSource{"position_rad"};
  for (const char* file : {"axis1", "axis4", "axis5", "axis6"})
    EXPECT_THAT(found("robot_axes", file, axis), IsEmpty()) << file;
}

}  // namespace
}  // namespace clampd
