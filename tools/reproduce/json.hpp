#pragma once

#include <nlohmann/json_fwd.hpp>

#include "tools/reproduce/study.hpp"

namespace clampd::reproduce {

/// The key figures as clampd.reproduction/1; a figure that could not be computed is null.
nlohmann::ordered_json study_json(const Study& study);

}  // namespace clampd::reproduce
