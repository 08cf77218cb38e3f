#pragma once

#include <array>
#include <string>
#include <span>
#include <string_view>

#include "clampd/base/result.hpp"

namespace clampd::sim {

/// Switchable physics that the simulated brake has on top of the base model: one member per effect, zero
/// means none.
struct Effects {
  double torque_offset_Nm = 0.0;
  double torque_gain = 0.0;
  double torque_lag_s = 0.0;
  double coulomb_load_Nm_N = 0.0;
  double friction_asymmetry_Nm = 0.0;
  double quadratic_drag_Nm_s2_rad2 = 0.0;
  double cogging_Nm = 0.0;
  double inertia_error = 0.0;
  double ratio_error = 0.0;
  double presliding_rad = 0.0;
  double friction_drift = 0.0;
  double stiffness_hysteresis = 0.0;
  double pad_damping_N_s_rad = 0.0;
  double pad_relaxation = 0.0;
  double backlash_rad = 0.0;
  double stiffness_shape_N_rad4 = 0.0;
  double force_offset_N = 0.0;
  double force_lag_s = 0.0;
  double force_saturation_N = 0.0;
  double force_hum_N = 0.0;
  double velocity_lag_s = 0.0;
  double channel_skew = 0.0;
  double outliers = 0.0;
};

// What the one VALUE of an effect leaves open.
inline constexpr double kCoggingOrder = 6.0;          ///< periods per motor revolution
inline constexpr double kHysteresisTravel_rad = 0.5;  ///< travel that turns the hysteresis round (e-fold)
inline constexpr double kRelaxationTime_s = 0.15;     ///< how fast a relaxing pad gives way
inline constexpr double kHumFrequency_Hz = 50.0;
inline constexpr double kOutlierForce_N = 2000.0;  ///< height of a spike; its sign is random
inline constexpr double kMaxSkew_samples = 16.0;

struct EffectInfo {
  std::string_view name;  ///< as in `clampctl simulate --effect NAME=VALUE`
  std::string_view unit;
  std::string_view meaning;  ///< of VALUE
  double Effects::*member;
  double lower;  ///< VALUE must lie within
  double upper;
};

/// THE table of the simulated brake's effects.
inline constexpr std::array<EffectInfo, 23> kEffectTable{{
    {"torque-offset", "N m", "added to the torque reading", &Effects::torque_offset_Nm, -1.0, 1.0},
    {"torque-gain", "1", "relative error of the torque reading's gain", &Effects::torque_gain, -0.5, 0.5},
    {"torque-lag", "s", "time constant with which the acting torque follows the reading",
     &Effects::torque_lag_s, 0.0, 0.02},
    {"coulomb-load", "N m/N", "growth of the Coulomb friction with the clamp force",
     &Effects::coulomb_load_Nm_N, -1e-5, 1e-4},
    {"friction-asymmetry", "N m", "Coulomb friction more when applying, less when releasing",
     &Effects::friction_asymmetry_Nm, -0.04, 0.04},
    {"quadratic-drag", "N m s^2/rad^2", "c of the drag torque c v |v|", &Effects::quadratic_drag_Nm_s2_rad2,
     0.0, 1e-4},
    {"cogging", "N m", "amplitude of the torque that has 6 periods per motor revolution",
     &Effects::cogging_Nm, 0.0, 0.5},
    {"inertia-error", "1", "relative deviation of J from its fixed value", &Effects::inertia_error, -0.5,
     1.0},
    {"ratio-error", "1", "relative deviation of N from its fixed value", &Effects::ratio_error, -0.5, 0.5},
    {"presliding", "rad", "bristle deflection at which static friction breaks away", &Effects::presliding_rad,
     0.0, 1.0},
    {"friction-drift", "1", "relative change of TC and Tv from each run to the next",
     &Effects::friction_drift, -0.2, 0.2},
    {"stiffness-hysteresis", "1", "share of the force that is missing on release",
     &Effects::stiffness_hysteresis, 0.0, 0.5},
    {"pad-damping", "N s/rad", "force per velocity of the pads in contact", &Effects::pad_damping_N_s_rad,
     0.0, 50.0},
    {"pad-relaxation", "1", "share of the force that relaxes, with 0.15 s", &Effects::pad_relaxation, 0.0,
     0.5},
    {"backlash", "rad", "lost motion at each reversal", &Effects::backlash_rad, 0.0, 5.0},
    {"stiffness-shape", "N/rad^4", "k of an additional force k x^4", &Effects::stiffness_shape_N_rad4, -5e-3,
     2e-2},
    {"force-offset", "N", "added to the force reading after the tare", &Effects::force_offset_N, -5000.0,
     5000.0},
    {"force-lag", "s", "time constant of the load cell's filter", &Effects::force_lag_s, 0.0, 0.05},
    {"force-saturation", "N", "level at which the force reading clips", &Effects::force_saturation_N, 0.0,
     1e5},
    {"force-hum", "N", "amplitude of 50 Hz on the force reading", &Effects::force_hum_N, 0.0, 5000.0},
    {"velocity-lag", "s", "time constant of the velocity filter", &Effects::velocity_lag_s, 0.0, 0.05},
    {"channel-skew", "samples", "how late the force reading is; fractions of a sample too",
     &Effects::channel_skew, 0.0, kMaxSkew_samples},
    {"outliers", "1", "share of force readings with a spike of 2 kN", &Effects::outliers, 0.0, 0.2},
}};

/// Sets one effect. Errors: an unknown name (the message lists the known ones), a value that is not within
/// the table.
Result<void> set_effect(Effects& effects, std::string_view name, double value);

/// A parameter of an effect, as a model file has it.
struct EffectParameterValue {
  std::string_view name;
  double value;
};

/// Sets an effect to what a model's parameters say of it. The simulated brake has one form of each effect; parameters that mean another
/// form (another order of cogging, say) are refused, with what the simulated brake can do instead.
Result<void> set_effect(Effects& effects, std::string_view name, std::span<const EffectParameterValue> parameters);

/// The same from "NAME=VALUE", as typed by a user.
Result<void> set_effect(Effects& effects, std::string_view assignment);

}  // namespace clampd::sim
