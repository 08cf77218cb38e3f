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

/// Parameters of a drive whose model is known.
struct DriveIdentification {
  std::vector<EstimatedParameter> parameters;  ///< of the base model, then "effect.parameter"
  double share_left = 0.0;         ///< of the torque's variation, rms over rms, on rows that were not fitted
  double share_explainable = 0.0;  ///< of that, squared, what any function of the columns would take; or NaN
  bool is_enough = false;          ///< no more is left than noise, or than what is called good enough
  std::vector<DataFinding> data;
  std::vector<std::string> notices;
  FittedDrive fitted;
};

/// Fits the terms of a saved model, with the shapes (speeds, lengths, powers, delays) that they have there,
/// to other runs of the same drive or of another of its kind. Nothing is searched for.
///
/// Errors: as of diagnose_drive(); a term that is of the runs of the fit, as friction that drifted from run
/// to run; runs that do not tell the terms apart.
Result<DriveIdentification> identify_drive(std::span<const Run> runs, const FittedDrive& saved);

}  // namespace clampd
