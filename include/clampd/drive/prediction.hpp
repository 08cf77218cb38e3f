#pragma once

#include <span>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/prediction.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// Simulates each run from its recorded torque and the state of its first rows, by a fitted model: the
/// acceleration that the torque balance leaves, friction as a set-valued law (it holds the drive, up to its
/// size, or opposes the motion), in semi-implicit steps that resolve the rows and the viscous time constant.
/// Beside it the same from the recorded motion anew every 0.1 s and 1 s: in an open loop position and
/// velocity drift, however good the model.
///
/// Of each run: position if it was recorded, and velocity, recorded or by differences of the position.
/// Errors: no fitted inertia, a model of steady speeds, a run that is too short, a column of the model that a
/// run does not have.
Result<std::vector<PredictedRun>> predict_drive(std::span<const Run> runs, const FittedDrive& drive);

}  // namespace clampd
