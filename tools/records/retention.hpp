#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/station/configuration.hpp"

namespace clampd {

/// What the configuration's [retention] asks of the archive.
RetentionPolicy retention_policy(const StationConfiguration& configuration);

/// Schema clampd.retention/1. `done`: false for a plan.
nlohmann::ordered_json retention_json(const RetentionSummary& summary, bool done);
std::string format_retention(const RetentionSummary& summary, bool done);

}  // namespace clampd
