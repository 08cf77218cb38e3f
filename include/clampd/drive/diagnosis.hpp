#pragma once

#include <span>

#include "clampd/base/result.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// Says whether the base model of a bare drive explains its runs, and if not what does, by the torque that
/// the motion needs (inverse dynamics, IDIM-LS; Janot, Gautier and Brunot 2019). Of `options`, the held-out
/// runs, the views, the false alarm rate, the number of effects and the progress count.
///
/// An effect is named if blocks of rows agree on it more than chance would (Hotelling's test over blocks,
/// times the alternatives tried), and if it predicts what was left out of its fit: each combination of
/// direction and speed in turn, and the held-out runs. Quantities are in the model file's units ("Nm" in the
/// names of GainFigures stands for it). Diagnosis::model, noise and next_experiment stay empty.
///
/// Errors: no run, a run that is too short, no motion.
Result<Diagnosis> diagnose_drive(std::span<const Run> runs, const DriveModel& model,
                                 const DiagnoseOptions& options);

}  // namespace clampd
