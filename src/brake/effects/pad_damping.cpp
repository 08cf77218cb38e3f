#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class PadDamping final : public EquationsOf<PadDamping> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "pad-damping",
        .location = Location::Stiffness,
        .cause = "the pads resist fast compression",
        .excitation = "fast motion under load",
        .parameters = {{.name = "damping",
                        .unit = "N s/rad",
                        .description = "force per velocity, at 10 kN if it grows with the force",
                        .lower = 0,
                        .upper = 200,
                        .scale = 1},
                       {.name = "law",
                        .unit = "",
                        .description = "by which the pads damp",
                        .role = Role::Choice,
                        .lower = 1,
                        .upper = 2,
                        .scale = 1,
                        .starts = {1, 2},
                        .choices = {"the same in all of the contact",
                                    "in proportion to the force (Hunt and Crossley)"}}}};
    return kInfo;
  }
  template <class T>
  void force(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    if (!(instant.pad_position > 0.0)) return;
    T damping = own.parameters[0];
    if (effects_detail::value_of(own.parameters[1]) > 1.5) damping *= instant.force_N / 1e4;
    instant.force_N += damping * instant.velocity;
    if (instant.force_N < 0.0) instant.force_N = T(0.0);
  }
};

}  // namespace

const Effect& pad_damping() {
  static const PadDamping kEffect;
  return kEffect;
}

}  // namespace clampd
