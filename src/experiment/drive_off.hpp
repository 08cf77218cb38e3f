#pragma once

#include <span>
#include <string>

#include "clampd/experiment/discrimination.hpp"

namespace clampd {

/// "a, b and c".
std::string names_of(std::span<const RivalModel> rivals);

/// A record of the torque reading with the drive off, as short as it may be for what is wanted.
Discrimination design_drive_off(std::span<const RivalModel> rivals, const NoiseLevels& noise,
                                const DiscriminationOptions& options);

}  // namespace clampd
