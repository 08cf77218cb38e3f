#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class FrictionDrift final : public EquationsOf<FrictionDrift> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "friction-drift",
        .location = Location::TorqueBalance,
        .cause = "the friction changes from run to run, as by warming up",
        .excitation = "several runs",
        .parameters = {{.name = "per_run",
                        .unit = "1",
                        .description = "relative change of TC and Tv from each run to the next",
                        .lower = -0.06,
                        .upper = 0.5,
                        .scale = 0.005}}};
    return kInfo;
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    const T factor = 1.0 + own.parameters[0] * instant.run;
    instant.coulomb_Nm *= factor;
    instant.viscous_Nm_s_rad *= factor;
  }
};

}  // namespace

const Effect& friction_drift() {
  static const FrictionDrift kEffect;
  return kEffect;
}

}  // namespace clampd
