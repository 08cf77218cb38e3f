#include "drivers/can/candump.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/record/utc.hpp"
#include "drivers/can/log.hpp"
#include "drivers/can/protocol.hpp"

namespace clampd {
namespace {

/// Between two repeats. Counters go on in it as they would on the bus, so that they agree with the sample
/// clock.
constexpr int kPause_periods = 97;

void append(std::string& log, std::int64_t stamp_ns, std::string_view interface, const can::Frame& frame) {
  const std::int64_t stamp_us = (stamp_ns + 500) / 1000;
  fmt::format_to(std::back_inserter(log), "({:010}.{:06}) {} ", stamp_us / 1'000'000, stamp_us % 1'000'000,
                 interface);
  log += can::id_text(frame.id) + '#';
  if (frame.format != can::FrameFormat::Classic)
    fmt::format_to(std::back_inserter(log), "#{}", frame.format == can::FrameFormat::FdFastData ? 1 : 0);
  for (std::size_t i = 0; i < frame.size; ++i)
    fmt::format_to(std::back_inserter(log), "{:02X}", frame.data[i]);
  log += '\n';
}

}  // namespace

Result<std::string> format_candump(const CheckRecord& record, const can::ProtocolCodec& codec,
                                   std::string_view interface) {
  if (record.runs.empty()) return failure(fmt::format("check {} has no runs to export", record.id));
  can::StationProtocol station(codec);
  can::BrakeProtocol brake(codec);
  std::array<can::Frame, can::kMaxFeedbackFrames> frames{};
  std::vector<std::pair<std::int64_t, can::Frame>> sent;
  const std::int64_t pause_ns = kPause_periods * codec.period_ns;
  std::int64_t offset_ns = pause_ns;
  const std::int64_t started_ns = parse_utc(record.started).value_or(0);
  for (const RunRecord& recorded : record.runs) {
    if (!recorded.removed.empty())
      return failure(fmt::format("check {}: its raw runs were removed on {}, as [retention] says", record.id,
                                 recorded.removed));
    const Run& run = recorded.run;
    for (std::size_t k = 0; k < run.size(); ++k) {
      BrakeFeedback reading;
      reading.brake_time_ns = offset_ns + std::llround((run.time_s[k] - run.time_s[0]) * 1e9);
      reading.torque_Nm = run.torque_Nm[k];
      reading.velocity_rad_s = run.velocity_rad_s[k];
      reading.force_N = run.force_N[k];
      if (!run.position_rad.empty()) reading.position_rad = run.position_rad[k];
      reading.drive_enabled = true;
      const std::int64_t stamp_ns = started_ns + reading.brake_time_ns;
      for (int i = 0; i < codec.commands_per_period; ++i)
        sent.emplace_back(stamp_ns - codec.period_ns / 2 + i * codec.command_cycle_ns(),
                          station.command({run.torque_Nm[k], true, run.velocity_rad_s[k], codec.commanded}));
      for (int i = 0; i < codec.samples_per_period; ++i) {
        const std::size_t count = brake.feedback(reading, frames);
        for (std::size_t frame = 0; frame < count; ++frame)
          sent.emplace_back(stamp_ns + i * codec.feedback_cycle_ns(), frames[frame]);
        reading.brake_time_ns += codec.feedback_cycle_ns();
      }
    }
    for (int k = codec.commands_per_period; k < kPause_periods * codec.commands_per_period; ++k)
      (void)station.command({});
    for (int k = codec.samples_per_period; k < kPause_periods * codec.samples_per_period; ++k)
      brake.feedback({}, frames);
    if (run.size() > 0) offset_ns += std::llround((run.time_s.back() - run.time_s[0]) * 1e9) + pause_ns;
  }
  std::stable_sort(sent.begin(), sent.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::string log;
  for (const auto& [stamp_ns, frame] : sent) append(log, stamp_ns, interface, frame);
  return log;
}

}  // namespace clampd
