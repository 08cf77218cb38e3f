#include "clampd/station/recipe.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>

#include "clampd/base/table_reader.hpp"
#include "clampd/record/checksum.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/text.hpp"
#include "src/station/configuration_tables.hpp"

namespace clampd {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kLongestName = 80;  // as a check request may have it

/// Reads one recipe: its tables one after the other, the first error is kept.
class RecipeReader {
 public:
  RecipeReader(const toml::table& document, const std::string& path)
      : document_(document), file_(path), folder_(fs::path(path).parent_path().string()) {
    if (folder_.empty()) folder_ = ".";
  }

  Result<Recipe> read(Recipe recipe) {
    TableReader reader(document_, "", file_, error_);
    read_name(reader, "part_number", recipe.part_number);
    read_name(reader, "version", recipe.version);
    read_serials(reader, recipe.serials);
    in_table(reader, "limits",
             [&](TableReader& limits, const toml::table& table) { read_limits_of(limits, table, recipe); });
    in_table(reader, "sheet", [&](TableReader& sheet, const toml::table& table) {
      read_path(sheet, table, "file", recipe.sheet_file);
      sheet.finish();
    });
    in_table(reader, "check", [&](TableReader& check, const toml::table& table) {
      read_path(check, table, "trajectory", recipe.trajectory);
      check.paths("further_trajectories", recipe.further_trajectories, folder_);
      read_path(check, table, "model", recipe.model);
      check.finish();
    });
    in_table(reader, "can", [&](TableReader& can, const toml::table& table) {
      read_path(can, table, "dbc", recipe.dbc);
      read_can_mapping(can, file_, error_, recipe.mapping);
      can.finish();
    });
    reader.finish();
    if (error_) return tl::unexpected(*error_);
    return recipe;
  }

 private:
  template <class Read>
  void in_table(TableReader& parent, std::string_view key, Read read) {
    const toml::table* table = parent.table(key);
    if (table == nullptr || error_) return;
    TableReader reader(*table, std::string(key), file_, error_);
    read(reader, *table);
  }

  void read_name(TableReader& reader, std::string_view key, std::string& target) {
    reader.text(key, target, kLongestName);
    target = trimmed(target);
    if (!target.empty()) return;
    // An empty document has no place of its own.
    const toml::node* node = document_.get(key);
    reader.refuse(
        node == nullptr ? toml::source_region{{1, 1}, {1, 1}, {}} : node->source(),
        fmt::format("a recipe needs a {0}: {0} = \"...\". Every .toml file directly in the directory of "
                    "[recipes] is a recipe; what recipes name belongs into a folder in it",
                    key));
  }

  void read_serials(TableReader& reader, std::vector<std::string>& serials) {
    reader.texts("serials", serials);
    for (std::string& pattern : serials) {
      pattern = trimmed(pattern);
      if (pattern.find_first_not_of("*?") == std::string::npos)
        reader.refuse(
            document_.get("serials")->source(),
            fmt::format("serials: \"{}\" stands for the serial numbers of every part; write what those of "
                        "this part begin or end with, as in \"BX2-*\"",
                        pattern));
    }
  }

  void read_limits_of(TableReader& reader, const toml::table& table, Recipe& recipe) {
    if (!table.contains("file")) {
      Result<LimitSet> limits = inline_limits(table, file_);
      if (limits)
        recipe.limits = std::move(*limits);
      else
        error_ = limits.error();
      return;
    }
    read_path(reader, table, "file", recipe.limits_file);
    if (table.size() > 1)
      reader.refuse(
          table.source(),
          "[limits] has a file and more: either name the file, or write all limits into the recipe");
  }

  void read_path(TableReader& reader, const toml::table& table, std::string_view key, std::string& target) {
    reader.path(key, target, folder_);
    if (error_ || !reader.has(key)) return;
    const toml::source_region& where = table.get(key)->source();
    if (target.empty())
      reader.refuse(where,
                    fmt::format("{} is empty: name a file, or leave it out for the station's own", key));
    else if (std::error_code failed; !fs::is_regular_file(target, failed) || !std::ifstream(target))
      reader.refuse(where,
                    fmt::format("{}: there is no file {} that can be read; relative paths count from the "
                                "recipe's folder",
                                key, target));
  }

  const toml::table& document_;
  const std::string& file_;
  std::string folder_;
  std::optional<Error> error_;
};

Result<std::vector<std::string>> recipe_files(const std::string& directory) {
  std::vector<std::string> files;
  std::error_code failed;
  fs::directory_iterator entry(directory, failed);
  for (; !failed && entry != fs::directory_iterator(); entry.increment(failed))
    if (entry->path().extension() == ".toml" && !entry->path().filename().string().starts_with('.'))
      files.push_back(entry->path().string());
  if (failed)
    return failure(
        fmt::format("{}: the directory of [recipes] cannot be read: {}; name another one, or leave "
                    "[recipes] out",
                    directory, failed.message()));
  if (files.empty())
    return failure(
        fmt::format("{}: the directory of [recipes] has no recipe, so that no brake could be checked: "
                    "write a .toml file a part number (docs/recipes.md), or leave [recipes] out",
                    directory));
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace

Result<Recipe> parse_recipe(const std::string& text, const std::string& path) {
  return parse_toml(text, path).and_then([&](const toml::table& document) {
    Recipe recipe;
    recipe.file = path;
    recipe.sha256 = sha256_hex(text);
    return RecipeReader(document, path).read(std::move(recipe));
  });
}

Result<std::vector<Recipe>> read_recipes(const std::string& directory) {
  const Result<std::vector<std::string>> files = recipe_files(directory);
  if (!files) return tl::unexpected(files.error());
  std::vector<Recipe> recipes;
  for (const std::string& file : *files) {
    Result<Recipe> recipe =
        read_file(file).and_then([&](const std::string& text) { return parse_recipe(text, file); });
    if (!recipe) return tl::unexpected(recipe.error());
    recipes.push_back(std::move(*recipe));
  }
  std::stable_sort(recipes.begin(), recipes.end(),
                   [](const Recipe& a, const Recipe& b) { return a.part_number < b.part_number; });
  const auto twice = std::adjacent_find(recipes.begin(), recipes.end(), [](const Recipe& a, const Recipe& b) {
    return a.part_number == b.part_number;
  });
  if (twice != recipes.end())
    return failure(
        fmt::format("{}: part number {} has a recipe in {} already; keep one of the two in the directory",
                    std::next(twice)->file, twice->part_number, twice->file));
  return recipes;
}

StationConfiguration with_recipe(StationConfiguration configuration, const Recipe& recipe) {
  configuration.part_number = recipe.part_number;
  for (const auto& [of_recipe, of_station] : {std::pair(&recipe.limits_file, &configuration.limits_file),
                                              std::pair(&recipe.sheet_file, &configuration.sheet_file),
                                              std::pair(&recipe.trajectory, &configuration.check.trajectory),
                                              std::pair(&recipe.model, &configuration.check.model)})
    if (!of_recipe->empty()) *of_station = *of_recipe;
  // Those of the station have been made for its own brakes, as its trajectory has.
  if (recipe.further_trajectories || !recipe.trajectory.empty())
    configuration.check.further_trajectories = recipe.further_trajectories;
  return configuration;
}

bool fits_pattern(std::string_view pattern, std::string_view text) {
  // Goes back to the last star only: one that came before cannot make more fit.
  std::size_t p = 0, t = 0, star = std::string_view::npos, after_star = 0;
  while (t < text.size()) {
    if (p < pattern.size() && pattern[p] == '*') {
      star = p++;
      after_star = t;
    } else if (p < pattern.size() && (pattern[p] == '?' || pattern[p] == text[t])) {
      ++p;
      ++t;
    } else if (star != std::string_view::npos) {
      p = star + 1;
      t = ++after_star;
    } else {
      return false;
    }
  }
  return pattern.find_first_not_of('*', p) == std::string_view::npos;
}

bool is_serial_of(const Recipe& recipe, std::string_view serial) {
  return std::any_of(recipe.serials.begin(), recipe.serials.end(),
                     [&](const std::string& pattern) { return fits_pattern(pattern, serial); });
}

}  // namespace clampd
