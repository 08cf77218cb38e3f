#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/record/check_record.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"

namespace clampd {

/// What the brakes of one part number are checked by, as a recipe says; what it leaves out is the station's
/// own.
struct Recipe {
  std::string file;
  std::string part_number;
  std::string version;
  std::string sha256;                ///< of the file's text
  std::vector<std::string> serials;  ///< patterns of the serial numbers that choose it; may be empty
  std::optional<LimitSet> limits;    ///< written into the recipe itself
  std::string limits_file;
  std::string sheet_file;
  std::string trajectory;
  std::optional<std::vector<std::string>> further_trajectories;
  std::string model;  ///< extended model, as `clampctl diagnose --save` writes it
  std::string dbc;    ///< the CAN layout that these brakes need, with the next one
  std::vector<std::pair<std::string, std::string>> mapping;  ///< by role

  bool states_can_layout() const { return !dbc.empty() || !mapping.empty(); }
  RecipeRecord record() const { return {file, version, sha256}; }
};

/// A recipe (TOML): part_number and version, and optionally serials (a list of patterns), [limits] (file, or
/// all that a limits file has), [sheet] file, [check] trajectory, further_trajectories and model, [can] dbc and [can.mapping], each
/// with the meaning that it has in the station's configuration. Relative paths count from the recipe's
/// folder. Errors with file, line and column: an unknown key, a wrong type, no part number or version, a file
/// that cannot be read.
Result<Recipe> parse_recipe(const std::string& text, const std::string& path);

/// Every *.toml directly in the directory, by part number. Errors: there is none, one is not valid, two have
/// the same part number.
Result<std::vector<Recipe>> read_recipes(const std::string& directory);

/// The station's configuration for brakes of this part number. Limits that are written into the recipe, and
/// its CAN layout, are not in it.
StationConfiguration with_recipe(StationConfiguration configuration, const Recipe& recipe);

/// Whether a text is what the pattern says: * stands for any characters or none, ? for one, all else for
/// itself.
bool fits_pattern(std::string_view pattern, std::string_view text);

/// Whether one of the recipe's patterns says so.
bool is_serial_of(const Recipe& recipe, std::string_view serial);

}  // namespace clampd
