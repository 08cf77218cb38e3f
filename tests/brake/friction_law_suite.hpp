#pragma once

// What every friction law must satisfy, as a typed test suite: instantiate it with a traits type that has
// `using Law`, `static Law law()` and `static std::vector<double> parameters()`.

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "clampd/brake/friction.hpp"

namespace clampd::test {

template <class Traits>
class FrictionLawSuite : public ::testing::Test {
 protected:
  using Law = typename Traits::Law;
  static constexpr double kForces_N[] = {0.0, 100.0, 5000.0, 23000.0, 30000.0};
  static constexpr double kSpeeds_rad_s[] = {0.0, 1e-3, 0.5, 5.0, 29.0, 80.0, 300.0};

  static Law with(const std::vector<double>& parameters) { return Law(parameters.data()); }
};

TYPED_TEST_SUITE_P(FrictionLawSuite);

TYPED_TEST_P(FrictionLawSuite, IsOddInVelocity) {
  const auto law = this->with(TypeParam::parameters());
  for (const double force : this->kForces_N)
    for (const double speed : this->kSpeeds_rad_s)
      EXPECT_DOUBLE_EQ(law.sliding_Nm(force, speed, 1.0), -law.sliding_Nm(force, -speed, -1.0))
          << force << " N, " << speed << " rad/s";
}

TYPED_TEST_P(FrictionLawSuite, Dissipates) {
  const auto law = this->with(TypeParam::parameters());
  for (const double force : this->kForces_N) {
    EXPECT_GT(law.holding_Nm(force), 0.0);
    for (const double speed : this->kSpeeds_rad_s) EXPECT_GT(law.sliding_Nm(force, speed, 1.0), 0.0);
  }
}

TYPED_TEST_P(FrictionLawSuite, SlidingStartsAtTheHoldingLevel) {
  // Otherwise breakaway would jump, and the stick decision and the motion after it would contradict each
  // other.
  const auto law = this->with(TypeParam::parameters());
  for (const double force : this->kForces_N)
    EXPECT_NEAR(law.sliding_Nm(force, 0.0, 1.0), law.holding_Nm(force),
                1e-15 + 1e-14 * law.holding_Nm(force));
}

TYPED_TEST_P(FrictionLawSuite, IsContinuousAcrossZeroVelocityForAFixedSign) {
  const auto law = this->with(TypeParam::parameters());
  for (const double force : this->kForces_N)
    EXPECT_NEAR(law.sliding_Nm(force, 1e-9, 1.0), law.sliding_Nm(force, -1e-9, 1.0), 1e-8);
}

TYPED_TEST_P(FrictionLawSuite, DerivativesAreThoseOfTheTorque) {
  const std::vector<double> parameters = TypeParam::parameters();
  const auto law = this->with(parameters);
  std::vector<double> gradient(parameters.size());
  // Fourth order central difference.
  const auto difference = [](auto function, double at, double step) {
    return (8.0 * (function(at + step) - function(at - step)) -
            (function(at + 2 * step) - function(at - 2 * step))) /
           (12.0 * step);
  };
  for (const double sign : {1.0, -1.0}) {
    for (const double force : this->kForces_N) {
      for (const double speed : this->kSpeeds_rad_s) {
        const double velocity = sign * speed;
        const FrictionPoint point = law.evaluate(force, velocity, sign, gradient.data());
        EXPECT_NEAR(point.torque_Nm, law.sliding_Nm(force, velocity, sign), 1e-15);
        EXPECT_NEAR(point.by_force_Nm_N,
                    difference([&](double f) { return law.sliding_Nm(f, velocity, sign); }, force, 10.0),
                    1e-12);
        EXPECT_NEAR(point.by_velocity_Nm_s_rad,
                    difference([&](double v) { return law.sliding_Nm(force, v, sign); }, velocity, 0.02),
                    1e-9);
        for (std::size_t i = 0; i < parameters.size(); ++i) {
          const auto with_parameter = [&](double value) {
            std::vector<double> changed = parameters;
            changed[i] = value;
            return this->with(changed).sliding_Nm(force, velocity, sign);
          };
          const double expected = difference(with_parameter, parameters[i], 1e-3 * parameters[i]);
          EXPECT_NEAR(gradient[i], expected, 1e-9 * (1.0 + std::abs(expected))) << "parameter " << i;
        }
      }
    }
  }
}

REGISTER_TYPED_TEST_SUITE_P(FrictionLawSuite, IsOddInVelocity, Dissipates, SlidingStartsAtTheHoldingLevel,
                            IsContinuousAcrossZeroVelocityForAFixedSign, DerivativesAreThoseOfTheTorque);

}  // namespace clampd::test
