#include "clampd/reanalysis/population.hpp"

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

/// As one list says it, so that lists can be compared without their numbers.
struct Asked {
  std::string effect, parameter;
  std::vector<double> at;

  bool operator==(const Asked&) const = default;
};

struct Answers {
  std::vector<Asked> asked;
  std::vector<double> scores, informations;
};

/// Throws what nlohmann::json throws.
Answers answers_of(const ordered_json& document) {
  Answers answers;
  for (const ordered_json& each : document.at("scores")) {
    answers.asked.push_back(
        {each.at("effect"), each.at("parameter"), each.at("at").get<std::vector<double>>()});
    const bool tells = each.at("score").is_number() && each.at("information").is_number();
    answers.scores.push_back(tells ? each.at("score").get<double>() : 0.0);
    answers.informations.push_back(tells ? each.at("information").get<double>() : 0.0);
  }
  return answers;
}

Result<EffectScore> direction_of(const Asked& asked) {
  const Effect* effect = find_effect(asked.effect);
  if (effect == nullptr) return failure(fmt::format("there is no effect {}", asked.effect));
  const auto& parameters = info_of(*effect).parameters;
  for (std::size_t i = 0; i < parameters.size() && asked.at.size() == parameters.size(); ++i)
    if (parameters[i].name == asked.parameter) return EffectScore{{effect, asked.at}, i, 0.0, 0.0};
  return failure(
      fmt::format("the effect {} has no {} of {} values", asked.effect, asked.parameter, asked.at.size()));
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

Result<Answers> read(const ScoredCheck& check) {
  try {
    const ordered_json document = ordered_json::parse(check.document);
    if (document.at("schema") != "clampd.effect_scores/1")
      return failure(
          fmt::format("check {}: its result is no clampd.effect_scores/1: submit a job with --score-effects",
                      check.check));
    return answers_of(document);
  } catch (const nlohmann::json::exception& wrong) {
    return failure(fmt::format("check {}: its result cannot be read: {}", check.check, wrong.what()));
  }
}

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

Result<Population> population_of(const std::vector<ScoredCheck>& checks) {
  Population population;
  std::vector<Asked> asked;
  std::vector<Answers> rows;
  Groups groups;
  std::set<std::pair<std::string, std::string>> seen;
  for (const ScoredCheck& check : checks) {
    if (!check.serial.empty() && !seen.emplace(check.serial, check.station).second) {
      ++population.repeated;
      continue;
    }
    Result<Answers> answers = read(check);
    if (!answers) return tl::unexpected(answers.error());
    if (rows.empty()) asked = answers->asked;
    if (answers->asked != asked)
      return failure(
          fmt::format("check {}: its result is of a version with other effects than that of check {}: submit "
                      "the job again, so that "
                      "one version does all of it",
                      check.check, checks.front().check));
    groups.add(check, static_cast<int>(rows.size()));
    rows.push_back(std::move(*answers));
  }
  for (const Asked& each : asked) {
    const Result<EffectScore> direction = direction_of(each);
    if (!direction)
      return failure(
          fmt::format("check {}: {}: use the version that made this result, or submit the job again",
                      checks.front().check, direction.error().message));
    population.directions.push_back(*direction);
    population.table.directions.push_back(direction_in_words(*direction));
  }
  const auto count = static_cast<Eigen::Index>(rows.size()),
             columns = static_cast<Eigen::Index>(asked.size());
  population.table.score.resize(count, columns);
  population.table.information.resize(count, columns);
  for (Eigen::Index i = 0; i < count; ++i)
    for (Eigen::Index j = 0; j < columns; ++j) {
      const Answers& row = rows[static_cast<std::size_t>(i)];
      population.table.score(i, j) = row.scores[static_cast<std::size_t>(j)];
      population.table.information(i, j) = row.informations[static_cast<std::size_t>(j)];
    }
  population.table.groups = groups.list();
  return population;
}

}  // namespace clampd::reanalysis
