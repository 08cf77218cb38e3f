#include <fmt/format.h>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class VelocityLag final : public EquationsOf<VelocityLag> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "velocity-lag",
                                  .location = Location::VelocityReading,
                                  .cause = "the reading of velocity comes late, as through a filter",
                                  .excitation = "velocity that changes quickly",
                                  .parameters = {{.name = "time_constant",
                                                  .unit = "s",
                                                  .description = "of the filter",
                                                  .lower = 0,
                                                  .upper = 0.1,
                                                  .scale = 0.0005}},
                                  .states = 1};
    return kInfo;
  }
  std::string in_words(std::span<const double> values, std::span<const double>, double) const override {
    return fmt::format("the reading of velocity comes {} late, as through a filter", size_in_words(values[0], "s"));
  }
  template <class T>
  void read(effects_detail::Readout<T>& readout, const effects_detail::Own<T>& own) const {
    readout.velocity_rad_s = own.states[0];
  }
  template <class T>
  void filter(const effects_detail::Transit<T>& transit, const effects_detail::Own<T>& own, T* states) const {
    const auto straight = [&](const auto& gap_s, const T& before, const T& after, const T& state) {
      return effects_detail::first_order(own.parameters[0], gap_s, before, after, T(0.0), state);
    };
    const T &before = transit.velocity_before_rad_s, &after = transit.velocity_after_rad_s;
    if (!transit.reverses()) {
      states[0] = straight(transit.gap_s, before, after, own.states[0]);
      return;
    }
    const T at_reversal = straight(transit.until_reversal_s, before, T(0.0), own.states[0]);
    states[0] = straight(transit.since_reversal_s, T(0.0), after, at_reversal);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>&, T* states) const {
    states[0] = instant.velocity;
  }
};

}  // namespace

const Effect& velocity_lag() {
  static const VelocityLag kEffect;
  return kEffect;
}

}  // namespace clampd
