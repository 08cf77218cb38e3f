#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class Presliding final : public EquationsOf<Presliding> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "presliding",
                                  .location = Location::TorqueBalance,
                                  .cause = "the friction gives way elastically before it slides",
                                  .excitation = "reversals, best under load",
                                  .parameters = {{.name = "deflection",
                                                  .unit = "rad",
                                                  .description = "at which the friction is fully built up",
                                                  .role = Role::Shape,
                                                  .lower = 0.0001,
                                                  .upper = 3,
                                                  .scale = 0.2,
                                                  .logarithmic = true,
                                                  .starts = {0.004, 0.02, 0.08, 0.3}}},
                                  .states = 1};
    return kInfo;
  }
  int substeps() const override { return 4; }
  /// Dahl's bristles; their deflection is a function of the travel.
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.grip =
        effects_detail::turned_round(own.states[0], instant.travel, instant.direction, own.parameters[0]);
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = effects_detail::turned_round(own.states[0], end.travel, end.direction, own.parameters[0]);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>&, T* states) const {
    states[0] = (instant.torque_Nm - instant.ratio_m_rad * instant.force_N) / instant.static_Nm;
    if (states[0] > 1.0) states[0] = T(1.0);
    if (states[0] < -1.0) states[0] = T(-1.0);
  }
};

}  // namespace

const Effect& presliding() {
  static const Presliding kEffect;
  return kEffect;
}

}  // namespace clampd
