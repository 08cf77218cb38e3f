#pragma once

#include <string>

#include "clampd/diagnose/diagnosis.hpp"

namespace clampd::diagnosing {

/// One sentence that a technician understands.
std::string summary_words(const Diagnosis& diagnosis);

/// Why runs could not have shown an effect; `blindness` is the standard deviation of its strength
/// over the change that matters.
std::string unseen_words(const Effect& effect, double blindness);

}  // namespace clampd::diagnosing
