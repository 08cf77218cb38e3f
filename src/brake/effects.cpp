#include <array>

#include "src/brake/effects/catalogue.hpp"

namespace clampd {

std::string_view to_string(Location location) noexcept {
  switch (location) {
    case Location::TorqueBalance:
      return "torque-balance";
    case Location::Stiffness:
      return "stiffness";
    case Location::ForceReading:
      return "force-reading";
    case Location::VelocityReading:
      return "velocity-reading";
    case Location::TorqueReading:
      return "torque-reading";
    case Location::Timing:
      return "timing";
  }
  return "?";
}

std::span<const Effect* const> effects() {
  static const std::array kCatalogue{
      &torque_offset(),      &torque_gain(),    &torque_lag(),       &coulomb_load(),
      &friction_asymmetry(), &quadratic_drag(), &cogging(),          &inertia_error(),
      &ratio_error(),        &presliding(),     &friction_drift(),   &stiffness_hysteresis(),
      &pad_damping(),        &pad_relaxation(), &backlash(),         &stiffness_shape(),
      &force_offset(),       &force_lag(),      &force_saturation(), &force_hum(),
      &velocity_lag(),       &channel_skew(),   &outliers(),
  };
  return kCatalogue;
}

const Effect* find_effect(std::string_view name) {
  for (const Effect* effect : effects())
    if (effect->info().name == name) return effect;
  return nullptr;
}

const EffectInfo& info_of(const Effect& effect) {
  return effect.info();
}

std::vector<double> starts_of(const Effect& effect, std::size_t parameter, std::span<const Run> runs) {
  return effect.starts(parameter, runs);
}

std::vector<double> chosen_otherwise(const Effect& effect, std::vector<double> values, std::size_t parameter,
                                     double choice) {
  return effect.chosen_otherwise(std::move(values), parameter, choice);
}

EffectDelays delays_of(const EffectValues& values) {
  return values.effect->delays(values.values);
}

}  // namespace clampd
