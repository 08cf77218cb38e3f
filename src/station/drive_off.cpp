#include "clampd/station/drive_off.hpp"

#include <algorithm>

#include "clampd/base/clock.hpp"

namespace clampd {

namespace {

/// Of a command to the drive, and of its current.
constexpr std::size_t kDiesAwayWithin_samples = 50;

}  // namespace

void DriveOffReadings::consume(const Sample& sample) {
  const bool is_off = sample.state == StationState::Init || sample.state == StationState::Idle;
  const bool follows = last_index_ && sample.sample_index == *last_index_ + 1;
  last_index_ = sample.sample_index;
  if (!is_off || !follows) {
    waited_ = 0;
    samples_.clear();
    return;
  }
  if (waited_ < kDiesAwayWithin_samples) {
    ++waited_;
    return;
  }
  samples_.push_back(sample);
  if (samples_.size() > most_rows_) samples_.pop_front();
}

Run DriveOffReadings::run() const {
  Run run;
  run.name = "drive off";
  for (const Sample& sample : samples_) {
    run.time_s.push_back(static_cast<double>(sample.brake_time_ns - samples_.front().brake_time_ns) /
                         static_cast<double>(kNanosecondsPerSecond));
    run.torque_Nm.push_back(sample.torque_Nm);
    run.velocity_rad_s.push_back(sample.velocity_rad_s);
    run.force_N.push_back(sample.force_N);
    run.position_rad.push_back(sample.position_rad);
    run.drive_enabled.push_back(0.0);
  }
  return run;
}

}  // namespace clampd
