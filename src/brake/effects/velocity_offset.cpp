#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class VelocityOffset final : public EquationsOf<VelocityOffset> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "velocity-offset",
                                  .location = Location::VelocityReading,
                                  .cause = "the reading of velocity is off by a constant",
                                  .excitation = "motion, or rest, for long enough",
                                  .parameters = {{.name = "offset",
                                                  .unit = "rad/s",
                                                  .description = "of the reading",
                                                  .lower = -100,
                                                  .upper = 100,
                                                  .scale = 0.3}},
                                  .is_zero = true};
    return kInfo;
  }
  template <class T>
  void read(effects_detail::Readout<T>& readout, const effects_detail::Own<T>& own) const {
    readout.velocity_rad_s += own.parameters[0];
  }
};

}  // namespace

const Effect& velocity_offset() {
  static const VelocityOffset kEffect;
  return kEffect;
}

}  // namespace clampd
