#include "drivers/can/candump.hpp"

#include <cstdio>
#include <sstream>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "drivers/can/protocol.hpp"
#include "support/check_records.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

struct LoggedFrame {
  double stamp_s = 0.0;
  std::string interface;
  can::Frame frame;
};

/// One line as `man candump` describes the log format: (seconds.microseconds) interface id#data
LoggedFrame parse_line(const std::string& line) {
  LoggedFrame logged;
  char interface[32] = "", id[16] = "", data[32] = "";
  if (std::sscanf(line.c_str(), "(%lf) %31s %15[0-9A-F]#%31[0-9A-F]", &logged.stamp_s, interface, id, data) !=
      4)
    ADD_FAILURE() << line;
  logged.interface = interface;
  const std::string digits = id, bytes = data;
  EXPECT_TRUE(digits.size() == 3 || digits.size() == 8) << line;
  logged.frame.id = static_cast<std::uint32_t>(std::stoul(digits, nullptr, 16));
  if (digits.size() == 8) logged.frame.id |= can::kExtendedId;
  logged.frame.size = static_cast<std::uint8_t>(bytes.size() / 2);
  for (std::size_t i = 0; i < logged.frame.size; ++i)
    logged.frame.data[i] = static_cast<std::uint8_t>(std::stoul(bytes.substr(2 * i, 2), nullptr, 16));
  return logged;
}

class CandumpCycles : public ::testing::TestWithParam<int> {};

TEST_P(CandumpCycles, TheStationWouldRecordTheSameRunsFromIt) {
  const CheckRecord record = bench::check(bench::plant(1), 2);
  can::ProtocolCodec codec = bench::prepared().codec;
  codec.samples_per_period = codec.commands_per_period = GetParam();
  const auto log = format_candump(record, codec, "can3");
  ASSERT_TRUE(log) << log.error().message;

  can::StationProtocol station(codec);
  can::BrakeProtocol brake(codec);
  std::vector<BrakeFeedback> samples;
  std::vector<double> commands_Nm;
  std::istringstream lines(*log);
  double last_s = 0.0;
  for (std::string line; std::getline(lines, line);) {
    const LoggedFrame logged = parse_line(line);
    EXPECT_EQ(logged.interface, "can3");
    EXPECT_GE(logged.stamp_s, last_s);
    last_s = logged.stamp_s;
    const auto now_ns = static_cast<std::int64_t>(logged.stamp_s * 1e9);
    if (const auto command = brake.accept(logged.frame, now_ns)) commands_Nm.push_back(command->torque_Nm);
    if (const auto sample = station.accept(logged.frame, now_ns)) samples.push_back(*sample);
  }
  EXPECT_EQ(station.counts().crc_errors + station.counts().counter_errors + station.counts().implausible, 0u);
  ASSERT_EQ(record.runs.size(), 2u);
  const std::size_t rows = record.runs[0].run.size();
  ASSERT_EQ(samples.size(), rows + record.runs[1].run.size());
  const auto repeats = static_cast<std::size_t>(GetParam());
  ASSERT_EQ(commands_Nm.size(), repeats * samples.size());
  for (std::size_t k = 0; k < samples.size(); ++k) {
    const clampd::Run& run = record.runs[k < rows ? 0 : 1].run;
    const std::size_t row = k < rows ? k : k - rows;
    EXPECT_NEAR(samples[k].force_N, run.force_N[row], 1.0);
    EXPECT_NEAR(samples[k].velocity_rad_s, run.velocity_rad_s[row], 0.02);
    EXPECT_NEAR(samples[k].torque_Nm, run.torque_Nm[row], 1e-3);
    EXPECT_NEAR(commands_Nm[repeats * k + repeats - 1], run.torque_Nm[row], 1e-3);
    if (row > 0) {
      EXPECT_NEAR(static_cast<double>(samples[k].brake_time_ns - samples[k - 1].brake_time_ns) * 1e-9,
                  run.time_s[row] - run.time_s[row - 1], 2e-6);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(PerPeriod, CandumpCycles, ::testing::ValuesIn(can::kFramesPerPeriod));

TEST(Candump, NeedsRawRuns) {
  const can::ProtocolCodec codec = bench::prepared().codec;
  CheckRecord record = support::make_check_record();
  record.runs[1].removed = "2026-11-21T00:00:00.000Z";
  EXPECT_THAT(format_candump(record, codec, "can0").error().message, HasSubstr("removed on 2026-11-21"));
  record.runs.clear();
  EXPECT_THAT(format_candump(record, codec, "can0").error().message, HasSubstr("no runs"));
}

}  // namespace
}  // namespace clampd
