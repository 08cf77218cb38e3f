#include "clampd/brake/extended_brake.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "clampd/brake/dynamics.hpp"
#include "clampd/brake/integrator.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

constexpr double kStep_s = 1e-3;

/// Approach, clamp, a reversal under load, a hold, release.
double torque_at(double time_s) {
  if (time_s < 0.08) return 1.2;
  if (time_s < 0.16) return 0.9 + 0.5 * std::sin(60.0 * time_s);
  if (time_s < 0.22) return -0.4;
  if (time_s < 0.28) return 0.2;
  return -0.9;
}

RowInput row_at(int k) {
  return {torque_at((k - 1) * kStep_s),
          torque_at(k * kStep_s),
          torque_at((k + 1) * kStep_s),
          torque_at((k + 2) * kStep_s),
          k * kStep_s,
          kStep_s,
          3.0};
}

/// Values at which an effect shows, of each of its parameters.
EffectValues visible(const Effect& effect) {
  EffectValues values{&effect, {}};
  for (const EffectParameter& parameter : info_of(effect).parameters) {
    if (parameter.role == EffectParameter::Role::Strength)
      values.values.push_back(parameter.neutral + 2.0 * parameter.scale);
    else if (!parameter.starts.empty())
      values.values.push_back(parameter.role == EffectParameter::Role::Shape
                                  ? parameter.starts[parameter.starts.size() / 2]
                                  : parameter.starts.front());
    else
      values.values.push_back(std::min(8000.0, 0.5 * parameter.upper));
  }
  return values;
}

std::string name_of(const ::testing::TestParamInfo<const Effect*>& info) {
  std::string name(info_of(*info.param).name);
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

TEST(ExtendedBrake, IsTheBaseModelWithoutEffects) {
  const BrakeParameters nominal;
  const ExtendedBrake extended({nominal, {}});
  const PaperBrake base = paper_brake(nominal);
  BrakeState state(-4.0, 0.0);
  ExtendedBrake::State other = extended.settled(-4.0, 0.0, row_at(0));
  for (int k = 0; k < 360; ++k) {
    const Reading reading = extended.read(other, row_at(k));
    EXPECT_NEAR(reading.force_N, base.read(state).force_N, 1e-6);
    EXPECT_NEAR(reading.velocity_rad_s, state[1], 1e-8);
    state = advance(base, state, torque_at(k * kStep_s), kStep_s);
    other = extended.advance(other, row_at(k));
  }
  EXPECT_GT(base.read(state).force_N, 0.0);
}

class EveryEffect : public ::testing::TestWithParam<const Effect*> {};
INSTANTIATE_TEST_SUITE_P(Catalogue, EveryEffect, ::testing::ValuesIn(effects().begin(), effects().end()),
                         name_of);

TEST_P(EveryEffect, RecoversTheBaseModelAtItsNeutralValue) {
  const EffectInfo& info = info_of(*GetParam());
  EffectValues neutral = visible(*GetParam());
  bool has_strength = info.free_states > 0;
  for (std::size_t i = 0; i < info.parameters.size(); ++i) {
    if (info.parameters[i].role != EffectParameter::Role::Strength) continue;
    has_strength = true;
    neutral.values[i] = info.parameters[i].neutral;
  }
  if (!has_strength) GTEST_SKIP() << "has no strength: its neutral value is a limit";
  const BrakeParameters nominal;
  const ExtendedBrake base({nominal, {}});
  const ExtendedBrake extended({nominal, {neutral}});
  ExtendedBrake::State state = base.settled(-4.0, 0.0, row_at(0));
  ExtendedBrake::State other = extended.settled(-4.0, 0.0, row_at(0));
  for (int k = 0; k < 360; ++k) {
    const Reading expected = base.read(state, row_at(k));
    const Reading reading = extended.read(other, row_at(k));
    ASSERT_NEAR(reading.force_N, expected.force_N, 1e-6) << k;
    ASSERT_NEAR(reading.velocity_rad_s, expected.velocity_rad_s, 1e-8) << k;
    state = base.advance(state, row_at(k));
    other = extended.advance(other, row_at(k));
  }
}

/// Every effect with each of its choices.
std::vector<EffectValues> every_form() {
  std::vector<EffectValues> forms;
  for (const Effect* effect : effects()) {
    forms.push_back(visible(*effect));
    const auto& parameters = info_of(*effect).parameters;
    for (std::size_t i = 0; i < parameters.size(); ++i) {
      if (is_estimated(parameters[i])) continue;
      for (std::size_t other = 1; other < parameters[i].starts.size(); ++other) {
        forms.push_back(visible(*effect));
        forms.back().values[i] = parameters[i].starts[other];
      }
    }
  }
  return forms;
}

std::string name_of_form(const ::testing::TestParamInfo<EffectValues>& form) {
  std::string name(info_of(*form.param.effect).name);
  std::replace(name.begin(), name.end(), '-', '_');
  return name + "_" + std::to_string(form.index);
}

class EveryForm : public ::testing::TestWithParam<EffectValues> {};
INSTANTIATE_TEST_SUITE_P(Catalogue, EveryForm, ::testing::ValuesIn(every_form()), name_of_form);

TEST_P(EveryForm, HasExactDerivativesThroughStickAndSlip) {
  const EffectValues values = GetParam();
  const ExtendedParameters at{BrakeParameters{}, {values}};
  const ExtendedBrake brake(at);
  const int n = brake.states();
  const int p = brake.parameters();
  std::vector<double> jacobian(static_cast<std::size_t>(n * (n + p + 1)));
  std::vector<double> reading_jacobian(static_cast<std::size_t>(2 * (n + p)));
  ExtendedBrake::State state = brake.settled(-4.0, 0.0, row_at(0));
  for (const int free : brake.free_states()) state[free] = 20.0;
  int compared = 0;
  int wrong = 0;
  for (int k = 0; k < 360; ++k) {
    const RowInput row = row_at(k);
    const ExtendedBrake::State next = brake.advance(state, row, jacobian.data());
    ASSERT_LT((next - brake.advance(state, row)).cwiseAbs().maxCoeff(), 1e-9);
    brake.read(state, row, reading_jacobian.data());
    if (k % 3 == 0) {
      for (int j = 0; j < n + p + 1; ++j) {
        const auto moved = [&](double by, bool reading) {
          ExtendedParameters parameters = at;
          ExtendedBrake::State start = state;
          RowInput input = row;
          double change = by;
          if (j < n) {
            change *= std::max(1.0, std::abs(state[j]));
            start[j] += change;
          } else if (j == n + p) {
            for (double* torque_Nm :
                 {&input.previous_torque_Nm, &input.torque_Nm, &input.next_torque_Nm, &input.later_torque_Nm})
              *torque_Nm += change;
          } else {
            const ExtendedBrake::Place place = brake.places()[static_cast<std::size_t>(j - n)];
            double& value = place.effect < 0
                                ? parameters.base.theta[place.parameter]
                                : parameters.effects[0].values[static_cast<std::size_t>(place.parameter)];
            change *= std::max(1e-6, std::abs(value));
            value += change;
          }
          const ExtendedBrake other(parameters);
          Eigen::VectorXd result(n + 3);
          const Reading read = other.read(start, input);
          result << other.advance(start, input), (reading ? read.force_N : 0.0),
              (reading ? read.velocity_rad_s : 0.0), change;
          return result;
        };
        const Eigen::VectorXd here = moved(0.0, true);
        const Eigen::VectorXd up = moved(1e-6, true);
        const Eigen::VectorXd down = moved(-1e-6, true);
        const double width = up[n + 2] - down[n + 2];
        for (int i = 0; i < n + 2; ++i) {
          if (i >= n && j == n + p) continue;
          const double exact = i < n ? jacobian[static_cast<std::size_t>(i * (n + p + 1) + j)]
                                     : reading_jacobian[static_cast<std::size_t>((i - n) * (n + p) + j)];
          const auto agrees = [&](double slope, double over) {
            return std::abs(exact - slope) < 2e-4 * std::max(1.0, std::abs(slope)) +
                                                 1e-9 * std::max(1.0, std::abs(here[i])) / std::abs(over);
          };
          ++compared;
          // At a kink, such as a play that is just closed, the derivative is that of one side.
          if (!agrees((up[i] - down[i]) / width, width) &&
              !agrees((up[i] - here[i]) / up[n + 2], up[n + 2]) &&
              !agrees((down[i] - here[i]) / down[n + 2], down[n + 2]))
            ++wrong;
        }
      }
    }
    state = next;
  }
  EXPECT_GT(compared, 1000);
  EXPECT_LT(wrong, compared / 200);
}

double elastic_N(double position) {
  const ParameterVector theta = nominal_parameters();
  const double x = std::max(0.0, position);
  return x * x * (theta[k1] * x + theta[k2]);
}

double friction_of(double sliding_Nm, double resting_Nm, double velocity) {
  const ParameterVector theta = nominal_parameters();
  const double speed = velocity / theta[ws];
  return sliding_Nm + (resting_Nm - sliding_Nm) / (1.0 + speed * speed) + theta[Tv] * std::abs(velocity);
}

TEST(ForceReading, OfALagOrADelayFollowsTheBendBetweenRows) {
  constexpr double kLag_s = 0.4e-3, kLate = 0.4;
  constexpr int kFine = 2000;  // steps in a row
  const auto torque_Nm = [](int row) { return row % 4 < 2 ? 3.4 : -0.6; };
  const ParameterVector theta = nominal_parameters();
  const FixedParameters fixed;
  const auto row_at = [&](int k) {
    return RowInput{torque_Nm(k - 1), torque_Nm(k), torque_Nm(k + 1), torque_Nm(k + 2), 1e-3 * k, 1e-3, 0.0};
  };

  double position = 12.0, velocity = 60.0;
  double filtered = elastic_N(position);
  std::vector<double> before(kFine, filtered);
  const ExtendedBrake brake{ExtendedParameters{}};
  const ExtendedBrake lagging({BrakeParameters{}, {{find_effect("force-lag"), {kLag_s}}}});
  const ExtendedBrake late({BrakeParameters{}, {{find_effect("channel-skew"), {kLate, 0, 1}}}});
  ExtendedBrake::State state = brake.settled(position, velocity, row_at(0));
  ExtendedBrake::State of_lagging = lagging.settled(position, velocity, row_at(0));
  ExtendedBrake::State of_late = late.settled(position, velocity, row_at(0));
  double bend = 0.0;
  for (int k = 0; k < 60; ++k) {
    ASSERT_GT(velocity, 5.0) << "one direction";
    const double at_once = brake.read(state, row_at(k)).force_N;
    if (k > 8) {  // the filter began as if the brake had stood still
      const double delayed = before[static_cast<std::size_t>((1.0 - kLate) * kFine)];
      EXPECT_NEAR(lagging.read(of_lagging, row_at(k)).force_N - at_once, filtered - elastic_N(position),
                  0.05);
      EXPECT_NEAR(late.read(of_late, row_at(k)).force_N - at_once, delayed - elastic_N(position), 0.05);
    }
    state = brake.advance(state, row_at(k));
    of_lagging = lagging.advance(of_lagging, row_at(k));
    of_late = late.advance(of_late, row_at(k));
    const double first = elastic_N(position);
    for (int i = 0; i < kFine; ++i) {
      constexpr double kStep = 1e-3 / kFine;
      before[static_cast<std::size_t>(i)] = elastic_N(position);
      const double friction = friction_of(theta[TC], theta[Ts0] + theta[mus] * elastic_N(position), velocity);
      velocity +=
          kStep / fixed.inertia_kg_m2 * (torque_Nm(k) - fixed.ratio_m_rad * elastic_N(position) - friction);
      position += kStep * velocity;
      const double midway_N = 0.5 * (before[static_cast<std::size_t>(i)] + elastic_N(position));
      filtered += (midway_N - filtered) * -std::expm1(-kStep / kLag_s);
    }
    bend = std::max(bend, std::abs(first - 2.0 * before[kFine / 2] + elastic_N(position)));
  }
  EXPECT_GT(bend, 1.0) << "N: or straight lines would do";
}

/// Friction turns round or ceases within the row, and the velocity with it is no straight line.
TEST(VelocityReading, OfALagOrADelayFollowsTheBendAtAReversal) {
  constexpr double kLag_s = 0.2e-3, kLate = 0.4, kPosition = 22.0, kStep = 1e-7;
  const ParameterVector theta = nominal_parameters();
  const FixedParameters fixed;
  const ExtendedBrake lagging({BrakeParameters{}, {{find_effect("velocity-lag"), {kLag_s}}}});
  const ExtendedBrake late({BrakeParameters{}, {{find_effect("channel-skew"), {kLate, 0, 2}}}});
  double bend = 0.0;
  for (const auto& [torque_Nm, start] :
       {std::pair{-2.6, 2.0}, {-2.6, 5.0}, {-2.6, 10.0}, {2.6, -2.0}, {2.6, -5.0}, {2.6, -9.0}, {0.4, 1.0}}) {
    double position = kPosition, velocity = start, filtered = start, delayed = start;
    for (int i = 0; i < 10'000; ++i) {
      if (i == 6'000) delayed = velocity;
      const double friction = friction_of(theta[TC], theta[Ts0] + theta[mus] * elastic_N(position), velocity);
      const double pushed =
          velocity + kStep / fixed.inertia_kg_m2 * (torque_Nm - fixed.ratio_m_rad * elastic_N(position));
      const double most = kStep / fixed.inertia_kg_m2 * friction;
      const double before = velocity;
      velocity = std::abs(pushed) <= most ? 0.0 : pushed - std::copysign(most, pushed);
      position += kStep * velocity;
      filtered += (0.5 * (before + velocity) - filtered) * -std::expm1(-kStep / kLag_s);
    }
    ASSERT_LE(start * velocity, 0.0) << "it was to reverse, or to stop";
    const RowInput row{torque_Nm, torque_Nm, torque_Nm, torque_Nm, 0.0, 1e-3, 0.0};
    const auto reading = [&](const ExtendedBrake& brake) {
      return brake.read(brake.advance(brake.settled(kPosition, start, row), row), row).velocity_rad_s;
    };
    EXPECT_NEAR(reading(lagging), filtered, 0.02) << torque_Nm << " N m from " << start << " rad/s";
    EXPECT_NEAR(reading(late), delayed, 0.02) << torque_Nm << " N m from " << start << " rad/s";
    bend = std::max(bend, std::abs(velocity + kLate * (start - velocity) - delayed));
  }
  EXPECT_GT(bend, 0.5) << "rad/s: or a straight line would do";
}

/// In the row in which the torque changes: what acts then is no constant, and friction turns round at an
/// instant that depends on it.
TEST(TorqueLag, ReversesTheBrakeWhenTheTorqueDoes) {
  constexpr double kTorque_Nm = 2.6, kPosition = 22.0, kStep = 1e-7;
  const ParameterVector theta = nominal_parameters();
  const FixedParameters fixed;
  double at_once = 0.0;
  for (const double lag_s : {0.03e-3, 0.1e-3, 0.4e-3})
    for (const double start : {1.0, 3.0, 5.0, 8.0}) {
      double position = kPosition, velocity = start;
      for (int i = 0; i < 10'000; ++i) {
        const double acting_Nm = kTorque_Nm * (2.0 * std::exp(-(i + 0.5) * kStep / lag_s) - 1.0);
        const double friction =
            friction_of(theta[TC], theta[Ts0] + theta[mus] * elastic_N(position), velocity);
        const double pushed =
            velocity + kStep / fixed.inertia_kg_m2 * (acting_Nm - fixed.ratio_m_rad * elastic_N(position));
        const double most = kStep / fixed.inertia_kg_m2 * friction;
        velocity = std::abs(pushed) <= most ? 0.0 : pushed - std::copysign(most, pushed);
        position += kStep * velocity;
      }
      const ExtendedBrake lagging({BrakeParameters{}, {{find_effect("torque-lag"), {lag_s}}}});
      const RowInput before{kTorque_Nm, kTorque_Nm, -kTorque_Nm, -kTorque_Nm, 0.0, 1e-3, 0.0};
      const RowInput row{kTorque_Nm, -kTorque_Nm, -kTorque_Nm, -kTorque_Nm, 1e-3, 1e-3, 0.0};
      const ExtendedBrake::State end = lagging.advance(lagging.settled(kPosition, start, before), row);
      EXPECT_NEAR(end[1], velocity, 0.1) << lag_s << " s, from " << start << " rad/s";
      const ExtendedBrake brake{ExtendedParameters{}};
      at_once =
          std::max(at_once, std::abs(velocity - brake.advance(brake.settled(kPosition, start, row), row)[1]));
    }
  EXPECT_GT(at_once, 5.0) << "rad/s: without the lag";
}

TEST(ExtendedBrake, KnowsWhatActsWhileTheTorqueReadsTheSame) {
  const ExtendedBrake brake({BrakeParameters{},
                             {{find_effect("torque-offset"), {0.02}},
                              {find_effect("torque-gain"), {0.1}},
                              {find_effect("torque-lag"), {0.002}},
                              {find_effect("channel-skew"), {0.4, 1, 3}},
                              {find_effect("cogging"), {0.05, 0.0, 6.0}}}});
  // The offset is added to what was multiplied.
  EXPECT_NEAR(brake.acting_torque(0.5), (0.5 - 0.02) / 1.1, 1e-12);
  std::vector<double> gradient(static_cast<std::size_t>(brake.parameters()), 9.0);
  EXPECT_DOUBLE_EQ(brake.acting_torque(0.5, gradient.data()), brake.acting_torque(0.5));
  for (std::size_t i = 0; i < gradient.size(); ++i) {
    const bool is_offset = brake.places()[i].effect == 0, is_gain = brake.places()[i].effect == 1;
    EXPECT_NEAR(gradient[i], is_offset ? -1.0 / 1.1 : is_gain ? -(0.5 - 0.02) / 1.21 : 0.0, 1e-12) << i;
  }
}

/// A torque held from row to row, its reading the mean of a row's time that began some of it earlier.
TEST(ChannelSkew, UndoesTheMixtureThatALateTorqueReadsAs) {
  constexpr double kLate = 0.6;
  const auto mixed = [](int k) {
    return (1.0 - kLate) * torque_at(k * kStep_s) + kLate * torque_at((k - 1) * kStep_s);
  };
  const auto apart = [&](double late) {
    const ExtendedBrake brake{ExtendedParameters{}};
    const ExtendedBrake skewed({BrakeParameters{}, {{find_effect("channel-skew"), {late, 0, 3}}}});
    ExtendedBrake::State state = brake.settled(-4.0, 0.0, row_at(0));
    ExtendedBrake::State seen = skewed.settled(-4.0, 0.0, row_at(0));
    double squares = 0.0;
    for (int k = 0; k < 360; ++k) {
      RowInput late_row = row_at(k);
      late_row.previous_torque_Nm = mixed(k - 1);
      late_row.torque_Nm = mixed(k);
      late_row.next_torque_Nm = mixed(k + 1);
      late_row.later_torque_Nm = mixed(k + 2);
      state = brake.advance(state, row_at(k));
      seen = skewed.advance(seen, late_row);
      squares += (state[1] - seen[1]) * (state[1] - seen[1]);
    }
    return std::sqrt(squares / 360.0);
  };
  EXPECT_GT(apart(0.0), 2.0) << "rad/s, taken as it was read";
  EXPECT_LT(apart(kLate), 0.35 * apart(0.0)) << "linear interpolation alone: 0.57";
}

/// The models of Canudas de Wit, Olsson, Astrom and Lischinsky (1995) and of Dupont, Hayward, Armstrong and
/// Altpeter (2002) as they are written, in steps of 0.1 us.
struct Bristles {
  enum class Law { LuGre = 3, ElastoPlastic } law;
  double deflection_rad, damping, within_N, within_rad_s;
  int reversals;  ///< of the motion, at least
};
void PrintTo(const Bristles& bristles, std::ostream* out) {
  *out << bristles.deflection_rad << " rad";
}

/// The share of the motion in which bristles bent by `share` of what they hold while sliding do slide.
double sliding(Bristles::Law law, double share) {
  constexpr double kBreakaway = 0.7;
  if (law == Bristles::Law::LuGre) return 1.0;
  if (share <= kBreakaway) return 0.0;
  if (share >= 1.0) return 1.0;
  const double middle = 0.5 * (1.0 + kBreakaway);
  return 0.5 * std::sin(std::numbers::pi * (share - middle) / (1.0 - kBreakaway)) + 0.5;
}

class BristleLaws : public ::testing::TestWithParam<Bristles> {};
INSTANTIATE_TEST_SUITE_P(Presliding, BristleLaws,
                         ::testing::Values(Bristles{Bristles::Law::LuGre, 0.0006, 0.4, 5.0, 0.12, 3},
                                           Bristles{Bristles::Law::LuGre, 0.02, 0.1, 1.0, 0.02, 1},
                                           Bristles{Bristles::Law::LuGre, 0.08, 0.0, 1.0, 0.02, 1},
                                           Bristles{Bristles::Law::ElastoPlastic, 0.0006, 0.4, 5.0, 0.12, 3},
                                           Bristles{Bristles::Law::ElastoPlastic, 0.02, 0.1, 2.0, 0.02, 1},
                                           Bristles{Bristles::Law::ElastoPlastic, 0.08, 0.0, 1.0, 0.02, 1}),
                         [](const auto& each) { return fmt::format("{}", each.index); });

TEST_P(BristleLaws, AreTheModelsAsPublished) {
  const auto [law, deflection_rad, damping_ratio, within_N, within_rad_s, least_reversals] = GetParam();
  const BrakeParameters nominal;
  const auto& theta = nominal.theta;
  const double inertia = nominal.fixed.inertia_kg_m2;
  const double stiffness = theta[TC] / deflection_rad;
  const double damping = 2.0 * damping_ratio * std::sqrt(stiffness * inertia);
  const ExtendedBrake brake(
      {nominal, {{find_effect("presliding"), {deflection_rad, static_cast<double>(law), damping_ratio}}}});
  ExtendedBrake::State state = brake.settled(-4.0, 0.0, row_at(0));
  double position = -4.0, velocity = 0.0, bristles = state[2] * deflection_rad;
  double fastest = 0.0;
  int reversals = 0;
  for (int k = 0; k < 360; ++k) {
    const Reading reading = brake.read(state, row_at(k));
    ASSERT_NEAR(reading.force_N, elastic_N(position), within_N) << k;
    ASSERT_NEAR(reading.velocity_rad_s, velocity, within_rad_s) << k;
    const double before = velocity;
    constexpr int kSteps = 10000;
    constexpr double kFine_s = kStep_s / kSteps;
    for (int i = 0; i < kSteps; ++i) {
      const double force = elastic_N(position);
      const double speed = velocity / theta[ws];
      const double level = theta[TC] + (theta[Ts0] + theta[mus] * force - theta[TC]) / (1.0 + speed * speed);
      const double share = stiffness * std::copysign(1.0, velocity) * bristles / level;
      const double bending = velocity * (1.0 - sliding(law, share) * share);
      const double friction = stiffness * bristles + damping * bending + theta[Tv] * velocity;
      const double net = torque_at(k * kStep_s) - nominal.fixed.ratio_m_rad * force - friction;
      bristles += kFine_s * bending;
      velocity += kFine_s * net / inertia;
      position += kFine_s * velocity;
    }
    fastest = std::max(fastest, std::abs(velocity));
    reversals += before * velocity < 0.0 ? 1 : 0;
    state = brake.advance(state, row_at(k));
  }
  EXPECT_GT(fastest, 50.0);
  EXPECT_GE(reversals, least_reversals);
}

/// A brake in steps of 0.5 us, its friction of the set-valued kind: `push_N(x, v)` of the pads, `friction_Nm(
/// direction, v, push)`.
template <class Push, class Friction>
void expect_same_motion(const EffectValues& effect, const Push& push_N, const Friction& friction_Nm) {
  const BrakeParameters nominal;
  const ExtendedBrake brake({nominal, {effect}});
  ExtendedBrake::State state = brake.settled(-4.0, 0.0, row_at(0));
  double position = -4.0, velocity = 0.0;
  int reversals = 0;
  for (int k = 0; k < 360; ++k) {
    const Reading reading = brake.read(state, row_at(k));
    ASSERT_NEAR(reading.force_N, push_N(position, velocity), 5.0) << k;
    ASSERT_NEAR(reading.velocity_rad_s, velocity, 0.1) << k;
    const double before = velocity;
    constexpr int kSteps = 2000;
    constexpr double kFine_s = kStep_s / kSteps;
    for (int i = 0; i < kSteps; ++i) {
      const double push = push_N(position, velocity);
      const double load = torque_at(k * kStep_s) - nominal.fixed.ratio_m_rad * push;
      const double sliding = velocity + kFine_s * load / nominal.fixed.inertia_kg_m2;
      const double direction = sliding < 0.0 ? -1.0 : 1.0;
      const double held = kFine_s * friction_Nm(direction, velocity, push) / nominal.fixed.inertia_kg_m2;
      velocity = direction * std::max(0.0, direction * sliding - held);
      position += kFine_s * velocity;
    }
    reversals += before * velocity < 0.0 || (before == 0.0) != (velocity == 0.0);
    state = brake.advance(state, row_at(k));
  }
  EXPECT_GT(reversals, 2);
}

TEST(FrictionAsymmetry, IsConstantOrOfTheDryFrictionOrOfTheSlidingPartAlone) {
  const ParameterVector theta = nominal_parameters();
  constexpr double kMore_Nm = 0.01;
  const auto push = [](double x, double) { return elastic_N(x); };
  const auto resting = [&](double push_N) { return theta[Ts0] + theta[mus] * push_N; };
  expect_same_motion({find_effect("friction-asymmetry"), {kMore_Nm, 0.0, 1}}, push,
                     [&](double direction, double v, double push_N) {
                       return friction_of(theta[TC], resting(push_N), v) + direction * kMore_Nm;
                     });
  expect_same_motion({find_effect("friction-asymmetry"), {kMore_Nm, 0.0, 2}}, push,
                     [&](double direction, double v, double push_N) {
                       const double share = 1.0 + direction * kMore_Nm / theta[TC];
                       return friction_of(share * theta[TC], share * resting(push_N), v);
                     });
  expect_same_motion({find_effect("friction-asymmetry"), {kMore_Nm, 0.0, 3}}, push,
                     [&](double direction, double v, double push_N) {
                       return friction_of(theta[TC] + direction * kMore_Nm, resting(push_N), v);
                     });
}

TEST(StiffnessHysteresis, IsTurnedRoundByTravel) {
  const ParameterVector theta = nominal_parameters();
  constexpr double kShare = 0.03, kTravel_rad = 0.4;
  const auto friction = [&](double, double v, double push_N) {
    return friction_of(theta[TC], theta[Ts0] + theta[mus] * push_N, v);
  };
  const auto expect_turned_by = [&](int law, const auto& change) {
    double side = -1.0, before = -4.0;
    expect_same_motion(
        {find_effect("stiffness-hysteresis"), {kShare, kTravel_rad, static_cast<double>(law)}},
        [&](double x, double) {
          side = std::clamp(side + change(side, x - before), -1.0, 1.0);
          before = x;
          return elastic_N(x) * (1.0 - 0.5 * kShare * (1.0 - side));
        },
        friction);
  };
  expect_turned_by(1, [](double side, double travel) {
    return (std::copysign(1.0, travel) - side) * std::abs(travel) / kTravel_rad;
  });
  expect_turned_by(4, [](double, double travel) { return 2.0 * travel / kTravel_rad; });
}

TEST(StiffnessHysteresis, MayGoByTheSpeed) {
  const ParameterVector theta = nominal_parameters();
  constexpr double kShare = 0.03, kTravel_rad = 0.05;
  constexpr double kSpeed = kTravel_rad / 0.01;
  const auto friction = [&](double, double v, double push_N) {
    return friction_of(theta[TC], theta[Ts0] + theta[mus] * push_N, v);
  };
  expect_same_motion(
      {find_effect("stiffness-hysteresis"), {kShare, kTravel_rad, 2}},
      [&](double x, double v) {
        return elastic_N(x) * (1.0 - kShare * std::max(0.0, std::tanh(-v / kSpeed)));
      },
      friction);
  expect_same_motion(
      {find_effect("stiffness-hysteresis"), {kShare, kTravel_rad, 3}},
      [&](double x, double v) { return elastic_N(x) * (1.0 - 0.5 * kShare * (1.0 - std::tanh(v / kSpeed))); },
      friction);
}

/// A load cell that is slow, off and clipped clips what it is late with, whatever was named first.
TEST(Chain, IsTheSameInAnyOrder) {
  constexpr double kLevel_N = 9000.0, kLag_s = 0.004;
  const EffectValues lag{find_effect("force-lag"), {kLag_s}};
  const EffectValues offset{find_effect("force-offset"), {50.0}};
  const EffectValues limit{find_effect("force-saturation"), {kLevel_N}};
  const EffectValues late{find_effect("torque-lag"), {0.002}};
  const EffectValues gain{find_effect("torque-gain"), {0.05}};
  const std::vector<std::vector<EffectValues>> orders{
      {lag, offset, limit, late, gain}, {limit, gain, late, offset, lag}, {gain, offset, lag, limit, late}};
  std::vector<std::vector<double>> forces;
  double highest = 0.0, slowest = 0.0;
  for (const std::vector<EffectValues>& effects : orders) {
    const ExtendedBrake brake({{}, effects});
    ExtendedBrake::State state = brake.settled(-4.0, 0.0, row_at(0));
    std::vector<double>& force = forces.emplace_back();
    for (int k = 0; k < 200; ++k) {
      force.push_back(brake.read(state, row_at(k)).force_N);
      highest = std::max(highest, force.back());
      slowest = std::max(slowest, elastic_N(state[0]) + 50.0 - force.back());
      state = brake.advance(state, row_at(k));
    }
  }
  for (const std::vector<double>& other : forces)
    for (std::size_t k = 0; k < other.size(); ++k) ASSERT_DOUBLE_EQ(other[k], forces.front()[k]) << k;
  EXPECT_DOUBLE_EQ(highest, kLevel_N) << "clipped, though the lag has a state of its own";
  EXPECT_GT(slowest, 500.0) << "late, though it is clipped";
  EXPECT_DOUBLE_EQ(forces.front().front(), 50.0);
}

/// Spinning free, two periods of the cogging a row.
TEST(Cogging, IsRightWhereAStepTakesInWholePeriods) {
  constexpr double kAmplitude_Nm = 0.05, kOrder = 60.0;
  const BrakeParameters nominal;
  const auto& theta = nominal.theta;
  const ExtendedBrake brake({nominal, {{find_effect("cogging"), {kAmplitude_Nm, 0.0, kOrder}}}});
  ExtendedBrake::State state = brake.settled(-90.0, 210.0, row_at(0));
  double position = -90.0, velocity = 210.0;
  for (int k = 0; k < 300; ++k) {
    RowInput row = row_at(k);
    row.torque_Nm = 0.17;
    ASSERT_NEAR(state[1], velocity, 0.02) << k;
    ASSERT_LT(position, 0.0);
    constexpr int kSteps = 2000;
    for (int i = 0; i < kSteps; ++i) {
      const double wave = kAmplitude_Nm * std::sin(kOrder * position);
      const double friction = friction_of(theta[TC], theta[Ts0], velocity);
      velocity += kStep_s / kSteps * (row.torque_Nm - friction - wave) / nominal.fixed.inertia_kg_m2;
      position += kStep_s / kSteps * velocity;
    }
    state = brake.advance(state, row);
  }
  EXPECT_GT(std::abs(kOrder * velocity * kStep_s), 6.3) << "so that the test can fail";
}

TEST(ExtendedParameters, SurviveAFile) {
  ExtendedParameters parameters;
  parameters.base.theta[TC] *= 1.1;
  parameters.effects.push_back(visible(*find_effect("cogging")));
  parameters.effects.push_back(visible(*find_effect("backlash")));
  const auto read = parse_extended_parameters(format_extended_parameters(parameters), "model.toml");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->base.theta, parameters.base.theta);
  ASSERT_EQ(read->effects.size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(read->effects[i].effect, parameters.effects[i].effect);
    EXPECT_EQ(read->effects[i].values, parameters.effects[i].values);
  }
}

TEST(ExtendedParameters, AFileSaysWhatItsChoicesMean) {
  ExtendedParameters parameters;
  parameters.effects.push_back(visible(*find_effect("outliers")));
  EXPECT_NE(format_extended_parameters(parameters).find("# that has them: 1 clamp force; 2 velocity"),
            std::string::npos);
  const auto lacking =
      parse_extended_parameters("[[effect]]\nname = \"pad-damping\"\ndamping = 1.0\n", "m.toml");
  ASSERT_FALSE(lacking);
  EXPECT_NE(lacking.error().message.find("2 in proportion to the force"), std::string::npos);
}

TEST(Effects, HaveANameForEveryChoice) {
  int named = 0;
  for (const Effect* effect : effects())
    for (const EffectParameter& parameter : info_of(*effect).parameters) {
      EXPECT_EQ(choice_of(parameter, parameter.lower - 1.0), "");
      EXPECT_EQ(choice_of(parameter, parameter.upper + 1.0), "");
      EXPECT_EQ(choice_of(parameter, NAN), "");
      if (parameter.choices.empty()) continue;
      ++named;
      EXPECT_FALSE(is_estimated(parameter)) << info_of(*effect).name;
      EXPECT_EQ(choice_of(parameter, parameter.lower), parameter.choices.front()) << info_of(*effect).name;
      EXPECT_EQ(choice_of(parameter, parameter.upper), parameter.choices.back()) << info_of(*effect).name;
    }
  EXPECT_GE(named, 6);
}

TEST(ExtendedParameters, AFormThatIsNotSaidIsTheFirst) {
  const auto read = parse_extended_parameters(
      "[[effect]]\nname = \"stiffness-hysteresis\"\nshare = 0.02\ntravel = 0.5\n", "model.toml");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->effects.at(0).values, (std::vector<double>{0.02, 0.5, 1.0}));
}

TEST(ExtendedParameters, ErrorsNameTheLineAndWhatIsKnown) {
  const auto unknown =
      parse_extended_parameters("[parameters]\nTC = 0.08\n[[effect]]\nname = \"magic\"\n", "m.toml");
  ASSERT_FALSE(unknown);
  EXPECT_NE(unknown.error().message.find("m.toml:3"), std::string::npos);
  EXPECT_NE(unknown.error().message.find("backlash"), std::string::npos);
  const auto lacking = parse_extended_parameters("[[effect]]\nname = \"backlash\"\n", "m.toml");
  ASSERT_FALSE(lacking);
  EXPECT_NE(lacking.error().message.find("play"), std::string::npos);
  const auto outside = parse_extended_parameters("[[effect]]\nname = \"backlash\"\nplay = 99.0\n", "m.toml");
  ASSERT_FALSE(outside);
  EXPECT_NE(outside.error().message.find("m.toml:3"), std::string::npos);
}

}  // namespace
}  // namespace clampd
