// A station that checks brakes of two part numbers: what chooses the recipe, and that no brake is judged by
// the limits of another part.

#include <filesystem>
#include <fstream>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/record/checksum.hpp"
#include "clampd/station/verdict.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::bench {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

/// What a nominal brake passes with factors around 1, and fails where k2 must be elsewhere.
std::string limits(double k2_lower, double k2_upper) {
  return fmt::format(R"([limits]
revision = "k2 {0}"
[limits.parameters_normalised]
k1 = {{lower = 0.1, upper = 3.0}}
k2 = {{lower = {0}, upper = {1}}}
TC = {{lower = 0.1, upper = 4.0}}
Ts0 = {{lower = 0.1, upper = 4.0}}
Tv = {{lower = 0.1, upper = 9.0}}
mus = {{lower = 0.1, upper = 4.0}}
ws = {{lower = 0.1, upper = 9.0}}
)",
                     k2_lower, k2_upper);
}

class StationWithRecipes : public ::testing::Test {
 protected:
  StationWithRecipes() {
    std::filesystem::create_directory(folder_.path("recipes"));
    std::filesystem::create_directory(folder_.path("recipes/files"));
    write("soft", "version = \"1\"\nserials = [\"S-*\"]\n" + limits(0.8, 1.2));
    write("stiff", "version = \"2\"\n" + limits(1.5, 2.0));
    configuration_.recipes_directory = folder_.path("recipes");
    configuration_.check.diagnose = false;  // which a FAIL would ask for, and which is not what is tested
  }
  void write(const std::string& part, const std::string& rest) {
    folder_.write("recipes/" + part + ".toml", "part_number = \"" + part + "\"\n" + rest);
  }
  PreparedStation prepare() const {
    Result<PreparedStation> station = prepare_station(configuration_);
    EXPECT_TRUE(station) << station.error().message;
    return std::move(*station);
  }
  std::string refusal() const {
    const Result<PreparedStation> station = prepare_station(configuration_);
    return station ? "taken" : station.error().message;
  }
  static CheckRequest request(const std::string& serial, const std::string& part = "") {
    return {.serial = serial, .repeats = 2, .part_number = part};
  }
  static std::string refusal(const PreparedStation& station, const CheckRequest& asked) {
    const Result<ChosenCheck> chosen = choose_check(station, asked);
    return chosen ? "taken" : chosen.error().message;
  }
  std::string builtin_dbc(const std::string& old, const std::string& now) const {
    std::string dbc(kBuiltinDbc);
    for (std::size_t at = 0; (at = dbc.find(old, at)) != std::string::npos; at += now.size())
      dbc.replace(at, old.size(), now);
    return dbc;
  }
  support::TemporaryDirectory folder_;
  StationConfiguration configuration_;
};

TEST_F(StationWithRecipes, JudgesEachBrakeByItsOwnLimits) {
  Result<CheckStore> store = CheckStore::open(folder_.path("checks.sqlite"));
  ASSERT_TRUE(store);
  EmbeddedStation station(prepare(), plant(1));
  const auto check = [&](const CheckRequest& asked) {
    return station.run_check(asked, &*store, nullptr).value();
  };
  const CheckRecord soft = check(request("S-1"));
  const CheckRecord stiff = check(request("T-1", "stiff"));
  const CheckRecord soft_again = check(request("S-2", " soft "));
  EXPECT_EQ(soft.verdict, Verdict::Pass) << soft.reason;
  EXPECT_EQ(stiff.verdict, Verdict::Fail) << stiff.reason;
  EXPECT_THAT(stiff.reason, HasSubstr("k2"));
  EXPECT_EQ(soft_again.verdict, Verdict::Pass) << "what judged the brake before is forgotten";
  EXPECT_EQ(soft.part_number, "soft");
  EXPECT_EQ(soft.recipe->version, "1");
  EXPECT_EQ(stiff.part_number, "stiff");
  EXPECT_EQ(stiff.recipe->version, "2");
  EXPECT_EQ(stiff.recipe->sha256, sha256_hex(folder_.read("recipes/stiff.toml")));
  EXPECT_NE(soft.limits_sha256, stiff.limits_sha256);
  EXPECT_EQ(soft_again.limits_sha256, soft.limits_sha256);
  EXPECT_EQ(soft.limits_revision, "k2 0.8");
  EXPECT_EQ(store->load(stiff.id)->recipe, stiff.recipe);
}

TEST_F(StationWithRecipes, StartsNothingWithoutAKnownPartNumber) {
  Bench bench(plant(1), WorkerMode::Synchronous, nullptr, prepare());
  bench.reach(StationState::Idle);
  for (const CheckRequest& asked : {request("T-1"), request("T-1", "hard")}) {
    const Result<void> begun = bench.conductor.begin(asked, {bench.now_ns, bench.now_ns});
    ASSERT_FALSE(begun);
    EXPECT_THAT(begun.error().message, HasSubstr("known are: soft, stiff"));
    EXPECT_FALSE(bench.conductor.busy());
  }
  EXPECT_THAT(refusal(bench.station, request("S-1", "stiff")),
              AllOf(HasSubstr("S-1 is one of part number soft"), HasSubstr("look which brake")));
  EXPECT_THAT(refusal(bench.station, request("T-1", "soft")), HasSubstr("serial numbers S-*"));
}

TEST_F(StationWithRecipes, TakesNoSerialNumberThatFitsTwo) {
  write("stiff", "version = \"2\"\nserials = [\"*-1\"]\n");
  const PreparedStation station = prepare();
  EXPECT_THAT(refusal(station, request("S-1")),
              AllOf(HasSubstr("soft and stiff"), HasSubstr("--part-number")));
  EXPECT_EQ(refusal(station, request("S-1", "stiff")), "taken") << "whoever asks says which";
  EXPECT_EQ(choose_check(station, request("T-1"))->check, &station.recipes[1]);
}

TEST_F(StationWithRecipes, WithoutAnyRefusesAPartNumberAndSaysWhy) {
  configuration_.recipes_directory.clear();
  configuration_.part_number = "P-1";
  const PreparedStation station = prepare();
  EXPECT_THAT(refusal(station, request("S-1", "soft")),
              AllOf(HasSubstr("has no recipes"), HasSubstr("[recipes] directory")));
  EXPECT_EQ(refusal(station, request("S-1", "P-1")), "taken") << "which says what the configuration says";
  EXPECT_EQ(refusal(station, request("S-1")), "taken");
}

TEST_F(StationWithRecipes, ChecksTheMasterBrakeAsConfigured) {
  configuration_.master.serial = "MASTER";
  const PreparedStation station = prepare();
  const Result<ChosenCheck> own = choose_check(station, request("MASTER"));
  ASSERT_TRUE(own) << own.error().message;
  EXPECT_EQ(own->check, &station);
  EXPECT_FALSE(own->recipe);
  EXPECT_EQ(choose_check(station, request("MASTER", "stiff"))->check, &station.recipes[1]);
}

TEST_F(StationWithRecipes, LetsNoEditTouchACheckThatHasBegun) {
  Bench bench(plant(1), WorkerMode::Synchronous, nullptr, prepare());
  bench.reach(StationState::Idle);
  const std::string before = sha256_hex(folder_.read("recipes/soft.toml"));
  ASSERT_TRUE(bench.conductor.begin(request("S-1"), {bench.now_ns, bench.now_ns}));
  for (int i = 0; i < 1'000; ++i) {
    bench.advance();
    ASSERT_FALSE(bench.pump());
  }
  write("soft", "version = \"99\"\n" + limits(1.5, 2.0));
  const CheckRecord record = bench.finish();
  EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
  EXPECT_EQ(record.recipe->version, "1");
  EXPECT_EQ(record.recipe->sha256, before);
}

TEST_F(StationWithRecipes, DrivesTheTrajectoryOfTheRecipe) {
  clampd::Run shorter = parse_run(std::string(kBuiltinTrajectory), "trajectory.csv")->run;
  for (auto* column : {&shorter.time_s, &shorter.torque_Nm, &shorter.velocity_rad_s, &shorter.force_N})
    column->resize(280);
  if (!shorter.position_rad.empty()) shorter.position_rad.resize(280);
  folder_.write("recipes/files/short.csv", format_run(shorter));
  write("stiff", "version = \"3\"\n[check]\ntrajectory = \"files/short.csv\"\n" + limits(0.8, 1.2));
  Bench bench(plant(1), WorkerMode::Synchronous, nullptr, prepare());
  bench.reach(StationState::Idle);
  const auto rows_of = [&](const CheckRequest& asked) {
    EXPECT_TRUE(bench.conductor.begin(asked, {bench.now_ns, bench.now_ns}));
    const std::size_t rows = bench.conductor.plan().reference.rows.size();
    const CheckRecord record = bench.finish();
    EXPECT_EQ(record.verdict, Verdict::Pass) << record.reason;
    EXPECT_EQ(record.runs.at(0).run.size(), rows);
    bench.reach(StationState::Idle);
    return rows;
  };
  const std::size_t own = rows_of(request("S-1"));
  EXPECT_EQ(rows_of(request("T-1", "stiff")), 280U);
  EXPECT_EQ(rows_of(request("S-1")), own);
  EXPECT_GT(own, 280U);
}

TEST_F(StationWithRecipes, RefusesToStartWithARecipeThatIsNotValid) {
  folder_.write("recipes/files/still.csv", "time_s,torque_Nm,velocity_rad_s,force_N\n0,0,0,0\nx,0,0,0\n");
  write("stiff", "version = \"3\"\n[check]\ntrajectory = \"files/still.csv\"\n");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("stiff.toml: part number stiff: "), HasSubstr("still.csv:3")));
  write("stiff", "version = \"3\"\n[check]\nmodel = \"files/still.csv\"\n");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("part number stiff"), HasSubstr("still.csv:1")));
  write("stiff", "version = \"3\"\n[sheet]\nfile = \"files/still.csv\"\n");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("part number stiff"), HasSubstr("still.csv:1")));
  write("stiff", "version = 3\n");
  EXPECT_THAT(refusal(), StartsWith(folder_.path("recipes/stiff.toml") + ":2:"));
}

TEST_F(StationWithRecipes, EstimatesTheEffectsOfTheRecipesModelForItsBrakesOnly) {
  folder_.write("recipes/files/extended.toml", "[[effect]]\nname = \"backlash\"\nplay = 0.2\n");
  folder_.write("recipes/files/sheet.toml",
                std::string("revision = \"9\"\n[[characteristic]]\nkind = \"drag\"\n") +
                    "unit = \"N m\"\nspeed_rad_s = 50\nupper = 0.5\n");
  write("stiff", "version = \"3\"\n[check]\nmodel = \"files/extended.toml\"\n");
  write("soft", "version = \"3\"\n[sheet]\nfile = \"files/sheet.toml\"\n");
  const PreparedStation station = prepare();
  ASSERT_EQ(station.recipes.size(), 2U);
  EXPECT_TRUE(station.recipes[0].sheet);
  EXPECT_FALSE(station.recipes[0].model);
  EXPECT_TRUE(station.recipes[1].model);
  EXPECT_EQ(station.recipes[1].configuration.check.method, Method::PredictionError);
  EXPECT_FALSE(station.model);
  EXPECT_FALSE(station.sheet);
}

TEST_F(StationWithRecipes, ChecksNoBrakeThatNeedsAnotherCanLayout) {
  folder_.write("recipes/files/same.dbc", builtin_dbc("NOTHING", "NOTHING") + "\n");
  folder_.write("recipes/files/other.dbc", builtin_dbc("BrakeFeedback", "Feedback"));
  write("soft", "version = \"1\"\n[can]\ndbc = \"files/same.dbc\"\n");
  write("stiff", "version = \"1\"\n[can]\ndbc = \"files/other.dbc\"\n");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("stiff.toml: part number stiff: "), HasSubstr("BrakeFeedback")))
      << "which does not hold what it maps";
  std::string moved = builtin_dbc("NOTHING", "NOTHING");
  const std::size_t scale = moved.find("SG_ Force");
  ASSERT_NE(scale, std::string::npos);
  const std::size_t factor = moved.find('(', scale);
  moved.replace(factor, 2, "(2");
  folder_.write("recipes/files/other.dbc", moved);
  const PreparedStation station = prepare();
  EXPECT_EQ(refusal(station, request("A", "soft")), "taken") << "the same frames, whatever file has them";
  EXPECT_THAT(refusal(station, request("A", "stiff")),
              AllOf(HasSubstr("needs the CAN layout of " + folder_.path("recipes/files/other.dbc")),
                    HasSubstr("built-in brake.dbc")));
}

}  // namespace
}  // namespace clampd::bench
