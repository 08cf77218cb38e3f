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
                        .description = "relative change of TC and Tv from the first run to the next",
                        .lower = -0.3,
                        .upper = 0.5,
                        .scale = 0.005},
                       {.name = "runs",
                        .unit = "runs",
                        .description = "after which the change has settled to a third",
                        .role = Role::Shape,
                        .lower = 0.7,
                        .upper = 1e4,
                        .scale = 0.3,
                        .logarithmic = true,
                        .starts = {3, 15, 1000}}}};
    return kInfo;
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    using std::exp;
    const T& settling = own.parameters[1];
    const T factor = 1.0 + own.parameters[0] * settling * (1.0 - exp(-instant.run / settling));
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
