#include "clampd/station/run_collector.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"

namespace clampd {
namespace {

bool belongs_to_check(const Sample& sample) {
  return sample.phase != CheckPhase::None && sample.phase != CheckPhase::Done;
}

double seconds(std::int64_t ns) {
  return static_cast<double>(ns) / static_cast<double>(kNanosecondsPerSecond);
}

}  // namespace

RunCollector::RunCollector(std::size_t rows) : rows_(rows) {
  CLAMPD_ASSERT(rows > 0);
}

double RunCollector::duration_s() const {
  return last_ ? seconds(last_->brake_time_ns - first_time_ns_) : 0.0;
}

void RunCollector::discard(std::string why) {
  if (problem_.empty()) problem_ = std::move(why);
  open_.reset();
}

void RunCollector::consume_tare(const Sample& sample) {
  // Welford: the offsets of a drifting encoder or load cell may be large against their noise.
  ++tare_.samples;
  const double n = static_cast<double>(tare_.samples);
  const auto add = [n](double value, double& mean, double& squares, double& sd) {
    const double before = value - mean;
    mean += before / n;
    squares += before * (value - mean);
    sd = n > 1.0 ? std::sqrt(squares / (n - 1.0)) : 0.0;
  };
  add(sample.force_N, tare_.force_offset_N, force_squares_, tare_.force_sd_N);
  add(sample.velocity_rad_s, tare_.velocity_offset_rad_s, velocity_squares_, tare_.velocity_sd_rad_s);
}

std::optional<CollectedRun> RunCollector::consume(const Sample& sample) {
  if (!belongs_to_check(sample)) {
    if (open_)
      discard(fmt::format("{} ended after {} of {} rows", open_->run.name, open_->run.size(), rows_));
    return std::nullopt;
  }
  if (samples_++ == 0) {
    first_time_ns_ = sample.brake_time_ns;
    if (std::isfinite(sample.position_rad)) found_rad_ = sample.position_rad;
  }
  const bool consecutive = !last_ || sample.sample_index == last_->sample_index + 1;
  if (!consecutive && sample.sample_index > last_->sample_index)
    samples_lost_ += static_cast<std::uint64_t>(sample.sample_index - last_->sample_index - 1);
  const std::int64_t previous_time_ns = last_ ? last_->brake_time_ns : sample.brake_time_ns - 1;
  last_ = sample;

  if (sample.phase == CheckPhase::Tare) consume_tare(sample);
  const bool continues = open_ && sample.phase == CheckPhase::Trajectory && sample.repeat == open_->repeat;
  if (open_ && !continues)
    discard(fmt::format("{} ended after {} of {} rows", open_->run.name, open_->run.size(), rows_));
  if (sample.phase != CheckPhase::Trajectory) return std::nullopt;

  const std::string name = fmt::format("repeat {}", sample.repeat + 1);
  if (!open_) {
    if (sample.trajectory_index != 0) {
      discard(fmt::format("{} began with row {}", name, sample.trajectory_index));
      return std::nullopt;
    }
    open_.emplace();
    open_->repeat = sample.repeat;
    open_->trajectory = sample.trajectory;
    open_->run.name = name;
    open_start_ns_ = sample.brake_time_ns;
    tracking_squares_ = 0.0;
  } else if (!consecutive || sample.trajectory_index != static_cast<std::int32_t>(open_->run.size())) {
    discard(fmt::format("samples are missing after row {} of {}", open_->run.size(), name));
    return std::nullopt;
  } else if (sample.brake_time_ns <= previous_time_ns) {
    discard(fmt::format("the brake's clock stands still in row {} of {}", open_->run.size(), name));
    return std::nullopt;
  }

  Run& run = open_->run;
  const double force_N = sample.force_N - tare_.force_offset_N;
  run.time_s.push_back(seconds(sample.brake_time_ns - open_start_ns_));
  run.torque_Nm.push_back(sample.torque_Nm);
  run.velocity_rad_s.push_back(sample.velocity_rad_s - tare_.velocity_offset_rad_s);
  run.force_N.push_back(force_N);
  run.position_rad.push_back(sample.position_rad);
  const double error_N = force_N - sample.force_reference_N;
  tracking_squares_ += error_N * error_N;
  open_->tracking_max_N = std::max(open_->tracking_max_N, std::abs(error_N));
  if (run.size() < rows_) return std::nullopt;

  open_->tracking_rms_N = std::sqrt(tracking_squares_ / static_cast<double>(rows_));
  return std::exchange(open_, std::nullopt);
}

}  // namespace clampd
