#pragma once

#include <optional>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// The runs of a check, and what else its record knows that a diagnosis of them needs.
std::vector<Run> runs_of(const std::vector<RunRecord>& records);
std::vector<Run> runs_of(const CheckRecord& record);
DiagnoseOptions diagnose_options(const CheckRecord& record, const BrakeParameters& nominal);

/// What a check's record keeps of a diagnosis; nothing where the base model explains the runs.
std::optional<CauseRecord> cause_of(const Diagnosis& diagnosis);

/// Whether all that the diagnosis puts forward, rivals too, is in how the station reads the brake: readings
/// or their timing, never the brake itself.
bool is_in_the_readings(const Diagnosis& diagnosis);

/// Whether what is named, or one of the rivals, may as well be a wrong scale of the force reading.
bool may_be_the_scale_of_force(const Diagnosis& diagnosis);

}  // namespace clampd
