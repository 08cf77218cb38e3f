#include "clampd/reanalysis/comparison.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace clampd::reanalysis {
namespace {

using nlohmann::json;

const json* find_parameter_in(const json& document, const std::string& name) {
  for (const json& parameter : document.at("parameters"))
    if (parameter.at("name") == name) return &parameter;
  return nullptr;
}

MovedParameter& entry_of(std::vector<MovedParameter>& list, const json& parameter) {
  const std::string name = parameter.at("name");
  const auto found =
      std::find_if(list.begin(), list.end(), [&](const auto& moved) { return moved.name == name; });
  if (found != list.end()) return *found;
  MovedParameter& added = list.emplace_back();
  added.name = name;
  added.unit = parameter.at("unit");
  return added;
}

/// `mean` is the sum until all checks are in.
void add_move(const std::string& check, const json& before, const json& after,
              std::vector<MovedParameter>& list) {
  if (!before.at("value").is_number() || !after.at("value").is_number()) return;
  const double move = after.at("value").get<double>() - before.at("value").get<double>();
  const double sd = before.at("sd").is_number() ? before.at("sd").get<double>() : 0.0;
  MovedParameter& moved = entry_of(list, after);
  ++moved.checks;
  moved.mean += move;
  if (moved.largest_in.empty() || std::abs(move) > std::abs(moved.largest)) {
    moved.largest = move;
    moved.largest_in = check;
  }
  if (move != 0.0)
    moved.largest_sd =
        std::max(moved.largest_sd, sd > 0.0 ? std::abs(move) / sd : std::numeric_limits<double>::infinity());
}

/// Diagnoses and scores do not; what was recorded has no schema.
bool identifies_parameters(const json& document) {
  const std::string schema = document.value("schema", "clampd.reanalysis/2");
  return schema == "clampd.reanalysis/2" || schema == "clampd.reanalysis/1";
}

/// Null where there is none, as in what earlier versions found.
json object_in(const json& document, const char* key) {
  return document.value(key, json());
}

json lines_of(const json& document) {
  const json sheet = object_in(document, "sheet");
  return sheet.is_null() ? json::array() : sheet.at("characteristics");
}

std::string verdict_of(const json& line) {
  return line.at("verdict").is_null() ? std::string() : line.at("verdict").get<std::string>();
}

void add_lines(const ComparedCheck& check, const json& before, const json& after, Comparison& comparison) {
  const json earlier = lines_of(before);
  for (const json& line : lines_of(after))
    for (const json& same : earlier)
      if (same.at("name") == line.at("name") && same.at("verdict") != line.at("verdict"))
        comparison.lines.push_back(
            {check.check, check.serial, line.at("name"), verdict_of(same), verdict_of(line)});
}

/// 0 for a fixed number of repeats.
double coverage_factor_of(const json& document) {
  const json stopping = object_in(document, "stopping");
  return stopping.is_null() ? 0.0 : stopping.value("coverage_factor", 0.0);
}

void add_guard_bands(const json& before, const json& after, Comparison& comparison) {
  // Its search ends at a few ten thousandths, to either side on other machines.
  constexpr double kSame = 1e-3;
  if (std::abs(coverage_factor_of(after) - coverage_factor_of(before)) > kSame) ++comparison.other_guard_bands;
  const json stopping = object_in(after, "stopping");
  if (!stopping.is_null() && stopping.at("rule") == "not on record") ++comparison.unknown_stopping;
}

/// Throws what nlohmann::json throws.
Result<void> add_check(const ComparedCheck& check, Comparison& comparison) {
  const json before = json::parse(check.before);
  const json after = json::parse(check.document);
  if (!identifies_parameters(before) || !identifies_parameters(after))
    return failure(fmt::format("check {}: a job of diagnoses or scores identifies no parameters that could be compared: see "
                               "`clampctl archive results` and `clampctl archive population`",
                               check.check));
  ++comparison.checks;
  if (before.at("verdict") != after.at("verdict"))
    comparison.verdicts.push_back(
        {check.check, check.serial, before.at("verdict"), after.at("verdict"), after.at("reason")});
  for (const json& parameter : after.at("parameters"))
    if (const json* earlier = find_parameter_in(before, parameter.at("name")))
      add_move(check.check, *earlier, parameter, comparison.parameters);
  add_lines(check, before, after, comparison);
  add_guard_bands(before, after, comparison);
  return {};
}

}  // namespace

Result<Comparison> compare(const std::vector<ComparedCheck>& checks) {
  Comparison comparison;
  for (const ComparedCheck& check : checks) try {
      if (const Result<void> added = add_check(check, comparison); !added) return tl::unexpected(added.error());
    } catch (const json::exception& wrong) {
      return failure(fmt::format("check {}: its result cannot be read: {}", check.check, wrong.what()));
    }
  for (MovedParameter& moved : comparison.parameters) moved.mean /= static_cast<double>(moved.checks);
  return comparison;
}

}  // namespace clampd::reanalysis
