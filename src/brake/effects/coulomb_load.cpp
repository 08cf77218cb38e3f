#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class CoulombLoad final : public EquationsOf<CoulombLoad> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "coulomb-load",
                                  .location = Location::TorqueBalance,
                                  .cause = "the sliding friction grows with the clamp force",
                                  .excitation = "fast motion under load",
                                  .parameters = {{.name = "growth",
                                                  .unit = "N m/N",
                                                  .description = "of the Coulomb friction with the force",
                                                  .lower = -3e-05,
                                                  .upper = 0.0002,
                                                  .scale = 1e-06}}};
    return kInfo;
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.coulomb_Nm += own.parameters[0] * instant.force_N;
  }
};

}  // namespace

const Effect& coulomb_load() {
  static const CoulombLoad kEffect;
  return kEffect;
}

}  // namespace clampd
