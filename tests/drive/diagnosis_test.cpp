#include "clampd/drive/diagnosis.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drive/truth.hpp"

namespace clampd {
namespace {

using DriveRun = Run;  // testing::Test has a Run of its own

using drive_test::simulate_set;
using drive_test::Truth;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

DriveModel drive(const std::string& more = "") {
  const Result<DriveModel> model = parse_drive_model(
      "[drive]\nkind = \"rotary\"\n[columns]\ntime = \"t\"\ntorque = \"u\"\nposition = \"q\"\n"
      "[data]\ntorque_held = true\n" +
          more,
      "m.toml");
  EXPECT_TRUE(model) << model.error().message;
  return *model;
}

Diagnosis diagnosed(std::span<const DriveRun> runs, const DriveModel& model = drive(),
                    const DiagnoseOptions& options = {}) {
  Result<Diagnosis> diagnosis = diagnose_drive(runs, model, options);
  EXPECT_TRUE(diagnosis) << diagnosis.error().message;
  return diagnosis ? std::move(*diagnosis) : Diagnosis{};
}

std::vector<std::string> names(const Diagnosis& diagnosis) {
  std::vector<std::string> result;
  for (const NamedEffect& effect : diagnosis.effects) result.push_back(effect.name);
  return result;
}

EstimatedParameter find(const std::vector<EstimatedParameter>& parameters, const std::string& name) {
  for (const EstimatedParameter& parameter : parameters)
    if (parameter.name == name) return parameter;
  ADD_FAILURE() << "no parameter " << name;
  return {};
}

void expect_within(const EstimatedParameter& parameter, double truth, double sds, double slack = 0.0) {
  EXPECT_GT(parameter.sd, 0.0) << parameter.name;
  EXPECT_NEAR(parameter.value, truth, sds * parameter.sd + slack) << parameter.name << " " << parameter.unit;
}

struct Hidden {
  std::string name;
  Truth truth;
};
void PrintTo(const Hidden& hidden, std::ostream* out) {
  *out << hidden.name;
}

std::vector<Hidden> hidden_effects() {
  std::vector<Hidden> all(8);
  all[0].name = "friction-asymmetry";
  all[0].truth.extra = [](double, double v, int) { return 1.5e-3 * std::abs(v); };
  all[1].name = "cogging";
  all[1].truth.extra = [](double q, double, int) {
    return 0.02 * std::sin(6.0 * q + 1.0) + 8e-3 * std::cos(12.0 * q);
  };
  all[2].name = "quadratic-drag";
  all[2].truth.extra = [](double, double v, int) { return 3e-4 * v * std::abs(v); };
  all[3].name = "friction-shape";
  all[3].truth.dry = [](double, double v, int) { return 0.15 + 0.08 / (1.0 + v * v / 9.0); };
  all[4].name = "friction-position";
  all[4].truth.dry = [](double q, double, int) { return 0.15 * (1.0 + q / 80.0); };
  all[5].name = "load-position";
  all[5].truth.extra = [](double q, double, int) { return 0.002 * q; };
  all[6].name = "friction-drift";
  all[6].truth.dry = [](double, double, int run) { return 0.15 * (1.0 - 0.08 * run); };
  all[7].name = "presliding";
  all[7].truth.bristle_rad = 0.15;
  return all;
}

class HiddenEffect : public ::testing::TestWithParam<Hidden> {};

TEST_P(HiddenEffect, IsNamedAndNothingElse) {
  for (const unsigned seed : {101u, 102u, 103u}) {
    const auto runs = simulate_set(GetParam().truth, seed);
    const Diagnosis diagnosis = diagnosed(runs);
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Explained) << diagnosis.summary;
    EXPECT_THAT(names(diagnosis), ElementsAre(GetParam().name)) << diagnosis.summary;
    ASSERT_TRUE(diagnosis.gain);
    EXPECT_LT(diagnosis.gain->after.rms_torque_Nm, 0.95 * diagnosis.gain->before.rms_torque_Nm);
  }
}

INSTANTIATE_TEST_SUITE_P(Single, HiddenEffect, ::testing::ValuesIn(hidden_effects()), [](const auto& each) {
  std::string name = each.param.name;
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
});

TEST(DriveDiagnosis, AFaultlessDriveIsAdequate) {
  int adequate = 0;
  constexpr int kSets = 20;
  for (unsigned seed = 1; seed <= kSets; ++seed) {
    Truth truth;
    truth.duration_s = 8.0;
    truth.disturbance = seed % 2 == 0 ? 0.004 : 0.012;
    const Diagnosis diagnosis = diagnosed(simulate_set(truth, seed));
    adequate += diagnosis.verdict == DiagnosisVerdict::Adequate ? 1 : 0;
  }
  EXPECT_GE(adequate, kSets - 1);  // one in a hundred may be called faulty
}

TEST(DriveDiagnosis, ParametersAreTrueWithinTheirUncertainty) {
  int within = 0;
  int all = 0;
  for (unsigned seed = 201; seed <= 212; ++seed) {
    const Truth truth;
    const Diagnosis diagnosis = diagnosed(simulate_set(truth, seed, 2));
    for (const auto& [name, value] :
         {std::pair{"inertia", truth.inertia}, {"viscous", truth.viscous}, {"coulomb", truth.coulomb}}) {
      const EstimatedParameter parameter = find(diagnosis.parameters_after, name);
      EXPECT_NEAR(parameter.value, value, 0.02 * value);
      // A tenth of a per cent for the smoothing of corners.
      within += std::abs(parameter.value - value) < 2.0 * parameter.sd + 1e-3 * value ? 1 : 0;
      ++all;
    }
  }
  EXPECT_GE(within, all * 8 / 10);
}

TEST(DriveDiagnosis, BristlesThatAreDampedAreSeenToBe) {
  Truth truth;
  truth.bristle_rad = 0.15;
  truth.bristle_damping = 0.03;
  for (const unsigned seed : {141u, 142u, 143u}) {
    const Diagnosis diagnosis = diagnosed(simulate_set(truth, seed));
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Explained) << diagnosis.summary;
    ASSERT_THAT(names(diagnosis), ElementsAre("presliding")) << diagnosis.summary;
    const auto& parameters = diagnosis.effects.front().parameters;
    EXPECT_NEAR(find(parameters, "length").value, truth.bristle_rad, 0.03);
    EXPECT_NEAR(find(parameters, "damping").value, truth.bristle_damping, 0.006);
  }
}

TEST(DriveDiagnosis, AnOffsetAndAsymmetricDryFrictionAreTwinsWhileSliding) {
  Truth truth;
  truth.extra = [](double, double, int) { return 0.03; };
  const Diagnosis diagnosis = diagnosed(simulate_set(truth, 301));
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Ambiguous);
  ASSERT_EQ(diagnosis.rivals.size(), 1u);
  EXPECT_THAT(diagnosis.rivals.front(), ElementsAre("torque-offset", "friction-asymmetry"));
  ASSERT_EQ(diagnosis.effects.size(), 1u);
  expect_within(find(diagnosis.effects.front().parameters, "offset"), 0.03, 3.0);
  ASSERT_TRUE(diagnosis.next_experiment);
  EXPECT_EQ(diagnosis.next_experiment->manoeuvre, "standstill with the drive off");
  const DriveRun& motion = diagnosis.next_experiment->trajectory;
  EXPECT_THAT(motion.drive_enabled, ::testing::AllOf(::testing::SizeIs(motion.size()), ::testing::Each(0.0)));
}

// A load cell reads the load from outside 2.5 times too small and with an offset; beside it a temperature
// that does nothing.
// The slope is certain, but makes less than half a per cent of the torque: no spring is named for it.
TEST(DriveDiagnosis, AConstantLoadWithAHardlyNoticeableSlopeIsAConstant) {
  for (const unsigned seed : {163u, 164u}) {
    Truth truth;
    truth.disturbance = 0.0;
    truth.extra = [](double q, double, int) { return 0.08 + 5e-5 * q; };
    const Diagnosis diagnosis = diagnosed(simulate_set(truth, seed));
    EXPECT_THAT(names(diagnosis), ElementsAre("torque-offset")) << diagnosis.summary;
  }
}

TEST(DriveDiagnosis, NamesTheColumnThatIsPartOfTheTorque) {
  Truth truth;
  truth.load = [](double t) {
    return 0.04 * std::sin(2.9 * t) + 0.03 * std::sin(7.3 * t + 1.0) - 0.02 * std::cos(1.1 * t);
  };
  std::vector<DriveRun> runs = simulate_set(truth, 312);
  std::mt19937_64 random(313);
  std::normal_distribution<double> normal;
  for (DriveRun& run : runs) {
    RunColumn cell{"load", {}}, temperature{"temperature", {}};
    for (const double t : run.time_s) {
      cell.values.push_back(0.4 * truth.load(t) + 3.0 + 5e-4 * normal(random));
      temperature.values.push_back(40.0 + 0.2 * t + 0.1 * normal(random));
    }
    run.others = {cell, temperature};
  }
  const DriveModel model = drive("[regressors]\nload = \"cell\"\ntemperature = \"T\"\n");
  const Diagnosis diagnosis = diagnosed(runs, model);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Explained) << diagnosis.summary;
  ASSERT_THAT(names(diagnosis), ElementsAre("column:load")) << diagnosis.summary;
  // The torque balance counts what the drive gives, so that a load against it counts positive.
  expect_within(find(diagnosis.effects.front().parameters, "factor"), 2.5, 3.0, 0.025);
  EXPECT_LT(diagnosis.gain->after.rms_torque_Nm, 0.6 * diagnosis.gain->before.rms_torque_Nm);

  for (DriveRun& run : runs) run.others.pop_back();
  const Result<DriveDiagnosis> missing = diagnose_drive(runs, model, {});
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, HasSubstr("temperature"));
}

/// Two columns that are the same one: no row tells their parts apart, whatever else could join the model.
TEST(DriveDiagnosis, ABaseModelThatTheRunsDoNotTellApartIsRefused) {
  std::vector<DriveRun> runs = simulate_set({}, 314);
  for (DriveRun& run : runs) {
    RunColumn load{"load", {}};
    for (const double t : run.time_s) load.values.push_back(std::sin(2.9 * t));
    run.others = {load, {"again", load.values}};
  }
  const DriveModel model = drive(
      "[regressors]\nload = {column = \"load\", use = \"estimate\"}\nagain = {column = \"again\", use = "
      "\"estimate\"}\n");
  const Result<DriveDiagnosis> diagnosis = diagnose_drive(runs, model, {});
  ASSERT_FALSE(diagnosis);
  EXPECT_THAT(diagnosis.error().message, HasSubstr("the base model cannot be fitted"));
}

// Each file has its payload, which is inertia, or its temperature, which is viscous friction.
TEST(DriveDiagnosis, NamesTheValueOfTheFilesThatTheTorqueGoesWith) {
  const DriveModel model =
      drive("[regressors]\npayload = {per_file = true}\ntemperature = {per_file = true}\n");
  constexpr std::array kPayload{0.0, 2.0, 1.0, 3.0, 0.5}, kTemperature{22.0, 40.0, 25.0, 31.0, 36.0};
  for (const bool payload : {true, false}) {
    std::vector<DriveRun> runs;
    for (std::size_t r = 0; r < kPayload.size(); ++r) {
      Truth truth;
      if (payload) truth.inertia += 2e-4 * kPayload[r];
      if (!payload) truth.viscous -= 1e-4 * (kTemperature[r] - 20.0);
      DriveRun run = simulate(truth, static_cast<int>(r), 320 + static_cast<unsigned>(r));
      run.others = {{"payload", std::vector<double>(run.size(), kPayload[r])},
                    {"temperature", std::vector<double>(run.size(), kTemperature[r])}};
      runs.push_back(std::move(run));
    }
    const Diagnosis diagnosis = diagnosed(runs, model);
    EXPECT_NE(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
    ASSERT_THAT(names(diagnosis), ElementsAre(payload ? "column:payload" : "column:temperature"))
        << diagnosis.summary;
    const EstimatedParameter factor = find(diagnosis.effects.front().parameters, "factor");
    expect_within(factor, payload ? 2e-4 : -1e-4, 4.0, 2e-6);
    EXPECT_EQ(factor.unit, payload ? "kg m^2 per unit" : "N m s/rad per unit");

    // Where all files have the same, nothing is made of it, and that is said.
    for (DriveRun& run : runs) run.others[payload ? 0 : 1].values.assign(run.size(), 7.0);
    const Diagnosis without = diagnosed(runs, model);
    EXPECT_TRUE(std::ranges::any_of(without.unseen, [&](const UnseenEffect& each) {
      return each.name == (payload ? "column:payload" : "column:temperature") &&
             each.reason == "it is the same in all runs";
    }));
    const Result<DriveDiagnosis> estimated =
        diagnose_drive(runs,
                       drive("[regressors]\npayload = {per_file = true, use = \"estimate\"}\ntemperature = "
                             "{per_file = true, use = "
                             "\"estimate\"}\n"),
                       {});
    ASSERT_FALSE(estimated);
    EXPECT_THAT(estimated.error().message,
                HasSubstr("is to be estimated, but is the same in all fitted runs"));
  }
}

TEST(DriveDiagnosis, FindsTwoEffects) {
  Truth truth;
  truth.extra = [](double q, double v, int) { return 1.5e-3 * std::abs(v) + 0.02 * std::sin(6.0 * q); };
  const Diagnosis diagnosis = diagnosed(simulate_set(truth, 302));
  EXPECT_THAT(names(diagnosis), ::testing::UnorderedElementsAre("friction-asymmetry", "cogging"));
  for (const NamedEffect& effect : diagnosis.effects) {
    EXPECT_LT(effect.p_value, 0.01);
    if (effect.name == "cogging") {
      EXPECT_EQ(find(effect.parameters, "order-1").value, 6.0);
      expect_within(find(effect.parameters, "amplitude-1"), 0.02, 3.0, 2e-4);
    } else {
      expect_within(find(effect.parameters, "viscous-forward"), 6.5e-3, 3.0, 1e-5);
      expect_within(find(effect.parameters, "viscous-backward"), 3.5e-3, 3.0, 1e-5);
    }
  }
}

// What a power law by direction leaves of a constant torque has the form of Stribeck's friction by direction.
TEST(DriveDiagnosis, AnEffectHasItsBestFormBeforeAnotherOneIsSought) {
  Truth truth;
  truth.viscous = 0.0;
  truth.coulomb = 0.05;
  truth.extra = [](double, double v, int) {
    return std::copysign(0.2 * std::pow(std::abs(v) / 20.0, 0.55), v) + 0.02;
  };
  for (const unsigned seed : {311u, 312u, 313u}) {
    const Diagnosis diagnosis = diagnosed(simulate_set(truth, seed));
    EXPECT_THAT(names(diagnosis), ::testing::UnorderedElementsAre("friction-power", "torque-offset"))
        << diagnosis.summary;
    for (const NamedEffect& effect : diagnosis.effects)
      if (effect.name == "friction-power") {
        EXPECT_NEAR(find(effect.parameters, "power").value, 0.55, 0.03);
      }
  }
}

// A sine once a turn is gravity, or the first order of a ripple whose harmonics are there, too.
TEST(DriveDiagnosis, GravityIsARivalOfARippleWithItsHarmonics) {
  Truth series, pendulum;
  series.extra = [](double q, double, int) {
    return 0.03 * std::sin(q) + 0.02 * std::cos(2.0 * q) + 0.015 * std::sin(3.0 * q);
  };
  pendulum.extra = [](double q, double, int) { return 0.2 * std::sin(q) + 0.02 * std::cos(2.0 * q); };
  const Diagnosis ripple = diagnosed(simulate_set(series, 331));
  EXPECT_EQ(ripple.verdict, DiagnosisVerdict::Ambiguous) << ripple.summary;
  EXPECT_THAT(names(ripple), ElementsAre("cogging")) << ripple.summary;
  EXPECT_THAT(ripple.rivals, ::testing::Contains(ElementsAre("cogging", "gravity")));
  const Diagnosis swinging = diagnosed(simulate_set(pendulum, 332));
  EXPECT_THAT(names(swinging), ::testing::UnorderedElementsAre("gravity", "cogging")) << swinging.summary;
}

TEST(DriveDiagnosis, WhatIsNotOnTheListHasNoName) {
  Truth bump;
  bump.extra = [](double q, double, int) { return 0.06 * std::exp(-(q - 3.0) * (q - 3.0) / 4.0); };
  Truth resonance;  // a torque at one speed only
  resonance.extra = [](double, double v, int) {
    return std::copysign(0.06, v) * std::exp(-std::pow((std::abs(v) - 14.0) / 2.0, 2));
  };
  for (const auto& [truth, variable] : {std::pair{bump, "position"}, {resonance, "velocity"}}) {
    const Diagnosis diagnosis = diagnosed(simulate_set(truth, 303));
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
    EXPECT_THAT(names(diagnosis), IsEmpty());
    ASSERT_FALSE(diagnosis.misfit.dependences.empty());
    EXPECT_EQ(diagnosis.misfit.dependences.front().variable, variable);
    EXPECT_EQ(diagnosis.misfit.location, Location::TorqueBalance);
  }
}

struct Sinusoid {
  double amplitude_rad, rad_s, phase_rad;
};
const std::vector<Sinusoid> kTwo{{6.0, 3.0, 0.0}, {0.6, 8.1, 0.0}};
const std::vector<Sinusoid> kThree{{3.0, 2.1, 0.3}, {1.0, 5.3, 1.1}, {0.4, 9.7, 2.0}};

/// The base model's torque and `extra`, a function of position and velocity, in a motion of sinusoids. With a
/// motor constant that falls with speed, more of the reading is needed for each newton metre: `per_Nm`.
DriveRun of_sinusoids(
    const std::vector<Sinusoid>& motion, double duration_s,
    const std::function<double(double q, double v)>& extra,
    const std::function<double(double v)>& per_Nm = [](double) { return 1.0; }) {
  std::mt19937_64 random(76);
  std::normal_distribution<double> normal;
  DriveRun run;
  run.name = "run";
  constexpr double kRate_Hz = 250.0;
  for (int i = 0; i < static_cast<int>(duration_s * kRate_Hz); ++i) {
    const double t = i / kRate_Hz;
    double q = 0.0, v = 0.0, a = 0.0;
    for (const auto& [amplitude, rad_s, phase] : motion) {
      q += amplitude * std::sin(rad_s * t + phase);
      v += amplitude * rad_s * std::cos(rad_s * t + phase);
      a -= amplitude * rad_s * rad_s * std::sin(rad_s * t + phase);
    }
    const double torque = 0.02 * a + 3e-3 * v + std::copysign(0.15, v) + extra(q, v);
    run.time_s.push_back(t);
    run.position_rad.push_back(1e-5 * std::round(1e5 * q));
    run.torque_Nm.push_back(per_Nm(v) * torque + 2e-3 * normal(random));
  }
  return run;
}

Diagnosis diagnosed_reading(const DriveRun& run) {
  DriveModel model = drive();
  model.torque_held = false;
  return diagnosed(std::span(&run, 1), model);
}

// A load that switches on beyond one place is on no list. Effects of the place take most of it; what they
// leave is still a function of the place, so that a ripple which fits that in part is none.
TEST(DriveDiagnosis, AFurtherNameHasToTakeMoreThanWhatIsLeftStillShows) {
  const Diagnosis diagnosis = diagnosed_reading(
      of_sinusoids(kTwo, 16.0, [](double q, double) { return 0.18 * std::tanh(10.0 * (q / 6.0 - 0.528)); }));
  EXPECT_THAT(names(diagnosis), ::testing::Not(::testing::Contains("cogging"))) << diagnosis.summary;
}

/// More of the reading for each newton metre above a speed, as of a motor whose field weakens.
DriveRun of_weakening(const std::vector<Sinusoid>& motion, double weakening) {
  return of_sinusoids(
      motion, 16.0, [](double, double) { return 0.0; },
      [=](double v) { return 1.0 + weakening * std::max(0.0, std::abs(v) / 8.0 - 1.0); });
}

// A motor whose field weakens is on no list. In this motion an inertia that changes along the travel takes
// two thirds of what it costs, squared, and no more.
TEST(DriveDiagnosis, WhatStandsInForAnotherTorqueHasNoName) {
  for (const double weakening : {0.5, 0.6, 0.8}) {
    const Diagnosis diagnosis = diagnosed_reading(of_weakening(kTwo, weakening));
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
    EXPECT_THAT(names(diagnosis), IsEmpty()) << weakening << ": " << diagnosis.summary;
  }
}

// In a motion of one sinusoid, gravity has most of the same motor's harmonics: all but 4 % of the square.
TEST(DriveDiagnosis, OneSinusoidNamesNothingThatLeavesMoreThanAFiftieth) {
  const Diagnosis diagnosis = diagnosed_reading(of_weakening({{1.5, 9.0, 0.0}}, 0.5));
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
  EXPECT_THAT(names(diagnosis), IsEmpty()) << diagnosis.summary;
}

// Beyond one place something is pushed ahead, and left there on the way back. A load that depends on the
// place and friction that grows with the load leave so little of it that it would be good enough, but half of
// that is a function of the columns.
TEST(DriveDiagnosis, WhatLeavesTheFormOfAnotherTorqueHasNoName) {
  for (const double push_Nm : {0.09, 0.1}) {
    const Diagnosis diagnosis = diagnosed_reading(
        of_sinusoids(kThree, 24.0, [=](double q, double v) { return q > 1.0 && v > 0.0 ? push_Nm : 0.0; }));
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
    EXPECT_THAT(names(diagnosis), IsEmpty()) << push_Nm << ": " << diagnosis.summary;
  }
}

// A load that changes slowly and at random has a mean, and resembles whatever is as slow, in one short run.
TEST(DriveDiagnosis, ALoadThatWandersHasNoName) {
  for (const unsigned seed : {1, 2, 3, 4, 5, 6, 26, 31}) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    constexpr double kMemory_s = 3.0, kStep_s = 0.01;
    std::vector<double> path{0.06 * normal(random)};
    while (path.size() < 1300)
      path.push_back(path.back() * (1.0 - kStep_s / kMemory_s) +
                     0.06 * std::sqrt(2.0 * kStep_s / kMemory_s) * normal(random));
    Truth truth;
    truth.load = [path](double t) { return path[static_cast<std::size_t>(t / kStep_s)]; };
    const DriveRun run = simulate(truth, 0, 500 + seed);
    const Diagnosis diagnosis = diagnosed(std::span(&run, 1));
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << seed << ": " << diagnosis.summary;
    EXPECT_THAT(names(diagnosis), IsEmpty()) << seed;
  }
}

// A soft stop at one end of the travel is on no list. It resembles a spring, and nothing else beside it.
TEST(DriveDiagnosis, ASoftStopIsNothingBesideASpring) {
  for (const double place : {6.0, 9.0, 12.0, 15.0}) {
    Truth truth;
    truth.extra = [place](double q, double, int) { return q > place ? 0.06 * (q - place) : 0.0; };
    const Diagnosis diagnosis = diagnosed(simulate_set(truth, 310));
    for (const std::string& name : names(diagnosis)) EXPECT_EQ(name, "load-position") << place;
  }
}

TEST(DriveDiagnosis, HeldOutRunsHaveAVeto) {
  // A ripple whose phase is another one after the position was lost.
  Truth truth, other;
  truth.extra = [](double q, double, int) { return 0.02 * std::sin(6.0 * q); };
  other.extra = [](double q, double, int) { return 0.02 * std::sin(6.0 * q + 2.5); };
  const auto runs = simulate_set(truth, 304);
  const auto same = simulate_set(truth, 305, 1);
  const auto lost = simulate_set(other, 306, 1);
  DiagnoseOptions options;
  options.heldout = same;
  const Diagnosis supported = diagnosed(runs, drive(), options);
  EXPECT_THAT(names(supported), ElementsAre("cogging"));
  ASSERT_TRUE(supported.gain);
  EXPECT_THAT(supported.gain->runs, ElementsAre("run 1"));
  EXPECT_LT(supported.gain->after.rms_torque_Nm, 0.7 * supported.gain->before.rms_torque_Nm);
  options.heldout = lost;
  EXPECT_THAT(names(diagnosed(runs, drive(), options)), IsEmpty());
}

TEST(DriveDiagnosis, IrregularAndDifferentSamplingChangeNothing) {
  Truth truth;
  truth.extra = [](double, double v, int) { return 1.5e-3 * std::abs(v); };
  truth.sample_jitter = 0.4;
  std::vector<DriveRun> runs = simulate_set(truth, 307);
  DriveRun sparse;
  sparse.name = "every fourth";
  for (std::size_t i = 0; i < runs[0].size(); i += 4) {
    sparse.time_s.push_back(runs[0].time_s[i]);
    sparse.position_rad.push_back(runs[0].position_rad[i]);
    // What acts from here to the next row.
    double mean = 0.0;
    for (std::size_t k = i; k < std::min(i + 4, runs[0].size()); ++k) mean += runs[0].torque_Nm[k] / 4.0;
    sparse.torque_Nm.push_back(mean);
  }
  runs[0] = sparse;
  const Diagnosis diagnosis = diagnosed(runs);
  EXPECT_THAT(names(diagnosis), ElementsAre("friction-asymmetry")) << diagnosis.summary;
  EXPECT_NEAR(find(diagnosis.effects.front().parameters, "viscous-forward").value, 6.5e-3, 2e-4);
  EXPECT_NEAR(find(diagnosis.parameters_after, "inertia").value, 1e-3, 2e-5);
}

TEST(DriveDiagnosis, AVelocityReadingWillDo) {
  Truth truth;
  truth.extra = [](double, double v, int) { return 1.5e-3 * std::abs(v); };
  std::vector<DriveRun> runs = simulate_set(truth, 308);
  for (DriveRun& run : runs) {
    run.velocity_rad_s.assign(run.size(), 0.0);
    for (std::size_t i = 2; i + 2 < run.size(); ++i)
      run.velocity_rad_s[i] =
          (run.position_rad[i + 2] - run.position_rad[i - 2]) / (run.time_s[i + 2] - run.time_s[i - 2]);
    run.position_rad.clear();
  }
  const Diagnosis diagnosis = diagnosed(runs);
  EXPECT_THAT(names(diagnosis), ElementsAre("friction-asymmetry")) << diagnosis.summary;
  const bool unseen =
      std::any_of(diagnosis.unseen.begin(), diagnosis.unseen.end(), [](const UnseenEffect& effect) {
        return effect.name == "load-position" && effect.reason.find("integrated") != std::string::npos;
      });
  EXPECT_TRUE(unseen);
}

TEST(DriveDiagnosis, FixedPartsStayAndSwitchedOffOnesAreNotTried) {
  Truth truth;
  truth.extra = [](double, double v, int) { return 1.5e-4 * v * std::abs(v); };
  const auto runs = simulate_set(truth, 309);
  const Diagnosis fixed = diagnosed(runs, drive("[model]\ninertia = 1e-3\n"));
  EXPECT_EQ(find(fixed.parameters_after, "inertia").value, 1e-3);
  EXPECT_TRUE(std::isnan(find(fixed.parameters_after, "inertia").sd));
  EXPECT_THAT(names(fixed), ElementsAre("quadratic-drag"));
  const Diagnosis off = diagnosed(runs, drive("[model]\nquadratic-drag = \"off\"\n"));
  for (const CandidateSummary& summary : off.candidates) EXPECT_NE(summary.name, "quadratic-drag");
  const Diagnosis asked = diagnosed(runs, drive("[model]\nquadratic-drag = \"estimate\"\n"));
  EXPECT_THAT(names(asked), IsEmpty());
  expect_within(find(asked.parameters_after, "quadratic-drag.drag"), 1.5e-4, 3.0, 2e-6);
}

TEST(DriveDiagnosis, ViewsAndProgressWhenAskedFor) {
  const auto runs = simulate_set(Truth{}, 310, 2);
  DiagnoseOptions options;
  options.views = true;
  double last = -1.0;
  options.progress = [&](double share, const std::string&) {
    EXPECT_GE(share, last);
    last = share;
  };
  const Diagnosis diagnosis = diagnosed(runs, drive(), options);
  EXPECT_EQ(last, 1.0);
  ASSERT_EQ(diagnosis.views.size(), 2u);
  const RunView& view = diagnosis.views.front();
  EXPECT_GT(view.time_s.size(), 100u);
  EXPECT_EQ(view.torque_Nm.size(), view.time_s.size());
  EXPECT_EQ(view.position_rad.size(), view.time_s.size());
  EXPECT_EQ(view.disturbance_before_Nm.size(), view.time_s.size());
  EXPECT_EQ(view.disturbance_after_Nm, view.disturbance_before_Nm) << "no effect, no change";
}

/// A motion of three sines, and a torque command that acts from its row until the next one, computed `late_s`
/// after its time.
DriveRun commanded(double rate_Hz, double inertia, double viscous, double late_s, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  constexpr double kDry = 0.15, kNoise = 2e-4;
  const auto motion = [](double t, int derivative) {
    double sum = 0.0;
    for (const auto& [size, rate] : {std::pair{6.0, 1.9}, {2.5, 4.1}, {1.0, 7.3}})
      sum += size * std::pow(rate, derivative) * std::sin(rate * t + size + 0.5 * M_PI * derivative);
    return sum;
  };
  DriveRun run;
  run.name = "run";
  const auto rows = static_cast<int>(12.0 * rate_Hz);
  for (int i = 0; i < rows; ++i) {
    const double t = i / rate_Hz, acts = t + 0.5 / rate_Hz - late_s;
    run.time_s.push_back(t);
    run.position_rad.push_back(1e-5 * std::round(1e5 * motion(t, 0)));
    run.torque_Nm.push_back(inertia * motion(acts, 2) + viscous * motion(acts, 1) +
                            std::copysign(kDry, motion(acts, 1)) + kNoise * normal(random));
  }
  return run;
}

TEST(DriveDiagnosis, ACommandThatActsForOneFastRowIsNotLate) {
  for (const double rate_Hz : {500.0, 5000.0}) {
    const DriveRun run = commanded(rate_Hz, 0.02, 0.003, 0.0, 5);
    const Diagnosis diagnosis = diagnosed(std::span(&run, 1));
    EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Adequate) << diagnosis.summary;
    EXPECT_LT(diagnosis.share_left, 0.005) << rate_Hz << " Hz";
    EXPECT_NEAR(find(diagnosis.parameters_after, "inertia").value, 0.02, 5e-5) << rate_Hz << " Hz";
  }
}

// Where the acceleration is mostly noise, its fit to the torque is none of the inertia.
TEST(DriveDiagnosis, ACoarseEncoderHidesNoInertia) {
  constexpr double kRate = 2.0 * M_PI * 0.1, kInertia = 0.0173;
  std::vector<DriveRun> runs(2);
  std::mt19937_64 random(17);
  std::normal_distribution<double> normal;
  for (DriveRun& run : runs)
    for (int i = 0; i < 12000; ++i) {
      const double t = i / 250.0, q = 39.0 * std::sin(kRate * t), v = 39.0 * kRate * std::cos(kRate * t);
      run.time_s.push_back(t);
      run.position_rad.push_back(q + 5e-3 * normal(random));
      run.torque_Nm.push_back(-kInertia * kRate * kRate * q + 5e-3 * v + std::copysign(0.94, v) +
                              5e-3 * normal(random));
    }
  const Diagnosis diagnosis = diagnosed(runs);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Adequate) << diagnosis.summary;
  EXPECT_NEAR(find(diagnosis.parameters_after, "inertia").value, kInertia, 0.03 * kInertia);
}

// One that is early by as much is not found in this motion.
TEST(DriveDiagnosis, AReadingThatIsLateByManyRowsIsMeasuredAllTheSame) {
  constexpr double kLate_s = 0.4;
  const DriveRun run = commanded(500.0, 0.02, 0.003, kLate_s, 5);
  const Diagnosis diagnosis = diagnosed(std::span(&run, 1));
  ASSERT_THAT(names(diagnosis), ElementsAre("torque-lag")) << diagnosis.summary;
  EXPECT_NEAR(find(diagnosis.effects.front().parameters, "lag").value, -kLate_s, 2e-3);
}

TEST(DriveDiagnosis, ANegativeInertiaIsNeverAdequate) {
  DriveModel model = drive("[model]\ntorque-lag = \"off\"\npresliding = \"off\"\n");
  model.good_enough = 0.5;  // however little is asked for
  const DriveRun run = commanded(500.0, 1e-4, 0.003, 0.08, 5);
  const Diagnosis diagnosis = diagnosed(std::span(&run, 1), model);
  EXPECT_EQ(diagnosis.verdict, DiagnosisVerdict::Unexplained) << diagnosis.summary;
  EXPECT_LT(find(diagnosis.parameters_after, "inertia").value, 0.0);
  EXPECT_THAT(diagnosis.data, ::testing::Contains(::testing::Field(&DataFinding::name, "torque-delay")));
}

// One rule for both: what is no explanation while effects are sought is none for a saved model either.
TEST(DriveIdentification, ANegativeInertiaIsNeverEnough) {
  DriveModel model = drive("[model]\ntorque-lag = \"off\"\npresliding = \"off\"\n");
  model.good_enough = 0.5;  // however little is asked for
  const DriveRun timely = commanded(500.0, 1e-4, 0.003, 0.0, 5),
                 late = commanded(500.0, 1e-4, 0.003, 0.08, 5);
  const Result<DriveDiagnosis> saved = diagnose_drive(std::span(&timely, 1), model, {});
  ASSERT_TRUE(saved) << saved.error().message;
  const Result<DriveIdentification> same = identify_drive(std::span(&timely, 1), saved->fitted);
  ASSERT_TRUE(same) << same.error().message;
  EXPECT_TRUE(same->is_enough);
  const Result<DriveIdentification> identified = identify_drive(std::span(&late, 1), saved->fitted);
  ASSERT_TRUE(identified) << identified.error().message;
  EXPECT_LT(find(identified->parameters, "inertia").value, 0.0);
  EXPECT_LT(identified->share_left, model.good_enough);
  EXPECT_FALSE(identified->is_enough);
  EXPECT_THAT(identified->data, ::testing::Contains(::testing::Field(
                                    &DataFinding::words, HasSubstr("the inertia would be negative"))));
}

/// A harmonic motion with so many rows a period, and white noise of the torque.
DriveRun harmonic(double rows_a_period, double torque_noise) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  DriveRun run;
  run.name = "run";
  for (int i = 0; i < 1500; ++i) {
    const double phase = 2.0 * M_PI * i / rows_a_period;
    run.time_s.push_back(0.01 * i);
    run.position_rad.push_back(std::sin(phase) + 0.2 * std::sin(0.31 * phase));
    run.torque_Nm.push_back(0.3 * std::copysign(1.0, std::cos(phase)) - std::sin(phase) +
                            torque_noise * normal(random));
  }
  return run;
}

TEST(DriveIdentification, ScatterOfTooFewRowsIsNoNoise) {
  const auto sampled_slowly = ::testing::Contains(::testing::Field(&DataFinding::name, "sampling-too-slow"));
  DriveModel model = drive();
  model.good_enough = 1e-6;
  const DriveRun run = harmonic(13.3, 0.3);
  const Result<DriveDiagnosis> diagnosis = diagnose_drive(std::span(&run, 1), model, {});
  ASSERT_TRUE(diagnosis) << diagnosis.error().message;
  ASSERT_THAT(diagnosis->data, sampled_slowly);
  EXPECT_EQ(diagnosis->verdict, DiagnosisVerdict::Unexplained) << diagnosis->summary;
  const Result<DriveIdentification> identified = identify_drive(std::span(&run, 1), diagnosis->fitted);
  ASSERT_TRUE(identified) << identified.error().message;
  EXPECT_THAT(identified->data, sampled_slowly);
  EXPECT_FALSE(identified->is_enough);
}

TEST(DriveDiagnosis, RefusesWhatItCannotJudge) {
  const auto message = [](const std::vector<DriveRun>& runs) {
    const Result<Diagnosis> diagnosis = diagnose_drive(runs, drive(), {});
    return diagnosis ? std::string() : diagnosis.error().message;
  };
  EXPECT_THAT(message({}), HasSubstr("no run"));
  DriveRun run;
  run.name = "short.csv";
  run.time_s = {0.0, 1.0};
  run.torque_Nm = run.position_rad = {0.0, 0.0};
  EXPECT_THAT(message({run}), HasSubstr("short.csv: 2 rows are too few"));
  for (int i = 2; i < 100; ++i) {
    run.time_s.push_back(i);
    run.torque_Nm.push_back(0.0);
    run.position_rad.push_back(0.0);
  }
  EXPECT_THAT(message({run}), HasSubstr("stands still"));
  run.position_rad.clear();
  EXPECT_THAT(message({run}), HasSubstr("neither position nor velocity"));
}

TEST(DriveDiagnosis, OneDirectionCannotShowAnOffset) {
  Truth truth;
  std::vector<DriveRun> runs = simulate_set(truth, 311, 1);
  // The first stretch before the drive turns.
  std::size_t end = 500;
  while (end < runs[0].size() && runs[0].position_rad[end] > runs[0].position_rad[end - 100]) ++end;
  DriveRun& run = runs[0];
  run.time_s.resize(end - 50);
  run.torque_Nm.resize(end - 50);
  run.position_rad.resize(end - 50);
  const Diagnosis diagnosis = diagnosed(runs);
  for (const NamedEffect& effect : diagnosis.effects) EXPECT_NE(effect.name, "torque-offset");
  int unseen = 0;
  for (const UnseenEffect& effect : diagnosis.unseen)
    if (effect.name == "torque-offset" || effect.name == "friction-asymmetry") ++unseen;
  EXPECT_EQ(unseen, 2);
  // Hence the next record is to go both ways, within what this one showed that the drive can do.
  ASSERT_TRUE(diagnosis.next_experiment);
  EXPECT_THAT(diagnosis.next_experiment->why, HasSubstr("forward and backward"));
  EXPECT_THAT(diagnosis.next_experiment->why, HasSubstr("torque-offset"));
  const DriveRun& motion = diagnosis.next_experiment->trajectory;
  const auto [slowest, fastest] =
      std::minmax_element(motion.velocity_rad_s.begin(), motion.velocity_rad_s.end());
  EXPECT_NEAR(*slowest, -*fastest, 0.1 * *fastest);
  const auto [lowest, highest] = std::minmax_element(run.position_rad.begin(), run.position_rad.end());
  const auto [least, most] = std::minmax_element(motion.position_rad.begin(), motion.position_rad.end());
  EXPECT_GE(*least, *lowest - 0.2 * (*highest - *lowest));
  EXPECT_LE(*most, *highest + 0.2 * (*highest - *lowest));
  for (const double torque : motion.torque_Nm) ASSERT_TRUE(std::isfinite(torque));
}

}  // namespace
}  // namespace clampd
