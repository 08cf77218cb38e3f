#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class StiffnessShape final : public EquationsOf<StiffnessShape> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "stiffness-shape",
        .location = Location::Stiffness,
        .cause = "the stiffness has another shape than the polynomial of two terms",
        .excitation = "clamping over the whole range of force",
        .parameters = {{.name = "force",
                        .unit = "N",
                        .description = "more at 15 rad of compression",
                        .lower = -30000.0,
                        .upper = 30000.0,
                        .scale = 100,
                        // A linear term of either sign is the same curve, moved along the compression:
                        // nothing tells it at its neutral value.
                        .starts = {500.0}},
                       {.name = "exponent",
                        .unit = "1",
                        .description = "of the missing power of the compression",
                        .role = Role::Choice,
                        .lower = 1,
                        .upper = 6,
                        .scale = 1,
                        .starts = {4, 1, 5}}}};
    return kInfo;
  }
  template <class T>
  void force(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    if (!(instant.pad_position > 0.0)) return;
    const T compression = instant.pad_position / 15.0;
    T power = compression;
    for (int i = 1; i < static_cast<int>(effects_detail::value_of(own.parameters[1])); ++i)
      power *= compression;
    instant.force_N += own.parameters[0] * power;
    if (instant.force_N < 0.0) instant.force_N = T(0.0);  // pads do not pull
  }
};

}  // namespace

const Effect& stiffness_shape() {
  static const StiffnessShape kEffect;
  return kEffect;
}

}  // namespace clampd
