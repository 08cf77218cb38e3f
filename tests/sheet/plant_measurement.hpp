#pragma once

#include <optional>

#include "clampd/sheet/sheet.hpp"
#include "drivers/sim/plant_configuration.hpp"

namespace clampd::support {

/// What the simulated brake, which shares nothing with the estimator's mathematics, really does in the place
/// of what a characteristic says of it: stopwatch and torque wrench on the plant. Nothing if it does not get
/// there. `plant`: the brake and its effects; where it starts is up to the measurement, but for the contact
/// point and the clearance, which are what it is configured to.
std::optional<double> measure(const Characteristic& characteristic, sim::PlantConfiguration plant);

}  // namespace clampd::support
