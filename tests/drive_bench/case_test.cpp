// Cases: drawn from their seed alone, spoiled as they say, and as detectable as closed forms say.

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <numbers>
#include <set>

#include "support/temporary_directory.hpp"
#include "tests/drive_bench/detectability.hpp"
#include "tests/drive_bench/files.hpp"
#include "tests/drive_bench/spoil.hpp"

namespace clampd::drive_bench {
namespace {

/// A plain case of a sinusoid, whose shares are known in closed form.
Case sliding_case() {
  Case c;
  c.seed = 1;
  c.kind = Kind::Single;
  c.family = &families().front();
  c.plant.inertia = 0.01;
  c.plant.coulomb = 1.0;
  c.plant.speed = 10.0;
  c.motion = {MotionKind::Sinusoid, 10.0, 0.5, 1e-3, 10.0, 0.0};
  c.rig.torque_limit = 5.0;
  c.rig.bandwidth_rad_s = 100.0;
  c.torque_scale = 1.0;
  c.band_Hz = 100.0;
  return c;
}

TEST(Detectability, OfAnOffsetUnderCoulombFrictionIsItsShareOfTheTorque) {
  Case c = sliding_case();
  c.rig.torque_offset = 0.3;
  const Fit fit = fit_base(c, record_runs(c));
  const double inertial_rms = 0.01 * 10.0 * std::numbers::pi / std::numbers::sqrt2;
  EXPECT_NEAR(fit.share_left, 0.3 / std::hypot(1.0, 0.3, inertial_rms), 0.01);
  EXPECT_LT(fit_named(c, record_runs(c), {"torque-offset"}).share_left, 0.005);
  EXPECT_GT(fit_named(c, record_runs(c), {"quadratic-drag"}).share_left, 0.25);
}

TEST(Detectability, NothingHiddenLeavesNothingAndEveryEffectIsItsOwnBestModel) {
  Case none = sliding_case();
  none.plant.inertia = 0.05;
  EXPECT_LT(fit_base(none, record_runs(none)).share_left, 1e-3);
  Case drag = none;
  drag.plant.quadratic = 0.02;
  const auto runs = record_runs(drag);
  EXPECT_GT(fit_base(drag, runs).share_left, 0.05);
  EXPECT_LT(fit_named(drag, runs, {"quadratic-drag"}).share_left, 2e-3);
  EXPECT_LT(fit_named(drag, runs, {"friction-power"}).share_left, 5e-3);  // of which it is a case
}

TEST(Detectability, FallsWithTheNoise) {
  Case c = sliding_case();
  c.rig.torque_offset = 0.3;
  c.rig.torque_noise = 0.01;
  const double quiet = fit_base(c, record_runs(c)).nats;
  c.rig.torque_noise = 0.1;
  EXPECT_NEAR(quiet / fit_base(c, record_runs(c)).nats, 100.0, 3.0);
}

TEST(Cases, AreDrawnFromTheirSeedAlone) {
  for (std::uint64_t seed = 500; seed < 504; ++seed) {
    const std::vector<Recording> first = record_runs(draw_case(seed)), second = record_runs(draw_case(seed));
    ASSERT_EQ(first.size(), second.size());
    for (std::size_t run = 0; run < first.size(); ++run) {
      EXPECT_EQ(first[run].torque, second[run].torque);
      EXPECT_EQ(first[run].position, second[run].position);
    }
    EXPECT_NE(first.front().torque, record_runs(draw_case(seed + 1)).front().torque);
  }
}

TEST(Cases, TheHalvesShareNoFamilyAndNoUnlistedEffect) {
  std::set<std::string> unlisted[2], listed[2];
  for (std::uint64_t seed = 1; seed < 3000; ++seed) {
    const Case c = draw_case(seed);
    const std::size_t half = c.family->development ? 0 : 1;
    if (c.kind == Kind::Unlisted) unlisted[half].insert(c.hidden.front().name);
    if (c.kind == Kind::Single) listed[half].insert(c.hidden.front().name);
  }
  EXPECT_EQ(unlisted[0].size(), 8u);
  EXPECT_EQ(unlisted[1].size(), 3u);
  for (const std::string& name : unlisted[0]) EXPECT_FALSE(unlisted[1].contains(name)) << name;
  EXPECT_EQ(listed[0], listed[1]);  // both have all that is on the list
  EXPECT_GE(listed[0].size(), 16u);
}

TEST(Cases, ACleanOneIsExplainedByItsBaseModel) {
  int clean = 0;
  for (std::uint64_t seed = 1; clean < 6; ++seed) {
    const Case c = draw_case(seed);
    if (c.kind != Kind::None) continue;
    ++clean;
    const std::vector<Recording> runs = record_runs(c);
    EXPECT_LT(fit_base(c, runs).share_left, 2e-3) << in_words(c);
    EXPECT_LT(noise_share(c, runs), 0.05) << in_words(c);
  }
}

/// What second differences of the recorded position leave of the recorded torque, as a share, where the drive
/// slides.
double left_of_columns(const Case& c, const Recording& run) {
  const double row_s = c.rig.row_s();
  double left = 0.0, size = 0.0;
  for (std::size_t k = 1; k + 1 < run.torque.size(); ++k) {
    const auto& truth = run.truth;
    if (truth[k - 1].stuck || truth[k].stuck || std::abs(truth[k - 1].direction + truth[k].direction) < 1.999)
      continue;
    const double velocity = (run.position[k + 1] - run.position[k - 1]) / (2.0 * row_s);
    const double acceleration =
        (run.position[k + 1] - 2.0 * run.position[k] + run.position[k - 1]) / (row_s * row_s);
    const double torque =
        c.rig.torque_column == TorqueColumn::Held ? 0.5 * (run.torque[k - 1] + run.torque[k]) : run.torque[k];
    left += std::pow(torque - c.plant.inertia * acceleration - c.plant.viscous * velocity -
                         std::copysign(c.plant.coulomb, velocity),
                     2);
    size += torque * torque;
  }
  return std::sqrt(left / size);
}

TEST(Cases, TheColumnsOfACleanOneTellItsOwnModelWhateverTheLogger) {
  std::set<TorqueColumn> seen;
  int clean = 0;
  for (std::uint64_t seed = 2000; clean < 6 || seen.size() < 3; ++seed) {
    Case c = draw_case(seed);
    if (c.kind != Kind::None || !c.rig.has_position || c.motion.kind == MotionKind::Steps) continue;
    ++clean;
    seen.insert(c.rig.torque_column);
    c.rig.encoder_step = c.rig.torque_noise = c.rig.velocity_noise = 0.0;
    c.runs = 1;
    EXPECT_LT(left_of_columns(c, record_runs(c).front()), 0.04) << seed << ": " << in_words(c);
  }
}

/// The first case that is spoiled in this way, before and after.
struct Spoiled {
  Case drawn;
  std::vector<Recording> good, bad;
};
Spoiled spoiled(const std::string& how) {
  for (std::uint64_t seed = 1;; ++seed) {
    Case c = draw_case(seed);
    if (c.spoil != how) continue;
    std::vector<Recording> good = record_runs(c), bad = good;
    spoil(c, bad);
    return {std::move(c), std::move(good), std::move(bad)};
  }
}

TEST(BadData, HasAFindingForEachKindAndTouchesWhatItSays) {
  for (const std::string& how : detail::spoils()) {
    EXPECT_EQ(accepted_findings(how).empty(), how == "cells-nan") << how;
    const Spoiled s = spoiled(how);
    EXPECT_FALSE(s.good.front().position.empty() && how != "resolution") << how;
  }
  const Spoiled rpm = spoiled("velocity-in-rpm");
  EXPECT_NEAR(rpm.bad[0].velocity[50], rpm.good[0].velocity[50] * 30.0 / std::numbers::pi, 1e-9);
  EXPECT_EQ(rpm.bad[0].position, rpm.good[0].position);
  const Spoiled held = spoiled("rows-repeated");
  const auto every = 3 + held.drawn.seed % 13;
  for (std::size_t k = 0; k < held.bad[0].torque.size(); ++k)
    ASSERT_EQ(held.bad[0].torque[k], held.good[0].torque[k - k % every]);
  const Spoiled gap = spoiled("stamps-gap");
  EXPECT_LT(gap.bad[0].time_s.size(), gap.good[0].time_s.size());
  const Spoiled jitter = spoiled("stamps-jitter");
  for (std::size_t k = 1; k < jitter.bad[0].time_s.size(); ++k)
    ASSERT_GT(jitter.bad[0].time_s[k], jitter.bad[0].time_s[k - 1]);
  const Spoiled wrap = spoiled("counter-wraps");
  for (const double position : wrap.bad[0].position) ASSERT_GE(position, 0.0);
  int not_a_number = 0;
  for (const Recording& run : spoiled("cells-nan").bad)
    for (const auto* column : {&run.torque, &run.position, &run.velocity})
      for (const double value : *column) not_a_number += std::isnan(value) ? 1 : 0;
  EXPECT_GT(not_a_number, 0);
}

TEST(Files, HoldTheColumnsInTheUnitsOfTheModelFile) {
  Case c = sliding_case();
  c.rig.has_velocity = true;
  c.rig.encoder_step = 1e-3;
  c.in_counts = c.in_rpm = c.in_amperes = true;
  c.torque_constant = 0.5;
  const support::TemporaryDirectory folder;
  const std::vector<Recording> runs = record_runs(c);
  const Files files = write_files(c, runs, folder.path(""));
  std::ifstream csv(files.runs.at(0));
  std::string header;
  std::getline(csv, header);
  EXPECT_EQ(header, "time_s,current_A,encoder_count,speed_rpm");
  double time = 0, current = 0, count = 0, speed = 0;
  char comma = 0;
  csv >> time >> comma >> current >> comma >> count >> comma >> speed;
  EXPECT_NEAR(current, runs[0].torque[0] / 0.5, 1e-6);
  EXPECT_NEAR(count * 1e-3, runs[0].position[0], 1e-9);
  EXPECT_NEAR(speed * std::numbers::pi / 30.0, runs[0].velocity[0], 1e-5);
  EXPECT_NE(folder.read("model.toml").find("scale = 0.001"), std::string::npos);
  EXPECT_NE(folder.read("model.toml").find("unit = \"A\""), std::string::npos);
  EXPECT_NE(folder.read("model.toml").find("torque_held = true"), std::string::npos);
}

}  // namespace
}  // namespace clampd::drive_bench
