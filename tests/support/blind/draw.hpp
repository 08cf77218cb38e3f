#pragma once

#include <random>
#include <span>
#include <string_view>

#include "tests/support/blind/blind_set.hpp"

namespace clampd::blind {

/// Random numbers of an answer.
class Draw {
 public:
  explicit Draw(std::uint64_t seed) : random_(seed) {}

  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  double log_uniform(double low, double high);
  double sign() { return chance(0.5) ? 1.0 : -1.0; }
  bool chance(double probability) { return uniform(0.0, 1.0) < probability; }
  int integer(int low, int high) {
    return std::uniform_int_distribution<int>(low, high)(random_);
  }  ///< inclusive

 private:
  std::mt19937_64 random_;
};

/// A kind of effect: how one is drawn.
struct EffectKind {
  std::string_view name;
  bool on_list;
  HiddenEffect (*draw)(Draw&);
};

std::span<const EffectKind> effect_kinds();

/// An effect of drivers/sim with a random value.
HiddenEffect draw_station_effect(std::string_view name, Draw& draw);

}  // namespace clampd::blind
