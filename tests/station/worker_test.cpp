#include "clampd/station/worker.hpp"

#include <atomic>
#include <semaphore>
#include <string>

#include <gtest/gtest.h>

#include "clampd/record/checksum.hpp"
#include "support/eventually.hpp"

namespace clampd {
namespace {

using Runs = std::span<const Run>;  // inside a TEST, plain Run is a member of testing::Test

CollectedRun run_of(double value) {
  CollectedRun collected;
  collected.run.name = "repeat " + std::to_string(value);
  collected.run.time_s = {0.0, 1e-3};
  collected.run.torque_Nm = collected.run.velocity_rad_s = collected.run.force_N = {value, value};
  collected.tracking_rms_N = 10.0 * value;
  return collected;
}

/// "Estimates" k2 as the mean of the first force values; TC reports the start it was given.
Estimate mean_of_forces(Runs runs, const EstimatorOptions& options) {
  Estimate summary;
  summary.termination = Termination::Converged;
  summary.parameters.theta = nominal_parameters();
  double sum = 0.0;
  for (const Run& run : runs) sum += run.force_N.front();
  summary.parameters.theta[k2] = sum / static_cast<double>(runs.size());
  summary.parameters.theta[TC] = options.start.theta[k2];
  summary.force_rms_N = 5.0;
  summary.iterations = static_cast<int>(runs.size());
  return summary;
}

class Worker : public ::testing::TestWithParam<WorkerMode> {};

TEST_P(Worker, IdentifiesEachRunAndAllJointly) {
  IdentificationWorker worker(mean_of_forces, {}, 5, GetParam());
  for (int i = 1; i <= 5; ++i) ASSERT_TRUE(worker.submit(run_of(i)));
  const auto outcome = worker.finish();
  EXPECT_EQ(worker.identified(), 5u);
  ASSERT_EQ(outcome.runs.size(), 5u);
  for (std::size_t i = 0; i < 5; ++i) {
    const double value = static_cast<double>(i + 1);
    EXPECT_EQ(outcome.runs[i].estimate[k2], value);
    EXPECT_EQ(outcome.runs[i].tracking_rms_N, 10.0 * value);
    EXPECT_EQ(outcome.runs[i].fit_force_rms_N, 5.0);
    EXPECT_TRUE(outcome.runs[i].converged);
    EXPECT_EQ(outcome.runs[i].checksum_sha256, sha256_hex(format_run(outcome.runs[i].run)));
  }
  EXPECT_EQ(outcome.joint.iterations, 5);
  EXPECT_EQ(outcome.joint.parameters.theta[k2], 3.0);
  EXPECT_EQ(outcome.joint.parameters.theta[TC], 3.0) << "starts from the median of the runs' estimates";
}

TEST_P(Worker, WithoutRunsThereIsNoEstimate) {
  IdentificationWorker worker(mean_of_forces, {}, 5, GetParam());
  const auto outcome = worker.finish();
  EXPECT_TRUE(outcome.runs.empty());
  EXPECT_FALSE(outcome.joint.converged());
}

TEST_P(Worker, ARunAloneThatDoesNotConvergeIsKeptAndNoStart) {
  const Estimator estimator = [](Runs runs, const EstimatorOptions& options) {
    Estimate summary = mean_of_forces(runs, options);
    if (runs.size() == 1 && runs[0].force_N[0] == 2.0) summary.termination = Termination::IterationLimit;
    return summary;
  };
  IdentificationWorker worker(estimator, {}, 5, GetParam());
  for (const double value : {2.0, 4.0}) ASSERT_TRUE(worker.submit(run_of(value)));
  const auto outcome = worker.finish();
  EXPECT_FALSE(outcome.runs[0].converged);
  EXPECT_TRUE(outcome.runs[1].converged);
  EXPECT_EQ(outcome.joint.parameters.theta[TC], 4.0);
}

TEST_P(Worker, LooksAtTheRunsSoFarAndTakesNoneOnceTheyAreEnough) {
  std::vector<std::size_t> looked;
  IdentificationWorker worker(mean_of_forces, {}, 9, GetParam(),
                              {2, [&looked](const std::vector<RunRecord>& runs, const Estimate& joint) {
                                 looked.push_back(runs.size());
                                 // The mean of 1, 2, 3.
                                 return Look{joint.parameters.theta[k2] >= 2.0,
                                             static_cast<std::uint8_t>(10 + runs.size())};
                               }});
  for (int i = 1; i <= 3; ++i) {
    ASSERT_TRUE(worker.submit(run_of(i)));
    ASSERT_TRUE(support::eventually([&] { return worker.identified() == static_cast<std::uint32_t>(i); }));
    EXPECT_TRUE(i == 3 || !worker.has_enough());
  }
  ASSERT_TRUE(support::eventually([&] { return worker.has_enough(); }));
  EXPECT_EQ(worker.next_trajectory(), 13) << "that the last look asked for";
  EXPECT_FALSE(worker.submit(run_of(99))) << "it would move the estimate that was enough";
  const auto outcome = worker.finish();
  EXPECT_EQ(outcome.runs.size(), 3u);
  EXPECT_EQ(outcome.joint.parameters.theta[k2], 2.0);
  ASSERT_FALSE(looked.empty());
  EXPECT_GE(looked.front(), 2u) << "not before the first look";
  EXPECT_EQ(looked.back(), 3u);
}

INSTANTIATE_TEST_SUITE_P(Modes, Worker, ::testing::Values(WorkerMode::Background, WorkerMode::Synchronous),
                         [](const auto& mode) {
                           return mode.param == WorkerMode::Background ? "background" : "synchronous";
                         });

TEST(BackgroundWorker, WorksBesideItsCallerAndRefusesWhatDoesNotFit) {
  std::counting_semaphore<16> started(0);
  std::counting_semaphore<16> go_on(0);
  const Estimator slow = [&](Runs runs, const EstimatorOptions& options) {
    started.release();
    go_on.acquire();
    return mean_of_forces(runs, options);
  };
  IdentificationWorker worker(slow, {}, 2, WorkerMode::Background);
  ASSERT_TRUE(worker.submit(run_of(1)));
  started.acquire();  // the first is being worked on and waits for us: submit() did not
  EXPECT_TRUE(worker.submit(run_of(2)));
  EXPECT_TRUE(worker.submit(run_of(3)));
  EXPECT_FALSE(worker.submit(run_of(4))) << "two are waiting";
  EXPECT_EQ(worker.identified(), 0u);
  go_on.release(16);
  EXPECT_EQ(worker.finish().runs.size(), 3u);
}

TEST(BackgroundWorker, LeavesOutALookWhileRunsWait) {
  std::counting_semaphore<16> started(0);
  std::counting_semaphore<16> go_on(0);
  std::vector<std::size_t> looked;
  const Estimator slow = [&](Runs runs, const EstimatorOptions& options) {
    started.release();
    go_on.acquire();
    return mean_of_forces(runs, options);
  };
  IdentificationWorker worker(slow, {}, 5, WorkerMode::Background,
                              {1, [&looked](const std::vector<RunRecord>& runs, const Estimate&) {
                                 looked.push_back(runs.size());
                                 return Look{};
                               }});
  ASSERT_TRUE(worker.submit(run_of(1)));
  started.acquire();
  ASSERT_TRUE(worker.submit(run_of(2)));
  ASSERT_TRUE(worker.submit(run_of(3)));
  go_on.release(16);
  EXPECT_EQ(worker.finish().joint.iterations, 3) << "the last look's fit is the verdict's";
  EXPECT_EQ(looked, std::vector<std::size_t>{3});
}

TEST(BackgroundWorker, CanBeDroppedWithRunsStillWaiting) {
  std::atomic<int> fits{0};
  {
    IdentificationWorker worker(
        [&](Runs runs, const EstimatorOptions& options) {
          ++fits;
          return mean_of_forces(runs, options);
        },
        {}, 100, WorkerMode::Background);
    for (int i = 0; i < 100; ++i) ASSERT_TRUE(worker.submit(run_of(i)));
  }
  EXPECT_LE(fits, 100);
}

}  // namespace
}  // namespace clampd
