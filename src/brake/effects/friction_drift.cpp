#include <fmt/format.h>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class FrictionDrift final : public EquationsOf<FrictionDrift> {
  enum Parameter { kCoulomb, kViscous, kStatic, kRuns };

 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{
        .name = "friction-drift",
        .location = Location::TorqueBalance,
        .cause = "the friction changes from run to run, as by warming up",
        .excitation = "several runs",
        .parameters = {change("coulomb", "relative change of TC from the first run to the next"),
                       change("viscous", "the same of Tv"),
                       change("static", "the same of Ts0 and mus"),
                       {.name = "runs",
                        .unit = "runs",
                        .description = "after which the changes have settled to a third",
                        .role = Role::Shape,
                        .lower = 0.7,
                        .upper = 1e4,
                        .scale = 0.3,
                        .logarithmic = true,
                        .starts = {3, 15, 1000}}},
        .differs_by_run = true};
    return kInfo;
  }
  std::string in_words(std::span<const double> values, std::span<const double> sds, double) const override {
    return fmt::format("{} ({} a run at first)", info().cause, effects_detail::strength_in_words(info(), values, sds));
  }
  template <class T>
  void friction(effects_detail::Instant<T>& instant, const effects_detail::Own<T>& own) const {
    using std::exp;
    const T& settling = own.parameters[kRuns];
    const T runs = settling * (1.0 - exp(-instant.run / settling));
    instant.coulomb_Nm *= 1.0 + own.parameters[kCoulomb] * runs;
    instant.viscous_Nm_s_rad *= 1.0 + own.parameters[kViscous] * runs;
    instant.static_Nm *= 1.0 + own.parameters[kStatic] * runs;
  }

 private:
  static EffectParameter change(std::string_view name, std::string_view description) {
    return {
        .name = name, .unit = "1", .description = description, .lower = -0.3, .upper = 0.5, .scale = 0.005};
  }
};

}  // namespace

const Effect& friction_drift() {
  static const FrictionDrift kEffect;
  return kEffect;
}

}  // namespace clampd
