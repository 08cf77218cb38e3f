#include "tests/support/blind/hidden_plant.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace clampd::blind {
namespace {

constexpr double kStep_s = 1e-5;
constexpr int kStepsPerRow = 100;
constexpr double kRow_s = kStep_s * kStepsPerRow;
constexpr double kPi = std::numbers::pi;

// Before a run the brake comes from here and rests at contact; nothing of it is recorded.
constexpr double kOpen_rad = 1.5;
constexpr int kApproachRows = 120;
constexpr int kRestRows = 30;
constexpr std::size_t kPreparation = kApproachRows + kRestRows;
constexpr double kTorqueLimit_Nm = 3.0;
constexpr double kEncoder_rad = 1e-3;

double relaxation_factor(double time_constant_s) {
  return time_constant_s > 0.0 ? -std::expm1(-kStep_s / time_constant_s) : 1.0;
}

/// What the controller wants of this brake at each row, its own stiffness known.
struct Plan {
  std::vector<double> position_rad, velocity_rad_s, acceleration, force_N;
};

double base_force_N(const ParameterVector& theta, double x) {
  return x > 0.0 ? (theta[k1] * x + theta[k2]) * x * x : 0.0;
}

double position_with_force(const ParameterVector& theta, double force_N) {
  // Where the cubic has its maximum there is no more force to be had.
  double low = 0.0, high = theta[k1] < 0.0 ? std::min(80.0, -2.0 * theta[k2] / (3.0 * theta[k1])) : 80.0;
  for (int i = 0; i < 50; ++i) {
    const double middle = 0.5 * (low + high);
    (base_force_N(theta, middle) < force_N ? low : high) = middle;
  }
  return low;
}

Plan plan_for(const Run& trajectory, const ParameterVector& theta, double start_rad) {
  Plan plan;
  for (int k = 0; k < kApproachRows + kRestRows; ++k) {
    const double s = std::min(1.0, static_cast<double>(k) / kApproachRows);
    plan.position_rad.push_back(-kOpen_rad +
                                (kOpen_rad + start_rad) * s * s * s * (10.0 + s * (-15.0 + 6.0 * s)));
  }
  for (std::size_t k = 0; k < trajectory.size(); ++k) {
    const double wanted = trajectory.position_rad[k] <= 0.0
                              ? trajectory.position_rad[k]
                              : position_with_force(theta, trajectory.force_N[k]);
    plan.position_rad.push_back(wanted + start_rad * std::exp(-0.02 * static_cast<double>(k)));
  }
  const std::size_t size = plan.position_rad.size();
  for (std::size_t k = 0; k < size; ++k) {
    const double before = plan.position_rad[k == 0 ? 0 : k - 1];
    const double now = plan.position_rad[k];
    const double next = plan.position_rad[std::min(k + 1, size - 1)];
    plan.velocity_rad_s.push_back((next - before) / (2.0 * kRow_s));
    plan.acceleration.push_back((next - 2.0 * now + before) / (kRow_s * kRow_s));
    plan.force_N.push_back(base_force_N(theta, now));
  }
  return plan;
}

/// Value of a trace at a fractional index.
double at(const std::vector<double>& trace, double index) {
  if (trace.size() < 2) return trace.front();
  const double clamped = std::clamp(index, 0.0, static_cast<double>(trace.size() - 1));
  const auto whole = std::min(static_cast<std::size_t>(clamped), trace.size() - 2);
  const double part = clamped - static_cast<double>(whole);
  return (1.0 - part) * trace[whole] + part * trace[whole + 1];
}

void quantise(std::vector<double>& values, double quantum) {
  for (double& value : values) value = std::round(value / quantum) * quantum;
}

}  // namespace

HiddenPlant::HiddenPlant(const Physics& physics, std::uint64_t seed)
    : physics_(physics),
      random_(seed),
      inertia_(physics.brake.fixed.inertia_kg_m2 * (1.0 + physics.inertia_error)),
      load_inertia_(inertia_ * physics.second_mass.share),
      ratio_(physics.brake.fixed.ratio_m_rad * (1.0 + physics.ratio_error)) {
  if (load_inertia_ > 0.0) {
    inertia_ -= load_inertia_;
    const double reduced = inertia_ * load_inertia_ / (inertia_ + load_inertia_);
    const double rate = 2.0 * kPi * physics.second_mass.frequency_Hz;
    shaft_Nm_rad_ = reduced * rate * rate;
    shaft_Nm_s_rad_ = 2.0 * physics.second_mass.damping * reduced * rate;
  }
}

double HiddenPlant::uniform(double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random_);
}

void HiddenPlant::reset(double position_rad, int run) {
  motion_ = {position_rad, 0.0, position_rad, 0.0};
  direction_ = 0.0;
  pads_rad_ = position_rad + physics_.backlash_rad;
  hysteresis_ = -1.0;
  relaxed_N_ = bristle_rad_ = 0.0;
  commanded_Nm_ = torque_Nm_ = filtered_force_N_ = filtered_velocity_ = 0.0;
  const double runs = physics_.friction_drift.warm_up_runs;
  warmth_ = 1.0 + physics_.friction_drift.per_run * (runs > 0.0 ? runs * -std::expm1(-run / runs) : run);
}

double HiddenPlant::pads_at(double load_position_rad) const {
  return std::clamp(pads_rad_, load_position_rad, load_position_rad + physics_.backlash_rad);
}

double HiddenPlant::elastic_N(double x) const {
  if (x <= 0.0) return 0.0;
  double force_N = base_force_N(physics_.brake.theta, x);
  if (physics_.shape_N != 0.0) force_N += physics_.shape_N * std::pow(x / 30.0, physics_.shape_power);
  return std::max(0.0, force_N);
}

double HiddenPlant::pad_force_N(const Motion& motion) const {
  const double contact_rad = physics_.contact_drift_rad_s * std::max(0.0, time_s_);
  const double x = pads_at(motion.load_position_rad) - contact_rad;
  if (x <= 0.0) return 0.0;
  const double elastic = elastic_N(x);
  double force_N = elastic;
  if (physics_.hysteresis.share > 0.0) force_N *= 1.0 - 0.5 * physics_.hysteresis.share * (1.0 - hysteresis_);
  if (physics_.relaxation > 0.0) force_N -= physics_.relaxation * relaxed_N_;
  if (physics_.pad_damping_N_s > 0.0)
    force_N += physics_.pad_damping_N_s * (physics_.pad_damping_grows ? elastic / 1e4 : 1.0) *
               motion.load_velocity_rad_s;
  if (physics_.stiffness_drift != 0.0) force_N *= 1.0 + physics_.stiffness_drift * std::max(0.0, time_s_);
  return std::max(0.0, force_N);
}

double HiddenPlant::asymmetry_Nm(double speed_rad_s) const {
  if (physics_.asymmetry_at_rest) return physics_.asymmetry_Nm;
  const double ratio = speed_rad_s / physics_.brake.theta[ws];
  return physics_.asymmetry_Nm * (1.0 - 1.0 / (1.0 + ratio * ratio));
}

double HiddenPlant::dry_friction_Nm(double speed_rad_s, double force_N) const {
  const ParameterVector& theta = physics_.brake.theta;
  double coulomb = theta[TC] * warmth_ + (flipped_ ? physics_.friction_flip.step_Nm : 0.0);
  if (physics_.coulomb_load_Nm != 0.0)
    coulomb += physics_.coulomb_load_Nm * std::pow(force_N / 1e4, physics_.coulomb_load_exponent);
  const double at_rest = theta[Ts0] + theta[mus] * force_N;
  const double ratio = speed_rad_s / theta[ws];
  double friction = coulomb + (at_rest - coulomb) / (1.0 + ratio * ratio);
  if (physics_.root_friction_Nm != 0.0)
    friction += physics_.root_friction_Nm * std::pow(speed_rad_s / 100.0, physics_.root_exponent);
  return std::max(0.0, friction);
}

/// Everything on the motor but friction of Coulomb's kind.
double HiddenPlant::smooth_torque_Nm(const Motion& motion, double force_N) const {
  const double v = motion.velocity_rad_s;
  double torque = torque_Nm_;
  if (load_inertia_ > 0.0)
    torque -= shaft_Nm_rad_ * (motion.position_rad - motion.load_position_rad) +
              shaft_Nm_s_rad_ * (v - motion.load_velocity_rad_s);
  else
    torque -= ratio_ * force_N;
  double viscous = physics_.brake.theta[Tv] * warmth_;
  if (physics_.position_viscous != 0.0)
    viscous *=
        1.0 + physics_.position_viscous * std::sin(physics_.position_viscous_order * motion.position_rad +
                                                   physics_.position_viscous_phase);
  if (physics_.asymmetry_viscous != 0.0) viscous *= 1.0 + std::copysign(physics_.asymmetry_viscous, v);
  torque -= (viscous + physics_.quadratic_drag_Nm_s2 * std::abs(v)) * v;
  if (physics_.cogging.amplitude_Nm != 0.0) {
    const double angle = physics_.cogging.order * motion.position_rad;
    torque -= physics_.cogging.amplitude_Nm *
              (std::sin(angle + physics_.cogging.phase) +
               physics_.cogging.second * std::sin(2.0 * angle + physics_.cogging.second_phase));
  }
  return torque;
}

HiddenPlant::Slope HiddenPlant::slope(const Motion& motion, double direction) const {
  const double force_N = pad_force_N(motion);
  const double speed = std::abs(motion.velocity_rad_s);
  const double friction = std::max(0.0, dry_friction_Nm(speed, force_N) + direction * asymmetry_Nm(speed));
  Slope result;
  result.acceleration = (smooth_torque_Nm(motion, force_N) - direction * friction) / inertia_;
  if (load_inertia_ > 0.0)
    result.load_acceleration =
        (shaft_Nm_rad_ * (motion.position_rad - motion.load_position_rad) +
         shaft_Nm_s_rad_ * (motion.velocity_rad_s - motion.load_velocity_rad_s) - ratio_ * force_N) /
        load_inertia_;
  return result;
}

void HiddenPlant::after_motion(double travel_rad) {
  pads_rad_ = pads_at(motion_.load_position_rad);
  if (physics_.hysteresis.share > 0.0 && travel_rad != 0.0) {
    const double part = travel_rad / physics_.hysteresis.travel_rad;
    const double aim = std::copysign(1.0, travel_rad);
    switch (physics_.hysteresis.law) {
      case Loop::SignLike:
        hysteresis_ = std::clamp(hysteresis_ + 2.0 * part, -1.0, 1.0);
        break;
      case Loop::Exponential:
        hysteresis_ = aim + (hysteresis_ - aim) * std::exp(-std::abs(part));
        break;
      case Loop::BoucWen:
        // Quadratic in the state: z' = x' (1 - sign(x' z) z^2), slower to turn round than to saturate.
        hysteresis_ = std::clamp(hysteresis_ + part * (1.0 - std::copysign(1.0, travel_rad * hysteresis_) *
                                                                 hysteresis_ * hysteresis_),
                                 -1.0, 1.0);
        break;
    }
  }
  if (physics_.relaxation > 0.0)
    relaxed_N_ += (elastic_N(pads_rad_) - relaxed_N_) * relaxation_factor(physics_.relaxation_s);
}

/// Friction by a state of deflection in place of rest: Heun for the motion, the bristles at its mean speed.
void HiddenPlant::step_bristles() {
  const auto& law = physics_.presliding;
  const ParameterVector& theta = physics_.brake.theta;
  const double stiffness = (theta[Ts0] + 1e4 * theta[mus]) / law.travel_rad;
  const double force_N = pad_force_N(motion_);
  double friction = 0.0, deflection = 0.0;
  const auto bristles = [&](double v) {
    const double level = std::max(
        1e-3, dry_friction_Nm(std::abs(v), force_N) + std::copysign(1.0, v) * asymmetry_Nm(std::abs(v)));
    if (law.law == Bristles::Dahl) {
      const double aim = std::copysign(law.travel_rad, v);
      deflection = aim + (bristle_rad_ - aim) * std::exp(-kStep_s * std::abs(v) / law.travel_rad);
      friction = level * 0.5 * (bristle_rad_ + deflection) / law.travel_rad;
      return;
    }
    const double steady = level / stiffness;
    double yield = 1.0;
    if (law.law == Bristles::ElastoPlastic) {
      const double share = std::abs(bristle_rad_) / steady;
      if (v * bristle_rad_ <= 0.0 || share <= 0.6)
        yield = 0.0;
      else if (share < 1.0)
        yield = 0.5 - 0.5 * std::cos(kPi * (share - 0.6) / 0.4);
    }
    const double rate = yield * std::abs(v) / steady;
    const double aim = rate > 0.0 ? v / rate : 0.0;
    deflection =
        rate > 0.0 ? aim + (bristle_rad_ - aim) * std::exp(-rate * kStep_s) : bristle_rad_ + v * kStep_s;
    friction = stiffness * 0.5 * (bristle_rad_ + deflection);
    if (law.law == Bristles::LuGre)
      friction += 2.0 * law.damping * std::sqrt(stiffness * inertia_) * (deflection - bristle_rad_) / kStep_s;
  };
  const auto accelerate = [&](const Motion& motion, double v) {
    bristles(v);
    Slope result = slope(motion, 0.0);
    result.acceleration -= friction / inertia_;
    return result;
  };
  const Motion before = motion_;
  const Slope first = accelerate(before, before.velocity_rad_s);
  Motion guess = before;
  guess.position_rad += kStep_s * before.velocity_rad_s;
  guess.velocity_rad_s += kStep_s * first.acceleration;
  guess.load_position_rad += kStep_s * before.load_velocity_rad_s;
  guess.load_velocity_rad_s += kStep_s * first.load_acceleration;
  if (load_inertia_ == 0.0) {
    guess.load_position_rad = guess.position_rad;
    guess.load_velocity_rad_s = guess.velocity_rad_s;
  }
  const Slope second = accelerate(guess, 0.5 * (before.velocity_rad_s + guess.velocity_rad_s));
  motion_.position_rad += 0.5 * kStep_s * (before.velocity_rad_s + guess.velocity_rad_s);
  motion_.velocity_rad_s += 0.5 * kStep_s * (first.acceleration + second.acceleration);
  motion_.load_position_rad += 0.5 * kStep_s * (before.load_velocity_rad_s + guess.load_velocity_rad_s);
  motion_.load_velocity_rad_s += 0.5 * kStep_s * (first.load_acceleration + second.load_acceleration);
  bristle_rad_ = deflection;
}

void HiddenPlant::step() {
  double delivered_Nm = commanded_Nm_;
  if (const double limit = physics_.torque_limit_Nm; limit > 0.0)
    delivered_Nm = physics_.torque_limit_soft ? limit * std::tanh(commanded_Nm_ / limit)
                                              : std::clamp(commanded_Nm_, -limit, limit);
  torque_Nm_ += (delivered_Nm - torque_Nm_) * relaxation_factor(physics_.torque_lag_s);

  const double before_rad = motion_.load_position_rad;
  if (physics_.presliding.travel_rad > 0.0) {
    step_bristles();
  } else {
    if (direction_ == 0.0) {
      const double force_N = pad_force_N(motion_);
      const double push = smooth_torque_Nm(motion_, force_N);
      const double holds = dry_friction_Nm(0.0, force_N);
      if (push > holds + asymmetry_Nm(0.0))
        direction_ = 1.0;
      else if (-push > holds - asymmetry_Nm(0.0))
        direction_ = -1.0;
    }
    double left_s = kStep_s;
    // Sliding, at most one reversal a step.
    for (int pass = 0; pass < 2 && left_s > 0.0; ++pass) {
      if (direction_ == 0.0 && load_inertia_ == 0.0) break;
      const Motion from = motion_;
      const Slope first =
          direction_ != 0.0 ? slope(from, direction_) : Slope{0.0, slope(from, 0.0).load_acceleration};
      Motion guess = from;
      guess.position_rad += left_s * from.velocity_rad_s;
      guess.velocity_rad_s += left_s * first.acceleration;
      guess.load_position_rad += left_s * from.load_velocity_rad_s;
      guess.load_velocity_rad_s += left_s * first.load_acceleration;
      if (load_inertia_ == 0.0) {
        guess.load_position_rad = guess.position_rad;
        guess.load_velocity_rad_s = guess.velocity_rad_s;
      }
      Slope second = slope(guess, direction_);
      if (direction_ == 0.0) second.acceleration = 0.0;
      const double mean = 0.5 * (first.acceleration + second.acceleration);
      const double next = from.velocity_rad_s + left_s * mean;
      double taken_s = left_s;
      const bool stops = direction_ != 0.0 && direction_ * next < 0.0;
      if (stops) taken_s = std::clamp(-from.velocity_rad_s / mean, 0.0, left_s);
      motion_.position_rad += taken_s * (from.velocity_rad_s + 0.5 * taken_s * mean);
      motion_.velocity_rad_s = stops ? 0.0 : next;
      motion_.load_position_rad +=
          taken_s *
          (from.load_velocity_rad_s + 0.25 * taken_s * (first.load_acceleration + second.load_acceleration));
      motion_.load_velocity_rad_s += 0.5 * taken_s * (first.load_acceleration + second.load_acceleration);
      left_s -= taken_s;
      if (!stops) break;
      const double force_N = pad_force_N(motion_);
      const double push = smooth_torque_Nm(motion_, force_N);
      const double holds = dry_friction_Nm(0.0, force_N);
      direction_ = push > holds + asymmetry_Nm(0.0) ? 1.0 : -push > holds - asymmetry_Nm(0.0) ? -1.0 : 0.0;
    }
  }
  if (load_inertia_ == 0.0) {
    motion_.load_position_rad = motion_.position_rad;
    motion_.load_velocity_rad_s = motion_.velocity_rad_s;
  }
  after_motion(motion_.load_position_rad - before_rad);
  filtered_force_N_ += (pad_force_N(motion_) - filtered_force_N_) * relaxation_factor(physics_.force_lag_s);
  filtered_velocity_ +=
      (motion_.velocity_rad_s - filtered_velocity_) * relaxation_factor(physics_.velocity_lag_s);
  time_s_ += kStep_s;
}

void HiddenPlant::append(Trace& trace) const {
  trace.force_N.push_back(filtered_force_N_);
  trace.velocity_rad_s.push_back(filtered_velocity_);
  trace.position_rad.push_back(motion_.position_rad);
}

/// What the sensors read at a row, but for noise and what comes after it.
HiddenPlant::Sensed HiddenPlant::sensed(const Trace& trace, double row, double jitter_rows) const {
  const auto late = [&](Channel channel) { return physics_.skewed == channel ? physics_.skew_samples : 0.0; };
  const auto index = [&](double late_rows) { return (row + jitter_rows - late_rows) * kStepsPerRow; };
  Sensed reading;
  reading.velocity_rad_s = at(trace.velocity_rad_s, index(late(Channel::Velocity)));
  reading.force_N = at(trace.force_N, index(late(Channel::Force)));
  reading.position_rad = std::round(at(trace.position_rad, index(0.0)) / kEncoder_rad) * kEncoder_rad;
  if (physics_.force_by_velocity_N != 0.0)
    reading.force_N +=
        std::copysign(physics_.force_by_velocity_N, reading.velocity_rad_s * physics_.force_by_velocity_N) *
        std::pow(std::abs(reading.velocity_rad_s) / 100.0, physics_.force_by_velocity_power);
  const double time_s = (row - static_cast<double>(kPreparation)) * kRow_s;
  reading.force_N +=
      physics_.force_offset_N + physics_.hum_N * std::sin(2.0 * kPi * physics_.hum_Hz * time_s + hum_phase_);
  return reading;
}

/// What the plan wants of a row, and the torque that the nominal motion needs.
struct HiddenPlant::Row {
  double position_rad, velocity_rad_s, force_N;
  double feed_forward_Nm;
};

/// What a controller knows of the state: the encoder, and an observer's velocity. Stiff enough to track, slow
/// enough to bear the delay and an elastic shaft.
double HiddenPlant::observer_torque_Nm(const Row& wanted) {
  constexpr double kBandwidth = 110.0, kDamping = 0.8;
  const double stiff = physics_.brake.fixed.inertia_kg_m2 * kBandwidth * kBandwidth;
  const double damp = 2.0 * kDamping * physics_.brake.fixed.inertia_kg_m2 * kBandwidth;
  const double seen_rad = std::round(motion_.position_rad / kEncoder_rad) * kEncoder_rad;
  const double seen_rad_s =
      motion_.velocity_rad_s + 0.25 * physics_.noise.sensors.velocity_rad_s * gaussian();
  return wanted.feed_forward_Nm + stiff * (wanted.position_rad - seen_rad) +
         damp * (wanted.velocity_rad_s - seen_rad_s);
}

/// From the readings of a row (a fraction: of an instant within one), which are noted where they are
/// recorded.
double HiddenPlant::feedback_torque_Nm(const Row& wanted, const Trace& trace, double row) {
  const Feedback& feedback = physics_.feedback;
  const double seen_row = std::max(0.0, row - feedback.delay_rows);
  Sensed seen = sensed(trace, seen_row, 0.0);
  double force_noise_N = physics_.noise.sensors.force_N * gaussian();
  double velocity_noise_rad_s = physics_.noise.sensors.velocity_rad_s * gaussian();
  if (row == std::floor(row)) {
    force_noise_N_.push_back(force_noise_N);
    velocity_noise_rad_s_.push_back(velocity_noise_rad_s);
    force_noise_N = force_noise_N_[static_cast<std::size_t>(seen_row)];
    velocity_noise_rad_s = velocity_noise_rad_s_[static_cast<std::size_t>(seen_row)];
  }
  return wanted.feed_forward_Nm + feedback.position_Nm_rad * (wanted.position_rad - seen.position_rad) +
         feedback.velocity_Nm_s_rad * (wanted.velocity_rad_s - seen.velocity_rad_s - velocity_noise_rad_s) +
         feedback.force_Nm_N * (wanted.force_N - seen.force_N - force_noise_N);
}

/// From a row to the next one; the mean torque.
double HiddenPlant::drive_row(const Row& wanted, std::size_t row, Trace& trace) {
  const int torques = physics_.feedback.is_on() ? physics_.feedback.per_row : 1;
  const int steps = kStepsPerRow / torques;
  double sum_Nm = 0.0;
  for (int t = 0; t < torques; ++t) {
    append(trace);
    const double at_row = static_cast<double>(row) + static_cast<double>(t) / torques;
    const double torque_Nm =
        physics_.feedback.is_on() ? feedback_torque_Nm(wanted, trace, at_row) : observer_torque_Nm(wanted);
    commanded_Nm_ = std::clamp(torque_Nm, -kTorqueLimit_Nm, kTorqueLimit_Nm);
    sum_Nm += commanded_Nm_;
    for (int i = 0; i < steps; ++i) {
      step();
      if (i + 1 < steps) append(trace);
    }
  }
  return sum_Nm / torques;
}

HiddenPlant::Recording HiddenPlant::record(const Run& trajectory, int run) {
  const ParameterVector& theta = physics_.brake.theta;
  const double start_rad = uniform(-0.1, 0.15);
  const Plan plan = plan_for(trajectory, theta, start_rad);
  reset(-kOpen_rad, run);
  force_noise_N_.clear();
  velocity_noise_rad_s_.clear();
  const bool sees_hum = physics_.feedback.is_on();
  if (sees_hum) hum_phase_ = uniform(0.0, 2.0 * kPi);

  Recording recording;
  Trace trace;
  std::vector<double> torque_Nm;
  for (std::size_t k = 0; k < plan.position_rad.size(); ++k) {
    time_s_ = (static_cast<double>(k) - static_cast<double>(kPreparation)) * kRow_s;
    if (physics_.friction_flip.step_Nm != 0.0 && uniform(0.0, 1.0) < kRow_s / physics_.friction_flip.dwell_s)
      flipped_ = !flipped_;
    const std::size_t next = std::min(k + 1, plan.position_rad.size() - 1);
    const double v = 0.5 * (plan.velocity_rad_s[k] + plan.velocity_rad_s[next]);
    const double force_N = 0.5 * (plan.force_N[k] + plan.force_N[next]);
    const double ratio = v / theta[ws];
    const double dry = theta[TC] + (theta[Ts0] + theta[mus] * force_N - theta[TC]) / (1.0 + ratio * ratio);
    const double feed_forward_Nm =
        physics_.brake.fixed.inertia_kg_m2 * 0.5 * (plan.acceleration[k] + plan.acceleration[next]) +
        physics_.brake.fixed.ratio_m_rad * force_N + theta[Tv] * v + dry * std::tanh(v / 0.5);
    const Row wanted{plan.position_rad[k], plan.velocity_rad_s[k], plan.force_N[k], feed_forward_Nm};
    torque_Nm.push_back(drive_row(wanted, k, trace));
    recording.force_max_N = std::max(recording.force_max_N, filtered_force_N_);
    recording.speed_max_rad_s = std::max(recording.speed_max_rad_s, std::abs(motion_.velocity_rad_s));
  }

  // The sensors.
  Run& clean = recording.noise_free;
  Run& noisy = recording.readings;
  const std::size_t size = trajectory.size();
  const double torque_late = physics_.skewed == Channel::Torque ? physics_.skew_samples : 0.0;
  if (!sees_hum) hum_phase_ = uniform(0.0, 2.0 * kPi);
  for (std::size_t k = 0; k < size; ++k) {
    const double row = static_cast<double>(kPreparation + k);
    const double jitter =
        physics_.jitter_s > 0.0 ? std::clamp(physics_.jitter_s * gaussian() / kRow_s, -0.9, 0.9) : 0.0;
    const Sensed reading = sensed(trace, row, jitter);
    clean.time_s.push_back(static_cast<double>(k) * kRow_s);
    clean.torque_Nm.push_back((1.0 + physics_.torque_gain) * at(torque_Nm, row - torque_late) +
                              physics_.torque_offset_Nm);
    clean.velocity_rad_s.push_back(reading.velocity_rad_s);
    clean.force_N.push_back(reading.force_N);
    clean.position_rad.push_back(reading.position_rad);
  }
  if (physics_.outliers.share > 0.0) {
    std::vector<double>& values =
        physics_.outliers.channel == Channel::Force ? clean.force_N : clean.velocity_rad_s;
    for (double& value : values) {
      if (uniform(0.0, 1.0) >= physics_.outliers.share) continue;
      const double sign = physics_.outliers.sign != 0 ? physics_.outliers.sign
                          : uniform(-1.0, 1.0) < 0.0  ? -1.0
                                                      : 1.0;
      value += sign * physics_.outliers.height * std::exp(physics_.outliers.spread * gaussian());
    }
  }
  noisy = clean;
  const double limit_N = physics_.force_saturation_N;
  const auto clip = [&](std::vector<double>& values) {
    for (double& value : values) value = std::clamp(value, -limit_N, limit_N);
  };
  if (limit_N > 0.0) clip(clean.force_N);
  if (limit_N > 0.0 && physics_.saturation_before_noise) clip(noisy.force_N);
  for (std::size_t k = 0; k < size; ++k) {
    noisy.torque_Nm[k] += physics_.noise.torque_Nm * gaussian();
    if (physics_.feedback.is_on()) {
      noisy.velocity_rad_s[k] += velocity_noise_rad_s_[kPreparation + k];
      noisy.force_N[k] += force_noise_N_[kPreparation + k];
      continue;
    }
    noisy.velocity_rad_s[k] += physics_.noise.sensors.velocity_rad_s * gaussian();
    noisy.force_N[k] += physics_.noise.sensors.force_N * gaussian();
  }
  if (limit_N > 0.0 && !physics_.saturation_before_noise) clip(noisy.force_N);
  const auto channel = [](Run& readings, Channel which) -> std::vector<double>& {
    return which == Channel::Force      ? readings.force_N
           : which == Channel::Velocity ? readings.velocity_rad_s
                                        : readings.torque_Nm;
  };
  if (physics_.quantum > 0.0)
    for (Run* readings : {&clean, &noisy}) quantise(channel(*readings, physics_.quantised), physics_.quantum);
  if (physics_.dropouts.per_s > 0.0) {
    std::size_t held = 0;
    for (std::size_t k = 1; k < size; ++k) {
      if (held == 0 && uniform(0.0, 1.0) < physics_.dropouts.per_s * kRow_s)
        held = static_cast<std::size_t>(
            std::max(1.0, std::round(physics_.dropouts.length_s / kRow_s * uniform(0.5, 1.5))));
      if (held == 0) continue;
      --held;
      for (Run* readings : {&clean, &noisy}) {
        std::vector<double>& values = channel(*readings, physics_.dropouts.channel);
        values[k] = values[k - 1];
      }
    }
  }
  return recording;
}

}  // namespace clampd::blind
