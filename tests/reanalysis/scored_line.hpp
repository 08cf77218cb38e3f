#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "bench/embedded_check.hpp"
#include "clampd/identify/effect_scores.hpp"
#include "clampd/station/cause.hpp"
#include "drivers/sim/effects.hpp"
#include "support/drawn_brake.hpp"

namespace clampd::support {

/// Something that the simulated brake has.
struct HiddenInBrake {
  std::string effect;
  double size = 0.0;
};

/// What one simulated check of a brake from the population says about each effect.
inline EffectScores scored_check(std::uint64_t seed, std::uint32_t repeats,
                                             const std::vector<HiddenInBrake>& hidden) {
  sim::PlantConfiguration brake = bench::plant(seed);
  Draws draws(seed);
  brake.brake.theta = draws.brake().theta;
  for (const HiddenInBrake& each : hidden)
    if (const Result<void> set = sim::set_effect(brake.effects, each.effect, each.size); !set)
      throw std::runtime_error(set.error().message);
  bench::PreparedStation prepared = bench::prepared();
  prepared.configuration.check.diagnose = false;
  bench::EmbeddedStation station(std::move(prepared), brake);
  const CheckRecord check = station.run_check(bench::request(repeats), nullptr, nullptr).value();
  Result<EffectScores> scores = score_effects(runs_of(check), BrakeParameters{});
  if (!scores) throw std::runtime_error(fmt::format("seed {}: {}", seed, scores.error().message));
  return std::move(*scores);
}

}  // namespace clampd::support
