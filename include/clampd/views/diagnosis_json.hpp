#pragma once

#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/views/diagnosis_subject.hpp"

namespace clampd {

/// The diagnosis as clampd.diagnosis/1; a figure that could not be computed is null. Of a bare drive, values
/// are in its own units, whatever the keys say.
nlohmann::ordered_json diagnosis_json(const Diagnosis& diagnosis, const DiagnosisSubject& subject);

/// Its lists of parameters and of what the readings show.
nlohmann::ordered_json parameters_json(const std::vector<EstimatedParameter>& parameters);
nlohmann::ordered_json findings_json(const std::vector<DataFinding>& findings);

}  // namespace clampd
