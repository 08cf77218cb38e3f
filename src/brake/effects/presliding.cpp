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
                                                  .lower = 0.00001,
                                                  .upper = 3,
                                                  .scale = 0.2,
                                                  .logarithmic = true,
                                                  .starts = {0.0001, 0.0004, 0.0015, 0.006, 0.025, 0.1, 0.4}},
                                                 {.name = "law",
                                                  .unit = "",
                                                  .description = "1 Dahl's; 2 elastic until it slides",
                                                  .role = Role::Refinement,
                                                  .lower = 1,
                                                  .upper = 2,
                                                  .starts = {1, 2}}},
                                  .states = 1};
    return kInfo;
  }
  int substeps() const override { return 4; }
  /// The bristles' deflection is a function of the travel.
  template <class T>
  static T grip(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) {
    if (effects_detail::value_of(own.parameters[1]) < 1.5)
      return effects_detail::turned_round(own.states[0], instant.travel, instant.direction,
                                          own.parameters[0]);
    const T deflected = own.states[0] + instant.travel / own.parameters[0];
    if (deflected > 1.0) return T(1.0);
    return deflected < -1.0 ? T(-1.0) : deflected;
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.grip = grip(instant, own);
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = grip(end, own);
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
