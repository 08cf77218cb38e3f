#pragma once

#include <span>

#include "clampd/identify/estimate.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// The output error method (Procedure 2): parameters and initial states that make an open-loop simulation
/// under the recorded torque fit the readings best, R by (9).
Estimate identify_output_error(std::span<const Run> runs, const EstimatorOptions& options);

}  // namespace clampd
