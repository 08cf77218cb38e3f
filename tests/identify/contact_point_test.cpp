#include "clampd/identify/contact_point.hpp"

#include <cmath>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/brake/stiffness.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

constexpr int kRows = 300;
constexpr double kPressed_rad = 27.0;

struct Encoder {
  double contact_rad = 17.3;
  double step_rad = 0.0;  ///< of its readings; 0: none
  double noise_rad = 0.0;
};

/// From the clearance to 27 rad beyond contact and back; the force of a brake with these parameters.
Run pressed(const Encoder& encoder, double force_noise_N, std::mt19937_64& random,
            const BrakeParameters& brake = {}) {
  const PolynomialStiffness stiffness(brake.theta.data());
  std::normal_distribution<double> normal;
  const double begin_rad = -3.0 + 0.05 * normal(random);
  Run run;
  run.name = "repeat 1";
  for (int k = 0; k < kRows; ++k) {
    const double x = begin_rad + (kPressed_rad + 3.0) * std::pow(std::sin(3.14159 * k / (kRows - 1)), 2);
    double reading = encoder.contact_rad + x + encoder.noise_rad * normal(random);
    if (encoder.step_rad > 0.0) reading = encoder.step_rad * std::round(reading / encoder.step_rad);
    run.time_s.push_back(1e-3 * k);
    run.torque_Nm.push_back(0.0);
    run.velocity_rad_s.push_back(0.0);
    run.force_N.push_back(stiffness.force_N(x) + force_noise_N * normal(random));
    run.position_rad.push_back(reading);
  }
  return run;
}

/// With the nominal parameters, from a start that is 0.4 rad wrong.
Estimate nominal_estimate(std::size_t runs) {
  Estimate estimate;
  estimate.termination = Termination::Converged;
  estimate.initial_states.assign(runs, Eigen::Vector2d(-2.6, 0.0));
  return estimate;
}

/// Whether the 95 % interval by its own error holds the truth.
bool holds(const ContactPoint& contact, double truth_rad) {
  return std::abs(contact.position_rad - truth_rad) <= 1.96 * std::sqrt(contact.variance_rad2);
}

/// Of so many sets of runs, in percent.
double coverage(int repeats, double force_noise_N, double moves_rad, const Encoder& encoder) {
  constexpr int kSets = 1000;
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  int held = 0;
  for (int set = 0; set < kSets; ++set) {
    Encoder standing = encoder;
    standing.contact_rad += std::uniform_real_distribution<double>(-1.0, 1.0)(random);
    std::vector<clampd::Run> runs;
    for (int i = 0; i < repeats; ++i) {
      Encoder moved = standing;
      moved.contact_rad += moves_rad * normal(random);
      runs.push_back(pressed(moved, force_noise_N, random));
    }
    held += holds(contact_point(runs, nominal_estimate(runs.size())), standing.contact_rad);
  }
  return 100.0 * held / kSets;
}

TEST(ContactPoint, IsWhereTheForceBegins) {
  std::mt19937_64 random(1);
  for (const double contact_rad : {0.0, 17.3, -203.0, 1e4}) {
    const clampd::Run runs[]{pressed({.contact_rad = contact_rad}, 0.0, random),
                             pressed({.contact_rad = contact_rad}, 0.0, random)};
    const ContactPoint contact = contact_point(runs, nominal_estimate(2));
    EXPECT_EQ(contact.why, "");
    EXPECT_NEAR(contact.position_rad, contact_rad, 1e-8) << "the readings have a smallest step of their own";
    EXPECT_LT(contact.variance_rad2, 1e-6);
  }
}

TEST(ContactPoint, FollowsTheParametersAndTheZeroOfTheForceAsItSays) {
  std::mt19937_64 random(2);
  std::vector<clampd::Run> runs{pressed({}, 20.0, random), pressed({}, 20.0, random)};
  const Estimate estimate = nominal_estimate(2);
  const ContactPoint contact = contact_point(runs, estimate);
  const auto with = [&](std::size_t parameter, double change) {
    Estimate other = estimate;
    other.parameters.theta[static_cast<Eigen::Index>(parameter)] *= 1.0 + change;
    return contact_point(runs, other).position_rad;
  };
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double slope = (with(i, 1e-4) - with(i, -1e-4)) / 2e-4;
    EXPECT_NEAR(contact.by_parameters[static_cast<Eigen::Index>(i)], slope, 0.01 * std::abs(slope) + 1e-9)
        << kParameterTable[i].name;
  }
  for (clampd::Run& run : runs)
    for (double& force_N : run.force_N) force_N += 2.0;
  const double slope = (contact_point(runs, estimate).position_rad - contact.position_rad) / 2.0;
  EXPECT_NEAR(contact.by_force_offset, slope, 0.01 * std::abs(slope));
  EXPECT_LT(slope, 0.0) << "a force that reads too much seems to begin sooner";
}

// Of 1,000 sets a coverage is known to 0.7 %: four deviations around 93 to 97 %.
TEST(ContactPoint, ItsOwnErrorIsThatOfTheForceReadings) {
  for (const int repeats : {1, 2, 6, 20}) {
    const double percent = coverage(repeats, 45.0, 0.0, {});
    EXPECT_GT(percent, 93.0 - 2.8) << repeats;
    EXPECT_LT(percent, 97.0 + 2.8) << repeats;
  }
}

TEST(ContactPoint, CountsThatItMovesFromRunToRun) {
  for (const int repeats : {2, 6}) {
    const double percent = coverage(repeats, 10.0, 0.05, {});
    EXPECT_GT(percent, 93.0 - 2.8) << repeats;
    EXPECT_LT(percent, 97.0 + 2.8) << repeats;
  }
}

TEST(ContactPoint, CountsACoarseAndANoisyEncoder) {
  EXPECT_GT(coverage(6, 10.0, 0.0, {.step_rad = 0.26}), 93.0 - 2.8);
  EXPECT_GT(coverage(6, 10.0, 0.0, {.step_rad = 1.0}), 93.0 - 2.8);
  EXPECT_GT(coverage(6, 10.0, 0.0, {.noise_rad = 0.02}), 93.0 - 2.8);
  std::mt19937_64 random(3);
  const auto reading_sd = [&](const Encoder& encoder) {
    const std::vector<clampd::Run> runs{pressed(encoder, 10.0, random)};
    return contact_point(runs, nominal_estimate(1)).reading_sd_rad;
  };
  EXPECT_NEAR(reading_sd({.noise_rad = 0.02}), 0.02, 0.005);
  EXPECT_GE(reading_sd({.step_rad = 0.26}), 0.26 / std::sqrt(12.0));
  EXPECT_LT(reading_sd({.step_rad = 0.26}), 0.26);
  EXPECT_LT(reading_sd({}), 1e-3);
}

TEST(ContactPoint, WeighsRunsByWhatTheyTell) {
  std::mt19937_64 random(4);
  std::vector<clampd::Run> runs{pressed({}, 20.0, random), pressed({}, 20.0, random)};
  const double alone_rad = contact_point(runs, nominal_estimate(2)).position_rad;
  clampd::Run open = pressed({}, 20.0, random);
  for (double& position_rad : open.position_rad) position_rad -= 40.0;
  for (double& force_N : open.force_N) force_N = 0.0;
  runs.push_back(open);
  Estimate estimate = nominal_estimate(3);
  estimate.initial_states[2][0] = -42.6;
  EXPECT_EQ(contact_point(runs, estimate).position_rad, alone_rad)
      << "in the clearance there is nothing to see";
}

TEST(ContactPoint, SaysWhyItIsNotKnown) {
  std::mt19937_64 random(6);
  std::vector<clampd::Run> runs{pressed({}, 20.0, random)};
  const auto why = [&](const Estimate& estimate) {
    const ContactPoint contact = contact_point(runs, estimate);
    EXPECT_TRUE(std::isnan(contact.position_rad));
    return contact.why;
  };
  Estimate estimate = nominal_estimate(1);
  EXPECT_NE(ContactPoint().why, "");
  estimate.parameters.theta[k1] = kNaN;
  EXPECT_THAT(why(estimate), HasSubstr("no estimate of k1 and k2"));
  EXPECT_THAT(why(nominal_estimate(2)), HasSubstr("no estimate of k1 and k2"));
  estimate = nominal_estimate(1);
  estimate.initial_states[0][0] = -50.0;
  EXPECT_THAT(why(estimate), HasSubstr("no run presses the pads"));
  runs[0].position_rad.clear();
  EXPECT_THAT(why(nominal_estimate(1)), HasSubstr("repeat 1 has no position readings: record"));
  runs.clear();
  EXPECT_THAT(why(nominal_estimate(0)), HasSubstr("no run presses the pads"));
}

}  // namespace
}  // namespace clampd
