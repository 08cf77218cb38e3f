#include "clampd/experiment/next_run.hpp"

#include <algorithm>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/experiment/reference.hpp"
#include "clampd/record/run.hpp"

namespace clampd {
namespace {

Reference shipped(const std::string& name) {
  const std::string path = std::string(CLAMPD_SOURCE_DIR) + "/configs/" + name + ".csv";
  return build_reference(read_run(path).value().run, {}).value();
}

Estimate estimate_of(const BrakeParameters& brake, Method method) {
  Estimate estimate;
  estimate.method = method;
  estimate.parameters = brake;
  estimate.noise_force_N = 45.0;
  estimate.noise_velocity_rad_s = 1.0;
  estimate.noise_torque_Nm = 0.0142;
  return estimate;
}

class NextRun : public ::testing::TestWithParam<Method> {
 protected:
  /// How many times smaller the variance of a parameter becomes by one run more along a trajectory.
  double gain(Parameter parameter, std::size_t trajectory, const BrakeParameters& brake = {}) const {
    const NextRunValue value =
        set_.value_of_next(estimate_of(brake, GetParam()), std::vector{4.0, 0.0, 0.0});
    return value.now(parameter, parameter) / value.after.at(trajectory)(parameter, parameter);
  }

  const TrajectorySet set_{
      {shipped("trajectory"), shipped("trajectory-sliding"), shipped("trajectory-breakaway")}, {}, 3.0};
};

TEST_P(NextRun, OfTheTrajectoriesThatShipEachTellsMostOfSomething) {
  EXPECT_NEAR(gain(k1, 0), 1.25, 1e-6) << "a fifth one like the other four";
  EXPECT_GT(gain(TC, 1), 2.0);
  EXPECT_GT(gain(Tv, 1), 2.0);
  EXPECT_GT(gain(Ts0, 2), 4.0);
  EXPECT_GT(gain(mus, 2), 2.0);
  for (const Parameter stiffness : {k1, k2})
    EXPECT_GT(gain(stiffness, 0), std::max(gain(stiffness, 1), gain(stiffness, 2)));
}

TEST_P(NextRun, SoItIsForBrakesAtTheEndsOfTheToleranceToo) {
  for (const double factor : {0.8, 1.25}) {
    BrakeParameters brake;
    brake.theta *= factor;
    EXPECT_GT(gain(TC, 1, brake), 1.1 * gain(TC, 0, brake)) << factor;
    EXPECT_GT(gain(Ts0, 2, brake), 1.1 * gain(Ts0, 0, brake)) << factor;
  }
}

INSTANTIATE_TEST_SUITE_P(Methods, NextRun, ::testing::Values(Method::OutputError, Method::PredictionError));

}  // namespace
}  // namespace clampd
