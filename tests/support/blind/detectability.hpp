#pragma once

#include "clampd/brake/extended_brake.hpp"
#include "tests/support/blind/blind_set.hpp"

namespace clampd::blind {

/// What the best fit of the base model to the noise-free readings leaves unexplained, in nats: half the
/// squared innovations of the filter that knows the true noise, torque's included, each weighted with its
/// inverse covariance S(k)^-1. NaN if nothing could be fitted.
double detectability_nats(const BlindSet& set);

/// The same for a model with effects, fitted again to the noise-free readings from where `model` is.
double nats_left(const BlindSet& set, const ExtendedParameters& model);

}  // namespace clampd::blind
