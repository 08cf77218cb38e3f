#pragma once

#include <nlohmann/json_fwd.hpp>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/views/diagnosis_subject.hpp"

namespace clampd {

/// The diagnosis as clampd.diagnosis/1; a figure that could not be computed is null. Of a bare drive, values
/// are in its own units, whatever the keys say.
nlohmann::ordered_json diagnosis_json(const Diagnosis& diagnosis, const DiagnosisSubject& subject);

}  // namespace clampd
