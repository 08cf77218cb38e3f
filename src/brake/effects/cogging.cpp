#include <fmt/format.h>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class Cogging final : public EquationsOf<Cogging> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "cogging",
        .location = Location::TorqueBalance,
        .cause = "a torque repeats itself with the motor angle",
        .excitation = "slow motion over many periods",
        .parameters = {{.name = "sine",
                        .unit = "N m",
                        .description = "amplitude in phase with the angle from contact",
                        .lower = -1,
                        .upper = 1,
                        .scale = 0.01},
                       {.name = "cosine",
                        .unit = "N m",
                        .description = "amplitude a quarter period ahead",
                        .lower = -1,
                        .upper = 1,
                        .scale = 0.01},
                       {.name = "order",
                        .unit = "1/rev",
                        .description = "periods a motor revolution",
                        .role = Role::Shape,
                        .lower = 0.3,
                        .upper = 100,
                        .scale = 0.02,
                        .starts = {1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12,
                                   13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24}}},
        .repeatable = true,
        .order_scan = OrderScan{.first = 0.4, .last = 90.0, .step = 0.12, .neighbourhood = 0.5, .fine_step = 0.025}};
    return kInfo;
  }
  std::string in_words(std::span<const double> values, std::span<const double>, double) const override {
    return fmt::format("{}: {:.2g} N m, {:.3g} times a revolution", info().cause, std::hypot(values[0], values[1]), values[2]);
  }
  template <class T>
  void balance(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    const effects_detail::Turned<T> turned(own.parameters[2] * instant.position);
    instant.opposing_Nm += (own.parameters[0] * turned.sine + own.parameters[1] * turned.cosine) *
                           mean_over_step(T(own.parameters[2] * instant.velocity * instant.step_s));
  }

 private:
  /// A fast motor turns through much of a period within a step: with this factor the step's three instants,
  /// weighted 1 : 4 : 1, make the mean of the wave over the phase that passes.
  template <class T>
  static T mean_over_step(const T& phase) {
    const T half = 0.5 * phase;
    const T square = half * half;
    if (square < 0.04) return 1.0 - square * square * (1.0 / 180.0 + square / 1512.0);  // its series
    const effects_detail::Turned<T> turned(half);
    return 3.0 * turned.sine / (half * (2.0 + turned.cosine));
  }
};

}  // namespace

const Effect& cogging() {
  static const Cogging kEffect;
  return kEffect;
}

}  // namespace clampd
