#pragma once

#include <string_view>

namespace clampd::bench {

// What ships with the station, compiled in from configs/, so that a station works without any file.
extern const std::string_view kBuiltinDbc;         ///< configs/brake.dbc
extern const std::string_view kBuiltinTrajectory;  ///< configs/trajectory.csv
extern const std::string_view kBuiltinSliding;     ///< configs/trajectory-sliding.csv
extern const std::string_view kBuiltinBreakaway;   ///< configs/trajectory-breakaway.csv
extern const std::string_view kBuiltinLimits;      ///< configs/limits.toml
extern const std::string_view kBuiltinPlant;       ///< configs/plant.toml: the embedded simulated brake

}  // namespace clampd::bench
