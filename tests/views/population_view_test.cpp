#include "clampd/views/population_view.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace clampd {
namespace {

using ::testing::HasSubstr;

// Each effect has words of its own for what it does.
TEST(PopulationView, HasWordsForEveryEffect) {
  const std::vector<EffectDirection> directions = effects_with_strengths();
  attribution::PopulationTable table;
  attribution::PopulationResult result;
  table.groups = {{attribution::CheckGroup::Kind::Line, "", {0}},
                  {attribution::CheckGroup::Kind::Station, "north", {0}}};
  table.score.setZero(1, static_cast<Eigen::Index>(directions.size()));
  result.overdispersion.setOnes(static_cast<Eigen::Index>(directions.size()));
  for (int i = 0; i < static_cast<int>(directions.size()); ++i) {
    const EffectDirection& direction = directions[static_cast<std::size_t>(i)];
    const EffectParameter& strength = info_of(*direction.effect.effect).parameters[direction.parameter];
    table.directions.push_back({"direction " + std::to_string(i), std::string(strength.unit), false});
    attribution::PopulationFinding finding;
    finding.suspect = {i, 1};
    finding.size = strength.scale;
    finding.sd = 0.1 * strength.scale;
    finding.rivals = {{0, 0}};
    result.findings.push_back(finding);
  }
  const std::string text = format_population(table, directions, result, 0.01);
  for (const attribution::Direction& direction : table.directions)
    EXPECT_THAT(text, HasSubstr(direction.name + " = "));
  EXPECT_THAT(text, HasSubstr("(viscous 0.0001 N m s/rad)")) << "of two strengths the one that was found";
  EXPECT_THAT(text, HasSubstr("station north: "));
  EXPECT_THAT(text, HasSubstr("these checks do not tell it from: direction 0 of the whole line"));
  EXPECT_THAT(text, HasSubstr("the reading of clamp force comes 0.5 ms late"));
  EXPECT_EQ(population_json(table, directions, result, 0.01)["findings"].size(), directions.size());
}

TEST(PopulationView, SaysWhichStationsAreFarthestApart) {
  const std::vector<EffectDirection> directions = effects_with_strengths();
  attribution::PopulationTable table;
  table.groups = {{attribution::CheckGroup::Kind::Line, "", {0}}};
  for (const char* name : {"north", "south", "west"})
    table.groups.push_back({attribution::CheckGroup::Kind::Station, name, {0}});
  for (std::size_t i = 0; i < directions.size(); ++i)
    table.directions.push_back({"direction " + std::to_string(i), "s", false});
  attribution::PopulationResult result;
  result.overdispersion.setOnes(static_cast<Eigen::Index>(directions.size()));
  result.differences.push_back({.direction = 1,
                                .sd = 0.002,
                                .p = 1e-9,
                                .of_one_check = 3.0,
                                .levels = {{1, 0.001, 1e-4}, {2, -0.003, 1e-4}, {3, 0.002, 1e-4}},
                                .rivals = {4}});
  const std::string text = format_population(table, directions, result, 0.01);
  EXPECT_THAT(text, HasSubstr("stations differ in direction 1: standard deviation 0.002 s"));
  EXPECT_THAT(text, HasSubstr("from south -0.003 ± 0.0002 to west 0.002 ± 0.0002"));
  EXPECT_THAT(text, HasSubstr("these checks do not tell it from: direction 4"));
  EXPECT_THAT(text, ::testing::Not(HasSubstr("Neither")));
  const nlohmann::ordered_json json = population_json(table, directions, result, 0.01);
  EXPECT_EQ(json["stations_differ"][0]["stations"][1]["name"], "south");
  EXPECT_EQ(json["stations_differ"][0]["rivals"].size(), 1U);
}

}  // namespace
}  // namespace clampd
