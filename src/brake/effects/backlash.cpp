#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class Backlash final : public EquationsOf<Backlash> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "backlash",
                                  .location = Location::Stiffness,
                                  .cause = "there is lost motion at each reversal",
                                  .excitation = "reversals under load",
                                  .parameters = {{.name = "play",
                                                  .unit = "rad",
                                                  .description = "motor angle lost at a reversal",
                                                  .lower = 0,
                                                  .upper = 10,
                                                  .scale = 0.1}},
                                  .states = 1};
    return kInfo;
  }
  /// The pads are ahead of the motor by the gap, which a travel closes or opens.
  template <class T>
  static T gap(const effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) {
    const T moved = own.states[0] - instant.travel;
    if (moved < 0.0) return T(0.0);
    return moved > own.parameters[0] ? own.parameters[0] : moved;
  }
  template <class T>
  void pad(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    instant.pad_position += gap(instant, own);
  }
  template <class T>
  void remember(const effects_detail::Instant<T>& end, const effects_detail::Own<T>& own, T* states) const {
    states[0] = gap(end, own);
  }
  template <class T>
  void settle(const effects_detail::Instant<T>&, const effects_detail::Own<T>&, T* states) const {
    states[0] = T(0.0);
  }
};

}  // namespace

const Effect& backlash() {
  static const Backlash kEffect;
  return kEffect;
}

}  // namespace clampd
