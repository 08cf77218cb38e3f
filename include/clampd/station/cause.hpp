#pragma once

#include <optional>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// What a check's record keeps of a diagnosis; nothing where the base model explains the runs.
std::optional<CauseRecord> cause_of(const Diagnosis& diagnosis);

}  // namespace clampd
