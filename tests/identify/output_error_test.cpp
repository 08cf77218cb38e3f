#include "clampd/identify/output_error.hpp"

#include <cmath>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd {
namespace {

using support::constant_run;
using support::expect_no_nonsense;
using ::testing::HasSubstr;

std::vector<clampd::Run> repeats(std::size_t count, const BrakeParameters& truth, unsigned seed,
                                 double force_noise_N = 75.0, double velocity_noise_rad_s = 1.5,
                                 double clearance_rad = 0.0) {
  std::mt19937_64 generator(seed);
  const auto torque = support::strong_torque();
  std::vector<clampd::Run> runs;
  for (std::size_t r = 0; r < count; ++r) {
    Simulation simulation(torque.size());
    simulate(truth, BrakeState(-clearance_rad - 0.1 * static_cast<double>(r) * (clearance_rad > 0.0), 0.0),
             {torque}, simulation);
    runs.push_back(support::noisy_run(torque, simulation.force_N, simulation.velocity_rad_s, force_noise_N,
                                      velocity_noise_rad_s, generator));
  }
  return runs;
}

TEST(OutputError, RecoversTheParametersOfANoiseFreeRunExactly) {
  BrakeParameters truth;
  truth.theta =
      truth.theta.cwiseProduct((ParameterVector() << 0.8, 0.9, 1.66, 0.93, 2.2, 1.05, 0.43).finished());
  const auto runs = repeats(1, truth, 1, 0.0, 0.0);
  const auto summary = identify_output_error(runs, {});
  ASSERT_TRUE(summary.converged()) << summary.message;
  EXPECT_LT((summary.parameters.theta.cwiseQuotient(truth.theta).array() - 1.0).abs().maxCoeff(), 1e-4);
}

TEST(OutputError, FitsRepeatsJointlyAndReportsThem) {
  const auto runs = repeats(20, {}, 2);
  const auto joint = identify_output_error(runs, {});
  const auto single = identify_output_error({runs.data(), 1}, {});
  ASSERT_TRUE(joint.converged()) << joint.message;
  ASSERT_TRUE(single.converged()) << single.message;
  EXPECT_NEAR(single.covariance_normalised(1, 1) / joint.covariance_normalised(1, 1), 20.0, 4.0);
  EXPECT_NEAR(joint.noise_force_N, 75.0, 3.0);
  EXPECT_NEAR(joint.noise_velocity_rad_s, 1.5, 0.05);
  EXPECT_EQ(joint.initial_states.size(), 20u);
  EXPECT_EQ(joint.run_force_rms_N.size(), 20u);
  EXPECT_TRUE(joint.covariance_over_runs.allFinite());
  EXPECT_TRUE(single.covariance_over_runs.array().isNaN().all());
  const ParameterVector error =
      joint.parameters.theta.cwiseQuotient(nominal_parameters()) - ParameterVector::Ones();
  for (int i = 0; i < 7; ++i)
    EXPECT_LT(std::abs(error[i]), 4.0 * std::sqrt(joint.covariance_normalised(i, i))) << i;
}

TEST(OutputError, TellsFromTwoRunsOnWhetherTheyAgree) {
  EXPECT_EQ(identify_output_error(repeats(1, {}, 5), {}).runs_agree_p, 1.0);
  int unlikely = 0;
  for (unsigned seed = 100; seed < 140; ++seed) {
    const Estimate alike = identify_output_error(repeats(2 + seed % 3, {}, seed), {});
    ASSERT_TRUE(alike.converged()) << alike.message;
    unlikely += alike.runs_agree_p < 0.05;
  }
  EXPECT_LE(unlikely, 7) << "two are expected, more than seven in one of a thousand such tests";
  BrakeParameters other;
  other.theta[k2] *= 1.05;
  auto runs = repeats(1, {}, 6);
  runs.push_back(repeats(1, other, 7).front());
  const Estimate mixed = identify_output_error(runs, {});
  EXPECT_LT(mixed.runs_agree_p, kRunsDiffer);
  EXPECT_FALSE(mixed.runs_differ) << "two runs are no scatter that could be an uncertainty";
  EXPECT_TRUE(mixed.covariance_over_runs.array().isNaN().all());
}

TEST(OutputError, DeviationsRestOnAsMuchAsIsKnownOfTheTorquesNoise) {
  const auto runs = repeats(2, {}, 8);
  EstimatorOptions exact_torque;
  exact_torque.noise_torque_Nm = 0.0;
  const Estimate given = identify_output_error(runs, exact_torque);
  EXPECT_TRUE(given.degrees_of_freedom.array().isInf().all()) << "nothing of it is estimated";
  const Estimate estimated = identify_output_error(runs, {});
  EXPECT_TRUE((estimated.degrees_of_freedom.array() >= 4.0).all());
}

TEST(OutputError, FindsADifferentClearanceOfEveryRun) {
  const auto runs = repeats(3, {}, 3, 75.0, 1.5, 1.0);
  const auto summary = identify_output_error(runs, {});
  ASSERT_TRUE(summary.converged()) << summary.message;
  for (std::size_t r = 0; r < 3; ++r)
    EXPECT_NEAR(summary.initial_states[r][0], -1.0 - 0.1 * static_cast<double>(r), 0.1);
}

TEST(OutputError, TakesIrregularTimeStamps) {
  auto runs = repeats(1, {}, 4, 0.0, 0.0);
  // Every third row left out while the torque stays the same across it.
  clampd::Run sparse;
  for (std::size_t k = 0; k < runs[0].size(); ++k) {
    if (k % 20 == 7) continue;
    sparse.time_s.push_back(runs[0].time_s[k] + 5.0);
    sparse.torque_Nm.push_back(runs[0].torque_Nm[k]);
    sparse.force_N.push_back(runs[0].force_N[k]);
    sparse.velocity_rad_s.push_back(runs[0].velocity_rad_s[k]);
  }
  const auto summary = identify_output_error({&sparse, 1}, {});
  ASSERT_TRUE(summary.converged()) << summary.message;
  EXPECT_NEAR(summary.parameters.theta[k2], 35.2, 1e-2);
}

TEST(OutputError, UsesKnownNoise) {
  const auto runs = repeats(1, {}, 5);
  EstimatorOptions options;
  options.noise_force_N = 150.0;
  options.noise_velocity_rad_s = 3.0;
  options.noise_torque_Nm = 0.0;
  const auto twice = identify_output_error(runs, options);
  EstimatorOptions exact_torque;
  exact_torque.noise_torque_Nm = 0.0;
  const auto once = identify_output_error(runs, exact_torque);
  ASSERT_TRUE(twice.converged() && once.converged());
  EXPECT_NEAR(twice.covariance_normalised(1, 1) / once.covariance_normalised(1, 1), 4.0, 0.6);
  EXPECT_EQ(twice.noise_force_N, 150.0);
  EXPECT_NEAR(twice.force_rms_N, 75.0, 8.0);
}

TEST(OutputError, ReportsTheIterationLimit) {
  const auto runs = repeats(1, {}, 6);
  EstimatorOptions options;
  options.max_iterations = 1;
  options.start.theta *= 1.3;
  EXPECT_EQ(identify_output_error(runs, options).termination, Termination::IterationLimit);
}

TEST(OutputError, SaysWhenTheRunsCannotTell) {
  for (const clampd::Run& run : {constant_run(300, 0.0, 0.0, 0.0), constant_run(300, 0.5, 0.0, 20000.0),
                                 constant_run(300, 0.0, 10.0, 100.0), constant_run(3, 0.1, 0.0, 0.0),
                                 constant_run(2, 0.0, 0.0, 0.0)}) {
    const auto summary = identify_output_error({&run, 1}, {});
    EXPECT_FALSE(summary.converged()) << run.size() << " rows, " << run.force_N[0] << " N";
    expect_no_nonsense(summary);
  }
}

TEST(OutputError, NamesAParameterThatTheRunDoesNotShow) {
  // In the clearance nothing depends on the stiffness or on the load.
  const std::vector<double> torque = [] {
    std::vector<double> values;
    for (const double block : {0.3, -0.3, 0.2, -0.4, 0.3}) values.insert(values.end(), 20, block);
    return values;
  }();
  Simulation simulation(torque.size());
  simulate({}, BrakeState(-50.0, 0.0), {torque}, simulation);
  std::mt19937_64 generator(8);
  const clampd::Run run =
      support::noisy_run(torque, simulation.force_N, simulation.velocity_rad_s, 75.0, 1.5, generator);
  const auto summary = identify_output_error({&run, 1}, {});
  EXPECT_EQ(summary.termination, Termination::NotIdentifiable);
  EXPECT_THAT(summary.message, ::testing::AnyOf(HasSubstr("k1"), HasSubstr("k2"), HasSubstr("mus")));
  expect_no_nonsense(summary);
}

TEST(OutputError, SurvivesSpikes) {
  for (const double spike : {1e5, 1e9, 1e15, -1e12}) {
    auto runs = repeats(1, {}, 9);
    for (std::size_t k = 50; k < 300; k += 50) {
      runs[0].force_N[k] = spike;
      runs[0].velocity_rad_s[k + 3] = -spike;
    }
    const auto summary = identify_output_error(runs, {});
    expect_no_nonsense(summary);
    if (summary.converged()) {
      EXPECT_GT(summary.noise_force_N, 0.05 * std::abs(spike));
    }
    runs[0].torque_Nm[70] = spike;
    expect_no_nonsense(identify_output_error(runs, {}));
  }
}

TEST(OutputError, RejectsWhatIsNotARun) {
  const auto message_of = [](const clampd::Run& run) {
    const auto summary = identify_output_error({&run, 1}, {});
    EXPECT_EQ(summary.termination, Termination::NumericalFailure);
    expect_no_nonsense(summary);
    return summary.message;
  };
  EXPECT_THAT(identify_output_error({}, {}).message, HasSubstr("no run"));
  clampd::Run run = constant_run(10, 0.1, 0.0, 0.0);
  run.force_N[4] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message_of(run), HasSubstr("row 4 of force_N"));
  run = constant_run(10, 0.1, 0.0, 0.0);
  run.torque_Nm.pop_back();
  EXPECT_THAT(message_of(run), HasSubstr("torque_Nm has 9 rows"));
  run = constant_run(10, 0.1, 0.0, 0.0);
  run.time_s[5] = 7.0;
  EXPECT_THAT(message_of(run), HasSubstr("leaps"));
  EXPECT_THAT(message_of(constant_run(1, 0.0, 0.0, 0.0)), HasSubstr("1 rows"));
}

TEST(EstimatorOptions, AreValidated) {
  EXPECT_TRUE(EstimatorOptions{}.validate());
  EstimatorOptions options;
  options.max_iterations = 0;
  EXPECT_FALSE(options.validate());
  options = {};
  options.start.theta[TC] = -1.0;
  EXPECT_THAT(options.validate().error().message, HasSubstr("TC"));
  options = {};
  options.noise_force_N = 0.0;
  EXPECT_FALSE(options.validate());
  options = {};
  options.start.fixed.inertia_kg_m2 = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(options.validate());
}

}  // namespace
}  // namespace clampd
