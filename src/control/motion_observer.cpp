#include "clampd/control/motion_observer.hpp"

#include <algorithm>
#include <cmath>

namespace clampd {
namespace {

// Variances of what the filter believes. The position's covers an encoder of 1 mrad and its time jitter.
constexpr double kPositionVariance_rad2 = 1e-3 * 1e-3;
constexpr double kVelocityVariance = 1.5 * 1.5;
constexpr double kTorqueVariance_Nm2 = 0.08 * 0.08;          // of what the model misses, per sample
constexpr double kFrictionStepVariance_Nm2 = 0.006 * 0.006;  // drift of the friction excess, per sample
constexpr double kFrictionStartVariance_Nm2 = 0.05 * 0.05;
constexpr double kFrictionLimit_Nm = 0.5;
constexpr double kLongestSubstep_s = 0.25e-3;

/// One scalar update of a Kalman filter, gain * innovation and P - gain * (P's row), where the state's
/// component m is read and a and b are the other two. Of each pair, its entry of the symmetric P.
inline void take_reading(double reading, double variance, double& m, double& a, double& b, double& mm,
                         double& ma, double& mb, double& aa, double& ab, double& bb) noexcept {
  const double total = mm + variance;
  const double gain_m = mm / total, gain_a = ma / total, gain_b = mb / total;
  const double innovation = reading - m;
  m += gain_m * innovation;
  a += gain_a * innovation;
  b += gain_b * innovation;
  aa -= gain_a * ma;
  ab -= gain_a * mb;
  bb -= gain_b * mb;
  mm -= gain_m * mm;
  ma -= gain_m * ma;
  mb -= gain_m * mb;
}

}  // namespace

void MotionObserver::reset(const MotionState& known) noexcept {
  state_ = known;
  covariance_ = {.pp = kPositionVariance_rad2, .vv = 100.0, .ff = kFrictionStartVariance_Nm2};
}

void MotionObserver::correct(double position_rad, double velocity_rad_s) noexcept {
  MotionState x = state_;
  Covariance c = covariance_;
  take_reading(position_rad, kPositionVariance_rad2, x.position_rad, x.velocity_rad_s, x.friction_excess_Nm,
               c.pp, c.pv, c.pf, c.vv, c.vf, c.ff);
  take_reading(velocity_rad_s, kVelocityVariance, x.velocity_rad_s, x.position_rad, x.friction_excess_Nm,
               c.vv, c.pv, c.vf, c.pp, c.pf, c.ff);
  x.friction_excess_Nm = std::clamp(x.friction_excess_Nm, -kFrictionLimit_Nm, kFrictionLimit_Nm);
  state_ = x;
  covariance_ = c;
}

void MotionObserver::predict(const NominalDrive& drive, double torque_Nm, double force_N) noexcept {
  const double period_s = drive.period_s;
  const int substeps = static_cast<int>(period_s / kLongestSubstep_s + 0.5);
  const double step_s = period_s / substeps;
  const double per_inertia = 1.0 / drive.inertia_kg_m2;
  const double push_rad_s = step_s * per_inertia * (torque_Nm - drive.ratio_m_rad * force_N);
  const double drag = 1.0 / (1.0 + step_s * per_inertia * drive.viscous_Nm_s_rad);
  // Friction as what it takes from the velocity in a step.
  DryFriction friction = drive.dry_friction(force_N);
  friction.coulomb_Nm = step_s * per_inertia * (friction.coulomb_Nm + state_.friction_excess_Nm);
  friction.beyond_coulomb_Nm *= step_s * per_inertia;
  const double before_rad_s = state_.velocity_rad_s;
  double velocity_rad_s = before_rad_s, sum_rad_s = 0.5 * before_rad_s;
  for (int i = 0; i < substeps; ++i) {
    const double holds_rad_s = std::max(friction.torque_Nm(velocity_rad_s), 0.0);
    const double free_rad_s = velocity_rad_s + push_rad_s;
    velocity_rad_s = (free_rad_s - std::max(std::min(free_rad_s, holds_rad_s), -holds_rad_s)) * drag;
    sum_rad_s += velocity_rad_s;
  }
  state_.velocity_rad_s = velocity_rad_s;
  state_.position_rad += step_s * (sum_rad_s - 0.5 * velocity_rad_s);
  Covariance c = covariance_;
  // At rest friction balances whatever acts: then neither velocity nor friction excess have an influence.
  const bool slides = velocity_rad_s != 0.0;
  if (!slides && before_rad_s == 0.0) c.pv = c.vv = c.vf = 0.0;
  // By how much 1 N m changes the velocity in a period, and what that is worth of the torque's variance.
  const double gain = period_s * per_inertia, kick = gain * gain * kTorqueVariance_Nm2;
  // T P T' + Q with T = (1 dt x; 0 1 v; 0 0 1), where v and x are what 1 N m of friction does to velocity
  // and position.
  const double v = slides ? std::copysign(gain, -velocity_rad_s) : 0.0;
  const double x = 0.5 * period_s * v;
  const double pv = c.pv + period_s * c.vv + x * c.vf;
  const double pf = c.pf + period_s * c.vf + x * c.ff;
  const double vf = c.vf + v * c.ff;
  c.pp += period_s * (c.pv + pv) + x * (c.pf + pf) + 0.25 * period_s * period_s * kick;
  c.pv = pv + v * pf + 0.5 * period_s * kick;
  c.pf = pf;
  c.vv += v * (c.vf + vf) + kick;
  c.vf = vf;
  if (slides) c.ff = std::min(c.ff + kFrictionStepVariance_Nm2, kFrictionLimit_Nm);
  covariance_ = c;
}

}  // namespace clampd
