#include "tests/drive_bench/drive_case.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fmt/format.h>

namespace clampd::drive_bench {
namespace {

constexpr double kTau = 2.0 * std::numbers::pi;
constexpr std::size_t kMaxRows = 60'000;  ///< of all runs

// Streams of the random numbers of one seed.
constexpr std::uint64_t kDesign = 0, kMotion = 100, kNoise = 200;

const std::vector<MotionKind> kServoMotions{MotionKind::Sinusoid,     MotionKind::Multisine,
                                            MotionKind::Trapezoids,   MotionKind::Steps,
                                            MotionKind::RandomMotion, MotionKind::SteadySpeeds};
const std::vector<MotionKind> kAxisMotions{MotionKind::Trapezoids, MotionKind::Sinusoid,
                                           MotionKind::Multisine, MotionKind::SlowSweep};
const std::vector<MotionKind> kGearMotions{MotionKind::SlowSweep, MotionKind::SteadySpeeds,
                                           MotionKind::Trapezoids, MotionKind::Sinusoid};
const std::vector<MotionKind> kJointMotions{MotionKind::Trapezoids, MotionKind::Multisine,
                                            MotionKind::Sinusoid, MotionKind::RandomMotion};
const std::vector<MotionKind> kSpindleMotions{MotionKind::OneDirection, MotionKind::SteadySpeeds};
const std::vector<MotionKind> kWheelMotions{MotionKind::Coasting, MotionKind::SteadySpeeds};

/// Chooses among effects that this family can have; `effect` narrows it.
const detail::EffectDraw* choose(const std::vector<detail::EffectDraw>& effects, const Case& c,
                                 bool beside_gravity, const std::string& effect, Random& random) {
  std::vector<const detail::EffectDraw*> possible;
  for (const detail::EffectDraw& each : effects) {
    if (each.needs_gravity && !c.family->under_gravity) continue;
    if (each.needs_rotary && c.family->linear) continue;
    if (beside_gravity ? each.name == "gravity" : each.name == "load-friction") continue;
    const std::string whole =
        each.form.empty() ? std::string(each.name) : fmt::format("{}/{}", each.name, each.form);
    if (!effect.empty() && effect != each.name && effect != whole) continue;
    possible.push_back(&each);
  }
  return possible.empty() ? nullptr : random.pick(possible);
}

struct Choice {
  const detail::EffectDraw* first = nullptr;
  const detail::EffectDraw* second = nullptr;

  bool needs(bool detail::EffectDraw::*what) const {
    return (first != nullptr && first->*what) || (second != nullptr && second->*what);
  }
  bool has(std::string_view name) const {
    return (first != nullptr && first->name == name) || (second != nullptr && second->name == name);
  }
};

Choice choose_effects(const Case& c, const std::string& effect, Random& random) {
  Choice choice;
  const auto& listed = detail::listed_effects();
  if (c.kind == Kind::Single) choice.first = choose(listed, c, false, effect, random);
  if (c.kind == Kind::Unlisted)
    choice.first = choose(detail::unlisted_effects(c.family->development), c, false, effect, random);
  if (c.kind == Kind::Pair) {
    const bool gravity = c.family->under_gravity && random.chance(0.7);
    choice.first = choose(listed, c, false, gravity ? "gravity" : "", random);
    for (int attempt = 0; attempt < 50 && choice.second == nullptr; ++attempt) {
      choice.second = choose(listed, c, gravity, effect, random);
      if (choice.second != nullptr && choice.second->name == choice.first->name) choice.second = nullptr;
    }
  }
  return choice;
}

void draw_motion_request(Case& c, const Choice& choice, Random& random) {
  const Family& family = *c.family;
  std::vector<MotionKind> motions = family.motions;
  if (choice.needs(&detail::EffectDraw::needs_both_ways)) std::erase(motions, MotionKind::OneDirection);
  if (c.kind == Kind::BadData && c.spoil != "one-direction") {
    std::erase(motions, MotionKind::OneDirection);
    std::erase(motions, MotionKind::Coasting);
  }
  if (c.spoil == "one-direction") motions = {MotionKind::OneDirection};
  if (choice.needs(&detail::EffectDraw::needs_position)) {  // these come back to the same places
    std::erase(motions, MotionKind::Coasting);
    std::erase(motions, MotionKind::SteadySpeeds);
  }
  if (motions.empty()) motions = {MotionKind::Sinusoid, MotionKind::Trapezoids};
  c.motion.kind = random.pick(motions);
  c.motion.frequency_Hz = random.log_uniform(family.least_pace_Hz, family.most_pace_Hz);
  double reach = random.log_uniform(family.least_speed, family.most_speed);
  if (!family.under_gravity) reach /= kTau * c.motion.frequency_Hz;
  if (!family.linear && choice.needs(&detail::EffectDraw::needs_position) && !family.under_gravity)
    reach = random.log_uniform(0.4, 6.0);
  c.motion.speed = kTau * c.motion.frequency_Hz * reach;
}

/// The logger's rate and the controller's, fast enough for the pace and the band.
void draw_rates(Case& c, Random& random) {
  const double pace = c.motion.frequency_Hz;
  std::vector<double> rates;
  for (const double rate :
       {25.0, 50.0, 100.0, 125.0, 200.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 5000.0, 10000.0})
    if (rate >= std::max(120.0 * pace, 5.0 * c.band_Hz) && rate <= 10000.0 * pace) rates.push_back(rate);
  const double rate = random.pick(rates);
  c.rig.command_delay = random.chance(0.3) ? random.integer(1, 2) : 0;
  const bool one_by_one =
      rate >= 500.0 * pace * (1 + c.rig.command_delay) && (rate >= 1000.0 || random.chance(0.5));
  if (one_by_one) {
    c.rig.ticks_per_row = 1;
    c.rig.torque_column = TorqueColumn::Held;
  } else {
    c.rig.ticks_per_row = std::max(5, static_cast<int>(std::ceil(1500.0 * pace / rate)));
    c.rig.torque_column = random.chance(0.5) ? TorqueColumn::Averaged : TorqueColumn::Sampled;
  }
  c.rig.tick_s = 1.0 / (rate * c.rig.ticks_per_row);
  c.motion.tick_s = c.rig.tick_s;
}

void draw_lengths(Case& c, const Choice& choice, Random& random) {
  const double cycles = random.log_uniform(6.0, 30.0);
  c.motion.duration_s = std::clamp(cycles / c.motion.frequency_Hz, 2.0, 300.0);
  c.runs = random.chance(0.35) ? 1 : random.integer(2, 6);
  const double shortest_s = std::max(2.0, 4.0 / c.motion.frequency_Hz);
  c.runs = std::min(c.runs, std::max(1, static_cast<int>(kMaxRows * c.rig.row_s() / shortest_s)));
  if (choice.needs(&detail::EffectDraw::needs_runs)) c.runs = random.integer(3, 6);
  const double most_s = static_cast<double>(kMaxRows) * c.rig.row_s() / c.runs;
  c.motion.duration_s = std::min(c.motion.duration_s, std::max(most_s, shortest_s));
}

void draw_base(Case& c, const Choice& choice, Random& random) {
  const Family& family = *c.family;
  Plant& plant = c.plant;
  plant.linear = family.linear;
  plant.inertia = random.log_uniform(family.least_inertia, family.most_inertia);
  plant.speed = c.motion.speed;
  const double inertial = detail::inertial_torque(c);
  double ratio = random.log_uniform(family.least_friction, family.most_friction);
  if (choice.needs(&detail::EffectDraw::needs_friction)) ratio = std::max(ratio, random.uniform(0.6, 2.0));
  if (choice.needs(&detail::EffectDraw::needs_inertia)) ratio = std::min(ratio, random.uniform(0.2, 1.0));
  plant.coulomb = ratio * inertial;
  plant.viscous = plant.coulomb / plant.speed * random.log_uniform(0.05, 1.0);
  c.torque_scale = std::hypot(0.7 * inertial, plant.coulomb + 0.5 * plant.viscous * plant.speed);
  c.rig.torque_limit = 4.0 * inertial + 3.0 * (plant.coulomb + plant.viscous * plant.speed);
  c.rig.torque_scale = 1.5 * (inertial + plant.coulomb);
}

/// Encoder and torque reading: whatever they add stays a few per cent of the torque within the band.
void draw_sensors(Case& c, const Choice& choice, Random& random) {
  Rig& rig = c.rig;
  const double inertia = c.plant.inertia, reach = detail::travel(c), row_s = rig.row_s();
  const double w_tick = 0.2 / (rig.tick_s * (1 + rig.command_delay));
  rig.bandwidth_rad_s = std::min(w_tick, kTau * c.motion.frequency_Hz * random.log_uniform(12.0, 40.0));
  const double allowed = 0.015 * c.torque_scale;
  const double position_gain = std::sqrt(2.0 * row_s * std::pow(kTau, 4) * std::pow(c.band_Hz, 5) / 5.0);
  const double velocity_gain = std::sqrt(2.0 * row_s * kTau * kTau * std::pow(c.band_Hz, 3) / 3.0);
  const double into_torque = 5.0 * inertia * rig.bandwidth_rad_s * rig.bandwidth_rad_s;
  rig.encoder_step =
      random.log_uniform(0.03, 1.0) * std::min({allowed * std::sqrt(12.0) / (inertia * position_gain),
                                                reach / 1000.0, 0.1 * c.torque_scale / into_torque});
  rig.velocity_noise =
      random.log_uniform(0.03, 1.0) * std::min({allowed / (inertia * velocity_gain), 0.01 * c.motion.speed,
                                                0.1 * c.torque_scale / (inertia * rig.bandwidth_rad_s)});
  rig.torque_noise = c.torque_scale * random.log_uniform(0.003, 0.04);
  if (rig.torque_column == TorqueColumn::Held && random.chance(0.4))
    rig.torque_noise = 0.0;  // the command itself
  rig.feed_forward = random.chance(0.5);
  rig.inner_loop = random.chance(0.5);
  const bool need_position = choice.needs(&detail::EffectDraw::needs_position) || c.kind == Kind::BadData;
  rig.has_position = need_position || random.chance(0.7);
  rig.has_velocity = !rig.has_position || c.kind == Kind::BadData || random.chance(0.35);
  rig.velocity_column = random.chance(0.5) ? VelocityColumn::Tachometer
                        : rig.has_position && random.chance(0.3) && c.kind != Kind::BadData
                            ? VelocityColumn::BackwardDifference
                            : VelocityColumn::CentralDifference;
}

void hide(Case& c, const detail::EffectDraw* effect, Random& random) {
  if (effect == nullptr) return;
  Hidden hidden{std::string(effect->name), std::string(effect->form == "again" ? "" : effect->form), {}};
  const double size = c.kind == Kind::Unlisted ? random.log_uniform(0.2, 0.7) : random.log_uniform(0.1, 0.6);
  effect->apply(c, random, size, hidden);
  c.hidden.push_back(std::move(hidden));
}

/// What has to be set before the sensors are drawn: rates, motion, drive by which the data are bad.
void prepare_bad_data(Case& c, Random& random) {
  if (c.spoil == "sampling-too-slow") {
    c.motion.frequency_Hz = random.uniform(2.0, 4.0);
    c.motion.kind = random.chance(0.5) ? MotionKind::Multisine : MotionKind::Trapezoids;
  }
  if (c.spoil == "standstill") c.motion.standing = random.uniform(0.9, 0.97);
}
void finish_bad_data(Case& c, Random& random) {
  if (c.spoil == "resolution") {
    c.rig.encoder_step = detail::travel(c) / random.uniform(4.0, 12.0);
    c.rig.velocity_column = VelocityColumn::Tachometer;  // the controller's: the file has the encoder only
    c.rig.has_velocity = false;
  }
  if (c.spoil == "sampling-too-slow") {
    c.rig.has_velocity = random.chance(0.5);
    c.rig.ticks_per_row = static_cast<int>(std::lround(0.1 / c.rig.tick_s));
    c.rig.torque_column = TorqueColumn::Sampled;
    c.motion.duration_s = random.uniform(15.0, 60.0);
  }
}

}  // namespace

const std::vector<Family>& families() {
  static const std::vector<Family> kFamilies{
      // name, development, linear, gravity; inertia; speed (under gravity: amplitude); pace; friction ratio;
      // motions
      {"servo motor", true, false, false, 1e-6, 1e-3, 5, 200, 0.2, 3, 0.05, 2.0, kServoMotions},
      {"belt axis", true, true, false, 1.0, 60, 0.2, 2.5, 0.1, 1, 0.2, 4.0, kAxisMotions},
      {"worm drive", true, false, false, 1e-5, 1e-2, 1, 50, 0.05, 0.5, 2.0, 60, kGearMotions},
      {"pendulum", true, false, true, 1e-3, 1, 0.5, 2.5, 0.1, 1, 0.1, 5.0, kJointMotions},
      {"coasting wheel", true, false, false, 1e-3, 1, 5, 100, 0.01, 0.2, 0.02, 0.5, kWheelMotions},
      {"linear motor", true, true, false, 0.3, 10, 0.1, 1.5, 0.2, 2, 0.05, 1.0, kAxisMotions},
      {"geared servo", false, false, false, 1e-5, 1e-1, 1, 30, 0.1, 2, 0.3, 8.0, kServoMotions},
      {"ball-screw axis", false, true, false, 20, 500, 0.02, 0.5, 0.05, 0.5, 0.5, 10, kAxisMotions},
      {"harmonic-drive joint", false, false, false, 1e-2, 1, 0.3, 4, 0.05, 0.6, 1.0, 30, kGearMotions},
      {"robot joint", false, false, true, 1e-2, 1, 0.4, 2.0, 0.08, 0.7, 0.3, 10, kJointMotions},
      {"spindle", false, false, false, 1e-4, 1e-1, 20, 500, 0.03, 0.3, 0.1, 2.0, kSpindleMotions},
      {"vertical axis", false, true, true, 2, 100, 0.1, 0.6, 0.1, 0.8, 0.2, 5.0, kAxisMotions},
  };
  return kFamilies;
}

std::string_view to_string(Kind kind) {
  switch (kind) {
    case Kind::None:
      return "none";
    case Kind::Single:
      return "single";
    case Kind::Pair:
      return "pair";
    case Kind::Unlisted:
      return "unlisted";
    case Kind::BadData:
      return "bad data";
  }
  return "";
}

Case draw_case(std::uint64_t seed, const std::string& effect) {
  Random random(seed, kDesign);
  Case c;
  c.seed = seed;
  c.family = &random.pick(families());
  const double kind = random.uniform();
  c.kind = kind < 0.22   ? Kind::None
           : kind < 0.58 ? Kind::Single
           : kind < 0.68 ? Kind::Pair
           : kind < 0.80 ? Kind::Unlisted
                         : Kind::BadData;
  if (c.kind == Kind::BadData) {
    c.spoil = random.pick(detail::spoils());
    c.hidden.push_back({c.spoil, "", {}});
  }
  const Choice choice = choose_effects(c, effect, random);
  draw_motion_request(c, choice, random);
  prepare_bad_data(c, random);
  const bool fine = choice.has("cogging") || choice.has("resonance") || choice.has("chatter");
  c.band_Hz = c.motion.frequency_Hz * (fine ? 30.0 : choice.has("presliding") ? 20.0 : 8.0);
  draw_rates(c, random);
  draw_lengths(c, choice, random);
  draw_base(c, choice, random);
  draw_sensors(c, choice, random);
  hide(c, choice.first, random);
  hide(c, choice.second, random);
  finish_bad_data(c, random);
  const double wish = random.log_uniform(0.01, 0.03);
  c.good_enough = c.kind != Kind::BadData && random.chance(0.5) ? wish : 0.0;
  c.in_amperes = random.chance(0.2);
  c.torque_constant = c.in_amperes ? random.log_uniform(0.02, 2.0) : 1.0;
  c.in_counts =
      random.chance(0.2) && c.rig.torque_column != TorqueColumn::Averaged && c.kind != Kind::BadData;
  c.in_rpm = random.chance(0.2) && !c.plant.linear && c.kind != Kind::BadData;
  return c;
}

std::vector<Recording> record_runs(const Case& c) {
  std::vector<Recording> runs;
  for (int run = 0; run < c.runs; ++run) {
    const auto number = static_cast<std::uint64_t>(run);
    Random random(c.seed, kMotion + number);
    const Motion motion = draw_motion(c.motion, random);
    runs.push_back(
        record(c.plant, c.rig, motion, static_cast<std::size_t>(run), Random(c.seed, kNoise + number)));
  }
  return runs;
}

std::string in_words(const Case& c) {
  const char* logger = c.rig.torque_column == TorqueColumn::Held       ? "held torque command or reading"
                       : c.rig.torque_column == TorqueColumn::Averaged ? "averages"
                                                                       : "sampled current";
  return fmt::format(
      "{}: {}, pace {:.3g} Hz, {:.3g} {} either way, {} runs of {:.3g} s at {:g} Hz ({}; {}{}{}), friction "
      "{:.2g} times inertial "
      "torque, torque noise {:.2g} %, encoder {:.2g} of the way, delay {}",
      c.family->name, words(c.motion.kind), c.motion.frequency_Hz, detail::travel(c),
      c.plant.linear ? "m" : "rad", c.runs, c.motion.duration_s, 1.0 / c.rig.row_s(), logger,
      c.rig.has_position ? "position" : "", c.rig.has_position && c.rig.has_velocity ? " and " : "",
      c.rig.has_velocity ? "velocity" : "", c.plant.coulomb / detail::inertial_torque(c),
      100.0 * c.rig.torque_noise / c.torque_scale, c.rig.encoder_step / detail::travel(c),
      c.rig.command_delay);
}

}  // namespace clampd::drive_bench
