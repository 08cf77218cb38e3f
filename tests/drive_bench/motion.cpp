#include "tests/drive_bench/motion.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace clampd::drive_bench {
namespace {

constexpr double kTau = 2.0 * std::numbers::pi;

double sign(double x) {
  return static_cast<double>((x > 0.0) - (x < 0.0));
}

struct Sine {
  double frequency_Hz, amplitude, phase;  ///< amplitude of the velocity
};

/// Velocity as a sum of sines about a mean; position by integration in closed form, so that it does not
/// wander.
void sum_of_sines(const MotionRequest& r, const std::vector<Sine>& sines, double mean, Motion& motion) {
  for (std::size_t k = 0; k < motion.position.size(); ++k) {
    const double t = static_cast<double>(k) * r.tick_s;
    double q = mean * t, v = mean, a = 0.0;
    for (const Sine& sine : sines) {
      const double w = kTau * sine.frequency_Hz, angle = w * t + sine.phase;
      q -= sine.amplitude / w * (std::cos(angle) - std::cos(sine.phase));
      v += sine.amplitude * std::sin(angle);
      a += sine.amplitude * w * std::cos(angle);
    }
    motion.position[k] = q;
    motion.velocity[k] = v;
    motion.feed_forward[k] = a;
  }
}

std::vector<Sine> draw_sines(const MotionRequest& r, int count, double slowest, double fastest, double speed,
                             Random& random) {
  std::vector<Sine> sines;
  double power = 0.0;
  for (int i = 0; i < count; ++i) {
    sines.push_back(
        {r.frequency_Hz * random.log_uniform(slowest, fastest), random.uniform(0.4, 1.0), random.phase()});
    power += sines.back().amplitude * sines.back().amplitude;
  }
  for (Sine& sine : sines) sine.amplitude *= speed / std::sqrt(1.6 * power);
  return sines;
}

/// A velocity that ramps from value to value; position and acceleration follow.
void from_velocity(const MotionRequest& r, const std::vector<double>& target, double most_acceleration,
                   Motion& motion) {
  double q = 0.0, v = 0.0;
  for (std::size_t k = 0; k < target.size(); ++k) {
    const double change =
        std::clamp(target[k] - v, -most_acceleration * r.tick_s, most_acceleration * r.tick_s);
    motion.position[k] = q;
    motion.velocity[k] = v;
    motion.feed_forward[k] = change / r.tick_s;
    q += (v + 0.5 * change) * r.tick_s;
    v += change;
  }
}

void trapezoids(const MotionRequest& r, Random& random, Motion& motion) {
  const double half_range = amplitude(r), acceleration = r.speed * r.frequency_Hz * random.uniform(4.0, 12.0);
  double t = 0.0, q = 0.0, end_s = 0.0, start_s = 0.0, from = 0.0, way = 0.0, peak = 0.0, ramp_s = 0.0,
         cruise_s = 0.0;
  for (std::size_t k = 0; k < motion.position.size(); ++k, t += r.tick_s) {
    if (t >= end_s) {
      from = q = from + way;
      const double target = half_range * random.uniform(0.3, 1.0) * (from > 0.0 ? -1.0 : 1.0);
      way = target - from;
      peak = std::min(r.speed, std::sqrt(std::abs(way) * acceleration));
      ramp_s = peak / acceleration;
      cruise_s = std::abs(way) / peak - ramp_s;
      start_s = t;
      end_s = t + 2.0 * ramp_s + cruise_s + random.uniform(0.02, 0.25) / r.frequency_Hz;
    }
    const double u = t - start_s, total = 2.0 * ramp_s + cruise_s, s = sign(way);
    double v = 0.0, a = 0.0, x = std::abs(way);
    if (u < ramp_s) {
      a = acceleration, v = acceleration * u, x = 0.5 * acceleration * u * u;
    } else if (u < ramp_s + cruise_s) {
      v = peak, x = 0.5 * peak * ramp_s + peak * (u - ramp_s);
    } else if (u < total) {
      a = -acceleration, v = acceleration * (total - u);
      x -= 0.5 * acceleration * (total - u) * (total - u);
    }
    motion.position[k] = from + s * x;
    motion.velocity[k] = s * v;
    motion.feed_forward[k] = s * a;
  }
}

void steps(const MotionRequest& r, Random& random, Motion& motion) {
  const double half_range = amplitude(r);
  double next_s = 0.0, target = 0.0;
  for (std::size_t k = 0; k < motion.position.size(); ++k) {
    const double t = static_cast<double>(k) * r.tick_s;
    if (t >= next_s) {
      target = half_range * random.uniform(0.3, 1.0) * (target > 0.0 ? -1.0 : 1.0);
      next_s = t + random.uniform(0.4, 0.9) / r.frequency_Hz;
    }
    motion.position[k] = target;
  }
}

void slow_sweep(const MotionRequest& r, Motion& motion) {
  const double range = amplitude(r), acceleration = 8.0 * r.speed * r.frequency_Hz;
  const double duration_s = static_cast<double>(motion.position.size()) * r.tick_s;
  std::vector<double> target(motion.position.size());
  double q = 0.0, way = 1.0;
  for (std::size_t k = 0; k < target.size(); ++k) {
    const double progress = static_cast<double>(k) * r.tick_s / duration_s;
    const double speed = r.speed * std::pow(0.08, 1.0 - progress);
    if (q * way >= range) way = -way;
    target[k] = way * speed;
    q += target[k] * r.tick_s;
  }
  from_velocity(r, target, acceleration, motion);
}

/// Steady speeds for a period each; without `both_ways` all of one sign.
void steady_speeds(const MotionRequest& r, bool both_ways, Random& random, Motion& motion) {
  std::vector<double> target(motion.position.size());
  const double way = random.sign(), hold_s = 0.5 / r.frequency_Hz;
  double speed = 0.0, next_s = 0.0;
  for (std::size_t k = 0; k < target.size(); ++k) {
    const double t = static_cast<double>(k) * r.tick_s;
    if (t >= next_s) {
      const double level = random.log_uniform(0.06, 1.0) * r.speed;
      speed = both_ways ? (speed > 0.0 ? -level : level) : way * level;
      next_s = t + hold_s * random.uniform(0.7, 1.3);
    }
    target[k] = speed;
  }
  from_velocity(r, target, 10.0 * r.speed * r.frequency_Hz, motion);
}

void coasting(const MotionRequest& r, Random& random, Motion& motion) {
  double next_s = 0.0, torque = 0.0, way = random.sign();
  bool pushing = false;
  for (std::size_t k = 0; k < motion.position.size(); ++k) {
    const double t = static_cast<double>(k) * r.tick_s;
    if (t >= next_s) {
      pushing = !pushing;
      if (pushing) way = -way;
      torque = pushing ? way * random.uniform(0.6, 1.4) : 0.0;
      next_s = t + (pushing ? 0.2 : 0.3) * random.uniform(0.8, 1.2) / r.frequency_Hz;
    }
    motion.feed_forward[k] = torque;
  }
}

}  // namespace

std::string_view words(MotionKind kind) {
  switch (kind) {
    case MotionKind::Sinusoid:
      return "a sinusoid";
    case MotionKind::Multisine:
      return "a multisine";
    case MotionKind::Trapezoids:
      return "moves of trapezoidal speed";
    case MotionKind::Steps:
      return "steps of the position reference";
    case MotionKind::SlowSweep:
      return "sweeps there and back, slow to fast";
    case MotionKind::SteadySpeeds:
      return "steady speeds of both directions";
    case MotionKind::RandomMotion:
      return "band-limited noise";
    case MotionKind::OneDirection:
      return "one direction only";
    case MotionKind::Coasting:
      return "torque pulses and coasting";
  }
  return "";
}

double amplitude(const MotionRequest& request) {
  return request.speed / (kTau * request.frequency_Hz);
}

Motion draw_motion(const MotionRequest& r, Random& random) {
  Motion motion;
  motion.kind = r.kind;
  const auto count = static_cast<std::size_t>(std::llround(r.duration_s / r.tick_s));
  motion.position.assign(count, 0.0);
  motion.velocity.assign(count, 0.0);
  motion.feed_forward.assign(count, 0.0);
  switch (r.kind) {
    case MotionKind::Sinusoid:
      sum_of_sines(r, {{r.frequency_Hz * random.uniform(0.8, 1.2), r.speed, random.phase()}}, 0.0, motion);
      break;
    case MotionKind::Multisine:
      sum_of_sines(r, draw_sines(r, random.integer(3, 7), 0.3, 2.0, r.speed, random), 0.0, motion);
      break;
    case MotionKind::RandomMotion:
      sum_of_sines(r, draw_sines(r, 25, 0.15, 2.0, r.speed, random), 0.0, motion);
      break;
    case MotionKind::OneDirection:
      motion.mode = ControlMode::Speed;
      if (random.chance(0.5))
        steady_speeds(r, false, random, motion);
      else
        sum_of_sines(r, draw_sines(r, 4, 0.3, 1.5, 0.3 * r.speed, random), random.sign() * 0.6 * r.speed,
                     motion);
      break;
    case MotionKind::Trapezoids:
      trapezoids(r, random, motion);
      break;
    case MotionKind::Steps:
      steps(r, random, motion);
      break;
    case MotionKind::SlowSweep:
      slow_sweep(r, motion);
      break;
    case MotionKind::SteadySpeeds:
      motion.mode = ControlMode::Speed;
      steady_speeds(r, true, random, motion);
      break;
    case MotionKind::Coasting:
      motion.mode = ControlMode::Torque;
      coasting(r, random, motion);
      break;
  }
  const auto moving = static_cast<std::size_t>(static_cast<double>(count) * (1.0 - r.standing));
  for (std::size_t k = moving; k < count; ++k) {
    motion.position[k] = motion.position[moving > 0 ? moving - 1 : 0];
    motion.velocity[k] = motion.feed_forward[k] = 0.0;
  }
  return motion;
}

}  // namespace clampd::drive_bench
