#pragma once

#include <string>
#include <vector>

#include "tests/drive_bench/drive_case.hpp"

namespace clampd::drive_bench {

/// Makes the recorded columns bad in the way that the case says; the truth behind them stays. Nothing for
/// good data.
void spoil(const Case& drawn, std::vector<Recording>& runs);

/// Names of findings of which one must come for data that are bad in this way (or the data be refused).
const std::vector<std::string>& accepted_findings(const std::string& spoil);

}  // namespace clampd::drive_bench
