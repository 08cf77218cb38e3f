#include "clampd/views/population_view.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace clampd {
namespace {

using ::testing::HasSubstr;

// Each effect has words of its own for what it does.
TEST(PopulationView, HasWordsForEveryEffect) {
  const std::vector<EffectScore> directions = effects_with_strengths();
  attribution::PopulationTable table;
  attribution::PopulationResult result;
  table.groups = {{attribution::CheckGroup::Kind::Line, "", {0}},
                  {attribution::CheckGroup::Kind::Station, "north", {0}}};
  table.score.setZero(1, static_cast<Eigen::Index>(directions.size()));
  result.overdispersion.setOnes(static_cast<Eigen::Index>(directions.size()));
  for (int i = 0; i < static_cast<int>(directions.size()); ++i) {
    const EffectScore& direction = directions[static_cast<std::size_t>(i)];
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

}  // namespace
}  // namespace clampd
