#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class StiffnessHysteresis final : public EquationsOf<StiffnessHysteresis> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "stiffness-hysteresis",
                                  .location = Location::Stiffness,
                                  .cause = "the pads push back less on release than on apply",
                                  .excitation = "reversals under load",
                                  .parameters = {{.name = "share",
                                                  .unit = "1",
                                                  .description = "of the force that is missing on release",
                                                  .lower = 0,
                                                  .upper = 0.7,
                                                  .scale = 0.02},
                                                 {.name = "travel",
                                                  .unit = "rad",
                                                  .description = "that turns the loop round",
                                                  .role = Role::Shape,
                                                  .lower = 0.005,
                                                  .upper = 20,
                                                  .scale = 0.2,
                                                  .logarithmic = true,
                                                  .starts = {0.1, 0.5, 2.5}}},
                                  .states = 1};
    return kInfo;
  }
  template <class T>
  void force(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    const T side =
        effects_detail::turned_round(own.states[0], instant.travel, instant.direction, own.parameters[1]);
    instant.force_N *= 1.0 - 0.5 * own.parameters[0] * (1.0 - side);
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = effects_detail::turned_round(own.states[0], end.travel, end.direction, own.parameters[1]);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>&, const effects_detail::Own<T>&, T* states) const {
    states[0] = T(-1.0);
  }
};

}  // namespace

const Effect& stiffness_hysteresis() {
  static const StiffnessHysteresis kEffect;
  return kEffect;
}

}  // namespace clampd
