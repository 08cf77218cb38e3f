#pragma once

#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "clampd/base/clock.hpp"
#include "clampd/ports/brake_port.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "drivers/sim/spoiling.hpp"

namespace clampd::sim {

/// What really is, at the instant of the last sample.
struct Truth {
  double time_s = 0.0;
  double position_rad = 0.0;  ///< from the contact point
  double velocity_rad_s = 0.0;
  double force_N = 0.0;
  double torque_Nm = 0.0;  ///< acting from this instant until the next sample
  bool drive_enabled = false;
  bool watchdog_tripped = false;
};

/// A brake that stands in for the real one: equations (1) to (6) with the sign of Tf restored and tanh(eps v)
/// replaced by its limit, a set-valued sign, so that the clamped brake really sticks.
///
/// It is meant to disagree with the estimator's model in its numerics: Moreau's time stepping (position at
/// the midpoint, friction implicit at velocity level as a projection) in steps of at most 20 us, against a
/// Runge-Kutta scheme with event location there. With effects it disagrees in its physics, too.
///
/// It samples on its own clock. At an instant k it latches the newest command, takes its readings, and
/// holds that torque until k + 1; told a speed, it makes the torque by a loop of its own. Pure: no I/O, no
/// clock; one call of sample() is one cycle. Neither command() nor sample() allocates.
class SimulatedBrake {
 public:
  /// `configuration` must be valid.
  /// `cycle_ns`: from sample to sample.
  explicit SimulatedBrake(const PlantConfiguration& configuration, std::int64_t cycle_ns = kPeriod_ns);

  /// A valid command arrived; it acts from the next sample on if no newer one comes.
  void command(const DriveCommand& command) noexcept;

  /// Takes the sample that is due now and advances the brake by one cycle.
  BrakeFeedback sample() noexcept;

  /// By which the sample that is due now is late, or early if negative.
  double lateness_s() const noexcept { return lateness_s_; }

  const Truth& truth() const noexcept { return truth_; }
  /// The last sample as it would have been had nothing spoiled it.
  const BrakeFeedback& unspoiled() const noexcept { return unspoiled_; }
  const PlantConfiguration& configuration() const noexcept { return configuration_; }

  /// Tells which run comes next (0, 1, ...), for what changes from run to run (friction-drift).
  void begin_run(std::uint32_t run) noexcept { run_ = run; }

 private:
  struct State {
    double position_rad = 0.0;
    double velocity_rad_s = 0.0;
    double force_N = 0.0;           ///< the pads' force, all effects in
    double pad_position_rad = 0.0;  ///< behind the backlash
    double bristle_rad = 0.0;       ///< presliding
    double hysteresis = -1.0;       ///< 1 applying, -1 releasing
    double relaxed_N = 0.0;
    double torque_Nm = 0.0;  ///< behind the torque lag
    double filtered_force_N = 0.0;
    double filtered_velocity_rad_s = 0.0;
  };

  void latch_command() noexcept;
  void follow_speed(double h) noexcept;
  BrakeFeedback read() noexcept;
  void advance() noexcept;
  void step(double h) noexcept;
  double mean_torque(double h) noexcept;
  void carry_pads() noexcept;
  double viscous_Nm_s_rad(double v) const noexcept;
  double inertia_kg_m2() const noexcept;
  double slide_on_bristles(double h, double torque_Nm, double force_N) noexcept;
  double slide(double h, double torque_Nm, double force_N) const noexcept;
  void press(double h, double before_rad) noexcept;
  double pad_force(double velocity_rad_s) const noexcept;
  double friction_level(double speed_rad_s, double force_N) const noexcept;
  double gaussian(double sd) noexcept;
  double force_before(double samples) const noexcept;

  PlantConfiguration configuration_;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_{0.0, 1.0};
  Spoiler spoiler_;
  BrakeFeedback unspoiled_;
  State state_;
  Truth truth_;
  DriveCommand newest_;
  bool fresh_ = false;  ///< a command came since the last sample
  std::int64_t silent_samples_ = 0;
  bool enabled_ = false;
  bool tripped_ = false;
  double torque_Nm_ = 0.0;  ///< latched, or made by the speed loop
  double integral_Nm_ = 0.0;           ///< of the speed loop
  double velocity_error_rad_s_ = 0.0;  ///< of the reading that it sees, as of the last sample
  std::int64_t index_ = 0;
  double lateness_s_ = 0.0;
  std::uint32_t run_ = 0;
  std::int64_t cycle_ns_;
  double cycle_s_;
  int steps_ = 1;                        ///< of the integrator in a sample
  int speed_steps_ = 1;                  ///< and for how many the speed loop holds a torque
  std::vector<double> force_history_N_;  ///< what the load cell had at each step of late, a ring
  std::size_t newest_force_ = 0;         ///< the step just made
};

}  // namespace clampd::sim
