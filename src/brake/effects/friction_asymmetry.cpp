#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class FrictionAsymmetry final : public EquationsOf<FrictionAsymmetry> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "friction-asymmetry",
        .location = Location::TorqueBalance,
        .cause = "the friction differs between applying and releasing",
        .excitation = "motion in both directions",
        .parameters = {{.name = "coulomb",
                        .unit = "N m",
                        .description = "more Coulomb friction when applying, less when releasing",
                        .lower = -1,
                        .upper = 1,
                        .scale = 0.01},
                       {.name = "viscous",
                        .unit = "N m s/rad",
                        .description = "the same of the viscous friction",
                        .lower = -0.01,
                        .upper = 0.01,
                        .scale = 0.0001}}};
    return kInfo;
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    // Half of the difference is a torque that does not change its sign.
    instant.opposing_Nm += own.parameters[0];
    instant.viscous_Nm_s_rad += instant.direction * own.parameters[1];
  }
};

}  // namespace

const Effect& friction_asymmetry() {
  static const FrictionAsymmetry kEffect;
  return kEffect;
}

}  // namespace clampd
