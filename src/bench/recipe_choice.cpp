#include <fmt/format.h>
#include <fmt/ranges.h>

#include "clampd/bench/prepared_station.hpp"

namespace clampd::bench {
namespace {

std::string known_part_numbers(const PreparedStation& station) {
  std::vector<std::string_view> names;
  for (const PreparedRecipe& known : station.recipes) names.push_back(known.recipe.part_number);
  return fmt::format("{}", fmt::join(names, ", "));
}

/// The recipes whose patterns this serial number fits.
std::vector<const PreparedRecipe*> recipes_of(const PreparedStation& station, const std::string& serial) {
  std::vector<const PreparedRecipe*> found;
  for (const PreparedRecipe& known : station.recipes)
    if (is_serial_of(known.recipe, serial)) found.push_back(&known);
  return found;
}

Result<const PreparedRecipe*> by_part_number(const PreparedStation& station, const CheckRequest& request) {
  const PreparedRecipe* asked = nullptr;
  for (const PreparedRecipe& known : station.recipes)
    if (known.recipe.part_number == request.part_number) asked = &known;
  if (asked == nullptr)
    return failure(
        fmt::format("part number {} has no recipe, so that it is not known what a good brake is; known "
                    "are: {}",
                    request.part_number, known_part_numbers(station)));
  if (is_serial_of(asked->recipe, request.serial)) return asked;
  if (const auto others = recipes_of(station, request.serial); !others.empty())
    return failure(
        fmt::format("serial number {} is one of part number {} by its recipe, and part number {} was asked for: look "
                    "which brake is in the fixture",
                    request.serial, others.front()->recipe.part_number, request.part_number));
  if (!asked->recipe.serials.empty())
    return failure(
        fmt::format("serial number {} is none of part number {}, whose recipe has the serial numbers {}: look which "
                    "brake is in the fixture",
                    request.serial, request.part_number, fmt::join(asked->recipe.serials, ", ")));
  return asked;
}

/// Null: the serial number says nothing.
Result<const PreparedRecipe*> by_serial(const PreparedStation& station, const CheckRequest& request) {
  const std::vector<const PreparedRecipe*> found = recipes_of(station, request.serial);
  if (found.size() > 1)
    return failure(
        fmt::format("serial number {} fits the recipes of part numbers {} and {}: give the part number "
                    "(--part-number), or make the serials of {} and {} exclude each other",
                    request.serial, found[0]->recipe.part_number, found[1]->recipe.part_number,
                    found[0]->recipe.file, found[1]->recipe.file));
  return found.empty() ? nullptr : found.front();
}

}  // namespace

Result<ChosenCheck> choose_check(const PreparedStation& station, const CheckRequest& request) {
  const StationConfiguration& configuration = station.configuration;
  if (station.recipes.empty()) {
    if (request.part_number.empty() || request.part_number == configuration.part_number)
      return ChosenCheck{&station};
    return failure(
        fmt::format("part number {} was given, but this station has no recipes, so that every brake is "
                    "judged by the same limits "
                    "whatever its part: leave --part-number (part_number) out, or give each part a recipe "
                    "([recipes] directory "
                    "in {}; docs/recipes.md). What records call the part is [station] part_number",
                    request.part_number,
                    configuration.file.empty() ? "the station's configuration" : configuration.file));
  }
  const Result<const PreparedRecipe*> chosen =
      request.part_number.empty() ? by_serial(station, request) : by_part_number(station, request);
  if (!chosen) return tl::unexpected(chosen.error());
  if (*chosen == nullptr) {
    const std::string& master = configuration.master.serial;
    if (!master.empty() && request.serial == master) return ChosenCheck{&station};
    return failure(
        fmt::format("the part number of {} is not known, and no recipe's serials fit it: give the part "
                    "number (--part-number, part_number); known are: {}",
                    request.serial, known_part_numbers(station)));
  }
  const PreparedRecipe& recipe = **chosen;
  if (!recipe.refusal.empty())
    return failure(
        fmt::format("part number {} cannot be checked here: {}", recipe.recipe.part_number, recipe.refusal));
  return ChosenCheck{&recipe, recipe.recipe.record()};
}

}  // namespace clampd::bench
