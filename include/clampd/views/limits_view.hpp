#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"

namespace clampd {

/// A limits file and what it changed against the one before; `changes` is empty for the first.
struct LimitsStep {
  LimitsRevision limits;
  std::vector<std::string> changes;
  bool same_revision =
      false;  ///< it judges differently under the revision of the one before: nobody can tell
};

std::vector<LimitsStep> limits_steps(const std::vector<LimitsRevision>& history);

/// Schema clampd.limits/1.
nlohmann::ordered_json limits_json(const std::vector<LimitsStep>& steps);
std::string format_limits(const std::vector<LimitsStep>& steps);

}  // namespace clampd
