#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class ForceOffset final : public EquationsOf<ForceOffset> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "force-offset",
                                  .location = Location::ForceReading,
                                  .cause = "the reading of clamp force is off by a constant",
                                  .excitation = "the clearance and the clamped brake",
                                  .parameters = {{.name = "offset",
                                                  .unit = "N",
                                                  .description = "of the reading",
                                                  .lower = -6000,
                                                  .upper = 6000,
                                                  .scale = 30}},
                                  .is_zero = true};
    return kInfo;
  }
  template <class T>
  void read(effects_detail::Readout<T>& readout, const effects_detail::Own<T>& own) const {
    readout.force_N += own.parameters[0];
  }
};

}  // namespace

const Effect& force_offset() {
  static const ForceOffset kEffect;
  return kEffect;
}

}  // namespace clampd
