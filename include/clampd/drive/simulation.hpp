#pragma once

#include <string>

#include "clampd/base/result.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// Reads a torque over time, and the columns of the model's regressors: time and torque as the model names
/// and scales them; columns of motion are not looked at. Errors as read_drive_run().
Result<LoadedRun> read_drive_torque(const std::string& path, const DriveModel& model);

/// The same of a motion, without a torque. Where the model has columns of position and of velocity, one of
/// them will do.
Result<LoadedRun> read_drive_motion(const std::string& path, const DriveModel& model);

/// The motion that follows from a torque (`read_drive_torque`), from rest at `position`, by the same steps as
/// predict_drive(). The run returned has position and velocity too. Errors: the model has no inertia, the run
/// is too short or lacks a column of the model, or the simulation leaves all bounds (the message says when).
Result<Run> simulate_drive_motion(const Run& torque, const FittedDrive& drive, double position);

/// The torque that a motion needs (`read_drive_motion`): that of the torque balance, before the lag with
/// which the drive follows its reading or command. What was not recorded of position and velocity is derived
/// from the other. At standstill no friction acts. The run returned has torque, position and velocity. Errors
/// as above, but that a model without inertia will do.
Result<Run> simulate_drive_torque(const Run& motion, const FittedDrive& drive);

/// CSV text of a simulated run by the names, units, offsets, wraps and delays of the model's columns, so that
/// the same model file reads it. A column that another is subtracted from holds the difference, the other 0;
/// load and motor stand at the same place; the drive is on.
std::string format_drive_run(const Run& run, const DriveModel& model);

}  // namespace clampd
