#include "tests/support/blind/draw.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"

namespace clampd::blind {
namespace {

constexpr double kPi = std::numbers::pi;

HiddenEffect effect(std::string form, std::vector<std::pair<std::string, double>> values,
                    std::vector<std::string> locations, std::function<void(Physics&)> onto) {
  HiddenEffect hidden;
  hidden.form = std::move(form);
  hidden.values = std::move(values);
  hidden.locations = std::move(locations);
  hidden.onto_physics = std::move(onto);
  return hidden;
}

std::string_view name_of(Channel channel) {
  return channel == Channel::Force ? "force" : channel == Channel::Velocity ? "velocity" : "torque";
}

std::string reading_of(Channel channel) {
  return fmt::format("{}-reading", name_of(channel));
}

// Strengths are log-uniform over ranges that leave from about ten to some thousand nats in a full set.

HiddenEffect torque_offset(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.00035, 0.007);
  return effect("constant", {{"offset_Nm", value}}, {"torque-reading", "torque-balance"},
                [=](Physics& p) { p.torque_offset_Nm = value; });
}
HiddenEffect torque_gain(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.0007, 0.014);
  return effect("constant", {{"gain", value}}, {"torque-reading"},
                [=](Physics& p) { p.torque_gain = value; });
}
HiddenEffect torque_lag(Draw& d) {
  const double value = d.log_uniform(0.03e-3, 0.6e-3);
  return effect("first order", {{"time_constant_s", value}}, {"torque-reading", "torque-balance", "timing"},
                [=](Physics& p) { p.torque_lag_s = value; });
}
HiddenEffect coulomb_load(Draw& d) {
  const double value = d.log_uniform(0.0018, 0.04);
  const double exponent = d.chance(0.6) ? 1.0 : d.uniform(0.8, 1.25);
  return effect(exponent == 1.0 ? "linear" : "power", {{"at_10kN_Nm", value}, {"exponent", exponent}},
                {"torque-balance"}, [=](Physics& p) {
                  p.coulomb_load_Nm = value;
                  p.coulomb_load_exponent = exponent;
                });
}
HiddenEffect friction_asymmetry(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.0003, 0.006);
  const int form = d.integer(0, 2);
  const double viscous = form == 2 ? d.uniform(3.0, 15.0) * value : 0.0;
  const bool at_rest = form != 1;
  static constexpr std::array kForms = {"all dry friction", "Coulomb friction only",
                                        "dry and viscous friction"};
  return effect(kForms[static_cast<std::size_t>(form)], {{"asymmetry_Nm", value}, {"viscous", viscous}},
                {"torque-balance"}, [=](Physics& p) {
                  p.asymmetry_Nm = value;
                  p.asymmetry_viscous = viscous;
                  p.asymmetry_at_rest = at_rest;
                });
}
HiddenEffect quadratic_drag(Draw& d) {
  const double value = d.log_uniform(4e-7, 8e-6);
  return effect("c v |v|", {{"c_Nm_s2", value}}, {"torque-balance"},
                [=](Physics& p) { p.quadratic_drag_Nm_s2 = value; });
}
HiddenEffect cogging(Draw& d) {
  const double amplitude = d.log_uniform(0.003, 0.06);
  // Of the motor: whole orders. Of a gear behind it: any.
  const bool gear = d.chance(0.25);
  const double order = gear ? d.uniform(1.0, 12.0) : d.integer(1, 24);
  const double second = d.chance(0.4) ? d.uniform(0.2, 0.8) : 0.0;
  const double phase = d.uniform(0.0, 2.0 * kPi), second_phase = d.uniform(0.0, 2.0 * kPi);
  return effect(fmt::format("{}{}", gear ? "gear" : "motor", second > 0.0 ? ", two harmonics" : ""),
                {{"amplitude_Nm", amplitude}, {"order", order}, {"phase", phase}, {"second", second}},
                {"torque-balance"}, [=](Physics& p) {
                  p.cogging.amplitude_Nm = amplitude;
                  p.cogging.order = order;
                  p.cogging.phase = phase;
                  p.cogging.second = second;
                  p.cogging.second_phase = second_phase;
                });
}
HiddenEffect inertia_error(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.0007, 0.014);
  return effect("constant", {{"relative", value}}, {"torque-balance"},
                [=](Physics& p) { p.inertia_error = value; });
}
HiddenEffect ratio_error(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.0013, 0.026);
  return effect("constant", {{"relative", value}}, {"torque-balance"},
                [=](Physics& p) { p.ratio_error = value; });
}
HiddenEffect presliding(Draw& d) {
  const double travel = d.log_uniform(0.0001, 0.006);
  const auto law = static_cast<Bristles>(d.integer(0, 2));
  const double damping = d.uniform(0.1, 0.8);
  static constexpr std::array kForms = {"Dahl", "LuGre", "elasto-plastic"};
  return effect(kForms[static_cast<std::size_t>(law)], {{"travel_rad", travel}, {"damping", damping}},
                {"torque-balance"}, [=](Physics& p) {
                  p.presliding.travel_rad = travel;
                  p.presliding.law = law;
                  p.presliding.damping = damping;
                });
}
HiddenEffect friction_drift(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.0015, 0.03);
  const double runs = d.chance(0.5) ? d.uniform(2.0, 10.0) : 0.0;
  return effect(runs > 0.0 ? "warm-up" : "linear", {{"per_run", value}, {"warm_up_runs", runs}},
                {"torque-balance"}, [=](Physics& p) {
                  p.friction_drift.per_run = value;
                  p.friction_drift.warm_up_runs = runs;
                });
}
HiddenEffect stiffness_hysteresis(Draw& d) {
  const double share = d.log_uniform(0.0013, 0.027);
  const auto law = static_cast<Loop>(d.integer(0, 2));
  const double travel = law == Loop::SignLike ? d.log_uniform(0.05, 0.5) : d.log_uniform(0.1, 2.0);
  static constexpr std::array kForms = {"sign-like", "exponential", "Bouc-Wen"};
  return effect(kForms[static_cast<std::size_t>(law)], {{"share", share}, {"travel_rad", travel}},
                {"stiffness"}, [=](Physics& p) {
                  p.hysteresis.share = share;
                  p.hysteresis.law = law;
                  p.hysteresis.travel_rad = travel;
                });
}
HiddenEffect pad_damping(Draw& d) {
  const double value = d.log_uniform(0.06, 1.3);
  const bool grows = d.chance(0.3);
  return effect(grows ? "in proportion to the force" : "linear", {{"damping_N_s", value}}, {"stiffness"},
                [=](Physics& p) {
                  p.pad_damping_N_s = value;
                  p.pad_damping_grows = grows;
                });
}
HiddenEffect pad_relaxation(Draw& d) {
  const double share = d.log_uniform(0.0016, 0.035);
  const double time_s = d.log_uniform(0.03, 1.0);
  return effect("one time constant", {{"share", share}, {"time_constant_s", time_s}}, {"stiffness"},
                [=](Physics& p) {
                  p.relaxation = share;
                  p.relaxation_s = time_s;
                });
}
HiddenEffect backlash(Draw& d) {
  const double value = d.log_uniform(0.012, 0.25);
  return effect("lost motion", {{"gap_rad", value}}, {"stiffness"},
                [=](Physics& p) { p.backlash_rad = value; });
}
HiddenEffect stiffness_shape(Draw& d) {
  static constexpr std::array kPowers = {1, 4, 5};
  static constexpr std::array kFrom_N = {700.0, 600.0, 250.0};
  const auto form = static_cast<std::size_t>(d.integer(0, 2));
  const int power = kPowers[form];
  // The two terms that are there take over most of any.
  const double value = d.sign() * d.log_uniform(kFrom_N[form], 10.0 * kFrom_N[form]);
  return effect(fmt::format("x^{}", power), {{"at_30rad_N", value}}, {"stiffness"}, [=](Physics& p) {
    p.shape_N = value;
    p.shape_power = power;
  });
}
HiddenEffect force_offset(Draw& d) {
  const double value = d.sign() * d.log_uniform(3.0, 60.0);
  return effect("constant", {{"offset_N", value}}, {"force-reading"},
                [=](Physics& p) { p.force_offset_N = value; });
}
HiddenEffect force_lag(Draw& d) {
  const double value = d.log_uniform(0.06e-3, 1.3e-3);
  return effect("first order", {{"time_constant_s", value}}, {"force-reading", "timing"},
                [=](Physics& p) { p.force_lag_s = value; });
}
HiddenEffect force_saturation(Draw& d) {
  const double value = 23.2e3 * (1.0 - d.log_uniform(0.003, 0.4));
  const bool before = d.chance(0.5);
  return effect(before ? "before the noise" : "behind the noise", {{"level_N", value}}, {"force-reading"},
                [=](Physics& p) {
                  p.force_saturation_N = value;
                  p.saturation_before_noise = before;
                });
}
HiddenEffect force_hum(Draw& d) {
  const double amplitude = d.log_uniform(4.0, 100.0);
  const double frequency = d.chance(0.5) ? 50.0 : 60.0;
  return effect("mains", {{"amplitude_N", amplitude}, {"frequency_Hz", frequency}}, {"force-reading"},
                [=](Physics& p) {
                  p.hum_N = amplitude;
                  p.hum_Hz = frequency;
                });
}
HiddenEffect velocity_lag(Draw& d) {
  const double value = d.log_uniform(0.04e-3, 0.8e-3);
  return effect("first order", {{"time_constant_s", value}}, {"velocity-reading", "timing"},
                [=](Physics& p) { p.velocity_lag_s = value; });
}
HiddenEffect channel_skew(Draw& d) {
  const auto channel = static_cast<Channel>(d.integer(0, 2));
  const double samples = d.log_uniform(0.03, 5.0);
  return effect(fmt::format("{} late", name_of(channel)), {{"samples", samples}},
                {"timing", reading_of(channel)}, [=](Physics& p) {
                  p.skewed = channel;
                  p.skew_samples = samples;
                });
}
HiddenEffect outliers(Draw& d) {
  const Channel channel = d.chance(0.5) ? Channel::Force : Channel::Velocity;
  const double share = d.log_uniform(2e-4, 0.01);
  const double height = channel == Channel::Force ? d.log_uniform(300.0, 3000.0) : d.log_uniform(5.0, 50.0);
  const double spread = d.chance(0.5) ? 0.0 : 0.4;
  const int sign = d.integer(-1, 1);
  return effect(fmt::format("{}, {}", name_of(channel), sign == 0 ? "both signs" : "one sign"),
                {{"share", share}, {"height", height}, {"spread", spread}}, {reading_of(channel)},
                [=](Physics& p) {
                  p.outliers.channel = channel;
                  p.outliers.share = share;
                  p.outliers.height = height;
                  p.outliers.spread = spread;
                  p.outliers.sign = sign;
                });
}

HiddenEffect second_resonance(Draw& d) {
  const double share = d.log_uniform(0.03, 0.5);
  const double frequency = d.log_uniform(40.0, 200.0);
  const double damping = d.uniform(0.02, 0.15);
  return effect("two masses", {{"inertia_share", share}, {"frequency_Hz", frequency}, {"damping", damping}},
                {"torque-balance", "stiffness"}, [=](Physics& p) {
                  p.second_mass.share = share;
                  p.second_mass.frequency_Hz = frequency;
                  p.second_mass.damping = damping;
                });
}
HiddenEffect torque_saturation(Draw& d) {
  const bool soft = d.chance(0.5);
  const double limit = soft ? d.log_uniform(4.0, 25.0) : d.uniform(1.2, 2.1);
  return effect(soft ? "soft" : "hard", {{"limit_Nm", limit}}, {"torque-reading", "torque-balance"},
                [=](Physics& p) {
                  p.torque_limit_Nm = limit;
                  p.torque_limit_soft = soft;
                });
}
HiddenEffect sampling_jitter(Draw& d) {
  const double sd = d.log_uniform(0.02e-3, 0.4e-3);
  return effect("all sensors", {{"sd_s", sd}}, {"timing", "force-reading", "velocity-reading"},
                [=](Physics& p) { p.jitter_s = sd; });
}
HiddenEffect quantisation(Draw& d) {
  const Channel channel = d.chance(0.5) ? Channel::Force : Channel::Velocity;
  const double quantum = channel == Channel::Force ? d.log_uniform(40.0, 400.0) : d.log_uniform(0.5, 6.0);
  return effect(std::string(name_of(channel)), {{"quantum", quantum}}, {reading_of(channel)},
                [=](Physics& p) {
                  p.quantised = channel;
                  p.quantum = quantum;
                });
}
HiddenEffect root_friction(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.03, 0.4);
  const bool cube = d.chance(0.5);
  return effect(cube ? "cube root" : "square root", {{"at_100rad_s_Nm", value}}, {"torque-balance"},
                [=](Physics& p) {
                  p.root_friction_Nm = value;
                  p.root_exponent = cube ? 1.0 / 3.0 : 0.5;
                });
}
HiddenEffect position_viscous(Draw& d) {
  const double value = d.log_uniform(0.03, 0.9);
  const double order = d.log_uniform(0.1, 3.0);
  const double phase = d.uniform(0.0, 2.0 * kPi);
  return effect("wave", {{"relative", value}, {"order", order}, {"phase", phase}}, {"torque-balance"},
                [=](Physics& p) {
                  p.position_viscous = value;
                  p.position_viscous_order = order;
                  p.position_viscous_phase = phase;
                });
}
HiddenEffect warming_stiffness(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.002, 0.05);
  return effect("within each run", {{"per_s", value}}, {"stiffness"},
                [=](Physics& p) { p.stiffness_drift = value; });
}
HiddenEffect dropouts(Draw& d) {
  const Channel channel = d.chance(0.5) ? Channel::Force : Channel::Velocity;
  const double per_s = d.log_uniform(0.1, 3.0);
  const double length = d.log_uniform(2e-3, 15e-3);
  return effect(fmt::format("{} held", name_of(channel)), {{"per_s", per_s}, {"length_s", length}},
                {reading_of(channel), "timing"}, [=](Physics& p) {
                  p.dropouts.channel = channel;
                  p.dropouts.per_s = per_s;
                  p.dropouts.length_s = length;
                });
}
HiddenEffect force_by_velocity(Draw& d) {
  const double value = d.sign() * d.log_uniform(4.0, 100.0);
  const double power = d.chance(0.5) ? 1.0 : 2.0;
  return effect(power == 1.0 ? "linear" : "quadratic", {{"at_100rad_s_N", value}}, {"force-reading"},
                [=](Physics& p) {
                  p.force_by_velocity_N = value;
                  p.force_by_velocity_power = power;
                });
}
HiddenEffect contact_drift(Draw& d) {
  const double value = d.sign() * d.log_uniform(0.03, 0.6);
  return effect("within each run", {{"rad_per_s", value}}, {"stiffness"},
                [=](Physics& p) { p.contact_drift_rad_s = value; });
}
HiddenEffect flipping_friction(Draw& d) {
  const double value = d.log_uniform(0.002, 0.03);
  const double dwell = d.log_uniform(0.05, 0.5);
  return effect("two levels", {{"step_Nm", value}, {"dwell_s", dwell}}, {"torque-balance"}, [=](Physics& p) {
    p.friction_flip.step_Nm = value;
    p.friction_flip.dwell_s = dwell;
  });
}

constexpr std::array kKinds = {
    EffectKind{"torque-offset", true, torque_offset},
    EffectKind{"torque-gain", true, torque_gain},
    EffectKind{"torque-lag", true, torque_lag},
    EffectKind{"coulomb-load", true, coulomb_load},
    EffectKind{"friction-asymmetry", true, friction_asymmetry},
    EffectKind{"quadratic-drag", true, quadratic_drag},
    EffectKind{"cogging", true, cogging},
    EffectKind{"inertia-error", true, inertia_error},
    EffectKind{"ratio-error", true, ratio_error},
    EffectKind{"presliding", true, presliding},
    EffectKind{"friction-drift", true, friction_drift},
    EffectKind{"stiffness-hysteresis", true, stiffness_hysteresis},
    EffectKind{"pad-damping", true, pad_damping},
    EffectKind{"pad-relaxation", true, pad_relaxation},
    EffectKind{"backlash", true, backlash},
    EffectKind{"stiffness-shape", true, stiffness_shape},
    EffectKind{"force-offset", true, force_offset},
    EffectKind{"force-lag", true, force_lag},
    EffectKind{"force-saturation", true, force_saturation},
    EffectKind{"force-hum", true, force_hum},
    EffectKind{"velocity-lag", true, velocity_lag},
    EffectKind{"channel-skew", true, channel_skew},
    EffectKind{"outliers", true, outliers},
    EffectKind{"second-resonance", false, second_resonance},
    EffectKind{"torque-saturation", false, torque_saturation},
    EffectKind{"sampling-jitter", false, sampling_jitter},
    EffectKind{"quantisation", false, quantisation},
    EffectKind{"root-friction", false, root_friction},
    EffectKind{"position-viscous", false, position_viscous},
    EffectKind{"warming-stiffness", false, warming_stiffness},
    EffectKind{"dropouts", false, dropouts},
    EffectKind{"force-by-velocity", false, force_by_velocity},
    EffectKind{"contact-drift", false, contact_drift},
    EffectKind{"flipping-friction", false, flipping_friction},
};

struct StationRange {
  std::string_view name;
  double lower, upper;
  bool either_sign;
  bool logarithmic = true;
};

constexpr std::array kStationRanges = {
    StationRange{"torque-offset", 0.00035, 0.007, true},
    StationRange{"torque-gain", 0.0007, 0.014, true},
    StationRange{"torque-lag", 0.03e-3, 0.6e-3, false},
    StationRange{"coulomb-load", 1.8e-7, 4e-6, false},
    StationRange{"friction-asymmetry", 0.0003, 0.006, true},
    StationRange{"quadratic-drag", 4e-7, 8e-6, false},
    StationRange{"cogging", 0.003, 0.06, false},
    StationRange{"inertia-error", 0.0007, 0.014, true},
    StationRange{"ratio-error", 0.0013, 0.026, true},
    StationRange{"presliding", 0.00005, 0.005, false},
    StationRange{"friction-drift", 0.0015, 0.03, true},
    StationRange{"stiffness-hysteresis", 0.0013, 0.027, false},
    StationRange{"pad-damping", 0.02, 0.8, false},
    StationRange{"pad-relaxation", 0.0016, 0.035, false},
    StationRange{"backlash", 0.012, 0.25, false},
    StationRange{"stiffness-shape", 4e-4, 8e-3, false},
    StationRange{"force-offset", 3.0, 60.0, true},
    StationRange{"force-lag", 0.06e-3, 1.3e-3, false},
    StationRange{"force-saturation", 14e3, 23e3, false, false},
    StationRange{"force-hum", 4.0, 100.0, false},
    StationRange{"velocity-lag", 0.04e-3, 0.8e-3, false},
    StationRange{"channel-skew", 0.03, 5.0, false},
    StationRange{"outliers", 2e-4, 0.01, false},
};

}  // namespace

double Draw::log_uniform(double low, double high) {
  return std::exp(uniform(std::log(low), std::log(high)));
}

std::span<const EffectKind> effect_kinds() {
  return kKinds;
}

HiddenEffect draw_station_effect(std::string_view name, Draw& draw) {
  const auto range = std::find_if(kStationRanges.begin(), kStationRanges.end(),
                                  [&](const StationRange& entry) { return entry.name == name; });
  CLAMPD_ASSERT(range != kStationRanges.end());
  const double size = range->logarithmic ? draw.log_uniform(range->lower, range->upper)
                                         : draw.uniform(range->lower, range->upper);
  const double value = range->either_sign ? draw.sign() * size : size;
  // Locations do not depend on the form, except for a skew or outliers, which are of the force here.
  Draw any(1);
  const auto kind =
      std::find_if(kKinds.begin(), kKinds.end(), [&](const EffectKind& entry) { return entry.name == name; });
  HiddenEffect hidden;
  hidden.form = "station";
  hidden.values = {{"value", value}};
  hidden.locations = name == "channel-skew" ? std::vector<std::string>{"timing", "force-reading"}
                     : name == "outliers"   ? std::vector<std::string>{"force-reading"}
                                            : kind->draw(any).locations;
  hidden.onto_effects = [name = std::string(name), value](sim::Effects& effects) {
    const Result<void> set = sim::set_effect(effects, name, value);
    CLAMPD_ASSERT(set.has_value());
  };
  return hidden;
}

}  // namespace clampd::blind
