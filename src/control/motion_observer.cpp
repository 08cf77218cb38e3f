#include "clampd/control/motion_observer.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/clock.hpp"

namespace clampd {
namespace {

// Variances of what the filter believes. The position's covers an encoder of 1 mrad and its time jitter.
constexpr double kPositionVariance_rad2 = 1e-3 * 1e-3;
constexpr double kVelocityVariance = 1.5 * 1.5;
constexpr double kTorqueVariance_Nm2 = 0.08 * 0.08;          // of what the model misses, per sample
constexpr double kFrictionStepVariance_Nm2 = 0.006 * 0.006;  // drift of the friction excess, per sample
constexpr double kFrictionStartVariance_Nm2 = 0.05 * 0.05;
constexpr double kFrictionLimit_Nm = 0.5;
constexpr int kSubsteps = 4;

}  // namespace

void MotionObserver::reset(const MotionState& known) noexcept {
  state_[0] = known.position_rad;
  state_[1] = known.velocity_rad_s;
  state_[2] = known.friction_excess_Nm;
  for (auto& row : covariance_)
    for (double& entry : row) entry = 0.0;
  covariance_[0][0] = kPositionVariance_rad2;
  covariance_[1][1] = 100.0;
  covariance_[2][2] = kFrictionStartVariance_Nm2;
}

void MotionObserver::correct(double position_rad, double velocity_rad_s) noexcept {
  update(0, position_rad, kPositionVariance_rad2);
  update(1, velocity_rad_s, kVelocityVariance);
  state_[2] = std::clamp(state_[2], -kFrictionLimit_Nm, kFrictionLimit_Nm);
}

void MotionObserver::update(int component, double reading, double variance) noexcept {
  const double innovation = reading - state_[component];
  const double total = covariance_[component][component] + variance;
  double gain[3];
  for (int i = 0; i < 3; ++i) gain[i] = covariance_[i][component] / total;
  double row[3];
  for (int j = 0; j < 3; ++j) row[j] = covariance_[component][j];
  for (int i = 0; i < 3; ++i) {
    state_[i] += gain[i] * innovation;
    for (int j = 0; j < 3; ++j) covariance_[i][j] -= gain[i] * row[j];
  }
}

void MotionObserver::predict(const NominalDrive& drive, double torque_Nm, double force_N,
                             int periods) noexcept {
  const double h = kPeriod_s / kSubsteps;
  const double per_inertia = h / drive.inertia_kg_m2;
  const double load_Nm = drive.ratio_m_rad * force_N;
  for (int period = 0; period < periods; ++period) {
    const double before_rad_s = state_[1];
    for (int i = 0; i < kSubsteps; ++i) {
      const double v = state_[1];
      const double level = std::max(0.0, drive.dry_friction_Nm(std::abs(v), force_N) + state_[2]);
      const double free = v + per_inertia * (torque_Nm - load_Nm);
      const double slip = std::copysign(std::max(0.0, std::abs(free) - per_inertia * level), free);
      state_[1] = slip / (1.0 + per_inertia * drive.viscous_Nm_s_rad);
      state_[0] += 0.5 * h * (v + state_[1]);
    }
    // At rest friction balances whatever acts: then neither velocity nor friction excess have an influence.
    const bool slides = state_[1] != 0.0;
    const double direction = slides ? std::copysign(1.0, state_[1]) : 0.0;
    const double keep = slides || before_rad_s != 0.0 ? 1.0 : 0.0;
    const double gain = kPeriod_s / drive.inertia_kg_m2;
    const double transition[3][3] = {{1.0, kPeriod_s * keep, -0.5 * kPeriod_s * gain * direction},
                                     {0.0, keep, -gain * direction},
                                     {0.0, 0.0, 1.0}};
    double product[3][3] = {};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        for (int k = 0; k < 3; ++k) product[i][j] += transition[i][k] * covariance_[k][j];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        covariance_[i][j] = 0.0;
        for (int k = 0; k < 3; ++k) covariance_[i][j] += product[i][k] * transition[j][k];
      }
    const double kick = gain * gain * kTorqueVariance_Nm2;
    covariance_[1][1] += kick;
    covariance_[0][1] += 0.5 * kPeriod_s * kick;
    covariance_[1][0] += 0.5 * kPeriod_s * kick;
    covariance_[0][0] += 0.25 * kPeriod_s * kPeriod_s * kick;
    if (slides)
      covariance_[2][2] = std::min(covariance_[2][2] + kFrictionStepVariance_Nm2, kFrictionLimit_Nm);
  }
}

}  // namespace clampd
