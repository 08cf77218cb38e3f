#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "clampd/drive/data_check.hpp"

/// The parts of check_data(): each looks at one run for one kind of defect, and mends it where that is
/// possible.
namespace clampd::data_check {

/// A run under examination. `run` is a copy that the checks mend.
struct RunCheck {
  const DriveModel& model;
  Run run;
  bool mended = false;
  std::vector<DataFinding> findings = {};

  void add(std::string name, std::string column, double size, std::string unit, DataSeverity severity,
           std::string words);
};

/// A column of readings of a run, with what messages call it.
struct Channel {
  std::vector<double>* values = nullptr;
  std::string column;
  std::string_view unit;
  enum class Kind { Torque, Velocity, Position } kind = Kind::Torque;
};
/// Those that the run has.
std::vector<Channel> channels_of(RunCheck& check);
std::string_view torque_unit(const DriveModel& model);
std::string_view velocity_unit(const DriveModel& model);

/// data_check_units.cpp
bool check_finite(RunCheck& check);  ///< false: nothing else can be asked of the run
void check_units(RunCheck& check);
/// data_check_time.cpp
void check_gaps(RunCheck& check);
void check_jitter(RunCheck& check);
/// data_check_held.cpp
void check_held(RunCheck& check);
/// data_check_position.cpp
void check_wraps_and_jumps(RunCheck& check);
/// data_check_spikes.cpp
void check_spikes(RunCheck& check);
/// data_check_velocity.cpp
void check_velocity_against_position(RunCheck& check);
/// data_check_torque.cpp
void check_torque_against_motion(RunCheck& check);
void check_clipping(RunCheck& check);
/// data_check_motion.cpp
void check_sampling(RunCheck& check);
void check_resolution(RunCheck& check);

/// How a run moves, for what is asked of all runs together.
struct MotionSummary {
  bool moves = false;
  std::size_t rows = 0, forward = 0, backward = 0;  ///< rows that move, by direction
  bool one_way() const;                             ///< but for a few rows
  double standing_share = 0.0;
  double least_speed = 0.0, greatest_speed = 0.0;  ///< 10 and 90 % quantiles of the rows that move
  double acceleration_share = 0.0;                 ///< change of speed within the run over the typical speed
};
MotionSummary summarise_motion(const RunCheck& check);
void check_excitation(std::span<const MotionSummary> motions, std::span<const RunCheck> checks,
                      std::vector<DataFinding>& findings);

// Robust statistics: medians and quantiles, so that single bad samples do not count.

/// The value below which this share of the values lies; NaN of none.
double quantile(std::vector<double> values, double share);
double median_of_steps(std::span<const double> time_s);
/// The step of a reading that has one: the smallest change that is no rounding error; 0 if it never changes.
double step_of(std::span<const double> values);
/// How far a position goes, but for 2 % of the samples at either end.
double travel_of(const std::vector<double>& position);
/// Standard deviation of a reading's noise by the median of its second differences (a parabola leaves little
/// of them).
double noise_of(std::span<const double> values);
/// Central differences over time: the velocity of a position.
std::vector<double> differences(std::span<const double> time_s, std::span<const double> values);
/// The run's velocity: its column, or differences of its position.
std::vector<double> velocity_of(const Run& run);
/// Linear interpolation at `at_s`, the end values beyond the ends.
double interpolate(std::span<const double> time_s, std::span<const double> values, double at_s);

/// Local polynomials at places spread over the run, for regressions: value, first and second derivative.
struct SmoothMotion {
  std::vector<double> time_s, position, velocity, acceleration, torque;
  double half_width_s = 0.0;
};
/// At most `most` places. Rows about a gap are left out.
SmoothMotion smooth_motion(const Run& run, std::size_t most);
/// The torque's local mean at times shifted by `shift_s`.
std::vector<double> smooth_torque(const Run& run, const SmoothMotion& at, double shift_s);

}  // namespace clampd::data_check
