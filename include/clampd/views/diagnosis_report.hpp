#pragma once

#include <string>

#include "clampd/base/result.hpp"
#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/views/diagnosis_subject.hpp"

namespace clampd {

/// The diagnosis as one HTML file for a technician: what is wrong, how large it is, how one sees it, what
/// mending the model gains, what remains open. Needs Diagnosis::views for its pictures of runs. Errors:
/// gnuplot is missing or fails.
Result<std::string> diagnosis_html(const Diagnosis& diagnosis, const DiagnosisSubject& subject);

}  // namespace clampd
