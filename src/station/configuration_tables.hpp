#pragma once

// Tables that the station's configuration and recipes have in common.

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "clampd/base/table_reader.hpp"
#include "clampd/station/limits.hpp"

namespace clampd {

/// [can.mapping] of the table [can]: names in the DBC file by role.
void read_can_mapping(TableReader& can, const std::string& file, std::optional<Error>& error,
                      std::vector<std::pair<std::string, std::string>>& mapping);

/// A table [limits] with what a limits file has. Errors name file and line; `contents` is the same as a file
/// of its own.
Result<LimitSet> inline_limits(const toml::table& table, const std::string& path);

}  // namespace clampd
