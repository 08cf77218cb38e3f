#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "clampd/identify/information.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/run.hpp"

namespace clampd::blind {

enum class Channel { Torque, Force, Velocity };
enum class Bristles { Dahl, LuGre, ElastoPlastic };
enum class Loop { SignLike, Exponential, BoucWen };  ///< how a hysteresis turns round

/// A controller that computes the torque of a row from the readings of that very row, their noise included,
/// as a drive does. Off (all gains zero) the plant's own controller follows an observer instead.
struct Feedback {
  double position_Nm_rad = 0.0;
  double velocity_Nm_s_rad = 0.0;
  double force_Nm_N = 0.0;
  int per_row = 1;     ///< torques computed in a row; the recorded torque is their mean
  int delay_rows = 0;  ///< the readings' age

  bool is_on() const { return position_Nm_rad > 0.0; }
};

/// All physics that the hidden brake may have beside the base model, each neutral unless set. SI.
struct Physics {
  BrakeParameters brake;

  double torque_offset_Nm = 0.0;  ///< of the reading
  double torque_gain = 0.0;       ///< of the reading, relative
  double torque_lag_s = 0.0;      ///< of the acting torque
  double torque_limit_Nm = 0.0;   ///< that the drive really delivers; 0: no limit
  bool torque_limit_soft = false;

  double inertia_error = 0.0;
  double ratio_error = 0.0;
  struct {
    double share = 0.0;  ///< of the inertia, behind the elastic shaft; 0: rigid
    double frequency_Hz = 0.0;
    double damping = 0.0;  ///< ratio to the critical
  } second_mass;

  double coulomb_load_Nm = 0.0;  ///< more Coulomb friction at 10 kN
  double coulomb_load_exponent = 1.0;
  double asymmetry_Nm = 0.0;       ///< more friction forward, less backward
  double asymmetry_viscous = 0.0;  ///< relative, of the viscous friction
  bool asymmetry_at_rest = true;   ///< the static friction differs, too
  double quadratic_drag_Nm_s2 = 0.0;
  double root_friction_Nm = 0.0;  ///< at 100 rad/s
  double root_exponent = 0.5;
  double position_viscous = 0.0;  ///< relative amplitude of a viscous friction that varies with the angle
  double position_viscous_order = 1.0;
  double position_viscous_phase = 0.0;
  struct {
    double per_run = 0.0;       ///< relative change of TC and Tv
    double warm_up_runs = 0.0;  ///< 0: for ever; otherwise it saturates with this constant
  } friction_drift;
  struct {
    double step_Nm = 0.0;  ///< Coulomb friction is this much higher in the other of its two states
    double dwell_s = 0.2;  ///< mean stay in a state
  } friction_flip;
  struct {
    double amplitude_Nm = 0.0;
    double order = 6.0;  ///< periods per motor revolution
    double phase = 0.0;
    double second = 0.0;  ///< amplitude of twice the order, relative
    double second_phase = 0.0;
  } cogging;
  struct {
    Bristles law = Bristles::Dahl;
    double travel_rad = 0.0;  ///< to break away at 10 kN; 0: set-valued friction
    double damping = 0.3;     ///< of the bristles, ratio to the critical (LuGre)
  } presliding;

  struct {
    Loop law = Loop::Exponential;
    double share = 0.0;  ///< of the force that is missing on release
    double travel_rad = 0.5;
  } hysteresis;
  double pad_damping_N_s = 0.0;
  bool pad_damping_grows = false;  ///< in proportion to the elastic force, the value being that at 10 kN
  double relaxation = 0.0;         ///< share of the force
  double relaxation_s = 0.15;
  double backlash_rad = 0.0;
  double shape_N = 0.0;  ///< of the additional force at 30 rad
  int shape_power = 4;
  double stiffness_drift = 0.0;  ///< relative change of the force by the end of a second
  double contact_drift_rad_s = 0.0;

  double force_offset_N = 0.0;
  double force_lag_s = 0.0;
  double velocity_lag_s = 0.0;
  double force_saturation_N = 0.0;  ///< 0: none
  bool saturation_before_noise = false;
  double hum_N = 0.0;
  double hum_Hz = 50.0;
  double force_by_velocity_N = 0.0;  ///< error of the force reading at 100 rad/s
  double force_by_velocity_power = 1.0;
  Channel skewed = Channel::Force;
  double skew_samples = 0.0;
  struct {
    Channel channel = Channel::Force;
    double share = 0.0;
    double height = 0.0;  ///< N or rad/s
    double spread = 0.0;  ///< relative, of the heights
    int sign = 0;         ///< 0: either
  } outliers;
  double jitter_s = 0.0;  ///< standard deviation of the instants at which the sensors are read
  Channel quantised = Channel::Force;
  double quantum = 0.0;  ///< of that channel's reading
  struct {
    Channel channel = Channel::Force;
    double per_s = 0.0;
    double length_s = 0.0;
  } dropouts;

  Feedback feedback;
  NoiseLevels noise;  ///< torque: of its reading; the torque that acts is exact
};

/// A brake that stands in for the real one in blind tests. It is neither the estimator's model (RK4 at 1 ms,
/// events by the implicit function theorem) nor the simulated brake of drivers/sim (Moreau's time stepping):
/// Heun's method at 10 us while sliding, rest as a state of its own that is entered and left explicitly.
/// It brings its own controller.
class HiddenPlant {
 public:
  HiddenPlant(const Physics& physics, std::uint64_t seed);

  struct Recording {
    Run readings;
    Run noise_free;  ///< the same without the sensors' white noise, all effects in
    double force_max_N = 0.0;
    double speed_max_rad_s = 0.0;
  };

  /// Opens, approaches and tracks `trajectory` of the nominal brake (1 ms a row, all columns). `run` counts
  /// the runs that this brake has done before.
  Recording record(const Run& trajectory, int run);

 private:
  struct Motion {
    double position_rad = 0.0, velocity_rad_s = 0.0;
    double load_position_rad = 0.0, load_velocity_rad_s = 0.0;  ///< second mass
  };
  struct Slope {
    double acceleration = 0.0, load_acceleration = 0.0;
  };
  struct Trace {  ///< of the sensors before noise, each step
    std::vector<double> force_N, velocity_rad_s, position_rad;
  };
  struct Sensed {
    double force_N = 0.0, velocity_rad_s = 0.0, position_rad = 0.0;
  };
  struct Row;

  void reset(double position_rad, int run);
  void step();
  void step_bristles();
  void after_motion(double travel_rad);
  Slope slope(const Motion& motion, double direction) const;
  double pads_at(double load_position_rad) const;
  double elastic_N(double compression_rad) const;
  double pad_force_N(const Motion& motion) const;
  double dry_friction_Nm(double speed_rad_s, double force_N) const;
  double smooth_torque_Nm(const Motion& motion, double force_N) const;
  double asymmetry_Nm(double speed_rad_s) const;
  void append(Trace& trace) const;
  Sensed sensed(const Trace& trace, double row, double jitter_rows) const;
  double observer_torque_Nm(const Row& wanted);
  double feedback_torque_Nm(const Row& wanted, const Trace& trace, double row);
  double drive_row(const Row& wanted, std::size_t row, Trace& trace);
  double uniform(double low, double high);
  double gaussian() { return normal_(random_); }

  const Physics physics_;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_{0.0, 1.0};
  double inertia_, load_inertia_, shaft_Nm_rad_ = 0.0, shaft_Nm_s_rad_ = 0.0, ratio_;

  Motion motion_;
  double direction_ = 0.0;  ///< of sliding; 0: at rest
  double pads_rad_ = 0.0;
  double hysteresis_ = -1.0;
  double relaxed_N_ = 0.0;
  double bristle_rad_ = 0.0;
  double commanded_Nm_ = 0.0, torque_Nm_ = 0.0;
  double filtered_force_N_ = 0.0, filtered_velocity_ = 0.0;
  double time_s_ = 0.0;  ///< since the run's first row
  double hum_phase_ = 0.0;
  /// Of the readings of each row, if the controller sees them; preparation included.
  std::vector<double> force_noise_N_, velocity_noise_rad_s_;
  double warmth_ = 1.0;  ///< factor on TC and Tv
  bool flipped_ = false;
};

}  // namespace clampd::blind
