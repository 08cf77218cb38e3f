#pragma once

#include <span>

#include "clampd/brake/extended_brake.hpp"
#include "clampd/identify/estimate.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// The prediction error method (Procedure 3, on innovations) for the base model with effects beside it:
/// identify_prediction_error() for a first idea of the base, then fit_extended() from there and from the
/// model's own parameters; the likelier one stands. `model` gives the effects' start values and choices; J
/// and N are those of `options`. An effect whose bound is its neutral value (a play of 0) and that makes the
/// runs no likelier is reported as absent: strength neutral, shape NaN.
/// Base parameters and strengths that the data do not determine make it NotIdentifiable. A known noise is
/// used if all three are given; only some of them, or a robust loss, is a numerical failure with its reason.
Estimate identify_extended(std::span<const Run> runs, const ExtendedParameters& model,
                           const EstimatorOptions& options);

}  // namespace clampd
