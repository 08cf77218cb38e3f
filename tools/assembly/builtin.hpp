#pragma once

#include <string_view>

namespace clampd::assembly {

// What ships with the station, compiled in from configs/, so that a station works without any file.
extern const std::string_view kBuiltinDbc;         ///< configs/brake.dbc
extern const std::string_view kBuiltinTrajectory;  ///< configs/trajectory.csv

}  // namespace clampd::assembly
