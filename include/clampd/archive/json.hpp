#pragma once

#include <optional>
#include <vector>

#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd {

/// The document of `clampctl run --json`, schema clampd.check/1. Numbers that are not finite become null.
nlohmann::ordered_json check_json(const CheckRecord& record);

/// A line of its "sheet"; `misfit_marked`: of the sheet, so that each line says it.
nlohmann::ordered_json characteristic_json(const CharacteristicRecord& line, bool misfit_marked);

/// Its "sheet": null where the station had none.
nlohmann::ordered_json sheet_json(const std::optional<SheetRecord>& sheet);

/// Its "cause".
nlohmann::ordered_json cause_json(const CauseRecord& cause);

/// The document of `clampctl results --json`, schema clampd.checks/1.
nlohmann::ordered_json summaries_json(const std::vector<CheckSummary>& checks);

}  // namespace clampd
