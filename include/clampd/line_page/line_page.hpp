#pragma once

#include <nlohmann/json.hpp>

#include "clampd/reanalysis/line_archive.hpp"

namespace clampd::line_page {

/// A station is silent once it has made no check while it would have made so many, had it kept its share of
/// the line's checks. So a line that rests, at night or at the weekend, is silent nowhere.
inline constexpr double kMissedChecks = 20.0;

/// What attribution finds on the chosen part number (clampd.line/1); null where there are fewer than ten
/// valid checks. Takes seconds where there are many stations, and changes slowly.
nlohmann::ordered_json attribution_of(const reanalysis::LineRows& rows);

/// What the page of the line is drawn from (clampd.line_page/1, docs/line.md): stations, the parameters of
/// the chosen part number side by side and over time, what attribution found, now or some time ago, and who
/// does what. Parameters count the last valid check of each brake at each station; simulated brakes count
/// where there are no others. The same rows give the same document.
nlohmann::ordered_json document(const reanalysis::LineRows& rows, nlohmann::ordered_json attribution);

}  // namespace clampd::line_page
