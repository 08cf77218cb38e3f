#include <fmt/format.h>

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
                        .choices = {"clamp force", "velocity"}}},
        .removes_readings = true};
    return kInfo;
  }
  std::string in_words(std::span<const double> values, std::span<const double>, double) const override {
    return fmt::format("single readings of {} are far off: {} of them", choice_of(info().parameters[2], values[2]),
                       size_in_words(values[0], "1"));
  }
};

}  // namespace

const Effect& outliers() {
  static const Outliers kEffect;
  return kEffect;
}

}  // namespace clampd
