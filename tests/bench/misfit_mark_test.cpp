#include <array>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <random>
#include <string>

#include <gtest/gtest.h>

#include "bench/embedded_check.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd::bench {
namespace {

/// Brakes as the paper's Table II varies them, or CLAMPD_MARK_BRAKES of each kind.
int brakes(int usual) {
  const char* asked = std::getenv("CLAMPD_MARK_BRAKES");
  return asked == nullptr ? usual : std::atoi(asked);
}

struct Counts {
  int marked = 0, significant = 0, told = 0, errors = 0;
  std::array<int, kParameterCount> inside{};  ///< of the marked: within 3 of the reported sd
  std::array<double, kParameterCount> worst{};
};

/// Checks brakes whose parameters differ by up to 15 % from nominal, at these sensors, with an effect.
Counts check_brakes(int count, double noise, const std::function<void(sim::PlantConfiguration&)>& spoil) {
  Counts counts;
  for (int i = 0; i < count; ++i) {
    const auto seed = static_cast<std::uint64_t>(7919 * (i + 1));
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> factor(0.87, 1.13);
    sim::PlantConfiguration brake = plant(seed);
    for (Eigen::Index k = 0; k < brake.brake.theta.size(); ++k) brake.brake.theta[k] *= factor(random);
    brake.sensors.force_noise_N *= noise;
    brake.sensors.velocity_noise_rad_s *= noise;
    brake.sensors.torque_noise_Nm *= noise;
    spoil(brake);
    const CheckRecord record = check(brake, 20);
    if (!record.systematic) {
      ++counts.errors;
      std::printf("  %s %s\n", std::string(to_string(record.verdict)).c_str(), record.reason.c_str());
      continue;
    }
    ++counts.told;
    counts.significant += record.systematic->p_value < 1e-3;
    counts.marked += record.systematic->marked;
    double far = 0.0;
    for (std::size_t k = 0; k < kParameterCount; ++k) {
      const ParameterRecord& p = record.parameters[k];
      const double off = std::abs(p.value - brake.brake.theta[static_cast<Eigen::Index>(k)]) / p.sd;
      counts.inside[k] += off < 3.0;
      far = std::max(far, off);
      counts.worst[k] = std::max(counts.worst[k], off);
    }
    if (i < 3)
      std::printf("  p %.2g, over noise %.3f, moved %.2f sd, marked %d, farthest %.1f sd, %s\n",
                  record.systematic->p_value, record.systematic->over_noise, record.systematic->moved_sd,
                  record.systematic->marked, far, std::string(to_string(record.verdict)).c_str());
  }
  return counts;
}

void print(const char* what, const Counts& counts) {
  std::printf("%s: told %d, significant %d, marked %d, not told %d; within 3 sd:", what, counts.told,
              counts.significant, counts.marked, counts.errors);
  for (std::size_t k = 0; k < kParameterCount; ++k)
    std::printf(" %s %d (%.1f)", std::string(kParameterTable[k].name).c_str(), counts.inside[k],
                counts.worst[k]);
  std::printf("\n");
  std::fflush(stdout);
}

TEST(MisfitMark, HealthyBrakesHaveNone) {
  const int count = brakes(40);
  for (const double noise : {1.0, 2.5}) {
    const Counts counts = check_brakes(count, noise, [](sim::PlantConfiguration&) {});
    print(noise > 1.0 ? "healthy, noisy" : "healthy", counts);
    // 1 % of them may be: beyond this count lies less than 1 in 1000 of the binomial distribution with 1 %.
    const double most = 0.01 * count + 3.3 * std::sqrt(0.01 * count) + 1.0;
    EXPECT_LE(counts.marked, most);
  }
}

TEST(MisfitMark, WhatTheModelLacksIsMarked) {
  const int count = brakes(10);
  const auto expect_marked = [&](const char* what,
                                 const std::function<void(sim::PlantConfiguration&)>& spoil) {
    const Counts counts = check_brakes(count, 1.0, spoil);
    print(what, counts);
    EXPECT_GE(counts.marked, 0.9 * counts.told) << what;
  };
  expect_marked("force-lag 0.5 ms", [](auto& brake) { brake.effects.force_lag_s = 0.5e-3; });
  expect_marked("friction-asymmetry 0.01 N m",
                [](auto& brake) { brake.effects.friction_asymmetry_Nm = 0.01; });
}

}  // namespace
}  // namespace clampd::bench
