#include "clampd/views/population_view.hpp"

#include <algorithm>
#include <limits>
#include <vector>

#include <fmt/format.h>

#include "clampd/base/json.hpp"

namespace clampd {
namespace {

using attribution::CheckGroup;
using attribution::Direction;
using attribution::PopulationFinding;
using attribution::PopulationResult;
using attribution::PopulationTable;
using attribution::StationDifference;
using nlohmann::ordered_json;

constexpr double kShownByOneCheck = 2.0;  // standard deviations

const char* kind_of(const CheckGroup& group) {
  switch (group.kind) {
    case CheckGroup::Kind::Line:
      return "line";
    case CheckGroup::Kind::Station:
      return "station";
    case CheckGroup::Kind::Fixture:
      return "fixture";
    case CheckGroup::Kind::Batch:
      return "batch";
  }
  return "";
}

const CheckGroup& group_of(const PopulationTable& table, const PopulationFinding::Suspect& suspect) {
  return table.groups[static_cast<std::size_t>(suspect.group)];
}

const Direction& direction_of(const PopulationTable& table, const PopulationFinding::Suspect& suspect) {
  return table.directions[static_cast<std::size_t>(suspect.direction)];
}

std::string name_of(const CheckGroup& group) {
  return group.kind == CheckGroup::Kind::Line ? "the whole line"
                                              : fmt::format("{} {}", kind_of(group), group.name);
}

/// What the effect does with this strength. Of its other strengths nothing is known.
std::string effect_in_words(const EffectDirection& direction, const PopulationFinding& finding) {
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  EffectValues values = direction.effect;
  values.values[direction.parameter] = finding.size;
  std::vector<double> deviations(values.values.size(), kUnknown);
  deviations[direction.parameter] = finding.sd;
  return in_words(values, deviations, kUnknown);
}

std::string sentence(const PopulationTable& table, std::span<const EffectDirection> directions,
                     const PopulationFinding& finding) {
  const CheckGroup& group = group_of(table, finding.suspect);
  const Direction& direction = direction_of(table, finding.suspect);
  const EffectDirection& effect = directions[static_cast<std::size_t>(finding.suspect.direction)];
  std::string text = fmt::format(
      "{}: {}\n  {} = {:.3g} ± {:.2g} {}{}, from {} checks; one of them shows it to {:.2g} standard "
      "deviations\n",
      name_of(group), effect_in_words(effect, finding), direction.name, finding.size, 1.96 * finding.sd,
      direction.unit, group.kind == CheckGroup::Kind::Line ? "" : " against the others", group.checks.size(),
      finding.of_one_check);
  if (finding.of_one_check > kShownByOneCheck)
    text += "  single checks show it: `clampctl archive submit --diagnose` tells more\n";
  std::string rivals;
  for (const PopulationFinding::Suspect& rival : finding.rivals) {
    const CheckGroup& other = group_of(table, rival);
    rivals += fmt::format("{}{}{}", rivals.empty() ? "" : "; ", direction_of(table, rival).name,
                          rival.group == finding.suspect.group ? "" : " of " + name_of(other));
  }
  if (!rivals.empty()) text += fmt::format("  these checks do not tell it from: {}\n", rivals);
  return text;
}

std::string sentence(const PopulationTable& table, const StationDifference& difference) {
  const Direction& direction = table.directions[static_cast<std::size_t>(difference.direction)];
  std::string text = fmt::format(
      "stations differ in {}: standard deviation {:.3g} {}; one check shows that to {:.2g} standard "
      "deviations\n",
      direction.name, difference.sd, direction.unit, difference.of_one_check);
  std::vector<StationDifference::Level> levels = difference.levels;
  std::sort(levels.begin(), levels.end(), [](const auto& a, const auto& b) { return a.size < b.size; });
  const auto in_words = [&](const StationDifference::Level& level) {
    return fmt::format("{} {:.3g} ± {:.2g}", table.groups[static_cast<std::size_t>(level.group)].name,
                       level.size, 1.96 * level.sd);
  };
  if (!levels.empty())
    text += fmt::format("  against their mean, from {} to {}\n", in_words(levels.front()),
                        in_words(levels.back()));
  std::string rivals;
  for (const int rival : difference.rivals)
    rivals += (rivals.empty() ? "" : "; ") + table.directions[static_cast<std::size_t>(rival)].name;
  if (!rivals.empty()) text += fmt::format("  these checks do not tell it from: {}\n", rivals);
  return text;
}

}  // namespace

std::string format_population(const PopulationTable& table, std::span<const EffectDirection> directions,
                              const PopulationResult& result, double false_alarms) {
  std::string text =
      fmt::format("{} checks, {} directions of effects, {} groups ({} of them too small to tell)\n\n",
                  table.score.rows(), table.directions.size(), table.groups.size(), result.groups_too_small);
  for (const PopulationFinding& finding : result.findings) text += sentence(table, directions, finding);
  for (const StationDifference& difference : result.differences) text += sentence(table, difference);
  text +=
      result.findings.empty() && result.differences.empty()
          ? "Neither the line nor any station, fixture or batch shows an effect.\n"
          : fmt::format("(Where there is none of this, something is found with a probability of {:g} %.)\n",
                        100.0 * false_alarms);
  return text;
}

ordered_json population_json(const PopulationTable& table, std::span<const EffectDirection> directions,
                             const PopulationResult& result, double false_alarms) {
  const auto direction_json = [&](int number) -> ordered_json {
    const EffectDirection& direction = directions[static_cast<std::size_t>(number)];
    const EffectInfo& info = info_of(*direction.effect.effect);
    return {{"effect", info.name},
            {"parameter", info.parameters[direction.parameter].name},
            {"direction", table.directions[static_cast<std::size_t>(number)].name}};
  };
  const auto suspect_json = [&](const PopulationFinding::Suspect& suspect) {
    ordered_json json = direction_json(suspect.direction);
    json["group"] = kind_of(group_of(table, suspect));
    json["name"] = group_of(table, suspect).name;
    return json;
  };
  ordered_json findings = ordered_json::array();
  for (const PopulationFinding& finding : result.findings) {
    ordered_json json = suspect_json(finding.suspect);
    json["unit"] = direction_of(table, finding.suspect).unit;
    json["size"] = number_or_null(finding.size);
    json["sd"] = number_or_null(finding.sd);
    json["t"] = number_or_null(finding.t);
    json["p_value"] = number_or_null(finding.p);
    json["checks"] = group_of(table, finding.suspect).checks.size();
    json["of_one_check_sd"] = number_or_null(finding.of_one_check);
    json["rivals"] = ordered_json::array();
    for (const PopulationFinding::Suspect& rival : finding.rivals)
      json["rivals"].push_back(suspect_json(rival));
    findings.push_back(std::move(json));
  }
  ordered_json differences = ordered_json::array();
  for (const StationDifference& difference : result.differences) {
    ordered_json json = direction_json(difference.direction);
    json["unit"] = table.directions[static_cast<std::size_t>(difference.direction)].unit;
    json["sd"] = number_or_null(difference.sd);
    json["p_value"] = number_or_null(difference.p);
    json["of_one_check_sd"] = number_or_null(difference.of_one_check);
    json["stations"] = ordered_json::array();
    for (const StationDifference::Level& level : difference.levels)
      json["stations"].push_back({{"name", table.groups[static_cast<std::size_t>(level.group)].name},
                                  {"size", number_or_null(level.size)},
                                  {"sd", number_or_null(level.sd)}});
    json["rivals"] = ordered_json::array();
    for (const int rival : difference.rivals) json["rivals"].push_back(direction_json(rival));
    differences.push_back(std::move(json));
  }
  ordered_json overdispersion = ordered_json::object();
  for (std::size_t j = 0; j < table.directions.size(); ++j)
    overdispersion[table.directions[j].name] =
        number_or_null(result.overdispersion[static_cast<Eigen::Index>(j)]);
  return {{"schema", "clampd.population/2"},
          {"checks", table.score.rows()},
          {"tests", result.tests},
          {"false_alarms", false_alarms},
          {"findings", std::move(findings)},
          {"stations_differ", std::move(differences)},
          {"overdispersion", std::move(overdispersion)}};
}

}  // namespace clampd
