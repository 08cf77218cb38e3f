#include "clampd/experiment/optimal_design.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "clampd/base/nan.hpp"
#include "experiment/designs.hpp"

namespace clampd {
namespace {


DesignOptions short_options(std::size_t samples, int starts) {
  DesignOptions options;
  options.samples = samples;
  options.starts = starts;
  options.threads = 2;
  return options;
}

/// Limits, and the agreement of two integrators on outputs and criterion.
void expect_sound(const DesignOptions& options, const DesignSummary& summary) {
  ASSERT_TRUE(summary.certified()) << summary.message;
  ASSERT_EQ(summary.block_torque_Nm.size(), options.samples / options.block_samples);
  for (const double torque : summary.block_torque_Nm) EXPECT_LE(std::abs(torque), options.limits.torque_Nm);
  const Certification& certification = summary.certification;
  EXPECT_LE(certification.force_max_N, options.limits.force_N);
  EXPECT_LE(certification.velocity_max_rad_s, options.limits.velocity_rad_s);
  EXPECT_LE(certification.amplification_rad_s_Nm, options.limits.amplification_rad_s_Nm);
  EXPECT_LE(std::abs(certification.end_velocity_rad_s), options.limits.end_velocity_rad_s);
  EXPECT_NEAR(certification.criterion.logdet, summary.criterion.logdet, kCertifiedLogdet);
  EXPECT_NEAR(std::log(certification.criterion.trace_inverse), std::log(summary.criterion.trace_inverse),
              0.1);
}

TEST(OptimalDesign, EvaluatesWhateverDesign) {
  DesignOptions options;
  options.samples = 200;
  const DesignEvaluation good = evaluate_design(options, testing::kGoodBlocks_Nm);
  EXPECT_NEAR(good.criterion.logdet, -68.33, 0.01);
  EXPECT_EQ(good.violation, 0.0);
  options.limits.force_N = 0.5 * good.force_max_N;
  EXPECT_NEAR(evaluate_design(options, testing::kGoodBlocks_Nm).violation, 1.0, 1e-9);
  EXPECT_TRUE(std::isinf(evaluate_design(options, std::vector<double>(10, 0.0)).criterion.logdet));
}

TEST(OptimalDesign, ReachesTheKnownOptimumOf100Samples) {
  const DesignOptions options = short_options(100, 48);
  const DesignSummary summary = design_experiment(options);
  expect_sound(options, summary);
  EXPECT_LE(summary.criterion.logdet, -39.0);
}

TEST(OptimalDesign, ReachesTheKnownOptimumOf200Samples) {
  const DesignOptions options = short_options(200, 96);
  const DesignSummary summary = design_experiment(options);
  expect_sound(options, summary);
  EXPECT_LE(summary.criterion.logdet, -68.2);
}

TEST(OptimalDesign, ReachesWhatTheProductPromisesAt300Samples) {
  const DesignOptions options;
  const DesignSummary summary = design_experiment(options);
  expect_sound(options, summary);
  // What a search finds hangs on the processor's rounding as it does on the seed. Twelve seeds of twelve found
  // -85.39 or better, and ten of them -85.6.
  EXPECT_LE(summary.criterion.logdet, -85.2);
  EXPECT_LE(summary.certification.criterion.logdet, -85.2);
  EXPECT_LE(summary.certification.amplification_rad_s_Nm, 4e5);
}

TEST(OptimalDesign, DoesNotDependOnThreads) {
  DesignOptions options = short_options(100, 8);
  options.seed = 5;
  std::vector<DesignSummary> summaries;
  for (const int threads : {1, 2, 3}) {
    options.threads = threads;
    summaries.push_back(design_experiment(options));
  }
  for (const DesignSummary& summary : summaries) {
    EXPECT_EQ(summary.block_torque_Nm, summaries.front().block_torque_Nm);
    EXPECT_EQ(summary.simulations, summaries.front().simulations);
  }
  options.seed = 6;
  EXPECT_NE(design_experiment(options).block_torque_Nm, summaries.front().block_torque_Nm);
}

TEST(OptimalDesign, KeepsOtherLimitsBlocksAndStarts) {
  DesignOptions options = short_options(120, 16);
  options.block_samples = 15;
  options.limits = {.torque_Nm = 2.4, .force_N = 6e3, .velocity_rad_s = 260.0, .end_velocity_rad_s = 2.0};
  options.initial = {5.0, 20.0};
  expect_sound(options, design_experiment(options));
}

TEST(OptimalDesign, EachObjectiveIsBestAtItsOwn) {
  DesignOptions options = short_options(100, 24);
  const DesignSummary d = design_experiment(options);
  options.objective = Objective::A;
  const DesignSummary a = design_experiment(options);
  expect_sound(options, a);
  EXPECT_LT(a.criterion.trace_inverse, d.criterion.trace_inverse);
  EXPECT_LT(d.criterion.logdet, a.criterion.logdet);
}

TEST(OptimalDesign, SaysWhenNothingIsPossible) {
  DesignOptions options = short_options(100, 8);
  options.limits.torque_Nm = 0.04;  // below the static friction: the brake never moves
  const DesignSummary summary = design_experiment(options);
  EXPECT_EQ(summary.termination, DesignTermination::NothingFeasible);
  EXPECT_TRUE(summary.block_torque_Nm.empty());
  EXPECT_FALSE(summary.message.empty());
}

TEST(OptimalDesign, ReportsProgressUpToTheEnd) {
  DesignOptions options = short_options(100, 8);
  double last = 0.0;
  double best = std::numeric_limits<double>::infinity();
  options.progress = [&](double fraction, double objective) {
    EXPECT_GE(fraction, last);
    EXPECT_LE(objective, best);
    last = fraction;
    best = objective;
  };
  design_experiment(options);
  EXPECT_DOUBLE_EQ(last, 1.0);
}

TEST(OptimalDesign, RefusesImpossibleOptions) {
  const auto refuses = [](auto change) {
    DesignOptions options;
    change(options);
    const Result<void> valid = options.validate();
    return !valid && !valid.error().message.empty();
  };
  EXPECT_TRUE(DesignOptions{}.validate());
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.samples = 310; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.samples = o.block_samples = 6; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.samples = 20000; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.samples = 1000, o.block_samples = 1; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.block_samples = 0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.limits.torque_Nm = 0.0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.limits.force_N = -1.0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.limits.velocity_rad_s = kNaN; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.limits.end_velocity_rad_s = -1.0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.limits.amplification_rad_s_Nm = 0.0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.noise.force_N = 0.0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.starts = 0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.caution = -1.0; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.threads = -1; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.initial = {kNaN, 0.0}; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.initial = {0.0, 301.0}; }));
  EXPECT_TRUE(refuses([](DesignOptions& o) { o.initial = {40.0, 0.0}; }));
}

}  // namespace
}  // namespace clampd
