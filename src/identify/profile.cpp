#include "clampd/identify/profile.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/assert.hpp"

namespace clampd {

namespace {

constexpr int kStepsToASide = 6;
constexpr double kStep = 0.5;        // standard deviations
constexpr double kDeviance = 3.841;  // 95 % of chi-square with one degree of freedom

/// Where the root of the deviance, nearly straight, passes that of kDeviance between two points.
double crossing(const ProfilePoint& inside, const ProfilePoint& outside) {
  const double low = std::sqrt(inside.deviance);
  const double high = std::sqrt(outside.deviance);
  const double share = std::isfinite(high) ? (std::sqrt(kDeviance) - low) / (high - low) : 1.0;
  return inside.value + share * (outside.value - inside.value);
}

}  // namespace

Profile profile_likelihood(Parameter parameter, Method method, std::span<const Run> runs,
                           const EstimatorOptions& options, const Estimate& estimate) {
  CLAMPD_ASSERT(estimate.converged() && !options.held[parameter]);
  const auto index = static_cast<Eigen::Index>(parameter);
  const ParameterInfo& info = kParameterTable[parameter];
  const double sd = std::sqrt(estimate.covariance_normalised(index, index)) * std::abs(info.nominal);
  EstimatorOptions held = options;
  held.held[parameter] = true;
  held.noise_force_N = estimate.noise_force_N;
  held.noise_velocity_rad_s = estimate.noise_velocity_rad_s;
  held.noise_torque_Nm = estimate.noise_torque_Nm;
  // All points, the estimate's own too, by the same fit: OEM weighs differently when the noise is given.
  const auto fit_at = [&](double value, const ParameterVector& start) {
    held.start.theta = start;
    held.start.theta[index] = value;
    return identify_brake(method, runs, held);
  };
  const Estimate centre = fit_at(estimate.parameters.theta[index], estimate.parameters.theta);
  Profile profile{.parameter = parameter, .points = {}};
  const auto deviance_of = [&](const Estimate& fit) {
    return std::isfinite(fit.log_likelihood)
               ? std::max(0.0, 2.0 * (centre.log_likelihood - fit.log_likelihood))
               : std::numeric_limits<double>::infinity();
  };
  const auto walk = [&](double direction) {
    std::vector<ProfilePoint> points;
    ParameterVector start = estimate.parameters.theta;
    for (int i = 1; i <= kStepsToASide; ++i) {
      const double value = estimate.parameters.theta[index] + direction * kStep * i * sd;
      if (value <= info.lower || value >= info.upper) break;
      const Estimate fit = fit_at(value, start);
      points.push_back({value, deviance_of(fit)});
      if (fit.parameters.theta.allFinite()) start = fit.parameters.theta;
    }
    return points;
  };
  const std::vector<ProfilePoint> below = walk(-1.0);
  const std::vector<ProfilePoint> above = walk(1.0);
  profile.points.assign(below.rbegin(), below.rend());
  const std::size_t middle = profile.points.size();
  profile.points.push_back({estimate.parameters.theta[index], 0.0});
  profile.points.insert(profile.points.end(), above.begin(), above.end());
  for (std::size_t i = middle; i-- > 0;) {
    if (profile.points[i].deviance < kDeviance) continue;
    profile.lower = crossing(profile.points[i + 1], profile.points[i]);
    break;
  }
  for (std::size_t i = middle + 1; i < profile.points.size(); ++i) {
    if (profile.points[i].deviance < kDeviance) continue;
    profile.upper = crossing(profile.points[i - 1], profile.points[i]);
    break;
  }
  return profile;
}

}  // namespace clampd
