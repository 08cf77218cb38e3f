#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

/// Of the readings' noise and of nothing else: it has no equations, and whoever fits it leaves out the
/// readings that it marks.
class Outliers final : public EquationsOf<Outliers> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "outliers",
        .location = Location::ForceReading,
        .cause = "single readings are far off: spikes",
        .excitation = "enough readings",
        .parameters = {{.name = "share",
                        .unit = "1",
                        .description = "of the readings of its channel",
                        .role = Role::Choice,
                        .lower = 0,
                        .upper = 0.5},
                       {.name = "size",
                        .unit = "",
                        .description = "standard deviation of the spikes, N or rad/s",
                        .role = Role::Choice,
                        .lower = 0,
                        .upper = 1e6},
                       {.name = "channel",
                        .unit = "",
                        .description = "that has them",
                        .role = Role::Choice,
                        .lower = 1,
                        .upper = 2,
                        .choices = {"clamp force", "velocity"}}}};
    return kInfo;
  }
};

}  // namespace

const Effect& outliers() {
  static const Outliers kEffect;
  return kEffect;
}

}  // namespace clampd
