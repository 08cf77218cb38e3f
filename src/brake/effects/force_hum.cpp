#include <fmt/format.h>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class ForceHum final : public EquationsOf<ForceHum> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "force-hum",
                                  .location = Location::ForceReading,
                                  .cause = "the mains hum on the reading of clamp force",
                                  .excitation = "any run of a few tenths of a second",
                                  .parameters = {{.name = "frequency",
                                                  .unit = "Hz",
                                                  .description = "of the hum",
                                                  .role = Role::Shape,
                                                  .lower = 5,
                                                  .upper = 450,
                                                  .scale = 0.1,
                                                  .starts = {50, 60, 100, 120, 150}}},
                                  .states = 2,
                                  .free_states = 2,
                                  .repeatable = true};
    return kInfo;
  }
  std::string in_words(std::span<const double> values, std::span<const double>, double amplitude) const override {
    return fmt::format("the mains hum on the reading of clamp force ({}, {})", size_in_words(amplitude, "N"),
                       size_in_words(values[0], "Hz"));
  }
  /// Amplitudes in phase and a quarter period ahead, other ones in each run: the mains know nothing of it.
  template <class T>
  void read(effects_detail::Readout<T>& readout, const effects_detail::Own<T>& own) const {
    using std::cos;
    using std::sin;
    const T angle = 2.0 * std::numbers::pi * readout.time_s * own.parameters[0];
    readout.force_N += own.states[0] * sin(angle) + own.states[1] * cos(angle);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>&, const effects_detail::Own<T>&, T* states) const {
    states[0] = states[1] = T(0.0);
  }
};

}  // namespace

const Effect& force_hum() {
  static const ForceHum kEffect;
  return kEffect;
}

}  // namespace clampd
