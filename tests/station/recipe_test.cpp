// Recipes: what is read of them, and what is refused with which words.

#include "clampd/station/recipe.hpp"

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/record/checksum.hpp"
#include "clampd/station/configuration.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr const char* kName = "part_number = \"BX-200\"\nversion = \"3\"\n";
constexpr const char* kInlineLimits = R"([limits]
revision = "7"
author = "Jo"
changed = 2026-11-20
guard_band_k = 1.5
[limits.parameters]
k1 = {lower = -0.46, upper = -0.25}
[limits.parameters_normalised]
k2 = {lower = 0.1, upper = 1.15}
TC = {lower = 0.5, upper = 2.0}
Ts0 = {lower = 0.3, upper = 1.7}
Tv = {lower = 0.25, upper = 3.0}
mus = {lower = 0.75, upper = 1.25}
ws = {lower = 0.25, upper = 2.0}
)";

class Recipes : public ::testing::Test {
 protected:
  Recipes() { std::filesystem::create_directory(folder_.path("files")); }
  std::string file(const std::string& name = "bx.toml") const { return folder_.path(name); }
  Result<Recipe> parse(const std::string& text) const { return parse_recipe(text, file()); }
  std::string refusal(const std::string& text) const {
    const Result<Recipe> recipe = parse(text);
    return recipe ? "taken" : recipe.error().message;
  }
  support::TemporaryDirectory folder_;
};

TEST_F(Recipes, NameTheirFilesFromTheirOwnFolder) {
  for (const char* name : {"limits.toml", "sheet.toml", "steep.csv", "model.toml", "bx.dbc"})
    folder_.write(std::string("files/") + name, "");
  const std::string text = std::string(kName) + R"(serials = ["BX2-*", " ?X2A "]
[limits]
file = "files/limits.toml"
[sheet]
file = "files/sheet.toml"
[check]
trajectory = "files/steep.csv"
model = "files/model.toml"
[can]
dbc = "files/bx.dbc"
[can.mapping]
force = "Brake.Force"
)";
  const Result<Recipe> recipe = parse(text);
  ASSERT_TRUE(recipe) << recipe.error().message;
  EXPECT_EQ(recipe->record(), (RecipeRecord{file(), "3", sha256_hex(text)}));
  EXPECT_THAT(recipe->serials, ElementsAre("BX2-*", "?X2A"));
  EXPECT_TRUE(recipe->states_can_layout());
  EXPECT_EQ(recipe->dbc, folder_.path("files/bx.dbc"));
  EXPECT_THAT(recipe->mapping, ElementsAre(::testing::Pair("force", "Brake.Force")));
  StationConfiguration station;
  station.name = "line 3";
  const StationConfiguration merged = with_recipe(station, *recipe);
  EXPECT_EQ(merged.name, "line 3");
  EXPECT_EQ(merged.part_number, "BX-200");
  EXPECT_EQ(merged.limits_file, folder_.path("files/limits.toml"));
  EXPECT_EQ(merged.sheet_file, folder_.path("files/sheet.toml"));
  EXPECT_EQ(merged.check.trajectory, folder_.path("files/steep.csv"));
  EXPECT_EQ(merged.check.model, folder_.path("files/model.toml"));
}

TEST_F(Recipes, LeaveTheStationsOwnWhereTheyNameNothing) {
  StationConfiguration station;
  station.limits_file = "/l.toml";
  station.check.trajectory = "/t.csv";
  const StationConfiguration merged = with_recipe(station, parse(kName).value());
  EXPECT_EQ(merged.limits_file, "/l.toml");
  EXPECT_EQ(merged.check.trajectory, "/t.csv");
}

TEST_F(Recipes, HoldLimitsThatReadBackTheSameAsAFile) {
  const Result<Recipe> recipe = parse(std::string(kName) + kInlineLimits);
  ASSERT_TRUE(recipe) << recipe.error().message;
  const LimitSet& limits = recipe->limits.value();
  EXPECT_EQ(limits.revision, "7");
  EXPECT_EQ(limits.changed, "2026-11-20");
  EXPECT_EQ(limits.guard_band_k, 1.5);
  EXPECT_EQ(limits.intervals[k1].lower, -0.46);
  EXPECT_DOUBLE_EQ(limits.intervals[k2].upper, 1.15 * nominal_parameters()[k2]);
  const Result<LimitSet> kept = parse_limits(limits.contents, "kept.toml");
  ASSERT_TRUE(kept) << kept.error().message;
  EXPECT_THAT(changes_between(limits, *kept), ::testing::IsEmpty());
  EXPECT_EQ(kept->sha256, limits.sha256);
  EXPECT_EQ(kept->guard_band_k, 1.5);

  const Result<Recipe> later =
      parse("version = \"4\"\npart_number = \"BX-200\"\n" + std::string(kInlineLimits));
  EXPECT_EQ(later->limits->sha256, limits.sha256) << "another version with the same limits judges alike";
  EXPECT_NE(later->sha256, recipe->sha256);
}

TEST_F(Recipes, AreRefusedWithFileLineAndWhatToDo) {
  EXPECT_THAT(refusal(""), AllOf(StartsWith(file() + ":1:1: "), HasSubstr("part_number = \"...\"")));
  EXPECT_THAT(refusal("part_number = \"  \"\nversion = \"1\"\n"), StartsWith(file() + ":1:"));
  EXPECT_THAT(refusal("part_number = \"P\"\n"), HasSubstr("needs a version"));
  EXPECT_THAT(refusal("part_number = \"P\"\nversion = 3\n"),
              AllOf(StartsWith(file() + ":2:"), HasSubstr("text")));
  EXPECT_THAT(refusal(std::string(kName) + "serial = [\"A*\"]\n"),
              AllOf(StartsWith(file() + ":3:"), HasSubstr("did you mean serials?")));
  EXPECT_THAT(refusal(std::string(kName) + "serials = [\"*\"]\n"),
              AllOf(StartsWith(file() + ":3:"), HasSubstr("every part")));
  EXPECT_THAT(refusal(std::string(kName) + "[check]\ntrajectory = \"none.csv\"\n"),
              AllOf(StartsWith(file() + ":4:"), HasSubstr(folder_.path("none.csv"))));
  EXPECT_THAT(refusal(std::string(kName) + "[check]\ntorque_limit_Nm = 9\n"), StartsWith(file() + ":4:"));
  EXPECT_THAT(refusal(std::string(kName) + "[can.mapping]\nforces = \"A.B\"\n"), StartsWith(file() + ":4:"));
  folder_.write("limits.toml", "");
  EXPECT_THAT(refusal(std::string(kName) + "[limits]\nfile = \"limits.toml\"\nrevision = \"1\"\n"),
              AllOf(StartsWith(file() + ":3:"), HasSubstr("either name the file")));
  std::string limits = kInlineLimits;
  limits.replace(limits.find("lower = 0.1"), 11, "lower = 9.1");
  EXPECT_THAT(refusal(std::string(kName) + limits),
              AllOf(StartsWith(file() + ":11:"), HasSubstr("k2: lower 9.1")));
  EXPECT_THAT(refusal(std::string(kName) + "[limits]\nrevision = \"1\"\n"),
              AllOf(StartsWith(file() + ":3: [limits]: no limits for k1"), HasSubstr("[limits.parameters]")));
}

TEST_F(Recipes, OfADirectoryHaveOnePartNumberEach) {
  EXPECT_THAT(read_recipes(folder_.path("none")).error().message, HasSubstr("cannot be read"));
  EXPECT_THAT(read_recipes(folder_.path("")).error().message, HasSubstr("has no recipe"));
  folder_.write("b.toml", "part_number = \"A-1\"\nversion = \"1\"\n");
  folder_.write("a.toml", kName);
  folder_.write("notes.txt", "not a recipe");
  folder_.write("files/limits.toml", "not a recipe either");
  const auto recipes = read_recipes(folder_.path(""));
  ASSERT_TRUE(recipes) << recipes.error().message;
  ASSERT_EQ(recipes->size(), 2U);
  EXPECT_EQ((*recipes)[0].part_number, "A-1");
  EXPECT_EQ((*recipes)[1].part_number, "BX-200");
  folder_.write("c.toml", "part_number = \" BX-200\"\nversion = \"4\"\n");
  EXPECT_THAT(read_recipes(folder_.path("")).error().message,
              AllOf(HasSubstr("c.toml: "), HasSubstr("BX-200"), HasSubstr("a.toml already")));
}

TEST_F(Recipes, AndAConfiguredPartNumberExcludeEachOther) {
  const auto both = parse_station_configuration(
      "[station]\npart_number = \"P\"\n[recipes]\ndirectory = \"r\"\n", "/etc/clampd/station.toml");
  ASSERT_FALSE(both);
  EXPECT_THAT(both.error().message, AllOf(HasSubstr("station.toml:3:"), HasSubstr("exclude each other")));
  EXPECT_EQ(parse_station_configuration("[recipes]\ndirectory = \"r\"\n", "/etc/clampd/station.toml")
                ->recipes_directory,
            "/etc/clampd/r");
}

TEST(SerialPatterns, StandForWhatTheySay) {
  for (const auto& [pattern, text] : {std::pair("BX2-*", "BX2-0001"),
                                      {"BX2-*", "BX2-"},
                                      {"*-7?", "A-1-70"},
                                      {"A*B*C", "AxBxxBC"},
                                      {"EXACT", "EXACT"},
                                      {"?", "*"}})
    EXPECT_TRUE(fits_pattern(pattern, text)) << pattern << ' ' << text;
  for (const auto& [pattern, text] : {std::pair("BX2-*", "BX3-0001"),
                                      {"BX2-*", "bx2-1"},
                                      {"*-7?", "A-7"},
                                      {"A*B*C", "ABD"},
                                      {"EXACT", "EXACT1"},
                                      {"A?", "A"},
                                      {"A", ""}})
    EXPECT_FALSE(fits_pattern(pattern, text)) << pattern << ' ' << text;
}

}  // namespace
}  // namespace clampd
