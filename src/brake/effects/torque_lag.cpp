#include <algorithm>

#include <fmt/format.h>

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
  std::string in_words(std::span<const double> values, std::span<const double>, double) const override {
    return fmt::format("the acting torque comes {} later than its reading", size_in_words(values[0], "s"));
  }
  /// Its mean acts, while it changes quickly and over the rest of the row: the velocity at the row's end is
  /// then exact, and it passes zero in between when it should.
  template <class T>
  void torque(effects_detail::TorqueInput<T>& input, const effects_detail::Own<T>& own, T* states) const {
    using std::exp;
    const T& lag_s = own.parameters[0];
    const T target = input.torque_Nm;
    const T distance = own.states[0] - target;
    if (!(lag_s > 1e-3 * input.gap_s)) {
      input.torque_Nm += distance * lag_s / input.gap_s;
      states[0] = target;
      return;
    }
    input.early_s = std::min(2.0 * effects_detail::value_of(lag_s), 0.5 * input.gap_s);
    const T left_then = exp(-input.early_s / lag_s), left = exp(-input.gap_s / lag_s);
    input.early_torque_Nm = target + distance * lag_s * (1.0 - left_then) / input.early_s;
    input.torque_Nm = target + distance * lag_s * (left_then - left) / (input.gap_s - input.early_s);
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
