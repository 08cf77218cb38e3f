#pragma once

#include <cmath>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "clampd/record/run.hpp"

namespace clampd::drive_test {

/// A rotary drive under position control with something hidden in it. Semi-implicit steps of 50 us with
/// friction as a projection: nothing in common with the smoothing and filtering of the diagnosis.
struct Truth {
  double inertia = 1e-3, viscous = 5e-3, coulomb = 0.15;
  /// Torque that opposes the motion, beside the viscous one: of position, velocity, bristle deflection, run
  /// number.
  std::function<double(double position, double velocity, int run)> extra = [](double, double, int) {
    return 0.0;
  };
  /// Dry friction at this speed, place and run.
  std::function<double(double position, double velocity, int run)> dry;
  std::function<double(double time_s)> load;  ///< torque from outside that opposes the positive direction
  double bristle_rad = 0.0;                   ///< of presliding; 0: rigid
  double bristle_damping = 0.0;               ///< of theirs, right after a reversal, per velocity
  double duration_s = 12.0;
  double torque_noise = 0.01, position_noise_rad = 2e-5, disturbance = 0.004;
  double sample_jitter = 0.0;  ///< share of the period
};

/// Trapezoids of random speed in both directions; the command acts until the next sample.
inline Run simulate(const Truth& truth, int run_number, unsigned seed) {
  constexpr double kStep_s = 5e-5;
  constexpr double kPeriod_s = 1e-3;
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  Run run;
  run.name = "run " + std::to_string(run_number + 1);
  double q = 0.0, v = 0.0, reference = 0.0, reference_v = 0.0, goal = 0.0, until_s = 0.0, command = 0.0;
  double disturbance = 0.0, deflection = 0.0, next_s = 0.0;
  for (double t = 0.0; t < truth.duration_s; t += kStep_s) {
    if (t >= until_s) {
      // Away from where the drive is, so that it stays in a range of some turns.
      const double speed = 2.0 + 26.0 * uniform(random);
      goal = (reference > 15.0 || (reference > -15.0 && goal < 0.0)) ? -speed : speed;
      if (reference > 15.0) goal = -speed;
      if (reference < -15.0) goal = speed;
      until_s = t + 0.25 + 0.35 * uniform(random);
    }
    const double step = 150.0 * kStep_s;
    reference_v += std::min(step, std::max(-step, goal - reference_v));
    reference += reference_v * kStep_s;
    if (t >= next_s) {
      const double measured = 1e-4 * std::round((q + truth.position_noise_rad * normal(random)) / 1e-4);
      disturbance += 0.05 * (truth.disturbance * std::sqrt(2.0 / 0.05) * normal(random) - disturbance);
      command = 4.0 * (reference - q) + 0.1 * (reference_v - v);
      run.time_s.push_back(t);
      run.position_rad.push_back(measured);
      run.torque_Nm.push_back(command + truth.torque_noise * normal(random));
      next_s += kPeriod_s * (1.0 + truth.sample_jitter * (2.0 * uniform(random) - 1.0));
    }
    const double dry = truth.dry ? truth.dry(q, v, run_number) : truth.coulomb;
    const double torque = command + disturbance - truth.viscous * v - truth.extra(q, v, run_number) -
                          (truth.load ? truth.load(t) : 0.0);
    double moved = v + kStep_s / truth.inertia * torque;
    if (truth.bristle_rad > 0.0) {
      const double bending = 0.5 * v * (1.0 - deflection * (v > 0.0 ? 1.0 : -1.0));
      moved -= kStep_s / truth.inertia * (dry * deflection + truth.bristle_damping * bending);
      deflection += kStep_s * moved / truth.bristle_rad * (1.0 - deflection * (moved > 0.0 ? 1.0 : -1.0));
    } else {
      const double brake = kStep_s / truth.inertia * dry;
      moved = std::abs(moved) <= brake ? 0.0 : moved - std::copysign(brake, moved);
    }
    v = moved;
    q += kStep_s * v;
  }
  return run;
}

inline std::vector<Run> simulate_set(const Truth& truth, unsigned seed, int runs = 3) {
  std::vector<Run> set;
  for (int r = 0; r < runs; ++r) set.push_back(simulate(truth, r, 1000 * seed + static_cast<unsigned>(r)));
  return set;
}

}  // namespace clampd::drive_test
