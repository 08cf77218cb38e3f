#include "clampd/drive/diagnosis.hpp"

namespace clampd {

Result<Diagnosis> diagnose_drive(std::span<const Run> runs, const DriveModel& model, const DiagnoseOptions&) {
  return failure(std::string(runs.empty() ? "no run" : model.name + ": not yet"));
}

}  // namespace clampd
