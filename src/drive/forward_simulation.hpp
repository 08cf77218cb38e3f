#pragma once

#include <cstddef>
#include <limits>
#include <vector>

#include "clampd/drive/model.hpp"
#include "clampd/record/run.hpp"

namespace clampd::drive {

/// What moves. `sign` is that of the last motion, `travel` what it has gone since its last reversal.
struct Motion {
  double position = 0.0, velocity = 0.0;
  double sign = 0.0, travel = std::numeric_limits<double>::infinity();

  /// Moves on by so much at this velocity. `length`: over which friction builds up after a reversal.
  void advance(double step_s, double length);
};

/// Over which friction builds up after a reversal; 1 where the model has no such term.
double length_of_reversals(const FittedDrive& drive);

/// The columns of a run that a model asks for, in the order of its regressors.
std::vector<const std::vector<double>*> columns_for(const DriveModel& model, const Run& run);

/// Error: the drive has no positive inertia, so that no motion follows from a torque; or it is one of steady
/// speeds.
Result<void> check_moves(const FittedDrive& drive);

/// Error: too few rows, or a column of the model that the run does not have.
Result<void> check_run(const Run& run, const DriveModel& model);

/// One run under one model: the acceleration that the torque balance leaves, friction as a set-valued law (it
/// holds the drive, up to its size, or opposes the motion), in semi-implicit steps that resolve the rows and
/// the viscous time constant. Run and model must outlive it and have been checked.
class ForwardSimulation {
 public:
  /// number: of the run, for terms that differ by run. start: the position at which it begins.
  ForwardSimulation(const Run& run, const FittedDrive& drive, int number, double start);

  /// One row on; false: it left all bounds.
  bool advance(std::size_t row, Motion& motion);

 private:
  double needed(double acceleration, double direction, const Motion& motion);
  void step(double torque, double step_s, Motion& motion);
  double viscous_time_s(double speed);
  double torque_at_rest(double start);
  double torque_at(std::size_t row, double at_s) const;

  const Run& run_;
  const FittedDrive& drive_;
  DriveState state_;
  std::vector<double> torque_;  ///< that acts, a lag aside
  double length_;               ///< over which friction builds up after a reversal
  std::vector<double> columns_;
  std::vector<const std::vector<double>*> recorded_;
  double fastest_ = 0.0, farthest_ = 0.0, longest_step_s_ = 0.0;
};

}  // namespace clampd::drive
