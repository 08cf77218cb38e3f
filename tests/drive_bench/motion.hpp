#pragma once

#include <string_view>
#include <vector>

#include "tests/drive_bench/random.hpp"

namespace clampd::drive_bench {

enum class MotionKind {
  Sinusoid,
  Multisine,
  Trapezoids,    ///< moves between points with dwell
  Steps,         ///< of the position reference
  SlowSweep,     ///< there and back again, faster and faster
  SteadySpeeds,  ///< of both directions
  RandomMotion,  ///< band-limited noise
  OneDirection,  ///< a speed that varies and never changes its sign
  Coasting,      ///< torque pulses, then no torque
};
std::string_view words(MotionKind kind);

/// What the controller is to do.
enum class ControlMode { Position, Speed, Torque };

/// References at the control ticks. In Torque mode `feed_forward` holds the torque as a share of the drive's
/// scale, else the acceleration.
struct Motion {
  MotionKind kind = MotionKind::Sinusoid;
  ControlMode mode = ControlMode::Position;
  std::vector<double> position, velocity, feed_forward;
};

struct MotionRequest {
  MotionKind kind = MotionKind::Sinusoid;
  double speed = 1.0;         ///< largest, about
  double frequency_Hz = 1.0;  ///< the pace: a period, or a move there and back
  double tick_s = 1e-3;
  double duration_s = 10.0;
  double standing = 0.0;  ///< this share of the time at rest, at the end
};

Motion draw_motion(const MotionRequest& request, Random& random);

/// Amplitude of the position at this speed and pace.
double amplitude(const MotionRequest& request);

}  // namespace clampd::drive_bench
