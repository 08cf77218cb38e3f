#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace clampd::drive_bench {

/// A torque against the drive that is a function of time: slow sines about a mean, noise with a memory, or
/// knocks. Each run has its own.
struct LoadSignal {
  double amplitude = 0.0;  ///< of the sines, about; 0: none
  double slowest_Hz = 0.0, fastest_Hz = 0.0;
  double walk_sd = 0.0;  ///< standard deviation of the noise; 0: none
  double walk_memory_s = 1.0;
  double knock_level = 0.0;    ///< mean height of half-sine pulses of either sign; 0: none
  double knock_s = 1.0;        ///< length of a pulse
  double knock_pause_s = 1.0;  ///< mean time between two pulses, drawn exponentially
  std::uint64_t seed = 0;

  bool is_there() const { return amplitude != 0.0 || walk_sd != 0.0 || knock_level != 0.0; }
};
/// One value a control tick; empty if there is none.
std::vector<double> by_tick(const LoadSignal& load, std::size_t run, std::size_t ticks, double tick_s);

/// The true drive. Everything is in SI units of the drive's kind: rad, N m, kg m^2 or m, N, kg; "torque"
/// stands for both. What is not said is absent. The equation of motion is
///   J(q) v' = T - friction - gravity - ... , with dry friction as a set-valued law (the drive sticks while
///   less than its level would move it) or, with a bristle length, as the LuGre model.
struct Plant {
  bool linear = false;
  // What the base model of every drive has.
  double inertia = 1.0;
  double coulomb = 0.0;
  double viscous = 0.0;

  // Effects of the catalogue.
  double gravity = 0.0;  ///< times sin(q + gravity_phase); of a vertical axis constant
  double gravity_phase = 0.0;
  double dry_asymmetry = 0.0;      ///< Coulomb level times 1 + this forwards, 1 - this backwards
  double viscous_asymmetry = 0.0;  ///< the same of the viscous friction
  double quadratic = 0.0;          ///< times v abs(v)
  double power = 0.0;              ///< times abs(v / speed)^exponent sign(v)
  double power_exponent = 1.0;
  double speed = 1.0;
  double stribeck_forward = 0.0;  ///< dry friction that is added at standstill and vanishes with speed
  double stribeck_backward = 0.0;
  double stribeck_speed = 1.0;
  double stribeck_exponent = 2.0;
  double load_friction = 0.0;  ///< times the absolute value of gravity and measured load together
  struct Ripple {
    double wave_number = 0.0;  ///< rad per unit of position
    double amplitude = 0.0;
    double phase = 0.0;
  };
  std::vector<Ripple> cogging;
  double bristle_length = 0.0;  ///< relaxation length of the presliding
  double warm_up = 0.0;         ///< Coulomb level times 1 + this exp(-t / warm_up_time_s)
  double warm_up_time_s = 1.0;
  std::vector<double> run_factor;  ///< Coulomb level of each run, by its factor; empty: 1
  double spring = 0.0;             ///< times (q - centre)
  double spring_cubic = 0.0;       ///< times (q - centre)^3
  double centre = 0.0;
  Ripple friction_ripple;   ///< Coulomb level times 1 + amplitude sin(wave_number q + phase)
  Ripple inertia_ripple;    ///< inertia times 1 + amplitude cos(wave_number q + phase)
  double saturation = 0.0;  ///< acting torque T (1 - this (T / torque_scale)^2)
  double torque_scale = 1.0;
  double torque_lag_s = 0.0;  ///< first-order lag between the torque that is recorded and the one that acts

  // Effects that are on no list.
  double load_inertia = 0.0;  ///< a second mass on an elastic shaft, without friction of its own
  double shaft_stiffness = 0.0;
  double shaft_damping = 0.0;
  double sticky_level = 0.0;  ///< dry friction that is added around one place
  double sticky_place = 0.0;
  double sticky_width = 1.0;
  double cable_level = 0.0;  ///< hysteresis over a length (Bouc and Wen, without the elastic part)
  double cable_length = 1.0;
  double chatter_amplitude = 0.0;  ///< while the speed is within the band
  double chatter_Hz = 0.0;
  double chatter_from = 0.0;
  double chatter_to = 0.0;
  LoadSignal hidden_load;       ///< that nobody records: a colleague axis, a random walk, knocks
  double clutch_torque = 0.0;   ///< most that a slip clutch passes on to the second mass, instead of a shaft
  double clutch_creep = 1.0;    ///< difference of the speeds at which it passes all of it and slips
  double stop_stiffness = 0.0;  ///< elastic end stop, touched at one end of the travel
  double stop_place = 0.0;
  double stop_side = 1.0;        ///< 1: beyond its place are the larger positions, -1: the smaller ones
  double stop_damping = 0.0;     ///< its torque times 1 + this times the speed into it (Hunt and Crossley)
  double payload_inertia = 0.0;  ///< carried for a share of each period, taken up at the drive's own speed
  double payload_period_s = 1.0;
  double payload_share = 0.5;
  double payload_start_s = 0.0;
  double base_speed = 0.0;  ///< above it the torque constant falls as 1 / speed; 0: never

  LoadSignal measured_load;  ///< that a column of the files holds
};

struct PlantState {
  double position = 0.0;
  double velocity = 0.0;
  double bristle = 0.0;  ///< of the level, -1 to 1
  double cable = 0.0;    ///< of the level, -1 to 1
  double load_position = 0.0;
  double load_velocity = 0.0;
  double acting_torque = 0.0;  ///< behind the lag
  double time_s = 0.0;
};

/// Of the last step: what the dry friction did.
struct DryFriction {
  double direction = 0.0;  ///< share of its level that acted, with its sign
  bool stuck = false;
};

/// One fixed step by the midpoint rule; dry friction as an impulse that never turns the motion round
/// (Moreau). `torque` is the recorded one, `load` all loads that are given by time, `measured_load` of them
/// what presses.
DryFriction advance(const Plant& plant, PlantState& state, double torque, double load, double measured_load,
                    std::size_t run, double step_s);

/// Gravity's torque at a position; of a linear drive it is constant.
double gravity_torque(const Plant& plant, double position);

/// The fastest rate of the equations, in 1/s: steps have to be short against its inverse.
double stiffness_rate(const Plant& plant, double speed);

/// Kinetic and potential energy of all that stores any, but for bristles and cable. A payload brings its
/// kinetic energy with it and takes it along.
double stored_energy(const Plant& plant, const PlantState& state);

}  // namespace clampd::drive_bench
