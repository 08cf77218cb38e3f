#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class TorqueLag final : public EquationsOf<TorqueLag> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "torque-lag",
                                  .location = Location::TorqueReading,
                                  .cause = "the acting torque comes later than its reading",
                                  .excitation = "torque that changes quickly",
                                  .parameters = {{.name = "time_constant",
                                                  .unit = "s",
                                                  .description = "of the torque behind its reading",
                                                  .lower = 0,
                                                  .upper = 0.05,
                                                  .scale = 0.0005}},
                                  .states = 1};
    return kInfo;
  }
  /// The mean over the row acts; the velocity at its end is then exact.
  template <class T>
  void torque(effects_detail::TorqueInput<T>& input, const effects_detail::Own<T>& own, T* states) const {
    using std::exp;
    const T lag = own.parameters[0] / input.gap_s;
    const T target = input.torque_Nm;
    const T distance = own.states[0] - target;
    if (!(lag > 1e-3)) {
      input.torque_Nm += distance * lag;
      states[0] = target;
      return;
    }
    const T left = exp(-1.0 / lag);
    input.torque_Nm += distance * lag * (1.0 - left);
    states[0] = target + distance * left;
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>&, T* states) const {
    states[0] = instant.torque_Nm;
  }
};

}  // namespace

const Effect& torque_lag() {
  static const TorqueLag kEffect;
  return kEffect;
}

}  // namespace clampd
