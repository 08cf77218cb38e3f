#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class TorqueGain final : public EquationsOf<TorqueGain> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "torque-gain",
                                  .location = Location::TorqueReading,
                                  .cause = "the torque reading has a wrong gain",
                                  .excitation = "acceleration and load, both large",
                                  .parameters = {{.name = "gain_error",
                                                  .unit = "1",
                                                  .description = "relative",
                                                  .lower = -0.6,
                                                  .upper = 1.5,
                                                  .scale = 0.05}}};
    return kInfo;
  }
  template <class T>
  void torque(effects_detail::TorqueInput<T>& input, const effects_detail::Own<T>& own, T*) const {
    input.each_reading([&](T& reading) { reading /= 1.0 + own.parameters[0]; });
  }
};

}  // namespace

const Effect& torque_gain() {
  static const TorqueGain kEffect;
  return kEffect;
}

}  // namespace clampd
