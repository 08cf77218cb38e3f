#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "clampd/record/run.hpp"

namespace clampd::drive_test {

/// Motor and load with a gear between them, which may have play and may yield; all on the motor's side. The
/// motor follows speeds by a controller of its own; velocity Verlet steps of 10 us, friction smoothed over a
/// small speed.
struct TwoMasses {
  double motor_inertia = 4e-4, load_inertia = 8e-4;
  double motor_viscous = 1e-3, load_viscous = 1e-3;
  double motor_coulomb = 0.02, load_coulomb = 0.05;
  double stiffness = 2000.0;                   ///< N m/rad, of the teeth in contact
  double damping = 0.03;                       ///< N m s/rad, the same
  double backlash = 0.0;                       ///< rad, from one side of the teeth to the other
  double motor_step = 1e-4, load_step = 1e-4;  ///< of the encoders, rad
  double position_noise = 0.0;
  int load_rows_late = 0;
  double duration_s = 20.0, ramp = 150.0;  ///< rad/s^2
  double fastest = 25.0;                   ///< rad/s
  double torque_noise = 2e-3;
};

/// The load's position is the last of Run::others.
inline Run record(const TwoMasses& drive, unsigned seed, const std::string& name = "run 1") {
  constexpr double kStep_s = 1e-5, kPeriod_s = 1e-3, kSlow = 0.02;
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Run run;
  run.name = name;
  run.others.push_back({"load_position", {}});
  double q = 0.0, v = 0.0, ql = 0.0, vl = 0.0, speed = 0.0, goal = 0.0, reference = 0.0, until_s = 0.0,
         command = 0.0;
  double ramp = drive.ramp;
  std::vector<double> load;
  const auto read = [&](double position, double step) {
    position += drive.position_noise * normal(random);
    return step > 0.0 ? step * std::floor(position / step) : position;
  };
  const auto steps = static_cast<long>(drive.duration_s / kStep_s);
  for (long k = 0; k < steps; ++k) {
    const double t = static_cast<double>(k) * kStep_s;
    if (k % std::lround(kPeriod_s / kStep_s) == 0) {
      if (t >= until_s) {
        goal = drive.fastest * uniform(random);
        if (std::abs(reference) > 40.0) goal = -std::copysign(std::abs(goal), reference);
        ramp = drive.ramp * (0.6 + 0.4 * uniform(random));
        until_s = t + 0.5 + 0.2 * uniform(random);
      }
      const double inertia = drive.motor_inertia + drive.load_inertia;
      const double wanted = std::clamp(goal - speed, -ramp * kPeriod_s, ramp * kPeriod_s);
      speed += wanted;
      reference += speed * kPeriod_s;
      command = inertia * wanted / kPeriod_s + 0.06 * (speed - v) + 1.0 * (reference - q);
      run.time_s.push_back(t);
      run.torque_Nm.push_back(command + drive.torque_noise * normal(random));
      run.position_rad.push_back(read(q, drive.motor_step));
      load.push_back(read(ql, drive.load_step));
    }
    const double twist = q - ql, half = 0.5 * drive.backlash;
    const double over = twist > half ? twist - half : twist < -half ? twist + half : 0.0;
    double through = over == 0.0 ? 0.0 : drive.stiffness * over + drive.damping * (v - vl);
    if (through * over < 0.0) through = 0.0;  // teeth do not pull
    const auto friction = [&](double speed_here, double viscous, double coulomb) {
      return viscous * speed_here + coulomb * std::tanh(speed_here / kSlow);
    };
    v += kStep_s / drive.motor_inertia *
         (command - through - friction(v, drive.motor_viscous, drive.motor_coulomb));
    vl += kStep_s / drive.load_inertia * (through - friction(vl, drive.load_viscous, drive.load_coulomb));
    q += kStep_s * v;
    ql += kStep_s * vl;
  }
  for (std::size_t k = 0; k < load.size(); ++k)
    run.others.front().values.push_back(
        load[static_cast<std::size_t>(std::max<long>(0, static_cast<long>(k) - drive.load_rows_late))]);
  return run;
}

}  // namespace clampd::drive_test
