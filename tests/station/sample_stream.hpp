#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "clampd/record/sample.hpp"

namespace clampd::support {

inline constexpr double kStreamTrackingError_N = 40.0;

inline double stream_force_N(int row) {
  return 500.0 * row;
}
inline double stream_velocity_rad_s(int row) {
  return 3.0 * row;
}
inline double stream_torque_Nm(int row) {
  return std::sin(0.3 * row);
}

struct StreamShape {
  std::int32_t rows = 30;
  std::uint16_t repeats = 3;
  int tare = 50;  ///< samples at rest
  double force_offset_N = 0.0;
  double velocity_offset_rad_s = 0.0;
};

/// The samples of a whole check as the loop logs them, noiseless: idle, tare, approach, repeats, release,
/// idle. The brake's clock ticks every 1.001 ms; host times jitter.
inline std::vector<Sample> sample_stream(const StreamShape& shape) {
  std::vector<Sample> samples;
  const auto add = [&](CheckPhase phase, std::uint16_t repeat, std::int32_t row) {
    Sample sample;
    const auto n = static_cast<std::int64_t>(samples.size());
    sample.sample_index = 70'000 + n;
    sample.brake_time_ns = 123'456'789 + n * 1'001'000;
    sample.host_time_ns = n * 1'000'000 + (n * 7919) % 300'000;
    sample.phase = phase;
    sample.state = phase == CheckPhase::None ? StationState::Idle : StationState::Running;
    sample.repeat = repeat;
    sample.trajectory_index = row;
    sample.force_N = shape.force_offset_N;
    sample.velocity_rad_s = shape.velocity_offset_rad_s;
    sample.position_rad = 9.0;
    if (row >= 0) {
      sample.force_N += stream_force_N(row);
      sample.velocity_rad_s += stream_velocity_rad_s(row);
      sample.torque_Nm = stream_torque_Nm(row);
      sample.force_reference_N = stream_force_N(row) + (row % 2 == 0 ? 1 : -1) * kStreamTrackingError_N;
    }
    samples.push_back(sample);
  };
  const auto add_many = [&](CheckPhase phase, std::uint16_t repeat, int count) {
    for (int i = 0; i < count; ++i) add(phase, repeat, -1);
  };
  add_many(CheckPhase::None, 0, 5);
  add_many(CheckPhase::Tare, 0, shape.tare);
  add_many(CheckPhase::Approach, 0, 20);
  for (std::uint16_t repeat = 0; repeat < shape.repeats; ++repeat) {
    add_many(CheckPhase::Settle, repeat, 10);
    for (std::int32_t row = 0; row < shape.rows; ++row) add(CheckPhase::Trajectory, repeat, row);
    add_many(CheckPhase::Return, repeat, 10);
  }
  add_many(CheckPhase::Release, shape.repeats, 20);
  add_many(CheckPhase::Done, shape.repeats, 3);
  add_many(CheckPhase::None, 0, 5);
  return samples;
}

}  // namespace clampd::support
