#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"

namespace clampd {

/// Schema clampd.retention/1. `done`: false for a plan.
nlohmann::ordered_json retention_json(const RetentionSummary& summary, bool done);
std::string format_retention(const RetentionSummary& summary, bool done);

}  // namespace clampd
