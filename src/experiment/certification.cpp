#include "clampd/experiment/certification.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
#include <vector>

#include <fmt/format.h>

#include "clampd/brake/simulation.hpp"

namespace clampd {

namespace {

constexpr int kSubsteps = 50;  // 20 us
constexpr double kSubstep_s = kMaxStep_s / kSubsteps;

/// Of the normalised parameters; the first one yields the reported criterion.
struct Difference {
  double step;
  double tolerance;
};
constexpr std::array<Difference, 2> kDifferences = {
    {{1e-6, kCertifiedLogdet}, {1e-5, kCertifiedLogdetWider}}};
constexpr double kReferenceTorqueStep_Nm = 1e-6;

struct Outputs {
  std::vector<double> force_N;
  std::vector<double> velocity_rad_s;
  double force_max_N = 0.0;
  double velocity_max_rad_s = 0.0;
};

/// Small implicit midpoint steps; a step in which the brake comes to rest is taken in two parts of uniform
/// acceleration. Written from (2) to (5) alone, it shares neither code nor method with advance().
Outputs simulate_finely(const BrakeParameters& brake, const BrakeState& initial,
                        std::span<const double> torque_Nm) {
  const double cubic = brake.theta[k1];
  const double quadratic = brake.theta[k2];
  const double coulomb_Nm = brake.theta[TC];
  const double viscous = brake.theta[Tv];
  const double speed_scale = brake.theta[ws];
  const double gain = kSubstep_s / brake.fixed.inertia_kg_m2;
  const auto force_at = [&](double x) { return x < 0.0 ? 0.0 : (cubic * x + quadratic) * x * x; };

  Outputs outputs;
  outputs.force_N.reserve(torque_Nm.size());
  outputs.velocity_rad_s.reserve(torque_Nm.size());
  double x = initial[0];
  double v = initial[1];
  for (std::size_t k = 0; k < torque_Nm.size(); ++k) {
    outputs.force_N.push_back(force_at(x));
    outputs.velocity_rad_s.push_back(v);
    outputs.force_max_N = std::max(outputs.force_max_N, force_at(x));
    outputs.velocity_max_rad_s = std::max(outputs.velocity_max_rad_s, std::abs(v));
    if (k + 1 == torque_Nm.size()) break;
    for (int i = 0; i < kSubsteps; ++i) {
      const double force_N = force_at(x + 0.5 * kSubstep_s * v);
      const double static_Nm = brake.theta[Ts0] + brake.theta[mus] * force_N;
      const double load_Nm = torque_Nm[k] - brake.fixed.ratio_m_rad * force_N;
      const double before = v;
      if (v != 0.0) {
        // Momentum and friction balance at the mean speed of the step; a contraction, since gain is tiny.
        for (int iteration = 0; iteration < 4; ++iteration) {
          const double mean = 0.5 * std::abs(before + v);
          const double ratio = mean / speed_scale;
          const double friction_Nm =
              viscous * mean + coulomb_Nm + (static_Nm - coulomb_Nm) / (1.0 + ratio * ratio);
          v = before + gain * (load_Nm - std::copysign(friction_Nm, before));
        }
      }
      if (before * v > 0.0) {
        x += 0.5 * kSubstep_s * (before + v);
      } else {
        // Comes to rest within the step (or rests already), then stays or breaks away: uniform accelerations.
        const double braking = std::abs(load_Nm - std::copysign(static_Nm, before)) * gain / kSubstep_s;
        const double stop_s = before == 0.0 ? 0.0 : std::min(kSubstep_s, std::abs(before) / braking);
        const double left_s = kSubstep_s - stop_s;
        const double excess_Nm = std::max(0.0, std::abs(load_Nm) - static_Nm);
        v = std::copysign(excess_Nm * gain / kSubstep_s * left_s, load_Nm);
        x += 0.5 * (stop_s * before + left_s * v);
      }
      const double speed = std::abs(v);
      outputs.force_max_N = std::max(outputs.force_max_N, force_at(x));
      outputs.velocity_max_rad_s = std::max(outputs.velocity_max_rad_s, speed);
      if (!(std::abs(x) < kDivergedPosition_rad && speed < kDivergedVelocity_rad_s)) {
        outputs.force_max_N = outputs.velocity_max_rad_s = std::numeric_limits<double>::infinity();
        outputs.force_N.resize(torque_Nm.size(), std::numeric_limits<double>::quiet_NaN());
        outputs.velocity_rad_s.resize(torque_Nm.size(), std::numeric_limits<double>::quiet_NaN());
        return outputs;
      }
    }
  }
  return outputs;
}

ParameterMatrix information_by_differences(const BrakeParameters& brake, const BrakeState& initial,
                                           std::span<const double> torque_Nm, const SensorNoise& noise,
                                           double step) {
  const ParameterVector nominal = nominal_parameters();
  const auto rows = static_cast<Eigen::Index>(torque_Nm.size());
  Eigen::Matrix<double, Eigen::Dynamic, static_cast<int>(kParameterCount)> sensitivity(
      2 * rows, static_cast<Eigen::Index>(kParameterCount));
  for (Eigen::Index i = 0; i < nominal.size(); ++i) {
    BrakeParameters above = brake;
    BrakeParameters below = brake;
    above.theta[i] += step * nominal[i];
    below.theta[i] -= step * nominal[i];
    const Outputs high = simulate_finely(above, initial, torque_Nm);
    const Outputs low = simulate_finely(below, initial, torque_Nm);
    for (Eigen::Index k = 0; k < rows; ++k) {
      const auto at = static_cast<std::size_t>(k);
      sensitivity(2 * k, i) = (high.force_N[at] - low.force_N[at]) / (2.0 * step * noise.force_N);
      sensitivity(2 * k + 1, i) =
          (high.velocity_rad_s[at] - low.velocity_rad_s[at]) / (2.0 * step * noise.velocity_rad_s);
    }
  }
  return sensitivity.transpose() * sensitivity;
}

double largest_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double largest = 0.0;
  for (std::size_t k = 0; k < a.size(); ++k) {
    const double difference = std::abs(a[k] - b[k]);
    if (!(difference <= largest)) largest = difference;  // keeps a NaN
    if (std::isnan(largest)) break;
  }
  return largest;
}

double amplification_by_differences(const BrakeParameters& brake, const BrakeState& initial,
                                    std::span<const double> torque_Nm) {
  std::vector<double> offset(torque_Nm.begin(), torque_Nm.end());
  for (double& torque : offset) torque += kReferenceTorqueStep_Nm;
  const Outputs high = simulate_finely(brake, initial, offset);
  for (double& torque : offset) torque -= 2.0 * kReferenceTorqueStep_Nm;
  const Outputs low = simulate_finely(brake, initial, offset);
  return largest_difference(high.velocity_rad_s, low.velocity_rad_s) / (2.0 * kReferenceTorqueStep_Nm);
}

}  // namespace

Certification certify(const BrakeParameters& brake, const BrakeState& initial,
                      std::span<const double> torque_Nm, const SensorNoise& noise, const DesignLimits& limits,
                      double claimed_logdet) {
  Certification result;
  const Outputs outputs = simulate_finely(brake, initial, torque_Nm);
  result.force_max_N = outputs.force_max_N;
  result.velocity_max_rad_s = outputs.velocity_max_rad_s;
  result.end_velocity_rad_s = outputs.velocity_rad_s.empty() ? 0.0 : outputs.velocity_rad_s.back();
  result.amplification_rad_s_Nm = amplification_by_differences(brake, initial, torque_Nm);
  std::optional<double> wrong_logdet;
  for (const auto& [step, tolerance] : kDifferences) {
    const Criterion criterion =
        criterion_of(information_by_differences(brake, initial, torque_Nm, noise, step));
    if (step == kDifferences.front().step) result.criterion = criterion;
    if (!(std::abs(criterion.logdet - claimed_logdet) <= tolerance)) wrong_logdet = criterion.logdet;
  }
  result.coarse_logdet =
      criterion_of(information_by_differences(brake, initial, torque_Nm, noise, kFragilityStep)).logdet;
  Simulation other(torque_Nm.size());
  simulate(brake, initial, Excitation{.torque_Nm = torque_Nm}, other);
  result.force_difference_N = largest_difference(outputs.force_N, other.force_N);
  result.velocity_difference_rad_s = largest_difference(outputs.velocity_rad_s, other.velocity_rad_s);

  const double torque_max_Nm =
      std::accumulate(torque_Nm.begin(), torque_Nm.end(), 0.0,
                      [](double largest, double torque) { return std::max(largest, std::abs(torque)); });
  if (torque_max_Nm > limits.torque_Nm)
    result.objection = fmt::format("torque reaches {:.4f} N m, limit {}", torque_max_Nm, limits.torque_Nm);
  else if (!(result.force_max_N <= limits.force_N))
    result.objection = fmt::format("force reaches {:.1f} N, limit {}", result.force_max_N, limits.force_N);
  else if (!(result.velocity_max_rad_s <= limits.velocity_rad_s))
    result.objection =
        fmt::format("speed reaches {:.3f} rad/s, limit {}", result.velocity_max_rad_s, limits.velocity_rad_s);
  else if (!(std::abs(result.end_velocity_rad_s) <= limits.end_velocity_rad_s))
    result.objection = fmt::format("speed at the end is {:.3f} rad/s, limit {}",
                                   std::abs(result.end_velocity_rad_s), limits.end_velocity_rad_s);
  else if (!(result.force_difference_N <= kCertifiedForce_N) ||
           !(result.velocity_difference_rad_s <= kCertifiedVelocity_rad_s))
    result.objection = fmt::format("the two integrators differ by {:.2f} N and {:.3f} rad/s",
                                   result.force_difference_N, result.velocity_difference_rad_s);
  else if (wrong_logdet)
    result.objection =
        fmt::format("-log det M is {:.3f} by differences instead of {:.3f}", *wrong_logdet, claimed_logdet);
  else if (!(result.amplification_rad_s_Nm <= limits.amplification_rad_s_Nm))
    result.objection = fmt::format("a torque error moves the velocity by {:.0f} rad/s per N m, limit {:.0f}",
                                   result.amplification_rad_s_Nm, limits.amplification_rad_s_Nm);
  return result;
}

}  // namespace clampd
