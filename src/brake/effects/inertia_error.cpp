#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class InertiaError final : public EquationsOf<InertiaError> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "inertia-error",
                                  .location = Location::TorqueBalance,
                                  .cause = "the moving parts have another inertia than assumed",
                                  .excitation = "strong acceleration",
                                  .parameters = {{.name = "relative",
                                                  .unit = "1",
                                                  .description = "deviation of J from its fixed value",
                                                  .lower = -0.8,
                                                  .upper = 3.0,
                                                  .scale = 0.05}}};
    return kInfo;
  }
  template <class T>
  void balance(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.inertia_kg_m2 *= 1.0 + own.parameters[0];
  }
};

}  // namespace

const Effect& inertia_error() {
  static const InertiaError kEffect;
  return kEffect;
}

}  // namespace clampd
