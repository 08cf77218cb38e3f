#pragma once

#include <span>

#include "clampd/base/result.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

struct DriveDiagnosis : Diagnosis {
  FittedDrive fitted;  ///< the base model with the named effects, for `--save` and for a simulation
};

/// Says whether the base model of a bare drive explains its runs, and if not what does, by the torque that
/// the motion needs (inverse dynamics, IDIM-LS; Janot, Gautier and Brunot 2019), with a noise that has a
/// memory. Of `options`, the held-out runs, the views, the false alarm rate, the number of effects and the
/// progress count. docs/diagnosis.md, section 6, is the algorithm.
///
/// Quantities are in the model file's units ("Nm" in the names of GainFigures stands for it).
/// Diagnosis::model and noise stay empty.
///
/// Errors: no run, a run that is too short, no motion, readings that would mislead (check_data()), a base
/// model that these runs cannot tell.
Result<DriveDiagnosis> diagnose_drive(std::span<const Run> runs, const DriveModel& model,
                                      const DiagnoseOptions& options);

}  // namespace clampd
