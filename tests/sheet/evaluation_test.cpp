#include "clampd/sheet/evaluation.hpp"

#include <cmath>
#include <limits>
#include <optional>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/brake/integrator.hpp"
#include "src/sheet/measured_brake.hpp"
#include "src/sheet/response.hpp"

namespace clampd {
namespace {

using State = CharacteristicEstimate::State;
using ::testing::HasSubstr;

constexpr double kNoLimit = std::numeric_limits<double>::infinity();

Characteristic line(std::string_view kind, const Circumstances& at) {
  for (const CharacteristicKind& each : characteristic_kinds())
    if (each.name == kind) return {std::string(kind), &each, at, -kNoLimit, kNoLimit};
  ADD_FAILURE() << kind;
  return {};
}

double value_of(std::string_view kind, const Circumstances& at, const BrakeParameters& brake = {}) {
  return line(kind, at).kind->value(brake, at, {}).value();
}

/// Known to 2 %, each by itself; k1 and k2 together, as they are.
Posterior good_posterior() {
  Posterior posterior;
  posterior.covariance_normalised = 4e-4 * ParameterMatrix::Identity();
  posterior.covariance_normalised(k1, k2) = posterior.covariance_normalised(k2, k1) = 3.9e-4;
  return posterior;
}

/// Those that the parameters alone tell.
std::vector<CharacteristicKind> kinds_of_parameters() {
  std::vector<CharacteristicKind> kinds;
  for (const CharacteristicKind& kind : characteristic_kinds())
    if (kind.value != nullptr) kinds.push_back(kind);
  return kinds;
}

/// Of a brake whose encoder has its zero far away, with a contact point that is known to a few milliradians,
/// and that was found 6 rad open.
Posterior posterior_with_contact() {
  Posterior posterior = good_posterior();
  posterior.contact.position_rad = 1e4;
  posterior.contact.variance_rad2 = 9e-6;
  posterior.contact.by_parameters[k1] = -2.0;
  posterior.contact.by_parameters[k2] = 6.0;
  posterior.contact.reading_sd_rad = 0.004;
  posterior.contact.why.clear();
  posterior.found_rad = 1e4 - 6.0;
  return posterior;
}

CharacteristicEstimate evaluate_one(std::string_view kind, const Circumstances& at,
                                    const Posterior& posterior) {
  const Characteristic lines[] = {line(kind, at)};
  return evaluate(lines, posterior, {}).front();
}

const Circumstances kAt{.force_N = 20e3, .share = 0.9, .speed_rad_s = 50.0, .clearance_rad = 6.0};

// Table I by hand: Ts = 4.68e-2 + 3.55e-5 * 20e3 = 0.7568 N m, N F = 0.526 N m.
TEST(SheetClosedForms, AreThoseOfThePaper) {
  EXPECT_NEAR(value_of("holding-margin", kAt), 0.2308, 1e-12);
  EXPECT_NEAR(value_of("least-torque", kAt), 1.2828, 1e-12);
  // 7.67e-2 + (4.68e-2 - 7.67e-2) / (1 + (50/28.9)^2) + 4.46e-4 * 50
  EXPECT_NEAR(value_of("drag", kAt), 0.0767 - 0.0299 / (1.0 + 2500.0 / 835.21) + 0.0223, 1e-12);
  // 2 (0.0767 + (0.7568 - 0.0767) / (1 + (50/28.9)^2) + 0.0223)
  EXPECT_NEAR(value_of("hysteresis", kAt), 2.0 * (0.0767 + 0.6801 / (1.0 + 2500.0 / 835.21) + 0.0223), 1e-12);
  // 35.2 x^2 - 0.354 x^3 = 20e3 at x = 27.9366..., found by Newton's method on paper
  double x = 28.0;
  for (int i = 0; i < 20; ++i) x -= (35.2 * x * x - 0.354 * x * x * x - 20e3) / (70.4 * x - 1.062 * x * x);
  EXPECT_NEAR(value_of("stiffness", kAt), 70.4 * x - 1.062 * x * x, 1e-8);
}

TEST(SheetResponse, ABrakeWithoutLoadMovesAsFastAsTheDriveAllows) {
  // Nearly no friction, no force: constant acceleration by 3 N m until the speed limit fades the torque.
  BrakeParameters brake;
  brake.theta << 0.0, 0.1, 1e-4, 1e-4, 1e-7, 1e-8, 30.0;
  const Move move{.from_rad = -6.0, .to_rad = 0.0, .level_rad = -5.0};
  const double acceleration = (3.0 - 1e-4) / 2.91e-4;
  EXPECT_NEAR(*move_time_s(paper_brake(brake), move, {}), std::sqrt(2.0 / acceleration), 1e-6);
}

TEST(SheetResponse, NeedsMoreTimeForMoreAndOnALowSupply) {
  Circumstances half = kAt, low = kAt, far = kAt;
  half.share = 0.5;
  low.torque_limit_Nm = 1.5;
  far.clearance_rad = 12.0;
  const double time = value_of("apply-time", kAt);
  EXPECT_GT(time, 0.08);
  EXPECT_LT(time, 0.2);
  EXPECT_LT(value_of("apply-time", half), time);
  EXPECT_GT(value_of("apply-time", low), 1.05 * time);
  EXPECT_GT(value_of("apply-time", far), time + 0.02);
  BrakeParameters soft;
  soft.theta[k2] *= 0.85;
  EXPECT_GT(value_of("apply-time", kAt, soft), time);
}

TEST(SheetResponse, PassesALevelWithinThePeriod) {
  // x = 1 + 2 t + 3 t^2 - t^3 over one second, exactly what the cubic is.
  EXPECT_NEAR(passing_share({1.0, 2.0}, {5.0, 5.0}, 1.0 + 2.0 * 0.3 + 3.0 * 0.09 - 0.027, 1.0), 0.3, 1e-12);
  EXPECT_NEAR(passing_share({5.0, -5.0}, {1.0, -2.0}, 1.0 + 2.0 * 0.3 + 3.0 * 0.09 - 0.027, 1.0), 0.7, 1e-12);
}

TEST(SheetEvaluation, PropagatesALinearCharacteristicExactly) {
  Posterior posterior = good_posterior();
  posterior.covariance_normalised(Ts0, mus) = posterior.covariance_normalised(mus, Ts0) = -3e-4;
  const CharacteristicEstimate margin = evaluate_one("holding-margin", kAt, posterior);
  ASSERT_EQ(margin.state, State::Known);
  EXPECT_NEAR(margin.value, 0.2308, 1e-12);
  const double a = 4.68e-2, b = 0.71;  // d margin / d normalised
  EXPECT_NEAR(margin.sd, std::sqrt(4e-4 * (a * a + b * b) - 2.0 * 3e-4 * a * b), 1e-12);
}

TEST(SheetEvaluation, AgreesWithDrawsFromThePosterior) {
  const Posterior posterior = good_posterior();
  const Eigen::LLT<ParameterMatrix> root(posterior.covariance_normalised);
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  constexpr int kDraws = 2000;
  for (const CharacteristicKind& kind : kinds_of_parameters()) {
    const CharacteristicEstimate estimate = evaluate_one(kind.name, kAt, posterior);
    ASSERT_EQ(estimate.state, State::Known) << kind.name;
    double sum = 0.0, squares = 0.0;
    for (int i = 0; i < kDraws; ++i) {
      ParameterVector z;
      for (double& each : z) each = normal(random);
      BrakeParameters brake;
      brake.theta += nominal_parameters().asDiagonal() * (root.matrixL() * z);
      const double value = kind.value(brake, kAt, {}).value();
      sum += value;
      squares += value * value;
    }
    const double mean = sum / kDraws, sd = std::sqrt(squares / kDraws - mean * mean);
    EXPECT_NEAR(estimate.sd / sd, 1.0, 0.07) << kind.name;  // four deviations of sd from so many draws
    EXPECT_NEAR(estimate.value, mean, 0.2 * sd) << kind.name;
  }
}

TEST(SheetEvaluation, IsTheSameAgain) {
  for (const CharacteristicKind& kind : kinds_of_parameters()) {
    const CharacteristicEstimate once = evaluate_one(kind.name, kAt, good_posterior());
    const CharacteristicEstimate again = evaluate_one(kind.name, kAt, good_posterior());
    EXPECT_EQ(once.value, again.value);
    EXPECT_EQ(once.sd, again.sd);
  }
}

TEST(SheetEvaluation, WhatNeedsAnUnknownParameterIsNotKnown) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  Posterior posterior = good_posterior();
  posterior.parameters.theta[Tv] = kNaN;
  posterior.covariance_normalised.row(Tv).setConstant(kNaN);
  posterior.covariance_normalised.col(Tv).setConstant(kNaN);
  for (const CharacteristicKind& kind : kinds_of_parameters()) {
    const bool needs = std::find(kind.needs.begin(), kind.needs.end(), Tv) != kind.needs.end();
    const CharacteristicEstimate estimate = evaluate_one(kind.name, kAt, posterior);
    EXPECT_EQ(estimate.state, needs ? State::Unknown : State::Known) << kind.name;
    if (needs) {
      EXPECT_TRUE(std::isnan(estimate.value) && std::isnan(estimate.sd));
      EXPECT_THAT(estimate.why, HasSubstr("needs Tv"));
    } else {
      EXPECT_EQ(estimate.value, evaluate_one(kind.name, kAt, good_posterior()).value);
    }
  }
}

TEST(SheetEvaluation, WhatNeedsAHeldParameterIsNotKnownEither) {
  Posterior posterior = good_posterior();
  posterior.covariance_normalised.row(Ts0).setZero();
  posterior.covariance_normalised.col(Ts0).setZero();
  EXPECT_THAT(evaluate_one("drag", kAt, posterior).why, HasSubstr("Ts0, which was held"));
  EXPECT_EQ(evaluate_one("stiffness", kAt, posterior).state, State::Known);
  posterior.covariance_normalised.setConstant(std::numeric_limits<double>::quiet_NaN());
  EXPECT_THAT(evaluate_one("drag", kAt, posterior).why, HasSubstr("uncertainty is not known"));
}

// Every value is what it is by those parameters alone that the table names.
TEST(SheetEvaluation, KindsNeedWhatTheyNeed) {
  for (const CharacteristicKind& kind : kinds_of_parameters())
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      BrakeParameters other;
      other.theta[static_cast<Eigen::Index>(i)] *= 1.05;
      const bool needs = std::find(kind.needs.begin(), kind.needs.end(), i) != kind.needs.end();
      EXPECT_EQ(kind.value(other, kAt, {}) != kind.value({}, kAt, {}), needs)
          << kind.name << ' ' << kParameterTable[i].name;
    }
}

TEST(SheetEvaluation, SaysIfABrakeDoesNotGetThere) {
  Posterior posterior = good_posterior();
  posterior.parameters.theta[k2] *= 0.5;
  Circumstances at = kAt;
  at.force_N = 27e3;
  EXPECT_EQ(evaluate_one("apply-time", at, posterior).state, State::NotReached);
  at.force_N = 4.0 * std::pow(17.6, 3) / (27.0 * 0.354 * 0.354);  // just where its stiffness turns over
  const CharacteristicEstimate edge = evaluate_one("apply-time", at, posterior);
  EXPECT_EQ(edge.state, State::Unknown);
  EXPECT_THAT(edge.why, HasSubstr("uncertain"));
}

TEST(SheetEvaluation, NothingIsKnownWithoutAnEstimateOrOfAModelWithEffects) {
  Estimate estimate;
  estimate.termination = Termination::IterationLimit;
  estimate.message = "too many iterations";
  EXPECT_THAT(evaluate_one("drag", kAt, posterior_of(estimate)).why, HasSubstr("too many iterations"));
  estimate.termination = Termination::Converged;
  estimate.covariance_normalised = good_posterior().covariance_normalised;
  EXPECT_EQ(evaluate_one("drag", kAt, posterior_of(estimate)).state, State::Known);
  estimate.effects.push_back({"backlash", "play", "rad", 0.1, 0.01});
  EXPECT_THAT(evaluate_one("drag", kAt, posterior_of(estimate)).why,
              HasSubstr("depend on what it did before"));
}

/// Of a check with this effect in its model, its strength known to `sd` and everything else as above.
Estimate estimate_with(const EffectEstimate& strength) {
  Estimate estimate;
  estimate.termination = Termination::Converged;
  estimate.covariance_normalised = good_posterior().covariance_normalised;
  estimate.effects = {strength};
  estimate.covariance_with_effects.setZero(8, 8);
  estimate.covariance_with_effects.topLeftCorner<7, 7>() = estimate.covariance_normalised;
  estimate.covariance_with_effects(7, 7) = strength.sd * strength.sd;
  return estimate;
}

// Put on the bench, a brake whose effect is nothing does what the closed forms say.
TEST(SheetMeasured, ABrakeWithoutEffectIsThatOfTheClosedForms) {
  BrakeParameters brake;
  brake.theta = nominal_parameters().cwiseProduct(
      (ParameterVector() << 1.1, 0.95, 1.2, 0.9, 1.3, 1.05, 0.8).finished());
  const EffectValues none{find_effect("quadratic-drag"), {0.0}};
  for (const CharacteristicKind& kind : kinds_of_parameters()) {
    const std::optional<double> value = kind.measured(MeasuredBrake({brake, {none}}), kAt, {});
    ASSERT_TRUE(value) << kind.name;
    EXPECT_NEAR(*value / kind.value(brake, kAt, {}).value(), 1.0, 2e-4) << kind.name;
  }
  Circumstances never = kAt;
  never.force_N = 5e4;
  BrakeParameters soft;
  soft.theta[k2] *= 0.6;
  for (const CharacteristicKind& kind : kinds_of_parameters())
    EXPECT_EQ(kind.measured(MeasuredBrake({soft, {none}}), never, {}).has_value(), kind.name == "drag")
        << kind.name;
}

TEST(SheetMeasured, WhatAnEffectDoesIsCountedWithItsUncertainty) {
  // 3e-6 N m s^2/rad^2 at 50 rad/s, known to 1e-6.
  const Estimate estimate = estimate_with({"quadratic-drag", "coefficient", "N m s^2/rad^2", 3e-6, 1e-6});
  const CharacteristicEstimate with = evaluate_one("drag", kAt, posterior_of(estimate));
  const CharacteristicEstimate without = evaluate_one("drag", kAt, good_posterior());
  ASSERT_EQ(with.state, State::Known) << with.why;
  EXPECT_NEAR(with.value - without.value, 3e-6 * 2500.0, 1e-6);
  EXPECT_NEAR(with.sd, std::hypot(without.sd, 1e-6 * 2500.0), 1e-5);
  // Without current a drag does nothing.
  EXPECT_NEAR(evaluate_one("holding-margin", kAt, posterior_of(estimate)).value, 0.2308, 1e-6);
  // A tare that moves it counts, too.
  Estimate tared = estimate;
  tared.effects[0].offset_sensitivity = {0.0, 1e-5};
  EXPECT_NEAR(evaluate_one("drag", kAt, posterior_of(tared, ParameterMatrix::Zero(), {0.0, 0.2})).sd,
              std::hypot(with.sd, 2e-6 * 2500.0), 1e-5);
}

// Friction that is greater by 0.02 N m when the brake applies, and as much less when it releases.
TEST(SheetMeasured, DirectionsDiffer) {
  const MeasuredBrake brake({{}, {{find_effect("friction-asymmetry"), {0.02, 0.0, 1.0}}}});
  const auto change = [&](std::string_view kind) {
    return line(kind, kAt).kind->measured(brake, kAt, {}).value() - value_of(kind, kAt);
  };
  EXPECT_NEAR(change("drag"), 0.02, 1e-6);
  EXPECT_NEAR(change("least-torque"), 0.02, 1e-6);
  EXPECT_NEAR(change("holding-margin"), -0.02, 1e-6);
  EXPECT_NEAR(change("hysteresis"), 0.0, 5e-6);
  EXPECT_NEAR(change("stiffness"), 0.0, 1e-3);
}

// A reading that is late makes no other brake.
TEST(SheetMeasured, EffectsInTheReadingsLeaveTheClosedForms) {
  const Posterior posterior = posterior_of(estimate_with({"force-lag", "time_constant", "s", 1e-3, 1e-4}));
  for (const CharacteristicKind& kind : kinds_of_parameters()) {
    EXPECT_EQ(evaluate_one(kind.name, kAt, posterior).value,
              evaluate_one(kind.name, kAt, good_posterior()).value);
    EXPECT_EQ(evaluate_one(kind.name, kAt, posterior).sd, evaluate_one(kind.name, kAt, good_posterior()).sd);
  }
}

TEST(SheetEvaluation, WhatIsAddedToTheCovarianceCounts) {
  Estimate estimate;
  estimate.termination = Termination::Converged;
  estimate.covariance_normalised = good_posterior().covariance_normalised;
  const double before = evaluate_one("apply-time", kAt, posterior_of(estimate)).sd;
  const double after =
      evaluate_one("apply-time", kAt, posterior_of(estimate, 3.0 * estimate.covariance_normalised)).sd;
  EXPECT_NEAR(after / before, 2.0, 0.1);
}

TEST(SheetContact, IsTheEncodersReadingWithBothOfItsErrors) {
  const Posterior posterior = posterior_with_contact();
  const CharacteristicEstimate contact = evaluate_one("contact-point", {}, posterior);
  ASSERT_EQ(contact.state, State::Known) << contact.why;
  EXPECT_EQ(contact.value, 1e4);
  const double by_parameters = 4e-4 * (4.0 + 36.0) - 2.0 * 3.9e-4 * 12.0;
  EXPECT_NEAR(contact.sd, std::sqrt(by_parameters + 9e-6), 1e-12);
  // A tare that moves both: what it does to the contact point alone is 0.1 rad of its deviation.
  Posterior tared = posterior;
  tared.covariance_normalised(k2, k2) += 1e-4;
  tared.contact.variance_rad2 += 0.01;
  tared.covariance_with_contact[k2] = 0.01 * 0.1;
  EXPECT_NEAR(evaluate_one("contact-point", {}, tared).sd,
              std::sqrt(by_parameters + 9e-6 + std::pow(6.0 * 0.01 + 0.1, 2)), 1e-12);
}

TEST(SheetContact, ClearanceCountsFromWhereTheCheckFoundTheBrake) {
  Posterior posterior = posterior_with_contact();
  const CharacteristicEstimate open = evaluate_one("clearance", {}, posterior);
  ASSERT_EQ(open.state, State::Known) << open.why;
  EXPECT_NEAR(open.value, 6.0, 1e-9);
  EXPECT_NEAR(open.sd, std::hypot(evaluate_one("contact-point", {}, posterior).sd, 0.004), 1e-12);
  posterior.found_rad = 1e4 + 20.0;
  EXPECT_NEAR(evaluate_one("clearance", {}, posterior).value, -20.0, 1e-9) << "it was clamped";
}

TEST(SheetContact, SaysWhyItIsNotKnown) {
  EXPECT_THAT(evaluate_one("contact-point", {}, good_posterior()).why, HasSubstr("no runs"));
  Posterior posterior = posterior_with_contact();
  posterior.found_rad.reset();
  EXPECT_EQ(evaluate_one("contact-point", {}, posterior).state, State::Known);
  const CharacteristicEstimate clearance = evaluate_one("clearance", {}, posterior);
  EXPECT_EQ(clearance.state, State::Unknown);
  EXPECT_TRUE(std::isnan(clearance.value) && std::isnan(clearance.sd));
  EXPECT_THAT(clearance.why, HasSubstr("let a station check it"));
  posterior = posterior_with_contact();
  posterior.contact.why = "repeat 1 has no position readings";
  for (const char* kind : {"contact-point", "clearance"})
    EXPECT_EQ(evaluate_one(kind, {}, posterior).why, "repeat 1 has no position readings");
  posterior = posterior_with_contact();
  posterior.covariance_normalised.row(k1).setZero();
  posterior.covariance_normalised.col(k1).setZero();
  EXPECT_THAT(evaluate_one("clearance", {}, posterior).why, HasSubstr("k1, which was held"));
}

}  // namespace
}  // namespace clampd
