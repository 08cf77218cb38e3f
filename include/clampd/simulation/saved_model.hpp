#pragma once

#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "drivers/sim/effects.hpp"

namespace clampd {

/// The effects of a model as the simulated brake has them. It knows one form of each; what is of another form
/// (another order of cogging, say) is refused, with what the simulated brake can do instead.
Result<sim::Effects> simulated_effects(const ExtendedParameters& model);

}  // namespace clampd
