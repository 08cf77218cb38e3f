#pragma once

#include <algorithm>
#include <cmath>
#include <deque>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "clampd/record/run.hpp"

namespace clampd::drive_test {

/// A drive under position control and its logger. Motion and friction are simulated in units of its own
/// (inertia 1, speeds of about 1, seconds) with fine semi-implicit steps and friction as a projection;
/// `length` and `inertia` then scale what is recorded.
struct RecordedDrive {
  double inertia = 1e-3, length = 20.0;  ///< kg m^2 or kg; rad or m per unit
  double viscous = 1.0, coulomb = 1.0;  ///< of the unit inertia, so that friction and inertia are of one size
  double gravity = 0.0;                 ///< times the sine of the recorded angle
  std::function<double(double)> reference_rate;  ///< speed asked for, of time
  double duration_s = 12.0, rate_Hz = 1000.0;
  double encoder_step = 1e-4;  ///< in units of length
  double torque_noise = 0.02;  ///< in units of the unit inertia's torque
  double velocity_noise = 0.0;
  int delay_rows = 0;            ///< of the controller
  double interval_jitter = 0.0;  ///< of the sampling itself, share of the period
  double torque_limit = 1e9;     ///< of the drive, in units of the unit inertia's torque
  bool with_velocity = false;
  double bandwidth = 60.0;  ///< rad/s of the position control
};

/// Trapezoids of random speed both ways with pauses.
inline std::function<double(double)> trapezoids(unsigned seed, double ramp_s = 0.15, double least = -1.0) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> uniform(least, 1.0);
  std::vector<double> goals;
  for (int i = 0; i < 400; ++i) goals.push_back(i % 7 == 6 ? 0.0 : uniform(random));
  return [goals, ramp_s](double t) {
    constexpr double kHold_s = 0.6;
    const auto i = std::min(goals.size() - 1, static_cast<std::size_t>(t / kHold_s));
    const double before = i == 0 ? 0.0 : goals[i - 1];
    const double share = std::min(1.0, (t - static_cast<double>(i) * kHold_s) / ramp_s);
    return before + (goals[i] - before) * share;
  };
}

inline std::function<double(double)> sines(double frequency_Hz) {
  return [frequency_Hz](double t) {
    const double w = 2.0 * M_PI * frequency_Hz;
    return 0.5 * std::sin(w * t) + 0.3 * std::sin(0.37 * w * t + 1.0) + 0.2 * std::sin(1.7 * w * t + 2.0);
  };
}

inline std::function<double(double)> steady(double speed) {
  return [speed](double t) { return speed * std::min(1.0, t / 0.3); };
}

inline Run record(const RecordedDrive& drive, unsigned seed, const std::string& name = "run 1") {
  constexpr int kSteps = 20;
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const double period_s = 1.0 / drive.rate_Hz;
  const double wc = std::min(drive.bandwidth, 0.15 * drive.rate_Hz);
  Run run;
  run.name = name;
  double x = 0.0, v = 0.0, reference = 0.0, filtered = 0.0, before = 0.0, integral = 0.0, t = 0.0;
  std::deque<double> commands(static_cast<std::size_t>(drive.delay_rows) + 1, 0.0);
  const auto round_to = [&](double value) {
    return drive.encoder_step > 0.0 ? drive.encoder_step * std::round(value / drive.encoder_step) : value;
  };
  while (t < drive.duration_s) {
    const double rate = drive.reference_rate(t);
    const double measured = round_to(x);
    filtered += std::min(1.0, 8.0 * wc * period_s) * ((measured - before) / period_s - filtered);
    before = measured;
    integral += (reference - measured) * period_s;
    commands.push_back(std::clamp(
        wc * wc * (reference - measured) + 1.6 * wc * (rate - filtered) + 0.3 * wc * wc * wc * integral,
        -drive.torque_limit, drive.torque_limit));
    commands.pop_front();
    run.time_s.push_back(t);
    run.torque_Nm.push_back(drive.inertia * drive.length *
                            (commands.front() + drive.torque_noise * normal(random)));
    run.position_rad.push_back(drive.length * measured);
    if (drive.with_velocity)
      run.velocity_rad_s.push_back(drive.length * (v + drive.velocity_noise * normal(random)));
    const double until_s = t + period_s * (1.0 + drive.interval_jitter * uniform(random));
    const double step_s = (until_s - t) / kSteps;
    for (int k = 0; k < kSteps; ++k) {
      reference += drive.reference_rate(t + k * step_s) * step_s;
      const double torque = commands.front() - drive.viscous * v - drive.gravity * std::sin(drive.length * x);
      double moved = v + step_s * torque;
      const double brake = step_s * drive.coulomb;
      v = std::abs(moved) <= brake ? 0.0 : moved - std::copysign(brake, moved);
      x += step_s * v;
    }
    t = until_s;
  }
  return run;
}

}  // namespace clampd::drive_test
