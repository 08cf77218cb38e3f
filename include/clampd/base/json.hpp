#pragma once

#include <cmath>

#include <nlohmann/json.hpp>

namespace clampd {

/// JSON knows no infinity and no NaN: what is not finite is null.
inline nlohmann::ordered_json number_or_null(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}

}  // namespace clampd
