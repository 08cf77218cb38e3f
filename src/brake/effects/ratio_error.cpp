#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class RatioError final : public EquationsOf<RatioError> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "ratio-error",
        .location = Location::TorqueBalance,
        .cause = "the gear has another ratio than assumed, or the force reading another scale",
        .excitation = "load in both directions of motion",
        .parameters = {{.name = "relative",
                        .unit = "1",
                        .description = "deviation of N from its fixed value",
                        .lower = -0.8,
                        .upper = 1.5,
                        .scale = 0.05}},
        .is_like_a_scale_of_force = true};
    return kInfo;
  }
  template <class T>
  void balance(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.ratio_m_rad *= 1.0 + own.parameters[0];
  }
};

}  // namespace

const Effect& ratio_error() {
  static const RatioError kEffect;
  return kEffect;
}

}  // namespace clampd
