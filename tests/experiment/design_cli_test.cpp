#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/brake/simulation.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"
#include "support/command.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using support::Outcome;
using ::testing::HasSubstr;

Outcome design(const std::string& arguments) {
  return support::run_command(fmt::format("\"{}\" design {}", CLAMPCTL, arguments));
}

class DesignCommand : public ::testing::Test {
 protected:
  std::string file(const std::string& name) const { return folder_.path(name); }
  bool nothing_written() const { return folder_.entries() == 0; }

 private:
  support::TemporaryDirectory folder_;
};

TEST_F(DesignCommand, WritesADesignAndTheResponseToIt) {
  const Outcome outcome =
      design(fmt::format("--duration 0.1 --starts 8 --force-limit 8000 --json {} --out {}",
                         file("design.json"), file("trajectory.csv")));
  ASSERT_EQ(outcome.exit_code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("-log det M"));
  EXPECT_THAT(outcome.output, ::testing::Not(HasSubstr("\r")));

  const nlohmann::json document = nlohmann::json::parse(*read_file(file("design.json")));
  EXPECT_EQ(document["schema"], "clampd.design/1");
  EXPECT_DOUBLE_EQ(document["duration_s"], 0.1);
  EXPECT_EQ(document["block_samples"], 20);
  EXPECT_EQ(document["objective"], "d");
  EXPECT_LT(document["criterion"]["logdet"], -30.0);
  EXPECT_GT(document["criterion"]["trace_inverse"], 0.0);
  EXPECT_LE(document["force_max_N"], 8000.0);
  EXPECT_LE(document["velocity_max_rad_s"], 300.0);
  EXPECT_GT(document["wall_s"], 0.0);
  ASSERT_EQ(document["torque_Nm"].size(), 5U);

  const Result<LoadedRun> trajectory = read_run(file("trajectory.csv"));
  ASSERT_TRUE(trajectory) << trajectory.error().message;
  const clampd::Run& run = trajectory->run;
  ASSERT_EQ(run.size(), 100U);
  ASSERT_EQ(run.position_rad.size(), 100U);
  for (std::size_t k = 0; k < run.size(); ++k) {
    EXPECT_NEAR(run.time_s[k], static_cast<double>(k) * 1e-3, 1e-12);
    EXPECT_EQ(run.torque_Nm[k], document["torque_Nm"][k / 20]);
  }
  Simulation expected(run.size());
  simulate(BrakeParameters{}, BrakeState::Zero(), excitation_of(run), expected);
  for (std::size_t k = 0; k < run.size(); ++k) EXPECT_NEAR(run.force_N[k], expected.force_N[k], 1e-3);
}

TEST_F(DesignCommand, BadInputIsRefusedBeforeAnythingIsDone) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"--duration 0.006 --block 2", "duration"},
      {"--duration 0", "duration"},
      {"--duration -0.3", "duration"},
      {"--duration nan", "duration"},
      {"--duration 1e9", "duration"},
      {"--duration 0.3005", "milliseconds"},
      {"--duration 0.31", "whole number of blocks"},
      {"--duration 0.3x", "duration"},
      {"--block 0", "block"},
      {"--objective best", "objective"},
      {"--objective robust --initial-position 3", "robust"},
      {"--noise-torque -1 --objective robust", "torque"},
      {"--beside " CLAMPD_SOURCE_DIR "/configs/trajectory.csv --for TC", "--objective robust"},
      {"--objective robust --for TC", "--beside"},
      {"--objective robust --beside " CLAMPD_SOURCE_DIR "/configs/trajectory.csv --for T0", "T0"},
      {"--torque-limit 0", "torque limit"},
      {"--force-limit -1", "force limit"},
      {"--speed-limit nan", "speed limit"},
      {"--noise-force 0", "noise"},
      {"--starts 0", "starts"},
      {"--initial-velocity 400", "initial velocity"},
      {"--no-such-option", "no-such-option"},
      {"--parameters " + file("missing.toml"), "missing.toml"},
      {"--json /nowhere/at/all/design.json", "/nowhere/at/all"},
      {"--out " + file(""), "folder"},
      {fmt::format("--json {0} --out {0}", file("same")), "same file"},
  };
  for (const auto& [arguments, hint] : cases) {
    const Outcome outcome = design(arguments);
    EXPECT_EQ(outcome.exit_code, 2) << arguments << "\n" << outcome.output;
    EXPECT_THAT(outcome.output, HasSubstr(hint)) << arguments;
  }
  EXPECT_TRUE(nothing_written());
}

TEST_F(DesignCommand, WritesNothingWhereThereIsNoDesign) {
  const Outcome outcome =
      design(fmt::format("--duration 0.1 --starts 4 --torque-limit 0.04 --json {} --out {}",
                         file("design.json"), file("trajectory.csv")));
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("no design"));
  EXPECT_TRUE(nothing_written());
}

}  // namespace
}  // namespace clampd
