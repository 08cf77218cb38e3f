#pragma once

#include <cstdint>
#include <vector>

#include "tests/drive_bench/motion.hpp"
#include "tests/drive_bench/plant.hpp"

namespace clampd::drive_bench {

enum class TorqueColumn {
  Held,      ///< one row a control tick: the torque of the row acts from it until the next
  Sampled,   ///< several ticks a row: the current, over the tick before and the tick after the row
  Averaged,  ///< all columns are means over the row that ends at the time stamp
};

enum class VelocityColumn { Tachometer, CentralDifference, BackwardDifference };

/// Controller, sensors and logger. The controller is a P-PI cascade that reads the row's sensors and sets the
/// row's torque.
struct Rig {
  double tick_s = 1e-3;   ///< of the controller
  int ticks_per_row = 1;  ///< of the logger
  TorqueColumn torque_column = TorqueColumn::Held;
  VelocityColumn velocity_column = VelocityColumn::CentralDifference;
  bool has_position = true;
  bool has_velocity = false;
  double torque_noise = 0.0;  ///< standard deviation
  double torque_offset = 0.0;
  double encoder_step = 0.0;      ///< 0: exact
  double velocity_noise = 0.0;    ///< of the tachometer
  double bandwidth_rad_s = 50.0;  ///< of the speed loop
  double torque_limit = 1.0;
  double torque_scale = 1.0;  ///< of Torque mode's references
  int command_delay = 0;      ///< ticks
  bool feed_forward = false;
  bool inner_loop = false;   ///< the torque follows with a tenth of a tick
  int torque_late_rows = 0;  ///< the torque column is shifted; negative: early

  double row_s() const { return tick_s * ticks_per_row; }
};

/// One run: the columns that a logger wrote, and the truth behind them.
struct Recording {
  std::vector<double> time_s, torque, position, velocity, load;  ///< a column that there is not is empty

  /// Of the interval that begins at each row, by the integrator's own steps: exact means.
  struct Truth {
    double position = 0.0;  ///< in its middle
    double velocity = 0.0;
    double acceleration = 0.0;
    double direction = 0.0;  ///< share of the dry friction's level that acted, signed
    double torque = 0.0;     ///< what the torque column would be without noise
    double load = 0.0;       ///< measured load
    double time_s = 0.0;
    bool stuck = false;  ///< at any time
  };
  std::vector<Truth> truth;
};

/// `inertia` and `coulomb` are what the controller believes. `noise` is drawn from for the sensors only.
Recording record(const Plant& plant, const Rig& rig, const Motion& motion, std::size_t run, Random noise);

}  // namespace clampd::drive_bench
