#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "publish/servers.hpp"
#include "support/command.hpp"
#include "support/temporary_directory.hpp"
#include "tools/factory/plan.hpp"
#include "tools/factory/stations.hpp"

namespace clampd::factory {
namespace {

using ::testing::HasSubstr;

Settings settings(int checks, std::uint64_t seed) {
  Settings settings;
  settings.stations = 3;
  settings.checks = checks;
  settings.seed = seed;
  return settings;
}

std::vector<PlannedCheck> planned(const Settings& settings, const std::vector<Hidden>& hidden) {
  return plan(settings, hidden, bench::plant(1));
}

/// All that a plan decides of a check, for comparison.
std::string text_of(const PlannedCheck& check) {
  const sim::PlantConfiguration& brake = check.brake;
  std::string text =
      fmt::format("{} {} {} {} {} {} {}", check.id, check.station, check.request.serial, check.request.batch,
                  brake.seed, brake.clearance_rad, brake.encoder_zero_rad);
  for (const double value : brake.brake.theta) text += fmt::format(" {}", value);
  for (const sim::EffectInfo& effect : sim::kEffectTable)
    text += fmt::format(" {}", brake.effects.*effect.member);
  for (const sim::SpoiledReading& spoiled : brake.spoiled)
    text += fmt::format(" {} {}", to_string(spoiled.reading), spoiled.amount);
  return text;
}

/// The quantity that a cause changes, as the brake of a check has it.
double quantity(Cause cause, const sim::PlantConfiguration& brake) {
  switch (cause) {
    case Cause::ForceGain:
      return brake.spoiled.front().amount;
    case Cause::TorqueGain:
      return brake.effects.torque_gain;
    case Cause::ForceLag:
      return brake.effects.force_lag_s;
    case Cause::Stiffness:
      return brake.brake.theta[k2];
    case Cause::CoulombFriction:
      return brake.brake.theta[TC];
    case Cause::Backlash:
      return brake.effects.backlash_rad;
  }
  return 0.0;
}

TEST(FactoryPlan, IsTheSameFromItsSeedAndAnotherFromAnother) {
  const Settings one = settings(60, 5), other = settings(60, 6);
  const std::vector<PlannedCheck> first = planned(one, hide(one)), second = planned(one, hide(one)),
                                  third = planned(other, hide(other));
  ASSERT_EQ(first.size(), 60U);
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(text_of(first[i]), text_of(second[i]));
    EXPECT_NE(text_of(first[i]), text_of(third[i]));
  }
}

TEST(FactoryPlan, ChecksSomeBrakesAtTwoStationsAndTheMasterBrakeNowAndThen) {
  const Settings of = settings(400, 9);
  std::map<std::string, std::vector<const PlannedCheck*>> of_brake;
  const std::vector<PlannedCheck> checks = planned(of, {});
  for (const PlannedCheck& check : checks) of_brake[check.request.serial].push_back(&check);
  EXPECT_EQ(of_brake["MASTER-1"].size(), 20U);
  of_brake.erase("MASTER-1");
  std::size_t twice = 0;
  for (const auto& [serial, list] : of_brake) {
    ASSERT_LE(list.size(), 2U) << serial;
    if (list.size() == 1) continue;
    ++twice;
    EXPECT_NE(list[0]->station, list[1]->station) << serial;
    EXPECT_EQ(list[0]->request.batch, list[1]->request.batch) << serial;
    EXPECT_EQ(list[0]->brake.brake.theta, list[1]->brake.brake.theta) << serial;
  }
  EXPECT_GT(twice, 20U);
  EXPECT_TRUE(std::is_sorted(checks.begin(), checks.end(), [](const auto& a, const auto& b) {
    return a.started_utc_ns < b.started_utc_ns;
  }));
}

/// Whatever is drawn: what hide() lists is all that differs from a factory that hides nothing, where and when
/// it says, by as much as it says.
TEST(FactoryPlan, HidesWhatItSaysItHides) {
  std::map<Cause, int> seen;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    const Settings of = settings(200, seed);
    const std::vector<PlannedCheck> innocent = planned(of, {});
    for (const Hidden& hidden : hide(of)) {
      SCOPED_TRACE(fmt::format("seed {}: {}", seed, describe(hidden, of)));
      ++seen[hidden.cause];
      const std::vector<PlannedCheck> checks = planned(of, {hidden});
      const bool relative = hidden.cause == Cause::Stiffness || hidden.cause == Cause::CoulombFriction;
      int changed = 0;
      for (std::size_t i = 0; i < checks.size(); ++i) {
        const double share = static_cast<double>(i) / of.checks;
        const bool here = hidden.course == Course::Whole
                              ? checks[i].request.batch == fmt::format("B-{:03}", hidden.number + 1)
                              : checks[i].station == hidden.number;
        double expected = here ? hidden.size : 0.0;
        if (hidden.course == Course::Step && share < hidden.from) expected = 0.0;
        if (hidden.course == Course::Drift) expected *= share;
        const double before = quantity(hidden.cause, innocent[i].brake);
        const double after = quantity(hidden.cause, checks[i].brake);
        EXPECT_NEAR(relative ? after / before - 1.0 : after - before, expected, 1e-12) << checks[i].id;
        if (expected == 0.0)
          EXPECT_EQ(text_of(checks[i]), text_of(innocent[i]));
        else
          ++changed;
      }
      EXPECT_GT(changed, 0);
    }
  }
  EXPECT_EQ(seen.size(), 6U) << "no cause is left out for good";
}

TEST(FactoryPlan, ABatchOfStifferBrakesIsIdentifiedAsOne) {
  const Settings of = settings(10, 3);
  Hidden hidden{Cause::Stiffness, Course::Whole, 0};
  hidden.size = 0.1;
  const std::vector<PlannedCheck> innocent = planned(of, {}), checks = planned(of, {hidden});
  const auto one = std::find_if(checks.begin(), checks.end(),
                                [](const PlannedCheck& check) { return check.request.batch == "B-001"; });
  ASSERT_NE(one, checks.end());
  const auto k2_of = [&](const PlannedCheck& check) {
    const CheckRecord record = bench::check(check.brake, 3);
    EXPECT_TRUE(is_about_the_brake(record.verdict)) << record.reason;
    return record.parameters.at(k2);
  };
  const ParameterRecord before = k2_of(innocent[static_cast<std::size_t>(one - checks.begin())]);
  const ParameterRecord after = k2_of(*one);
  EXPECT_NEAR(after.value / before.value, 1.1, 4.0 * std::hypot(after.sd, before.sd) / before.value);
}

TEST(FactoryProgram, ValidatesItsArgumentsAndMakesNothing) {
  const support::TemporaryDirectory folder;
  const std::string line = fmt::format("{} --folder {} --validate", CLAMPD_FACTORY, folder.path("none"));
  EXPECT_EQ(support::run_command(line + " --stations 2 --checks 6 --seed 4").exit_code, 0);
  for (const std::string mistake :
       {"--stations 1", "--checks 0", "--checks many", "--repeats 201", "--days 0", "--seed one"}) {
    const support::Outcome refused = support::run_command(fmt::format("{} {}", line, mistake));
    EXPECT_EQ(refused.exit_code, 2) << mistake;
    EXPECT_THAT(refused.output, HasSubstr(mistake.substr(0, mistake.find(' '))));
  }
  EXPECT_FALSE(std::filesystem::exists(folder.path("none")));
}

class FactoryStations : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string missing = support::Database::missing(); !missing.empty()) GTEST_SKIP() << missing;
  }
  /// Two stations and six checks, into this server.
  support::Outcome run(const std::string& name, const support::Database& server) const {
    return support::run_command(
        fmt::format("{} --folder {} --host {} --database line --user line --stations 2 --checks 6 "
                    "--repeats 2 --seed 4",
                    CLAMPD_FACTORY, folder.path(name), server.host()));
  }
  support::TemporaryDirectory folder;
};

TEST_F(FactoryStations, PublishEachCheckOnceWithItsRunsAndTheSameAgain) {
  Settings of = settings(6, 4);
  of.stations = 2;
  std::vector<std::string> ids;
  for (const PlannedCheck& check : planned(of, hide(of))) ids.push_back(check.id);
  std::vector<std::vector<std::string>> verdicts, runs, parameters;
  for (const char* name : {"first", "second"}) {
    support::Database server;
    const support::Outcome said = run(name, server);
    ASSERT_EQ(said.exit_code, 0) << said.output;
    EXPECT_THAT(said.output, HasSubstr("6 checks at 2 stations"));
    EXPECT_EQ(server.column("SELECT id FROM clampd.checks ORDER BY id"), ids);
    EXPECT_EQ(server.ask("SELECT count(*) FROM clampd.runs r JOIN clampd.checks c ON c.id = r.check_id JOIN "
                         "clampd.raw_runs w ON w.sha256 = r.sha256 AND w.recorded = c.started"),
              "12");
    EXPECT_EQ(server.ask("SELECT count(*) FROM clampd.raw_runs"), "12");
    verdicts.push_back(server.column("SELECT serial || ' ' || verdict FROM clampd.checks ORDER BY id"));
    runs.push_back(server.column("SELECT sha256 FROM clampd.runs ORDER BY check_id, position"));
    parameters.push_back(
        server.column("SELECT value::text FROM clampd.parameters ORDER BY check_id, position"));
  }
  EXPECT_EQ(verdicts[0], verdicts[1]);
  EXPECT_EQ(verdicts[0].size(), 6U);
  EXPECT_EQ(runs[0], runs[1]);
  EXPECT_EQ(parameters[0], parameters[1]);
  EXPECT_EQ(parameters[0].size(), 42U);
}

TEST_F(FactoryStations, ADatabaseThatIsNotThereIsSaidBeforeAnyCheck) {
  const support::Outcome refused =
      support::run_command(fmt::format("{} --folder {} --host {} --stations 2 --checks 6", CLAMPD_FACTORY,
                                       folder.path("none"), folder.path("nowhere")));
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.output, HasSubstr("no connection"));
  EXPECT_FALSE(std::filesystem::exists(folder.path("none")));
}

TEST_F(FactoryStations, SayWhatTheyHideOnlyWhenAskedAndReplaceNoFactory) {
  const support::Database server;
  const support::Outcome made = run("one", server);
  ASSERT_EQ(made.exit_code, 0) << made.output;
  const support::Outcome said =
      support::run_command(fmt::format("{} --folder {} --reveal", CLAMPD_FACTORY, folder.path("one")));
  EXPECT_EQ(said.exit_code, 0);
  Settings of = settings(6, 4);
  of.stations = 2;
  for (const Hidden& hidden : hide(of)) {
    EXPECT_THAT(said.output, HasSubstr(describe(hidden, of)));
    EXPECT_THAT(made.output, ::testing::Not(HasSubstr(describe(hidden, of))));
  }
  const support::Outcome again = run("one", server);
  EXPECT_EQ(again.exit_code, 2);
  EXPECT_THAT(again.output, HasSubstr("there is a factory in this folder already"));
}

}  // namespace
}  // namespace clampd::factory
