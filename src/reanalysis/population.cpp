#include "clampd/reanalysis/population.hpp"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace clampd::reanalysis {
namespace {

using attribution::CheckGroup;
using attribution::Direction;
using nlohmann::ordered_json;

/// Throws what nlohmann::json throws.
Result<EffectScore> score_of(const ordered_json& entry) {
  const std::string name = entry.at("effect"), parameter = entry.at("parameter");
  const auto at = entry.at("at").get<std::vector<double>>();
  const Effect* effect = find_effect(name);
  if (effect == nullptr) return failure(fmt::format("there is no effect {}", name));
  const auto& parameters = info_of(*effect).parameters;
  const auto strength = std::find_if(parameters.begin(), parameters.end(),
                                     [&](const EffectParameter& each) { return each.name == parameter; });
  if (strength == parameters.end() || at.size() != parameters.size())
    return failure(fmt::format("the effect {} has no {} of {} values", name, parameter, at.size()));
  EffectScore score{{effect, at}, static_cast<std::size_t>(strength - parameters.begin())};
  if (entry.at("score").is_number() && entry.at("information").is_number()) {
    score.score = entry.at("score");
    score.information = entry.at("information");
  }
  return score;
}

bool is_same_direction(const EffectScore& a, const EffectScore& b) {
  return a.effect.effect == b.effect.effect && a.effect.values == b.effect.values &&
         a.parameter == b.parameter;
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

Direction direction_in_words(const EffectScore& score) {
  const EffectInfo& info = info_of(*score.effect.effect);
  const EffectParameter& strength = info.parameters[score.parameter];
  std::string chosen;
  for (std::size_t i = 0; i < info.parameters.size(); ++i) {
    const EffectParameter& parameter = info.parameters[i];
    if (parameter.role == EffectParameter::Role::Strength ||
        parameter.role == EffectParameter::Role::Refinement)
      continue;
    const double value = score.effect.values[i];
    const std::string_view name = choice_of(parameter, value);
    const std::string unit =
        parameter.unit.empty() || parameter.unit == "1" ? "" : fmt::format(" {}", parameter.unit);
    chosen += (chosen.empty() ? "" : ", ") +
              (name.empty() ? fmt::format("{} {:g}{}", parameter.name, value, unit) : std::string(name));
  }
  return {fmt::format("{}.{}{}", info.name, strength.name, chosen.empty() ? "" : " (" + chosen + ")"),
          std::string(strength.unit), strength.lower == strength.neutral};
}

Result<std::vector<EffectScore>> parse_scores(const std::string& document) {
  try {
    const ordered_json parsed = ordered_json::parse(document);
    if (parsed.at("schema") != "clampd.effect_scores/1")
      return failure("its result is no clampd.effect_scores/1: submit a job with --score-effects");
    std::vector<EffectScore> scores;
    for (const ordered_json& entry : parsed.at("scores")) {
      const Result<EffectScore> score = score_of(entry);
      if (!score)
        return failure(fmt::format("{}: use the version that made this result, or submit the job again",
                                   score.error().message));
      scores.push_back(*score);
    }
    return scores;
  } catch (const nlohmann::json::exception& wrong) {
    return failure(fmt::format("its result cannot be read: {}", wrong.what()));
  }
}

Result<Population> population_of(const std::vector<ScoredCheck>& checks) {
  Population population;
  std::vector<const std::vector<EffectScore>*> rows;
  Groups groups;
  std::set<std::pair<std::string, std::string>> seen;
  for (const ScoredCheck& check : checks) {
    if (!check.serial.empty() && !seen.emplace(check.serial, check.station).second) {
      ++population.repeated;
      continue;
    }
    const std::vector<EffectScore>& first = checks.front().scores;
    if (!std::equal(first.begin(), first.end(), check.scores.begin(), check.scores.end(), is_same_direction))
      return failure(fmt::format(
          "check {}: its result is of a version with other effects than that of check {}: submit the job "
          "again, so that one version does all of it",
          check.check, checks.front().check));
    groups.add(check, static_cast<int>(rows.size()));
    rows.push_back(&check.scores);
  }
  if (!checks.empty()) population.directions = checks.front().scores;
  attribution::PopulationTable& table = population.table;
  for (const EffectScore& direction : population.directions)
    table.directions.push_back(direction_in_words(direction));
  const auto count = static_cast<Eigen::Index>(rows.size()),
             columns = static_cast<Eigen::Index>(population.directions.size());
  table.score.resize(count, columns);
  table.information.resize(count, columns);
  for (Eigen::Index i = 0; i < count; ++i)
    for (Eigen::Index j = 0; j < columns; ++j) {
      const EffectScore& score = (*rows[static_cast<std::size_t>(i)])[static_cast<std::size_t>(j)];
      table.score(i, j) = score.score;
      table.information(i, j) = score.information;
    }
  table.groups = groups.list();
  return population;
}

}  // namespace clampd::reanalysis
