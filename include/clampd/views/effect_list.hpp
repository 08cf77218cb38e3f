#pragma once

#include <string>

#include <nlohmann/json.hpp>

namespace clampd {

/// What a diagnosis knows beside the base model: the catalogue of effects of a brake with their parameters,
/// and the parts of a bare drive's torque balance.
nlohmann::ordered_json effects_json();

/// The same as a technician reads it: what it is, what a run must do to show it, and its parameters.
std::string format_effects();

}  // namespace clampd
