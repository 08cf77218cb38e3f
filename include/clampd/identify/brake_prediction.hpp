#pragma once

#include <span>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/record/prediction.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// Simulates each run from its recorded torque and the state of its first rows: force and velocity readings,
/// row by row, by a model with any effects. Nothing is corrected on the way. The velocity begins at the mean
/// of the first rows; the position where the model reads their force, or, before the pads touch, at the
/// recorded position or else at contact.
///
/// Errors: no run, or one without force or velocity.
Result<std::vector<PredictedRun>> predict_brake(std::span<const Run> runs, const ExtendedParameters& model);

}  // namespace clampd
