#include <fmt/format.h>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class ForceLag final : public EquationsOf<ForceLag> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "force-lag",
                                  .location = Location::ForceReading,
                                  .cause = "the reading of clamp force comes late, as through a filter",
                                  .excitation = "force that changes quickly",
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
    return fmt::format("the reading of clamp force comes {} late, as through a filter", size_in_words(values[0], "s"));
  }
  template <class T>
  void read(effects_detail::Readout<T>& readout, const effects_detail::Own<T>& own) const {
    readout.force_N = own.states[0];
  }
  template <class T>
  void filter(const effects_detail::Transit<T>& transit, const effects_detail::Own<T>& own, T* states) const {
    states[0] = effects_detail::first_order(own.parameters[0], transit.gap_s, transit.force_before_N,
                                            transit.force_after_N, transit.force_bend_N, own.states[0]);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>&, T* states) const {
    states[0] = instant.force_N;
  }
};

}  // namespace

const Effect& force_lag() {
  static const ForceLag kEffect;
  return kEffect;
}

}  // namespace clampd
