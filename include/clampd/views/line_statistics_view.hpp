#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "clampd/line/line_statistics.hpp"

namespace clampd {

/// Schema clampd.statistics/1.
nlohmann::ordered_json statistics_json(const LineStatistics& statistics);

/// As a technician reads it.
std::string format_statistics(const LineStatistics& statistics);

}  // namespace clampd
