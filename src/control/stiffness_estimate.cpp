#include "clampd/control/stiffness_estimate.hpp"

#include <algorithm>
#include <cmath>

namespace clampd {
namespace {

constexpr double kForceVariance_N2 = 75.0 * 75.0;
constexpr double kModelError = 0.01;  // of the force: shapes that the cubic cannot take
constexpr double kDelayStartVariance_s2 = 0.6e-3 * 0.6e-3;
constexpr double kDelayLimit_s = 8e-3;
constexpr double kQuadraticStartVariance = 0.12 * 0.12;
constexpr double kCubicStartVariance = 0.2 * 0.2;
constexpr double kContactStartVariance_rad2 = 0.3 * 0.3;
constexpr double kContactReach_rad = 1.0;  // from where the slow approach found it
// Per sample: keeps the filter awake for what drifts (wear-in, hysteresis, relaxation).
constexpr double kScaleStepVariance = 1e-3 * 1e-3;
constexpr double kContactStepVariance_rad2 = 1e-3 * 1e-3;
constexpr double kReach_sd = 4.0;

}  // namespace

void StiffnessEstimate::start(const NominalDrive& drive, double position_rad, double force_N) noexcept {
  cubic_nominal_ = drive.cubic_N_rad3;
  quadratic_nominal_ = drive.quadratic_N_rad2;
  cubic_ = quadratic_ = 1.0;
  contact_rad_ = position_rad - std::sqrt(std::max(0.0, force_N) / quadratic_nominal_);
  found_rad_ = contact_rad_;
  for (auto& row : covariance_)
    for (double& entry : row) entry = 0.0;
  covariance_[0][0] = kQuadraticStartVariance;
  covariance_[1][1] = kCubicStartVariance;
  covariance_[2][2] = kContactStartVariance_rad2;
  covariance_[3][3] = kDelayStartVariance_s2;
  delay_s_ = 0.0;
}

void StiffnessEstimate::learn(double position_rad, double force_N, double velocity_rad_s) noexcept {
  const double u = position_rad - contact_rad_ - delay_s_ * velocity_rad_s;
  if (u < 0.5) return;  // hardly any force, hardly any information
  const StiffnessCurve known = curve();
  const double slope_N_rad = known.slope_N_rad(u);
  const double slope[4] = {quadratic_nominal_ * u * u, cubic_nominal_ * u * u * u, -slope_N_rad,
                           -slope_N_rad * velocity_rad_s};
  double product[4] = {};
  for (int i = 0; i < 4; ++i) {
    product[i] += covariance_[i][i] * slope[i];
    for (int j = i + 1; j < 4; ++j) {
      product[i] += covariance_[i][j] * slope[j];
      product[j] += covariance_[i][j] * slope[i];
    }
  }
  const double expected_N = known.force_N(u);
  const double model_N = kModelError * expected_N;
  double total = kForceVariance_N2 + model_N * model_N;
  for (int i = 0; i < 4; ++i) total += slope[i] * product[i];
  // A spike shall not move much; but what is wrong for long must be learned, so nothing is refused.
  const double reach_N = kReach_sd * std::sqrt(total);
  const double innovation_N = std::clamp(force_N - expected_N, -reach_N, reach_N);
  const double step = innovation_N / total;
  quadratic_ = std::clamp(quadratic_ + product[0] * step, 0.6, 1.5);
  cubic_ = std::clamp(cubic_ + product[1] * step, 0.4, 1.6);
  delay_s_ = std::clamp(delay_s_ + product[3] * step, -kDelayLimit_s, kDelayLimit_s);
  contact_rad_ = std::clamp(contact_rad_ + product[2] * step, found_rad_ - kContactReach_rad,
                            found_rad_ + kContactReach_rad);
  for (int i = 0; i < 4; ++i) {
    const double gain = product[i] / total;
    for (int j = i; j < 4; ++j) covariance_[i][j] -= gain * product[j];
  }
  covariance_[0][0] = std::min(covariance_[0][0] + kScaleStepVariance, kQuadraticStartVariance);
  covariance_[1][1] = std::min(covariance_[1][1] + kScaleStepVariance, kCubicStartVariance);
  covariance_[2][2] = std::min(covariance_[2][2] + kContactStepVariance_rad2, kContactStartVariance_rad2);
}

}  // namespace clampd
