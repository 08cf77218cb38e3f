#include "clampd/reanalysis/population.hpp"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/base/json.hpp"

namespace clampd::reanalysis {
namespace {

using attribution::CheckGroup;
using attribution::Direction;
using nlohmann::ordered_json;

/// Throws what nlohmann::json throws.
Result<EffectDirection> direction_of(const ordered_json& entry) {
  const std::string name = entry.at("effect"), parameter = entry.at("parameter");
  const auto at = entry.at("at").get<std::vector<double>>();
  const Effect* effect = find_effect(name);
  if (effect == nullptr) return failure(fmt::format("there is no effect {}", name));
  const auto& parameters = info_of(*effect).parameters;
  const auto strength = std::find_if(parameters.begin(), parameters.end(),
                                     [&](const EffectParameter& each) { return each.name == parameter; });
  if (strength == parameters.end() || at.size() != parameters.size())
    return failure(fmt::format("the effect {} has no {} of {} values", name, parameter, at.size()));
  return EffectDirection{{effect, at}, static_cast<std::size_t>(strength - parameters.begin())};
}

/// Seven digits are more than a check knows of its information, and make its result half as long.
double rounded(double value) {
  return std::stod(fmt::format("{:.7g}", value));
}

/// The line, then stations, fixtures and batches by name.
class Groups {
 public:
  void add(const ScoredCheck& check, int row) {
    line_.push_back(row);
    stations_[check.station].push_back(row);
    if (!check.fixture.empty())
      fixtures_[check.station][check.station + " / " + check.fixture].push_back(row);
    if (!check.batch.empty()) batches_[check.batch].push_back(row);
  }
  std::vector<CheckGroup> list() const {
    std::vector<CheckGroup> groups{{CheckGroup::Kind::Line, "", line_}};
    for (const auto& [name, rows] : stations_) groups.push_back({CheckGroup::Kind::Station, name, rows});
    for (const auto& [station, fixtures] : fixtures_)
      for (const auto& [name, rows] : fixtures)
        if (fixtures.size() > 1) groups.push_back({CheckGroup::Kind::Fixture, name, rows});
    for (const auto& [name, rows] : batches_) groups.push_back({CheckGroup::Kind::Batch, name, rows});
    return groups;
  }

 private:
  using Rows = std::map<std::string, std::vector<int>>;
  std::vector<int> line_;
  Rows stations_, batches_;
  std::map<std::string, Rows> fixtures_;
};

}  // namespace

Direction direction_in_words(const EffectDirection& direction) {
  const EffectInfo& info = info_of(*direction.effect.effect);
  const EffectParameter& strength = info.parameters[direction.parameter];
  std::string chosen;
  for (std::size_t i = 0; i < info.parameters.size(); ++i) {
    const EffectParameter& parameter = info.parameters[i];
    if (parameter.role == EffectParameter::Role::Strength ||
        parameter.role == EffectParameter::Role::Refinement)
      continue;
    const double value = direction.effect.values[i];
    const std::string_view name = choice_of(parameter, value);
    const std::string unit =
        parameter.unit.empty() || parameter.unit == "1" ? "" : fmt::format(" {}", parameter.unit);
    chosen += (chosen.empty() ? "" : ", ") +
              (name.empty() ? fmt::format("{} {:g}{}", parameter.name, value, unit) : std::string(name));
  }
  return {fmt::format("{}.{}{}", info.name, strength.name, chosen.empty() ? "" : " (" + chosen + ")"),
          std::string(strength.unit), strength.lower == strength.neutral};
}

ordered_json scores_json(const EffectScores& scores) {
  ordered_json directions = ordered_json::array(), score = ordered_json::array(),
               information = ordered_json::array();
  for (std::size_t i = 0; i < scores.directions.size(); ++i) {
    const EffectDirection& direction = scores.directions[i];
    const EffectInfo& info = info_of(*direction.effect.effect);
    directions.push_back({{"effect", info.name},
                          {"parameter", info.parameters[direction.parameter].name},
                          {"at", direction.effect.values}});
    score.push_back(number_or_null(scores.score[static_cast<Eigen::Index>(i)]));
    ordered_json row = ordered_json::array();
    for (std::size_t j = 0; j <= i; ++j)
      row.push_back(number_or_null(
          rounded(scores.information(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)))));
    information.push_back(std::move(row));
  }
  return {{"directions", std::move(directions)},
          {"score", std::move(score)},
          {"information", std::move(information)}};
}

Result<EffectScores> parse_scores(const std::string& document) {
  try {
    const ordered_json parsed = ordered_json::parse(document);
    if (parsed.at("schema") != "clampd.effect_scores/2")
      return failure(
          "its result is no clampd.effect_scores/2: submit a job with --score-effects, with this version");
    const ordered_json& json = parsed.at("scores");
    EffectScores scores;
    for (const ordered_json& entry : json.at("directions")) {
      const Result<EffectDirection> direction = direction_of(entry);
      if (!direction)
        return failure(fmt::format("{}: use the version that made this result, or submit the job again",
                                   direction.error().message));
      scores.directions.push_back(*direction);
    }
    const auto count = static_cast<Eigen::Index>(scores.directions.size());
    scores.score.setZero(count);
    scores.information.setZero(count, count);
    for (Eigen::Index i = 0; i < count; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const auto row = json.at("information").at(at).get<std::vector<double>>();
      if (row.size() != at + 1) return failure("its result cannot be read: the information is no triangle");
      scores.score[i] = json.at("score").at(at);
      for (Eigen::Index j = 0; j <= i; ++j)
        scores.information(i, j) = scores.information(j, i) = row[static_cast<std::size_t>(j)];
    }
    return scores;
  } catch (const nlohmann::json::exception& wrong) {
    return failure(fmt::format("its result cannot be read: {}", wrong.what()));
  }
}

Result<Population> population_of(std::vector<ScoredCheck> checks) {
  Population population;
  std::vector<EffectScores*> rows;
  Groups groups;
  std::set<std::pair<std::string, std::string>> seen;
  for (ScoredCheck& check : checks) {
    if (!check.serial.empty() && !seen.emplace(check.serial, check.station).second) {
      ++population.repeated;
      continue;
    }
    if (check.scores.directions != checks.front().scores.directions)
      return failure(fmt::format(
          "check {}: its result is of a version with other effects than that of check {}: submit the job "
          "again, so that one version does all of it",
          check.check, checks.front().check));
    groups.add(check, static_cast<int>(rows.size()));
    rows.push_back(&check.scores);
  }
  if (!checks.empty()) population.directions = checks.front().scores.directions;
  attribution::PopulationTable& table = population.table;
  for (const EffectDirection& direction : population.directions)
    table.directions.push_back(direction_in_words(direction));
  table.score.resize(static_cast<Eigen::Index>(rows.size()),
                     static_cast<Eigen::Index>(population.directions.size()));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    table.score.row(static_cast<Eigen::Index>(i)) = rows[i]->score.transpose();
    table.information.push_back(rows[i]->information.cast<float>());
    rows[i]->information.resize(0, 0);  // a line's checks fill the memory once, not twice
  }
  table.groups = groups.list();
  return population;
}

}  // namespace clampd::reanalysis
