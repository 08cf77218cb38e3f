#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class PadDamping final : public EquationsOf<PadDamping> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "pad-damping",
                                  .location = Location::Stiffness,
                                  .cause = "the pads resist fast compression",
                                  .excitation = "fast motion under load",
                                  .parameters = {{.name = "damping",
                                                  .unit = "N s/rad",
                                                  .description = "force per velocity in contact",
                                                  .lower = 0,
                                                  .upper = 200,
                                                  .scale = 1}}};
    return kInfo;
  }
  template <class T>
  void force(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    if (!(instant.pad_position > 0.0)) return;
    instant.force_N += own.parameters[0] * instant.velocity;
    if (instant.force_N < 0.0) instant.force_N = T(0.0);
  }
};

}  // namespace

const Effect& pad_damping() {
  static const PadDamping kEffect;
  return kEffect;
}

}  // namespace clampd
