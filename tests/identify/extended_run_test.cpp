#include "src/identify/extended_run.hpp"

#include <limits>
#include <random>

#include <gtest/gtest.h>

#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd::identify {
namespace {

const NoiseLevels kNoise{{30.0, 0.3}, 0.0142};

/// What the squares alone say of a point is the last element of the normal equations there, under the gains
/// of another point: states of effects, readings that do not count, and the initial states included.
TEST(ExtendedRun, SquaresAreThoseOfTheNormalEquations) {
  std::mt19937_64 generator(7);
  const std::vector<clampd::Run> runs{
      support::run_reference_brake({}, BrakeState{0.0, 0.0}, support::strong_torque(), kNoise, generator)
          .run};
  std::vector<FitRun> fitted = fit_runs(runs, TorqueWhileOff{0.004, 0.0007, 500});
  FitRun& run = fitted.front();
  run.use_force[40] = run.use_velocity[40] = run.use_velocity[41] = 0;

  ExtendedParameters model;
  model.effects = {{find_effect("cogging"), {0.01, 0.005, 11.3}},
                   {find_effect("presliding"), {0.0004, 4.0, 0.1}},
                   {find_effect("force-lag"), {0.0003}},
                   {find_effect("torque-offset"), {0.002}},
                   {find_effect("force-hum"), {60.0}}};
  const auto linearised_at = [&](const ExtendedParameters& at, const Eigen::VectorXd& initial, Gains gains,
                                 ExtendedRun& out) {
    const ExtendedBrake brake(at);
    const Unknowns unknowns(at, brake.places(), {}, false);
    out.resize(run.size(), brake.states(), unknowns.count(), static_cast<int>(initial.size()));
    ASSERT_TRUE(linearise(run, brake, at, unknowns, initial, variances_of(kNoise), gains, out));
    compute_normal(run, out);
  };
  Eigen::VectorXd initial = Eigen::VectorXd::Zero(4);
  ExtendedRun linear;
  linearised_at(model, initial, Gains::Renewed, linear);

  model.base.theta[mus] *= 1.05;
  model.effects[2].values[0] = 0.0006;
  model.effects[3].values[0] = -0.003;
  initial << 0.02, 0.3, 40.0, -25.0;
  const double squares = sum_of_squares_of(run, ExtendedBrake(model), initial, linear);
  linearised_at(model, initial, Gains::Kept, linear);
  const Eigen::Index data = linear.columns() - 1;
  EXPECT_NEAR(squares, linear.normal(data, data), 1e-9 * squares);
  run.torque_while_off.reset();
  EXPECT_NEAR(squares - sum_of_squares_of(run, ExtendedBrake(model), initial, linear), 100.0, 1e-6)
      << "((0.004 + 0.003) / 0.0007)^2";

  model.base.theta[k2] = 1e12;  // flies apart
  EXPECT_EQ(sum_of_squares_of(run, ExtendedBrake(model), initial, linear),
            std::numeric_limits<double>::infinity());
}

}  // namespace
}  // namespace clampd::identify
