#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "clampd/base/result.hpp"
#include "clampd/line/gauge_study.hpp"

namespace clampd {

/// Schema clampd.gauge/1.
nlohmann::ordered_json gauge_json(const std::vector<GaugeQuantity>& quantities);

/// As a technician reads it.
std::string format_gauge(const std::vector<GaugeQuantity>& quantities);

/// A page with figures, self-contained. Errors: gnuplot is missing.
Result<std::string> gauge_report(const std::vector<GaugeQuantity>& quantities, const std::string& subtitle);

}  // namespace clampd
