#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "clampd/attribution/line_monitor.hpp"
#include "clampd/base/result.hpp"

namespace clampd {

/// For a terminal: what was counted, the alarms, the quiet stations.
std::string format_monitor(const attribution::LineMonitor& line, const attribution::MonitorCount& count);

/// clampd.line_monitor/1.
nlohmann::ordered_json monitor_json(const attribution::LineMonitor& line,
                                    const attribution::MonitorCount& count);

/// Everything that the monitor remembers, as clampd.line_monitor_state/1.
nlohmann::ordered_json monitor_state_json(const attribution::LineMonitor& line);

/// Reads it back. `file` stands for the text in messages. Refuses another version, keys that are missing or
/// unknown, and values that no monitor can have.
Result<attribution::LineMonitor> parse_monitor_state(const std::string& text, const std::string& file);

}  // namespace clampd
