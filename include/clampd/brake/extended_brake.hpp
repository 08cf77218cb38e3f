#pragma once

#include <string>
#include <vector>

#include "clampd/brake/effect.hpp"
#include "clampd/brake/parameters.hpp"

namespace clampd {

/// The base model's parameters and the effects beside it.
struct ExtendedParameters {
  BrakeParameters base;
  std::vector<EffectValues> effects;
};

/// As a TOML file: [parameters], [fixed] and one table [effects.NAME] each. What read_extended_parameters()
/// reads, format_extended_parameters() wrote; a file without effects is one of read_brake_parameters().
Result<ExtendedParameters> read_extended_parameters(const std::string& path);
std::string format_extended_parameters(const ExtendedParameters& parameters);

}  // namespace clampd
