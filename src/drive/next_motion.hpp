#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/drive/model.hpp"
#include "src/drive/terms.hpp"

namespace clampd::drive {

/// What to record next to settle the rivals or to show what these runs could not: standstill with the drive
/// off, or speeds in both directions all over the range. Nothing where neither is open.
std::optional<NextExperiment> next_motion(const FittedDrive& drive,
                                          const std::vector<std::vector<std::string>>& rivals,
                                          const std::map<std::string, Unidentifiable>& unseen,
                                          const DriveRange& range);

}  // namespace clampd::drive
