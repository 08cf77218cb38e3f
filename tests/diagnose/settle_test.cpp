// Settling an ambiguous diagnosis: on the simulated brake, and what a user sees of it.

#include "clampd/diagnose/settle.hpp"

#include <span>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/experiment/reference.hpp"
#include "clampd/experiment/robust_design.hpp"
#include "clampd/identify/extended_fit.hpp"
#include "clampd/simulation/simulate.hpp"
#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

sim::PlantConfiguration plant_with(const std::string& effect, double value) {
  sim::PlantConfiguration plant;
  plant.sensors = {.force_noise_N = 50.0, .velocity_noise_rad_s = 0.8, .torque_noise_Nm = 0.01};
  EXPECT_TRUE(sim::set_effect(plant.effects, effect, value));
  return plant;
}

std::vector<Run> drive(const sim::PlantConfiguration& plant, const Run& trajectory, int repeats) {
  return simulate_manoeuvre(plant, build_reference(trajectory, {}).value(), {},
                            static_cast<std::uint16_t>(repeats))
      .value();
}

std::vector<Run> optimal_runs(const sim::PlantConfiguration& plant, int count = 2) {
  return drive(
      plant,
      response_to({kKnownRobustBlocks_Nm.begin(), kKnownRobustBlocks_Nm.end()}, kKnownRobustBlockSamples, {}),
      count);
}

using Runs = std::vector<Run>;
using Driven = Result<Runs>;
using Trajectory = Run;

/// As diagnose() leaves it when it cannot tell two effects apart.
Diagnosis ambiguous(const std::vector<Run>& runs, const std::vector<EffectValues>& starts) {
  Diagnosis diagnosis;
  diagnosis.verdict = DiagnosisVerdict::Ambiguous;
  diagnosis.rivals.emplace_back();
  diagnosis.rival_models.emplace_back();
  const ExtendedEstimate base = fit_base(runs, {});
  for (const EffectValues& values : starts) {
    const ExtendedEstimate estimate = fit_extended(fit_runs(runs), with_effect(base, values));
    const std::string name(info_of(*values.effect).name);
    diagnosis.rivals.back().push_back(name);
    diagnosis.rival_models.back().push_back({name, estimate.parameters, estimate.covariance});
    diagnosis.noise_after = estimate.noise;
  }
  return diagnosis;
}

TEST(Settle, RunsTheExperimentAndNamesTheCause) {
  const sim::PlantConfiguration plant = plant_with("inertia-error", 0.01);
  const Runs runs = optimal_runs(plant);
  const Diagnosis before =
      ambiguous(runs, {{find_effect("torque-gain"), {-0.01}}, {find_effect("inertia-error"), {0.01}}});
  int driven = 0;
  sim::PlantConfiguration later = plant;
  const auto settlement = settle(before, runs,
                                 [&](const Trajectory& trajectory, int repeats) -> Driven {
                                   later.seed = plant.seed + static_cast<std::uint64_t>(++driven);
                                   return drive(later, trajectory, repeats);
                                 },
                                 {});
  ASSERT_TRUE(settlement) << settlement.error().message;
  EXPECT_EQ(settlement->diagnosis.verdict, DiagnosisVerdict::Explained) << settlement->words;
  ASSERT_FALSE(settlement->diagnosis.effects.empty());
  EXPECT_EQ(settlement->diagnosis.effects.front().name, "inertia-error");
  EXPECT_EQ(driven, static_cast<int>(settlement->experiments.size()));
  ASSERT_FALSE(settlement->experiments.empty());
  std::size_t repeats = 0;
  for (const NextExperiment& experiment : settlement->experiments)
    repeats += static_cast<std::size_t>(experiment.repeats);
  EXPECT_EQ(settlement->runs.size(), runs.size() + repeats);
  EXPECT_FALSE(settlement->diagnosis.next_experiment);
  EXPECT_THAT(settlement->words, AllOf(HasSubstr("settled"), Not(HasSubstr("not settled"))));
}

TEST(Settle, TwinsAreNotDrivenFor) {
  const Runs runs = optimal_runs(plant_with("velocity-lag", 0.02e-3));
  const Diagnosis before = ambiguous(
      runs, {{find_effect("velocity-lag"), {0.02e-3}}, {find_effect("channel-skew"), {0.02, 0.0, 2.0}}});
  const auto settlement = settle(before, runs,
                                 [](const Trajectory&, int) -> Driven {
                                   ADD_FAILURE() << "nothing was to be driven";
                                   return failure("driven");
                                 },
                                 {});
  ASSERT_TRUE(settlement) << settlement.error().message;
  EXPECT_EQ(settlement->diagnosis.verdict, DiagnosisVerdict::Ambiguous);
  EXPECT_TRUE(settlement->experiments.empty());
  EXPECT_THAT(settlement->words, AllOf(HasSubstr("not settled"), HasSubstr("cannot be told apart")));
  EXPECT_FALSE(next_experiment_for(before, {}));
}

class DriveOff : public ::testing::TestWithParam<std::string> {};

TEST_P(DriveOff, TellsAnOffsetOfTheTorqueReadingFromAnAsymmetryOfFriction) {
  const sim::PlantConfiguration plant = plant_with(GetParam(), 0.02);
  const Runs runs = optimal_runs(plant, 4);
  const Diagnosis before = ambiguous(
      runs, {{find_effect("torque-offset"), {0.02}}, {find_effect("friction-asymmetry"), {0.02, 0.0, 1.0}}});
  std::size_t off = 0;
  const auto settlement = settle(before, runs,
                                 [&](const Trajectory& trajectory, int repeats) -> Driven {
                                   EXPECT_FALSE(is_driven(trajectory));
                                   EXPECT_EQ(repeats, 1);
                                   off += trajectory.size();
                                   return Runs{simulate_drive_off(plant, trajectory.size())};
                                 },
                                 {});
  ASSERT_TRUE(settlement) << settlement.error().message;
  EXPECT_EQ(settlement->diagnosis.verdict, DiagnosisVerdict::Explained) << settlement->words;
  ASSERT_EQ(settlement->diagnosis.effects.size(), 1U);
  EXPECT_EQ(settlement->diagnosis.effects.front().name, GetParam());
  ASSERT_TRUE(settlement->diagnosis.torque_while_off);
  EXPECT_EQ(settlement->diagnosis.torque_while_off->rows, off);
  EXPECT_THAT(settlement->words, HasSubstr("settled after one experiment"));
}

INSTANTIATE_TEST_SUITE_P(Settle, DriveOff, ::testing::Values("torque-offset", "friction-asymmetry"),
                         [](const auto& one) {
                           return one.param == "torque-offset" ? "Offset" : "Asymmetry";
                         });

TEST(Settle, ABrakeThatCannotBeDrivenEndsIt) {
  const Runs runs = optimal_runs(plant_with("inertia-error", 0.01));
  const auto settlement =
      settle(ambiguous(runs, {{find_effect("torque-gain"), {-0.01}}, {find_effect("inertia-error"), {0.01}}}),
             runs, [](const Trajectory&, int) -> Driven { return failure("the brake is gone"); }, {});
  ASSERT_FALSE(settlement);
  EXPECT_EQ(settlement.error().message, "the brake is gone");
}

TEST(Settle, WithoutRivalsThereIsNothingToDo) {
  Diagnosis diagnosis;
  diagnosis.verdict = DiagnosisVerdict::Adequate;
  const auto settlement = settle(diagnosis, {}, {}, {});
  ASSERT_TRUE(settlement);
  EXPECT_TRUE(settlement->experiments.empty());
  EXPECT_THAT(settlement->words, HasSubstr("nothing to settle"));
  EXPECT_FALSE(next_experiment_for(diagnosis, {}));
}

class RunSettle : public ::testing::Test {
 protected:
  Outcome run(const std::string& plant, const std::string& arguments) {
    folder_.write("plant.toml", plant);
    return support::run_command("cd '" + folder_.path("") + "' && STATE_DIRECTORY='" + folder_.path("state") +
                                "' " + CLAMPCTL + " run --serial S-1 --settle " + arguments);
  }
  nlohmann::json document() { return nlohmann::json::parse(folder_.read("check.json")); }

  support::TemporaryDirectory folder_;
};

constexpr const char* kSomeRuns = "--repeats 2 --simulated-brake plant.toml --json check.json";
constexpr const char* kAmbiguous = "[effects]\ninertia-error = 0.005\n";

TEST_F(RunSettle, DesignsRunsAndDecides) {
  const Outcome outcome = run(kAmbiguous, kSomeRuns);
  EXPECT_EQ(outcome.exit_code, document().at("verdict") == "PASS" ? 0 : 1) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("Next experiment"), HasSubstr("Settling: settled")));
  const auto cause = document().at("cause");
  EXPECT_EQ(cause.at("effect"), "inertia-error");
  EXPECT_EQ(cause.at("verdict"), "explained");
  EXPECT_FALSE(cause.at("experiments").empty());
  // Record, report and terminal say the same.
  const Outcome shown = support::run_command("STATE_DIRECTORY='" + folder_.path("state") + "' " + CLAMPCTL +
                                             " results last --json");
  const auto recorded = nlohmann::json::parse(shown.output);
  EXPECT_EQ(recorded.at("record"), document().at("record"));
  EXPECT_EQ(recorded.at("cause").at("effect"), "inertia-error");
  EXPECT_EQ(recorded.at("reason"), document().at("reason"));
  EXPECT_THAT(recorded.at("reason").get<std::string>(), HasSubstr(cause.at("summary").get<std::string>()));
}

TEST_F(RunSettle, ABrakeThatFallsSilentInTheExperimentEndsAsInEveryCheck) {
  const Outcome outcome = run(
      std::string(kAmbiguous) + "[[fault]]\nkind = \"silent\"\nat_s = 5.0\nduration_s = 100.0\n", kSomeRuns);
  EXPECT_EQ(outcome.exit_code, 3) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("stopped sending"), HasSubstr("AMBIGUOUS")));
  EXPECT_EQ(document().at("cause").at("verdict"), "ambiguous");
}

TEST_F(RunSettle, AGoodBrakeNeedsNone) {
  const Outcome outcome = run("", kSomeRuns);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_TRUE(document().at("cause").is_null());
  EXPECT_THAT(outcome.output, Not(HasSubstr("Next experiment")));
}

TEST_F(RunSettle, ADaemonCannotAndSaysSo) {
  folder_.write("station.toml", "[can]\ninterface = \"can77\"\n");
  const Outcome outcome = run("", "--config station.toml");
  EXPECT_EQ(outcome.exit_code, 2) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("--settle"), HasSubstr("clampctl diagnose")));
}

}  // namespace
}  // namespace clampd
