#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class FrictionAsymmetry final : public EquationsOf<FrictionAsymmetry> {
  enum Parameter { kCoulomb, kViscous, kShare };
  enum class Share { Constant = 1, Proportional, Coulomb };

 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "friction-asymmetry",
        .location = Location::TorqueBalance,
        .cause = "the friction differs between applying and releasing",
        .excitation = "motion in both directions",
        .parameters = {
            {.name = "coulomb",
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
             .scale = 0.0001},
            {.name = "share",
             .unit = "",
             .description = "of the friction that differs",
             .role = Role::Refinement,
             .lower = 1,
             .upper = 3,
             .starts = {1, 2, 3},
             .choices = {"constant", "in proportion to the dry friction", "the sliding part alone"}}}};
    return kInfo;
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.viscous_Nm_s_rad += instant.direction * own.parameters[kViscous];
    if (effects_detail::chosen<Share>(own.parameters[kShare]) == Share::Coulomb)
      instant.coulomb_Nm += instant.direction * own.parameters[kCoulomb];
  }
  template <class T>
  void balance(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    // Half of the difference is a torque that does not change its sign.
    const auto share = effects_detail::chosen<Share>(own.parameters[kShare]);
    if (share == Share::Constant) instant.opposing_Nm += own.parameters[kCoulomb];
    if (share == Share::Proportional)
      instant.opposing_Nm += own.parameters[kCoulomb] * (instant.level_Nm / instant.coulomb_Nm);
  }
};

}  // namespace

const Effect& friction_asymmetry() {
  static const FrictionAsymmetry kEffect;
  return kEffect;
}

}  // namespace clampd
