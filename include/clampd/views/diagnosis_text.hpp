#pragma once

#include <string>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/views/diagnosis_subject.hpp"

namespace clampd {

/// What a technician needs to know of the diagnosis, as text for a terminal: the verdict first. `colours`:
/// with the terminal's colour codes.
std::string diagnosis_text(const Diagnosis& diagnosis, const DiagnosisSubject& subject, bool colours);

}  // namespace clampd
