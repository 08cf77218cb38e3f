#pragma once

#include <nlohmann/json.hpp>

#include "clampd/record/check_record.hpp"

namespace clampd {

/// The document of `clampctl run --json`, schema clampd.check/1. Numbers that are not finite become null.
nlohmann::ordered_json check_json(const CheckRecord& record);

}  // namespace clampd
