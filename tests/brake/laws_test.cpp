#include <gtest/gtest.h>

#include "brake/friction_law_suite.hpp"
#include "clampd/brake/dynamics.hpp"

namespace clampd::test {
namespace {

struct NominalStribeck {
  using Law = StribeckFriction;
  static std::vector<double> parameters() { return {7.67e-2, 4.68e-2, 4.46e-4, 3.55e-5, 28.9}; }
};
struct FastStribeck {  // the real brake of the paper's Table II: less static than Coulomb friction, small ws
  using Law = StribeckFriction;
  static std::vector<double> parameters() { return {1.27e-1, 4.35e-2, 9.9e-4, 3.73e-5, 12.3}; }
};
using StribeckCases = ::testing::Types<NominalStribeck, FastStribeck>;
INSTANTIATE_TYPED_TEST_SUITE_P(Stribeck, FrictionLawSuite, StribeckCases);

TEST(StribeckFriction, FollowsItsLimits) {
  const StribeckFriction law(NominalStribeck::parameters().data());
  const double force_N = 20000.0;
  const double holding = 4.68e-2 + 3.55e-5 * force_N;
  EXPECT_DOUBLE_EQ(law.holding_Nm(force_N), holding);
  // Halfway from static to Coulomb at ws; Coulomb and viscous far above.
  EXPECT_NEAR(law.sliding_Nm(force_N, 28.9, 1.0) - 4.46e-4 * 28.9, 0.5 * (holding + 7.67e-2), 1e-12);
  EXPECT_NEAR(law.sliding_Nm(force_N, 1e5, 1.0) - 4.46e-4 * 1e5, 7.67e-2, 1e-6);
}

TEST(StribeckFriction, LoadedSlowMotionIsUnstable) {
  // The steepest Stribeck slope of the clamped brake, about -0.018 N m s/rad: nearly every difficulty comes
  // from it.
  const StribeckFriction law(NominalStribeck::parameters().data());
  double gradient[StribeckFriction::kParameters];
  double steepest = 0.0;
  for (double v = 0.0; v < 100.0; v += 0.1)
    steepest = std::min(steepest, law.evaluate(23000.0, v, 1.0, gradient).by_velocity_Nm_s_rad);
  EXPECT_NEAR(steepest, -0.018, 0.001);
}

TEST(PolynomialStiffness, IsZeroInTheClearanceAndSmoothAtContact) {
  const double parameters[] = {-3.54e-1, 3.52e1};
  const PolynomialStiffness law(parameters);
  double gradient[2] = {1.0, 1.0};
  const ForcePoint clearance = law.evaluate(-0.5, gradient);
  EXPECT_EQ(clearance.force_N, 0.0);
  EXPECT_EQ(clearance.slope_N_rad, 0.0);
  EXPECT_EQ(gradient[0], 0.0);
  EXPECT_EQ(gradient[1], 0.0);
  const ForcePoint contact = law.evaluate(1e-9, gradient);
  EXPECT_NEAR(contact.force_N, 0.0, 1e-12);
  EXPECT_NEAR(contact.slope_N_rad, 0.0, 1e-6);
}

TEST(PolynomialStiffness, DerivativesAreThoseOfTheForce) {
  const double parameters[] = {-3.54e-1, 3.52e1};
  const PolynomialStiffness law(parameters);
  for (const double x : {0.5, 5.0, 20.0, 33.0, 80.0}) {
    double gradient[2];
    const ForcePoint point = law.evaluate(x, gradient);
    EXPECT_DOUBLE_EQ(point.force_N, law.force_N(x));
    EXPECT_NEAR(point.force_N, -3.54e-1 * std::pow(x, 3) + 3.52e1 * std::pow(x, 2), 1e-9);
    EXPECT_NEAR(point.slope_N_rad, (law.force_N(x + 1e-4) - law.force_N(x - 1e-4)) / 2e-4, 1e-5);
    EXPECT_DOUBLE_EQ(gradient[0], x * x * x);
    EXPECT_DOUBLE_EQ(gradient[1], x * x);
  }
}

/// A model of other parts: an actuator with a gain and an offset and a force reading with an offset. It shows
/// that the parts are replaceable and that the parameters are laid out part after part.
struct AffineActuator {
  static constexpr int kParameters = 2;
  double gain, offset_Nm;
  explicit AffineActuator(const double* parameters) : gain(parameters[0]), offset_Nm(parameters[1]) {}
  double acting_Nm(double reading_Nm, double) const noexcept { return gain * reading_Nm + offset_Nm; }
  TorquePoint evaluate(double reading_Nm, double velocity_rad_s, double* gradient) const noexcept {
    gradient[0] = reading_Nm;
    gradient[1] = 1.0;
    return {acting_Nm(reading_Nm, velocity_rad_s), gain, 0.0};
  }
};
struct OffsetReadings {
  static constexpr int kParameters = 1;
  double offset_N;
  explicit OffsetReadings(const double* parameters) : offset_N(parameters[0]) {}
  Reading read(double force_N, double velocity_rad_s) const noexcept {
    return {force_N + offset_N, velocity_rad_s};
  }
  ReadingSlopes evaluate(double, double, double* gradient) const noexcept {
    gradient[0] = 1.0;
    gradient[1] = 0.0;
    return {1.0, 0.0, 0.0, 1.0};
  }
};
using OtherBrake = BrakeModel<PolynomialStiffness, StribeckFriction, AffineActuator, OffsetReadings>;

TEST(BrakeModel, DerivativesAreThoseOfTheAccelerationForAnyParts) {
  static_assert(OtherBrake::kParameters == 10);
  OtherBrake::Parameters parameters;
  parameters << nominal_parameters(), 1.1, 0.02, 40.0;
  const FixedParameters fixed;
  const OtherBrake model(parameters, fixed);
  const double x = 20.0, v = 12.0, torque = 0.9, sign = 1.0;
  const auto point = model.linearise(x, v, torque, sign);
  EXPECT_NEAR(point.value, model.acceleration(x, v, torque, sign), 1e-9);
  const auto slope = [](auto function, double at, double step) {
    return (function(at + step) - function(at - step)) / (2.0 * step);
  };
  EXPECT_NEAR(point.by_position,
              slope([&](double p) { return model.acceleration(p, v, torque, sign); }, x, 1e-4), 1e-4);
  EXPECT_NEAR(point.by_velocity,
              slope([&](double w) { return model.acceleration(x, w, torque, sign); }, v, 1e-3), 1e-4);
  EXPECT_NEAR(point.by_torque,
              slope([&](double t) { return model.acceleration(x, v, t, sign); }, torque, 1e-3), 1e-6);
  for (int i = 0; i < OtherBrake::kParameters; ++i) {
    const double expected = slope(
        [&](double value) {
          OtherBrake::Parameters changed = parameters;
          changed[i] = value;
          return OtherBrake(changed, fixed).acceleration(x, v, torque, sign);
        },
        parameters[i], 1e-4 * std::abs(parameters[i]));
    EXPECT_NEAR(point.by_parameter[i], expected, 1e-6 * std::abs(expected) + 1e-9) << i;
  }
  EXPECT_DOUBLE_EQ(model.read(BrakeState(x, v)).force_N,
                   PolynomialStiffness(parameters.data()).force_N(x) + 40.0);
}

TEST(BrakeModel, HoldsWithinTheStaticLevelOnly) {
  const PaperBrake brake = paper_brake({});
  const double x = 25.0;
  const double load = 2.63e-5 * brake.stiffness().force_N(x);
  const double holding = brake.friction().holding_Nm(brake.stiffness().force_N(x));
  EXPECT_GT(holding, load);  // self-locking
  EXPECT_EQ(brake.breakaway_sign(x, 0.0), 0.0);
  EXPECT_EQ(brake.breakaway_sign(x, load + 0.999 * holding), 0.0);
  EXPECT_EQ(brake.breakaway_sign(x, load + 1.001 * holding), 1.0);
  EXPECT_EQ(brake.breakaway_sign(x, load - 1.001 * holding), -1.0);
}

}  // namespace
}  // namespace clampd::test
