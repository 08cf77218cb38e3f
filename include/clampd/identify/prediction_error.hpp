#pragma once

#include <span>

#include "clampd/identify/estimate.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// The prediction error method (Procedure 3), on innovations: parameters and initial states that make the
/// extended Kalman filter's one-step predictions fit the readings best, each innovation weighted with its own
/// covariance S(k) of (17); torque and sensor noise by restricted maximum likelihood. Starts from the output
/// error estimate.
Estimate identify_prediction_error(std::span<const Run> runs, const EstimatorOptions& options);

}  // namespace clampd
