#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class QuadraticDrag final : public EquationsOf<QuadraticDrag> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "quadratic-drag",
                                  .location = Location::TorqueBalance,
                                  .cause = "a drag grows with the square of the speed",
                                  .excitation = "slow and fast motion",
                                  .parameters = {{.name = "coefficient",
                                                  .unit = "N m s^2/rad^2",
                                                  .description = "c of c v |v|",
                                                  .lower = 0,
                                                  .upper = 0.001,
                                                  .scale = 1e-07}}};
    return kInfo;
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.opposing_Nm += own.parameters[0] * instant.direction * instant.velocity * instant.velocity;
  }
};

}  // namespace

const Effect& quadratic_drag() {
  static const QuadraticDrag kEffect;
  return kEffect;
}

}  // namespace clampd
