// How large each effect is made, and where it may be hidden at all. `size` is a share of the torque that the
// base model needs.

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/drive_bench/drive_case.hpp"

namespace clampd::drive_bench::detail {
namespace {

constexpr double kTau = 2.0 * std::numbers::pi;

void torque_offset(Case& c, Random& random, double size, Hidden& h) {
  c.rig.torque_offset = h.values["offset"] = 0.7 * size * c.torque_scale * random.sign();
}

void dry_asymmetry(Case& c, Random& random, double size, Hidden& h) {
  c.plant.dry_asymmetry = h.values["asymmetry"] =
      std::min(0.6, 0.7 * size * c.torque_scale / c.plant.coulomb) * random.sign();
}

void viscous_asymmetry(Case& c, Random& random, double, Hidden& h) {
  c.plant.viscous = std::max(c.plant.viscous, random.uniform(0.4, 1.0) * c.torque_scale / c.plant.speed);
  c.plant.viscous_asymmetry = h.values["asymmetry"] = random.uniform(0.3, 0.8) * random.sign();
}

void quadratic_drag(Case& c, Random&, double size, Hidden& h) {
  c.plant.quadratic = h.values["coefficient"] = 3.0 * size * c.torque_scale / (c.plant.speed * c.plant.speed);
}

void power_law(Case& c, double exponent, double level, Hidden& h) {
  c.plant.viscous = 0.0;
  c.plant.coulomb *= 0.3;
  c.plant.power = h.values["at-full-speed"] = level;
  c.plant.power_exponent = h.values["exponent"] = exponent;
}
void power_below_one(Case& c, Random& random, double, Hidden& h) {
  power_law(c, random.uniform(0.25, 0.6), random.uniform(1.0, 2.5) * c.torque_scale, h);
}
void power_above_one(Case& c, Random& random, double, Hidden& h) {
  power_law(c, random.uniform(1.4, 2.6), random.uniform(1.0, 2.5) * c.torque_scale, h);
}

void stribeck(Case& c, Random& random, double forward, double backward, Hidden& h) {
  c.plant.stribeck_forward = h.values["forward"] = forward * c.plant.coulomb;
  c.plant.stribeck_backward = h.values["backward"] = backward * c.plant.coulomb;
  c.plant.stribeck_speed = h.values["speed"] = c.plant.speed * random.uniform(0.05, 0.25);
  c.plant.stribeck_exponent = h.values["exponent"] = random.chance(0.5) ? 1.0 : 2.0;
}
void stribeck_same(Case& c, Random& random, double, Hidden& h) {
  const double level = random.uniform(0.4, 1.5);
  stribeck(c, random, level, level, h);
}
void stribeck_by_direction(Case& c, Random& random, double, Hidden& h) {
  const double forward = random.uniform(0.6, 1.5), backward = forward * random.uniform(0.1, 0.5);
  stribeck(c, random, forward, backward, h);
}

void gravity(Case& c, Random& random, double, Hidden& h) {
  c.plant.gravity = h.values["amplitude"] = random.log_uniform(0.3, 3.0) * c.torque_scale;
  c.plant.gravity_phase = h.values["phase"] = c.plant.linear ? 0.0 : random.phase();
  c.rig.torque_limit += 1.5 * c.plant.gravity;
}

void load_friction(Case& c, Random& random, double, Hidden& h) {
  c.plant.load_friction = h.values["share"] = random.uniform(0.15, 0.5);
  c.rig.torque_limit += 1.5 * c.plant.load_friction * c.plant.gravity;
}

void cogging_of(Case& c, Random& random, double size, int harmonics, Hidden& h) {
  double wave_number =
      random.uniform(6.0, 24.0 / harmonics + 4.0) / travel(c);  // at full speed so many times the pace
  if (!c.plant.linear) wave_number = std::max(1.0, std::round(wave_number));
  h.values["wave-number"] = wave_number;
  for (int i = 1; i <= harmonics; ++i) {
    const double amplitude = 1.2 * size * c.torque_scale * (i == 1 ? 1.0 : random.uniform(0.3, 0.8));
    c.plant.cogging.push_back({wave_number * i, amplitude, random.phase()});
  }
  h.values["amplitude"] = c.plant.cogging.front().amplitude;
}
void cogging_one(Case& c, Random& random, double size, Hidden& h) {
  cogging_of(c, random, size, 1, h);
}
void cogging_several(Case& c, Random& random, double size, Hidden& h) {
  cogging_of(c, random, size, random.integer(2, 3), h);
}

void presliding(Case& c, Random& random, double, Hidden& h) {
  c.plant.bristle_length = h.values["length"] = travel(c) * random.log_uniform(0.02, 0.15);
  c.rig.encoder_step = std::min(c.rig.encoder_step, c.plant.bristle_length / 30.0);
}

void warm_up(Case& c, Random& random, double, Hidden& h) {
  c.plant.warm_up = h.values["share"] = random.uniform(0.4, 1.2);
  c.plant.warm_up_time_s = h.values["time"] = c.motion.duration_s * random.uniform(0.15, 0.6);
}
void between_runs(Case& c, Random& random, double, Hidden& h) {
  const double last = random.uniform(0.35, 0.7);
  for (int run = 0; run < c.runs; ++run)
    c.plant.run_factor.push_back(1.0 - (1.0 - last) * -std::expm1(-1.5 * run / (c.runs - 1.0)) * 1.287);
  h.values["last-run"] = c.plant.run_factor.back();
}

void spring(Case& c, Random& random, double size, Hidden& h) {
  const double reach = travel(c), torque = 2.0 * size * c.torque_scale * (random.chance(0.8) ? 1.0 : -0.5);
  c.plant.centre = random.uniform(-0.5, 0.5) * reach;
  const bool hardening = random.chance(0.3);
  c.plant.spring = h.values["stiffness"] = torque / reach * (hardening ? 0.4 : 1.0);
  if (hardening) c.plant.spring_cubic = h.values["cubic"] = 0.6 * torque / (reach * reach * reach);
  c.rig.torque_limit += 2.0 * std::abs(torque);
}

void friction_over_position(Case& c, Random& random, double, Hidden& h) {
  const double amplitude = random.uniform(0.35, 0.7), periods = random.uniform(0.4, 2.5);
  c.plant.friction_ripple = {kTau * periods / (2.0 * travel(c)), amplitude, random.phase()};
  h.values["amplitude"] = amplitude;
  h.values["wave-number"] = c.plant.friction_ripple.wave_number;
}

void torque_lag(Case& c, Random& random, double, Hidden& h) {
  const double lag_s = random.uniform(0.01, 0.022) / c.motion.frequency_Hz;
  c.plant.torque_lag_s = h.values["lag"] = std::max(lag_s, 2.0 * c.rig.row_s());
  c.rig.bandwidth_rad_s = std::min(c.rig.bandwidth_rad_s, 0.6 / c.plant.torque_lag_s);
}
void channel_skew(Case& c, Random& random, double, Hidden& h) {
  const double late_s = random.uniform(0.015, 0.06) / c.motion.frequency_Hz;
  const int rows = std::max(2, static_cast<int>(std::lround(late_s / c.rig.row_s())));
  c.rig.torque_late_rows = random.chance(0.7) ? rows : -rows;
  h.values["rows"] = c.rig.torque_late_rows;
}

void torque_saturation(Case& c, Random& random, double, Hidden& h) {
  c.plant.torque_scale = 1.6 * c.torque_scale;
  c.plant.saturation = h.values["loss"] = random.uniform(0.15, 0.32);
  c.rig.torque_limit = c.plant.torque_scale;
}

void inertia_over_position(Case& c, Random& random, double, Hidden& h) {
  const double amplitude = random.uniform(0.25, 0.5);
  const double wave_number = c.plant.linear || travel(c) < 1.0
                                 ? kTau * random.uniform(0.4, 1.5) / (2.0 * travel(c))
                                 : static_cast<double>(random.integer(1, 2));
  c.plant.inertia_ripple = {wave_number, amplitude, random.phase()};
  h.values["amplitude"] = amplitude;
  h.values["wave-number"] = wave_number;
}

LoadSignal slow_torque(const Case& c, Random& random, double amplitude) {
  LoadSignal load;
  load.amplitude = amplitude;
  load.slowest_Hz = 0.2 * c.motion.frequency_Hz;
  load.fastest_Hz = 1.7 * c.motion.frequency_Hz;
  load.seed = c.seed + static_cast<std::uint64_t>(random.integer(1, 1'000'000'000));
  return load;
}
void load_column(Case& c, Random& random, double size, Hidden& h) {
  const double amplitude = h.values["amplitude"] = 1.5 * size * c.torque_scale;
  c.plant.measured_load = slow_torque(c, random, amplitude);
  c.rig.torque_limit += 3.0 * amplitude;
}

void resonance(Case& c, Random& random, double, Hidden& h) {
  const double share = random.uniform(0.2, 0.5), w = kTau * c.motion.frequency_Hz * random.uniform(8.0, 20.0);
  c.plant.load_inertia = share * c.plant.inertia;
  c.plant.inertia *= 1.0 - share;
  const double reduced = c.plant.load_inertia * c.plant.inertia / (c.plant.load_inertia + c.plant.inertia);
  c.plant.shaft_stiffness = reduced * w * w;
  c.plant.shaft_damping = 2.0 * 0.05 * reduced * w;
  h.values["frequency"] = w / kTau;
  h.values["load-share"] = share;
}
void sticky_place(Case& c, Random& random, double size, Hidden& h) {
  c.plant.sticky_level = h.values["level"] = 5.0 * size * c.torque_scale;
  c.plant.sticky_place = h.values["place"] = random.uniform(-0.4, 0.4) * travel(c);
  c.plant.sticky_width = h.values["width"] = random.uniform(0.06, 0.15) * travel(c);
  c.rig.torque_limit += 2.0 * c.plant.sticky_level;
}
void random_walk(Case& c, Random& random, double size, Hidden& h) {
  LoadSignal& load = c.plant.hidden_load;
  load.walk_sd = h.values["sd"] = 1.3 * size * c.torque_scale;
  load.walk_memory_s = h.values["memory"] = random.uniform(0.3, 2.0) / c.motion.frequency_Hz;
  load.seed = c.seed + static_cast<std::uint64_t>(random.integer(1, 1'000'000'000));
  c.rig.torque_limit += 3.0 * load.walk_sd;
}
void coupling_torque(Case& c, Random& random, double size, Hidden& h) {
  const double amplitude = h.values["amplitude"] = 1.5 * size * c.torque_scale;
  c.plant.hidden_load = slow_torque(c, random, amplitude);
  c.rig.torque_limit += 3.0 * amplitude;
}
void hysteretic_cable(Case& c, Random& random, double size, Hidden& h) {
  c.plant.cable_level = h.values["level"] = 3.0 * size * c.torque_scale;
  c.plant.cable_length = h.values["length"] = travel(c) * random.uniform(0.25, 0.8);
  c.rig.torque_limit += 2.0 * c.plant.cable_level;
}
void chatter(Case& c, Random& random, double size, Hidden& h) {
  c.plant.chatter_amplitude = h.values["amplitude"] = 3.0 * size * c.torque_scale;
  c.plant.chatter_Hz = h.values["frequency"] = c.motion.frequency_Hz * random.uniform(5.0, 10.0);
  c.plant.chatter_from = c.plant.speed * random.uniform(0.1, 0.3);
  c.plant.chatter_to = c.plant.speed * random.uniform(0.6, 1.2);
  c.rig.torque_limit += 2.0 * c.plant.chatter_amplitude;
}

void end_stop(Case& c, Random& random, double size, Hidden& h) {
  const double torque = 6.0 * size * c.torque_scale, share = random.uniform(0.5, 0.75);
  c.plant.stop_side = random.sign();
  c.plant.stop_place = h.values["place"] = c.plant.stop_side * share * travel(c);
  c.plant.stop_stiffness = h.values["stiffness"] = torque / ((1.0 - share) * travel(c));
  c.plant.stop_damping = random.uniform(0.5, 1.5) / c.plant.speed;
  c.rig.torque_limit += 2.0 * torque;
}
void knocks(Case& c, Random& random, double size, Hidden& h) {
  LoadSignal& load = c.plant.hidden_load;
  load.knock_level = h.values["level"] = 5.0 * size * c.torque_scale;
  load.knock_s = h.values["length"] = random.uniform(0.1, 0.25) / c.motion.frequency_Hz;
  load.knock_pause_s = h.values["pause"] = random.uniform(0.5, 2.0) / c.motion.frequency_Hz;
  load.seed = c.seed + static_cast<std::uint64_t>(random.integer(1, 1'000'000'000));
  c.rig.torque_limit += 2.0 * load.knock_level;
}
/// The larger the effect, the more of the inertia is behind the clutch.
void slip_clutch(Case& c, Random& random, double size, Hidden& h) {
  const double share = 0.55 + 0.4 * size;
  c.plant.load_inertia = share * c.plant.inertia;
  c.plant.clutch_torque = h.values["torque"] =
      random.uniform(0.3, 0.6) * share * std::min(inertial_torque(c), c.torque_scale);
  c.plant.inertia *= 1.0 - share;
  c.plant.clutch_creep = 0.02 * c.plant.speed;
  h.values["load-share"] = share;
}
void payload(Case& c, Random& random, double size, Hidden& h) {
  const double share = std::min(1.5, 2.5 * size * c.torque_scale / inertial_torque(c));
  c.plant.payload_inertia = h.values["inertia"] = share * c.plant.inertia;
  c.plant.payload_period_s = h.values["period"] = random.uniform(1.3, 3.7) / c.motion.frequency_Hz;
  c.plant.payload_share = random.uniform(0.35, 0.65);
  c.plant.payload_start_s = random.uniform() * c.plant.payload_period_s;
  c.rig.torque_limit += 4.0 * share * inertial_torque(c);
}
void field_weakening(Case& c, Random&, double size, Hidden& h) {
  const double loss = 0.4 + 0.4 * size;
  c.plant.base_speed = h.values["base-speed"] = (1.0 - loss) * c.plant.speed;
  c.rig.torque_limit /= 1.0 - loss;
}

}  // namespace

double travel(const Case& c) {
  return amplitude(c.motion);
}

double inertial_torque(const Case& c) {
  return c.plant.inertia * c.motion.speed * kTau * c.motion.frequency_Hz;
}

const std::vector<EffectDraw>& listed_effects() {
  // name, form, needs: position, rotary, gravity's families, both directions, friction, inertia, three runs
  static const std::vector<EffectDraw> kEffects{
      {"torque-offset", "", false, false, false, true, false, false, false, torque_offset},
      {"friction-asymmetry", "dry", false, false, false, true, true, false, false, dry_asymmetry},
      {"friction-asymmetry", "viscous", false, false, false, true, false, false, false, viscous_asymmetry},
      {"quadratic-drag", "", false, false, false, false, false, false, false, quadratic_drag},
      {"friction-power", "below-one", false, false, false, false, true, false, false, power_below_one},
      {"friction-power", "above-one", false, false, false, false, true, false, false, power_above_one},
      {"friction-shape", "same", false, false, false, true, true, false, false, stribeck_same},
      {"friction-shape", "by-direction", false, false, false, true, true, false, false,
       stribeck_by_direction},
      {"gravity", "", true, false, true, true, false, false, false, gravity},
      {"gravity", "again", true, false, true, true, false, false, false, gravity},
      {"cogging", "one", true, false, false, false, false, false, false, cogging_one},
      {"cogging", "several", true, false, false, false, false, false, false, cogging_several},
      {"presliding", "", true, false, false, true, true, false, false, presliding},
      {"friction-drift", "within", false, false, false, false, true, false, false, warm_up},
      {"friction-drift", "between", false, false, false, false, true, false, true, between_runs},
      {"load-position", "", true, false, false, true, false, false, false, spring},
      {"friction-position", "", true, false, false, true, true, false, false, friction_over_position},
      {"torque-lag", "", false, false, false, true, false, true, false, torque_lag},
      {"channel-skew", "", false, false, false, true, false, true, false, channel_skew},
      {"torque-saturation", "", false, false, false, true, false, true, false, torque_saturation},
      {"inertia-position", "", true, false, false, true, false, true, false, inertia_over_position},
      {"column:load", "", false, false, false, false, false, false, false, load_column},
      {"load-friction", "", true, false, true, true, false, false, false,
       load_friction},  // beside gravity only
  };
  return kEffects;
}

const std::vector<EffectDraw>& unlisted_effects(bool development) {
  static const std::vector<EffectDraw> kDevelopment{
      {"resonance", "", false, false, false, true, false, true, false, resonance},
      {"sticky-place", "", true, false, false, true, false, false, false, sticky_place},
      {"random-walk-load", "", false, false, false, false, false, false, false, random_walk},
      {"end-stop", "", true, false, false, true, false, false, false, end_stop},
      {"knocks", "", false, false, false, false, false, false, false, knocks},
      {"slip-clutch", "", false, false, false, true, false, true, false, slip_clutch},
      {"payload", "", false, false, false, true, false, true, false, payload},
      {"field-weakening", "", false, false, false, true, false, true, false, field_weakening},
  };
  static const std::vector<EffectDraw> kHeldOut{
      {"coupling-torque", "", false, false, false, false, false, false, false, coupling_torque},
      {"hysteretic-cable", "", true, false, false, true, false, false, false, hysteretic_cable},
      {"chatter", "", false, false, false, true, false, false, false, chatter},
  };
  return development ? kDevelopment : kHeldOut;
}

}  // namespace clampd::drive_bench::detail
