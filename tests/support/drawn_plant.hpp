#pragma once

#include <cstdint>

#include "clampd/identify/information.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "drivers/sim/plant_configuration.hpp"

namespace clampd::support {

/// The plant with this brake, and with sensors that are as noisy as this.
inline sim::PlantConfiguration plant_with(sim::PlantConfiguration plant, const BrakeParameters& brake,
                                          const NoiseLevels& noise, std::uint64_t seed) {
  plant.brake = brake;
  plant.sensors.force_noise_N = noise.sensors.force_N;
  plant.sensors.velocity_noise_rad_s = noise.sensors.velocity_rad_s;
  plant.sensors.torque_noise_Nm = noise.torque_Nm;
  plant.seed = seed;
  return plant;
}

}  // namespace clampd::support
