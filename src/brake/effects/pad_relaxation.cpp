#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class PadRelaxation final : public EquationsOf<PadRelaxation> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "pad-relaxation",
                                  .location = Location::Stiffness,
                                  .cause = "the force gives way while the brake holds",
                                  .excitation = "holding under load",
                                  .parameters = {{.name = "share",
                                                  .unit = "1",
                                                  .description = "of the force that relaxes",
                                                  .lower = 0,
                                                  .upper = 0.7,
                                                  .scale = 0.02},
                                                 {.name = "time_constant",
                                                  .unit = "s",
                                                  .description = "of the relaxation",
                                                  .role = Role::Shape,
                                                  .lower = 0.01,
                                                  .upper = 5,
                                                  .scale = 0.2,
                                                  .logarithmic = true,
                                                  .starts = {0.03, 0.15, 0.7}}},
                                  .states = 1,
                                  // What an earlier clamping left behind.
                                  .free_states = 1,
                                  .free_state_deviation = 3000.0,
                                  .free_states_count = false};
    return kInfo;
  }
  template <class T>
  static T relaxed(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) {
    using std::exp;
    return instant.elastic_N +
           (own.states[0] - instant.elastic_N) * exp(-instant.elapsed_s / own.parameters[1]);
  }
  template <class T>
  void force(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    if (!(instant.pad_position > 0.0)) return;
    instant.force_N -= own.parameters[0] * relaxed(instant, own);
    if (instant.force_N < 0.0) instant.force_N = T(0.0);  // pads do not pull
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = relaxed(end, own);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>&, T* states) const {
    states[0] = instant.elastic_N;
  }
};

}  // namespace

const Effect& pad_relaxation() {
  static const PadRelaxation kEffect;
  return kEffect;
}

}  // namespace clampd
