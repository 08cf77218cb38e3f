#include "clampd/attribution/population.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace clampd::attribution {
namespace {

using Suspect = PopulationFinding::Suspect;

/// A line of 240 checks at four stations, of eight batches. The scores of its six directions have a known
/// information matrix, so that an effect in one of them shows in the others by as much as they are alike; the
/// first two are nearly the same.
class Population : public ::testing::Test {
 protected:
  static constexpr int kChecks = 240, kDirections = 6, kStations = 4, kBatches = 8;
  static constexpr double kRoot = 50.0;  // of each direction's information

  Population() {
    correlation_ = Eigen::MatrixXd::Constant(kDirections, kDirections, 0.3);
    correlation_(0, 1) = correlation_(1, 0) = 0.99;
    correlation_.diagonal().setOnes();
  }

  /// `batch_is_station`: each station has a batch of its own.
  PopulationTable table(std::uint64_t seed, bool batch_is_station = false) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    const Eigen::MatrixXd half = correlation_.llt().matrixL();
    PopulationTable table;
    for (int j = 0; j < kDirections; ++j)
      table.directions.push_back({fmt::format("effect-{}.size", j), "N", j == 5});
    table.groups.push_back({CheckGroup::Kind::Line, "", {}});
    for (int s = 0; s < kStations; ++s)
      table.groups.push_back({CheckGroup::Kind::Station, fmt::format("{}", s), {}});
    for (int b = 0; b < kBatches; ++b)
      table.groups.push_back({CheckGroup::Kind::Batch, fmt::format("{}", b), {}});
    table.score.resize(kChecks, kDirections);
    table.information.assign(kChecks, (kRoot * kRoot * correlation_).cast<float>());
    for (int i = 0; i < kChecks; ++i) {
      Eigen::VectorXd noise(kDirections);
      for (double& value : noise) value = normal(random);
      table.score.row(i) = kRoot * (half * noise).transpose();
      const int station = i % kStations,
                batch = batch_is_station ? station : static_cast<int>(random() % kBatches);
      for (const int group : {0, 1 + station, 1 + kStations + batch})
        table.groups[static_cast<std::size_t>(group)].checks.push_back(i);
    }
    return table;
  }
  /// Gives a check a strength, in standard deviations of one check.
  void add(PopulationTable& table, int check, int direction, double strength) const {
    table.score.row(check) += kRoot * strength * correlation_.row(direction);
  }
  void add(PopulationTable& table, const CheckGroup& group, int direction, double strength) const {
    for (const int check : group.checks) add(table, check, direction, strength);
  }

  Eigen::MatrixXd correlation_;
};

TEST_F(Population, FindsAtAStationWhatNoCheckShows) {
  PopulationTable line = table(1);
  add(line, line.groups[3], 2, 1.2);
  const PopulationResult result = attribute_effects(line);
  ASSERT_EQ(result.findings.size(), 1U);
  const PopulationFinding& found = result.findings.front();
  EXPECT_EQ(found.suspect, (Suspect{2, 3}));
  EXPECT_NEAR(found.size, 1.2 / kRoot, 3.0 * found.sd);
  EXPECT_NEAR(found.sd, 1.0 / (kRoot * std::sqrt(60.0 * 0.75)),
              0.15 * found.sd);  // 240 checks know it to 5 %
  EXPECT_NEAR(found.of_one_check, 1.2, 0.5);
  EXPECT_TRUE(found.rivals.empty());
}

TEST_F(Population, FindsTwoEffectsOfDifferentGroups) {
  PopulationTable line = table(2);
  add(line, line.groups[1], 3, -1.5);
  add(line, line.groups[7], 4, 2.0);
  const PopulationResult result = attribute_effects(line);
  ASSERT_EQ(result.findings.size(), 2U);
  const std::vector found{result.findings[0].suspect, result.findings[1].suspect};
  EXPECT_THAT(found, ::testing::UnorderedElementsAre(Suspect{3, 1}, Suspect{4, 7}));
}

TEST_F(Population, SaysWhichDirectionsItCannotTellApart) {
  PopulationTable line = table(3);
  add(line, line.groups[2], 0, 1.5);
  const PopulationResult result = attribute_effects(line);
  ASSERT_EQ(result.findings.size(), 1U);
  std::vector<Suspect> named = result.findings.front().rivals;
  named.push_back(result.findings.front().suspect);
  EXPECT_THAT(named, ::testing::UnorderedElementsAre(Suspect{0, 2}, Suspect{1, 2}));
}

TEST_F(Population, SaysThatAStationCannotBeToldFromItsBatch) {
  PopulationTable line = table(4, true);
  add(line, line.groups[2], 2, 1.5);
  const PopulationResult result = attribute_effects(line);
  ASSERT_EQ(result.findings.size(), 1U);
  std::vector<Suspect> named = result.findings.front().rivals;
  named.push_back(result.findings.front().suspect);
  EXPECT_THAT(named, ::testing::UnorderedElementsAre(Suspect{2, 2}, Suspect{2, 1 + kStations + 1}));
}

// Scores are linear in small strengths only: what moves with a large one by a little more than the information says
// is no effect of its own.
TEST_F(Population, NamesNoConsequencesOfALargeEffect) {
  for (const std::size_t guilty : {std::size_t{3}, std::size_t{7}}) {  // a station, a batch
    PopulationTable line = table(12);
    add(line, line.groups[guilty], 2, 12.0);
    for (const int check : line.groups[guilty].checks) line.score(check, 4) += kRoot * 0.03 * 0.3 * 12.0;
    const PopulationResult result = attribute_effects(line);
    ASSERT_EQ(result.findings.size(), 1U);
    EXPECT_EQ(result.findings.front().suspect, (Suspect{2, static_cast<int>(guilty)}));
    EXPECT_GT(result.findings.front().of_one_check, guilty == 3 ? 8.0 : 3.0);
  }
}

// The calibration of each station is another, by much more than what is hidden, and brakes tell it differently well.
TEST_F(Population, FindsWhatStationsThatDifferHave) {
  std::mt19937_64 random(14);
  std::normal_distribution<double> normal;
  const auto differing = [&](std::uint64_t seed) {
    PopulationTable line = table(seed);
    std::vector<double> levels;
    for (int s = 0; s < kStations; ++s) levels.push_back(10.0 * normal(random));
    for (int i = 0; i < kChecks; ++i) {
      // A brake that shows direction 3 less, and its correlation with 2 more than others do.
      Eigen::MatrixXd own = correlation_;
      own(2, 3) = own(3, 2) = 0.3 + 0.15 * normal(random);
      const auto at = static_cast<std::size_t>(i);
      line.information[at] = (kRoot * kRoot * own).cast<float>();
      line.score.row(i) += kRoot * levels[static_cast<std::size_t>(i % kStations)] * own.row(2);
    }
    return line;
  };
  for (const std::uint64_t seed : {20, 21, 22}) {
    const PopulationTable line = differing(seed);
    const PopulationResult result = attribute_effects(line);
    EXPECT_TRUE(result.findings.empty()) << "direction " << result.findings.front().suspect.direction;
    ASSERT_EQ(result.differences.size(), 1U);
    EXPECT_EQ(result.differences.front().direction, 2);
    EXPECT_EQ(result.differences.front().levels.size(), static_cast<std::size_t>(kStations));
    EXPECT_GT(result.differences.front().of_one_check, 3.0);
  }
  PopulationTable line = differing(23);
  add(line, line.groups[2], 3, 1.5);   // a station
  add(line, line.groups[7], 4, -2.0);  // a batch
  const PopulationResult result = attribute_effects(line);
  std::vector<Suspect> found;
  for (const PopulationFinding& finding : result.findings) found.push_back(finding.suspect);
  EXPECT_THAT(found, ::testing::UnorderedElementsAre(Suspect{3, 2}, Suspect{4, 7}));
  ASSERT_EQ(result.differences.size(), 1U);
  EXPECT_EQ(result.differences.front().direction, 2);
}

TEST_F(Population, NamesTheLineForWhatAllChecksHave) {
  PopulationTable line = table(5);
  add(line, line.groups[0], 2, 0.8);
  const PopulationResult result = attribute_effects(line);
  ASSERT_EQ(result.findings.size(), 1U);
  EXPECT_EQ(result.findings.front().suspect, (Suspect{2, 0}));
}

// Two directions of the line of which hardly anything tells one from the other are one finding.
TEST_F(Population, NamesTheLineOnceForDirectionsThatAreNearlyTheSame) {
  PopulationTable line = table(13);
  add(line, line.groups[0], 0, 1.2);
  const PopulationResult result = attribute_effects(line);
  ASSERT_EQ(result.findings.size(), 1U);
  EXPECT_EQ(result.findings.front().suspect.group, 0);
  EXPECT_EQ(result.findings.front().rivals, (std::vector{Suspect{1 - result.findings.front().suspect.direction, 0}}));
}

// Estimates share a bias of a part of their own deviation; a million checks would make it significant.
TEST_F(Population, NamesNoBiasThatAllChecksShare) {
  PopulationTable line = table(6);
  add(line, line.groups[0], 2, 0.4);
  EXPECT_TRUE(attribute_effects(line).findings.empty());
}

TEST_F(Population, StationsThatAllDifferAreNoEffectOfTheLine) {
  PopulationTable line = table(7);
  const double levels[kStations] = {2.5, -0.5, 1.8, -0.9};
  for (std::size_t s = 0; s < kStations; ++s) add(line, line.groups[1 + s], 2, levels[s]);
  const PopulationResult result = attribute_effects(line);
  EXPECT_TRUE(result.findings.empty());
  ASSERT_EQ(result.differences.size(), 1U);
  EXPECT_EQ(result.differences.front().direction, 2);
}

TEST_F(Population, OneBrokenBrakeIsNoEffectOfItsStation) {
  PopulationTable line = table(8);
  add(line, line.groups[2].checks[10], 2, 80.0);
  EXPECT_TRUE(attribute_effects(line).findings.empty());
}

TEST_F(Population, AStrengthThatCannotBeNegativeIsNotNamedForLessThanNothing) {
  PopulationTable line = table(9);
  add(line, line.groups[2], 5, -1.5);
  for (const PopulationFinding& finding : attribute_effects(line).findings)
    EXPECT_NE(finding.suspect.direction, 5);
}

TEST_F(Population, ACleanLineShowsNothingAsOftenAsPromised) {
  int found = 0;
  for (std::uint64_t seed = 100; seed < 500; ++seed) {
    const PopulationResult result = attribute_effects(table(seed));
    found += !result.findings.empty() || !result.differences.empty();
  }
  EXPECT_LE(found, 10);  // 4 are expected of 400 at 1 %; more than 10 in 0.3 % of the cases
}

TEST_F(Population, DoesNotLookAtGroupsOfAFewChecks) {
  PopulationTable line = table(10);
  line.groups.push_back({CheckGroup::Kind::Batch, "last", {3, 9, 40, 77}});
  add(line, line.groups.back(), 2, 30.0);
  const PopulationResult result = attribute_effects(line);
  EXPECT_EQ(result.groups_too_small, 1);
  for (const PopulationFinding& finding : result.findings) EXPECT_NE(finding.suspect.group, 13);
}

TEST_F(Population, ChecksThatShowNothingDoNotCount) {
  PopulationTable line = table(11);
  for (Eigen::MatrixXf& information : line.information) information.row(4).setZero(), information.col(4).setZero();
  line.score.col(4).setConstant(std::numeric_limits<double>::quiet_NaN());
  EXPECT_TRUE(attribute_effects(line).findings.empty());
  EXPECT_TRUE(attribute_effects({}).findings.empty());
}

}  // namespace
}  // namespace clampd::attribution
