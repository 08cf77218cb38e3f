#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "clampd/attribution/attribution.hpp"

namespace clampd {

/// clampd.line/1.
nlohmann::ordered_json attribution_json(const attribution::LineTable& table,
                                        const attribution::LineAttribution& found, double false_alarms);

/// For a terminal: what was read, what differs or changes, the spread by its causes, the stations.
std::string format_attribution(const attribution::LineTable& table, const attribution::LineAttribution& found,
                               double false_alarms);

}  // namespace clampd
