// The generator of blind tests must itself be above suspicion.

#include "tests/support/blind/blind_set.hpp"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/brake/effect.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
#include "drivers/sim/simulated_brake.hpp"
#include "tests/support/blind/detectability.hpp"
#include "tests/support/reference_brake.hpp"
#include "tests/support/temporary_directory.hpp"

namespace clampd::blind {
namespace {

Run trajectory_of(const char* manoeuvre) {
  const clampd::Run optimal =
      read_run(std::string(CLAMPD_SOURCE_DIR) + "/configs/trajectory.csv").value().run;
  return make_manoeuvre(manoeuvre, BrakeParameters{}, optimal).value();
}

/// Largest distance between two signals.
double distance(const std::vector<double>& a, const std::vector<double>& b) {
  EXPECT_EQ(a.size(), b.size());
  double largest = 0.0;
  for (std::size_t k = 0; k < std::min(a.size(), b.size()); ++k)
    largest = std::max(largest, std::abs(a[k] - b[k]));
  return largest;
}

Answer quiet(Answer answer) {
  answer.noise = {.sensors = {.force_N = 0.0, .velocity_rad_s = 0.0}, .torque_Nm = 0.0};
  return answer;
}

TEST(BlindSet, RepeatsWithItsSeedAndOnlyWithIt) {
  for (const Generator generator : {Generator::Station, Generator::Independent}) {
    const Request request{.kind = Kind::Single, .generator = generator, .seed = 5};
    const BlindSet first = make_set(request).value();
    const BlindSet second = make_set(request).value();
    Request other = request;
    other.seed = 6;
    const BlindSet third = make_set(other).value();
    EXPECT_EQ(answer_json(first.answer), answer_json(second.answer));
    EXPECT_NE(answer_json(first.answer), answer_json(third.answer));
    ASSERT_EQ(first.runs.size(), second.runs.size());
    for (std::size_t i = 0; i < first.runs.size(); ++i) {
      EXPECT_EQ(first.runs[i].force_N, second.runs[i].force_N);
      EXPECT_EQ(first.runs[i].torque_Nm, second.runs[i].torque_Nm);
      EXPECT_NE(first.runs[i].force_N, third.runs[i].force_N);
    }
  }
}

TEST(BlindSet, HoldsTheAgreedRunsInTheirOrder) {
  const BlindSet set = make_set({.kind = Kind::None}).value();
  ASSERT_EQ(set.runs.size(), 15u);
  EXPECT_EQ(set.runs.front().name, "run-01-optimal.csv");
  EXPECT_EQ(set.runs[6].name, "run-07-apply-release.csv");
  EXPECT_EQ(set.runs.back().name, "run-15-clearance.csv");
  double duration_s = 0.0;
  for (const clampd::Run& run : set.runs) duration_s += run.time_s.back();
  EXPECT_GT(duration_s, 9.0);
  EXPECT_LT(duration_s, 14.0);
}

TEST(BlindSet, ReducedSetsKeepAtLeastOneRun) {
  std::size_t least = 100, most = 0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    const Answer answer = draw_answer({.kind = Kind::None, .seed = seed, .reduced = true});
    least = std::min(least, answer.manoeuvres.size());
    most = std::max(most, answer.manoeuvres.size());
  }
  EXPECT_EQ(least, 1u);
  EXPECT_GT(most, 8u);
  EXPECT_LE(most, 15u);
}

TEST(BlindSet, HidesEachEffectOfTheListAndOnlyThose) {
  for (const std::string_view name : effect_names(true, Generator::Station))
    EXPECT_NE(find_effect(name), nullptr) << name;
  const auto off_list = effect_names(false, Generator::Independent);
  EXPECT_GE(off_list.size(), 8u);
  for (const std::string_view name : off_list) EXPECT_EQ(find_effect(name), nullptr) << name;
}

TEST(BlindSet, FilesSayNothingOfTheAnswer) {
  const support::TemporaryDirectory folder;
  const BlindSet set = make_set({.kind = Kind::Single, .seed = 3, .effect = "cogging"}).value();
  const auto paths = write_runs(set.runs, folder.path("set"));
  ASSERT_TRUE(paths.has_value());
  ASSERT_EQ(paths->size(), set.runs.size());
  for (std::size_t i = 0; i < paths->size(); ++i) {
    EXPECT_THAT((*paths)[i], ::testing::Not(::testing::HasSubstr("cogging")));
    const auto loaded = read_run((*paths)[i]);
    ASSERT_TRUE(loaded.has_value());
    EXPECT_TRUE(loaded->notices.empty());
    EXPECT_EQ(loaded->run.force_N, set.runs[i].force_N);
  }
  EXPECT_THAT(answer_json(set.answer), ::testing::HasSubstr("cogging"));
}

TEST(BlindSet, NoiseIsWhatTheAnswerSays) {
  const BlindSet set = make_set({.kind = Kind::None, .seed = 2}).value();
  double force = 0.0, velocity = 0.0, torque = 0.0, rows = 0.0;
  for (std::size_t i = 0; i < set.runs.size(); ++i)
    for (std::size_t k = 0; k < set.runs[i].size(); ++k) {
      force += std::pow(set.runs[i].force_N[k] - set.noise_free[i].force_N[k], 2);
      velocity += std::pow(set.runs[i].velocity_rad_s[k] - set.noise_free[i].velocity_rad_s[k], 2);
      torque += std::pow(set.runs[i].torque_Nm[k] - set.noise_free[i].torque_Nm[k], 2);
      rows += 1.0;
    }
  const NoiseLevels& noise = set.answer.noise;
  const double five_sd = 5.0 / std::sqrt(2.0 * rows);
  EXPECT_NEAR(std::sqrt(force / rows) / noise.sensors.force_N, 1.0, five_sd);
  EXPECT_NEAR(std::sqrt(velocity / rows) / noise.sensors.velocity_rad_s, 1.0, five_sd);
  EXPECT_NEAR(std::sqrt(torque / rows) / noise.torque_Nm, 1.0, five_sd);
}

class HiddenPlantMotion : public ::testing::TestWithParam<const char*> {};

// Without effects the plant is the paper's brake: another integrator, driven by the torque that it recorded,
// goes the same way.
TEST_P(HiddenPlantMotion, IsThatOfAReferenceBrake) {
  Physics physics;
  physics.brake.theta[TC] *= 1.4;
  physics.brake.theta[ws] *= 0.5;
  physics.noise = {.sensors = {.force_N = 30.0, .velocity_rad_s = 0.3}, .torque_Nm = 0.005};
  HiddenPlant plant(physics, 1);
  const clampd::Run run = plant.record(trajectory_of(GetParam()), 0).noise_free;
  const support::ReferenceTrace trace = support::simulate_reference(
      physics.brake, run.position_rad[0], run.velocity_rad_s[0], run.torque_Nm, 5e-6);
  // Open loop and unstable under load, from a start that the encoder rounds to 1 mrad.
  EXPECT_LT(distance(run.force_N, trace.force_N), 30.0);
  EXPECT_LT(distance(run.velocity_rad_s, trace.velocity_rad_s), 1.0);
}

TEST_P(HiddenPlantMotion, FollowsTheManoeuvreAsTheSimulatedBrakeDoes) {
  const clampd::Run trajectory = trajectory_of(GetParam());
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const Answer answer = draw_answer({.kind = Kind::None, .seed = seed});
    Physics physics;
    physics.brake = answer.brake;
    physics.noise = answer.noise;
    const HiddenPlant::Recording recording = HiddenPlant(physics, seed).record(trajectory, 0);
    EXPECT_LT(recording.force_max_N, 30e3);
    EXPECT_LT(recording.speed_max_rad_s, 300.0);
    double sum = 0.0;
    for (std::size_t k = 0; k < trajectory.size(); ++k)
      sum += std::pow(recording.noise_free.force_N[k] - trajectory.force_N[k], 2);
    EXPECT_LT(std::sqrt(sum / static_cast<double>(trajectory.size())), 400.0) << seed;
  }
}

INSTANTIATE_TEST_SUITE_P(Manoeuvres, HiddenPlantMotion,
                         ::testing::Values("optimal", "apply-release", "sinusoid", "staircase", "clearance"),
                         [](const auto& which) {
                           std::string name = which.param;
                           std::erase(name, '-');
                           return name;
                         });

TEST(HiddenPlantPhysics, SticksUnderLoadWithoutTorqueBeingNeeded) {
  Physics physics;
  physics.noise = {.sensors = {.force_N = 0.0, .velocity_rad_s = 0.0}, .torque_Nm = 0.0};
  const clampd::Run run = HiddenPlant(physics, 1).record(trajectory_of("apply-release"), 0).noise_free;
  // In the middle of the hold.
  for (std::size_t k = 380; k < 480; ++k) EXPECT_EQ(run.velocity_rad_s[k], 0.0) << k;
}

/// How much an effect moves the readings, in units of the least noise; nothing insane on the way.
double change_by(const Request& request) {
  Answer answer = quiet(draw_answer(request));
  answer.manoeuvres = {"apply-release", "optimal", "clearance"};
  const BlindSet with = simulate(answer).value();
  answer.effects.clear();
  const BlindSet without = simulate(answer).value();
  double change = 0.0;
  for (std::size_t i = 0; i < with.runs.size(); ++i) {
    const clampd::Run& run = with.runs[i];
    for (std::size_t k = 0; k < run.size(); ++k) {
      EXPECT_LT(std::abs(run.force_N[k]), 35e3);
      EXPECT_LT(std::abs(run.velocity_rad_s[k]), 400.0);
      EXPECT_LE(std::abs(run.torque_Nm[k]), 3.2);
    }
    change += distance(run.force_N, without.runs[i].force_N) / 30.0 +
              distance(run.velocity_rad_s, without.runs[i].velocity_rad_s) / 0.3 +
              distance(run.torque_Nm, without.runs[i].torque_Nm) / 0.005;
  }
  return change;
}

TEST(HiddenPlantPhysics, EachEffectShowsAndStaysSane) {
  for (const bool on_list : {true, false})
    for (const std::string_view name : effect_names(on_list, Generator::Independent)) {
      SCOPED_TRACE(name);
      // A limit or a rare event may be beyond what a single draw meets.
      double change = 0.0;
      for (std::uint64_t seed = 11; seed < 17 && change <= 0.1; ++seed)
        change = change_by(
            {.kind = on_list ? Kind::Single : Kind::OffList, .seed = seed, .effect = std::string(name)});
      EXPECT_GT(change, 0.1);
    }
}

TEST(HiddenPlantPhysics, FrictionDriftCountsRunsOverTheWholeSet) {
  for (const Generator generator : {Generator::Station, Generator::Independent}) {
    Request request{.kind = Kind::Single, .generator = generator, .seed = 4, .effect = "friction-drift"};
    Answer answer = quiet(draw_answer(request));
    answer.effects.front().onto_physics = [](Physics& physics) { physics.friction_drift.per_run = 0.05; };
    answer.effects.front().onto_effects = [](sim::Effects& effects) { effects.friction_drift = 0.05; };
    const BlindSet set = simulate(answer).value();
    // Back and forth without force: what is left of the sum is friction.
    const auto torque_in_clearance = [](const clampd::Run& run) {
      double sum = 0.0;
      for (std::size_t k = 0; k < run.size(); ++k)
        if (std::abs(run.velocity_rad_s[k]) > 5.0)
          sum += std::copysign(1.0, run.velocity_rad_s[k]) * run.torque_Nm[k];
      return sum;
    };
    const double before = torque_in_clearance(set.runs[13]), after = torque_in_clearance(set.runs[14]);
    EXPECT_GT(after, 1.01 * before) << to_string(generator);
    answer.effects.clear();
    const BlindSet steady = simulate(answer).value();
    EXPECT_GT(before, 1.3 * torque_in_clearance(steady.runs[13])) << to_string(generator);
  }
}

TEST(Detectability, IsNothingWithoutAnEffectAndGrowsWithItsSquare) {
  for (const Generator generator : {Generator::Station, Generator::Independent})
    EXPECT_LT(detectability_nats(make_set({.kind = Kind::None, .generator = generator, .seed = 8}).value()),
              2.0)
        << to_string(generator);
  Answer answer = draw_answer({.kind = Kind::Single, .seed = 8, .effect = "force-hum"});
  double nats[2];
  for (int i = 0; i < 2; ++i) {
    answer.effects.front().onto_physics = [i](Physics& physics) { physics.hum_N = 20.0 * (i + 1); };
    nats[i] = detectability_nats(simulate(answer).value());
  }
  EXPECT_GT(nats[0], 20.0);
  EXPECT_NEAR(nats[1] / nats[0], 4.0, 0.2);
}

}  // namespace
}  // namespace clampd::blind
