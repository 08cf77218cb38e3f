#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class TorqueOffset final : public EquationsOf<TorqueOffset> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "torque-offset",
                                  .location = Location::TorqueReading,
                                  .cause = "the torque reading is off by a constant",
                                  .excitation = "motion in both directions",
                                  .parameters = {{.name = "offset",
                                                  .unit = "N m",
                                                  .description = "of the reading",
                                                  .lower = -1,
                                                  .upper = 1,
                                                  .scale = 0.01}},
                                  .is_zero = true};
    return kInfo;
  }
  template <class T>
  void torque(effects_detail::TorqueInput<T>& input, const effects_detail::Own<T>& own, T*) const {
    input.each_reading([&](T& reading) { reading -= own.parameters[0]; });
  }
};

}  // namespace

const Effect& torque_offset() {
  static const TorqueOffset kEffect;
  return kEffect;
}

}  // namespace clampd
