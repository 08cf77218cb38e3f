#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "clampd/line/master.hpp"

namespace clampd {

/// Schema clampd.master/1.
nlohmann::ordered_json master_json(const MasterReport& report);

/// As a technician reads it.
std::string format_master(const MasterReport& report);

}  // namespace clampd
