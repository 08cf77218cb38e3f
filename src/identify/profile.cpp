#include "clampd/identify/profile.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"
#include "src/identify/joint_fit.hpp"

namespace clampd {

namespace identify {

namespace {

constexpr int kStepsToASide = 6;
constexpr double kStep = 0.5;        // standard deviations
constexpr double kFarthest = 12.0;   // the same
constexpr double kDeviance = 3.841;  // 95 % of chi-square with one degree of freedom

/// Of the unscaled cost: what a converged fit leaves open, several times over.
constexpr double kSameCost = 0.5;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Where the root of the deviance, nearly straight, passes that of kDeviance between two points.
double crossing(const ProfilePoint& inside, const ProfilePoint& outside) {
  const double low = std::sqrt(inside.deviance);
  const double high = std::sqrt(outside.deviance);
  const double share = std::isfinite(high) ? (std::sqrt(kDeviance) - low) / (high - low) : 1.0;
  return inside.value + share * (outside.value - inside.value);
}

/// A minimum of the cost for one value of the parameter.
struct InnerFit {
  double value = 0.0;
  double cost = kInfinity;
  bool settled = false;
  Eigen::VectorXd unknowns;
};

/// The cost around an estimate.
class ProfiledCost {
 public:
  ProfiledCost(Parameter parameter, Method method, std::span<const Run> runs, const EstimatorOptions& options,
               const Estimate& estimate)
      : index_(static_cast<Eigen::Index>(parameter)),
        method_(method),
        estimate_(estimate),
        options_(starting_at(options, estimate)),
        held_options_(holding(options_, parameter)),
        held_(runs, held_options_),
        minimise_(held_, Minimiser::Kinks::LookBeyond) {
    centre_.value = estimate.parameters.theta[index_];
    centre_.unknowns = prepare(held_);
    find_minimum(runs);
  }

  /// Nothing could be evaluated at the estimate.
  bool possible() const { return std::isfinite(lowest_) && reported_over_own_ > 0.0; }
  /// What the fit ends at where the estimate is.
  const InnerFit& centre() const { return centre_; }
  double lowest() const { return lowest_; }
  double deviance(const InnerFit& fit, double lowest) const {
    return std::max(0.0, fit.cost - lowest) / reported_over_own_;
  }

  InnerFit fit_at(double value, const Eigen::VectorXd& start) {
    InnerFit fit{.value = value, .unknowns = start};
    held_options_.start.theta[index_] = value;
    held_.forget();
    const Descent descent = minimise_(held_, fit.unknowns, options_.max_iterations);
    fit.settled = descent.possible && descent.settled;
    if (descent.possible) fit.cost = held_.sum_of_squares();
    return fit;
  }

  /// The others' unknowns a little further on, as far as the cost's curvature tells.
  Eigen::VectorXd first_start(double value) const {
    return centre_.unknowns + (value - centre_.value) * follow_;
  }

 private:
  static EstimatorOptions starting_at(EstimatorOptions options, const Estimate& estimate) {
    options.start.theta = estimate.parameters.theta;
    return options;
  }
  static EstimatorOptions holding(EstimatorOptions options, Parameter parameter) {
    options.held[parameter] = true;
    return options;
  }

  /// R of the fit: the output error method weighs by its residuals, (9), or by the noise that is known.
  Variances weights() const {
    const bool residuals = method_ == Method::OutputError;
    const auto variance = [&](const std::optional<double>& known, double rms, double noise) {
      const double sd = known ? *known : residuals ? rms : noise;
      return sd * sd;
    };
    return {
        variance(options_.noise_force_N, estimate_.force_rms_N, estimate_.noise_force_N),
        variance(options_.noise_velocity_rad_s, estimate_.velocity_rms_rad_s, estimate_.noise_velocity_rad_s),
        residuals ? 0.0 : estimate_.noise_torque_Nm * estimate_.noise_torque_Nm};
  }

  /// Gives a fit the weights and gains at the estimate; back come its unknowns there.
  Eigen::VectorXd prepare(JointFit& fit) const {
    fit.start_from(estimate_.parameters.theta);
    const Eigen::VectorXd unknowns = fit.unknowns_of(estimate_.parameters.theta, estimate_.initial_states);
    const auto weigh = [&] {
      if (method_ == Method::PredictionError)
        return fit.use_innovations(unknowns, weights()) && fit.evaluate(unknowns);
      fit.use_output_errors(weights());
      return fit.evaluate(unknowns);
    };
    if (weigh() && fit.update_weights() > 0.0) weigh();
    return unknowns;
  }

  /// The least cost of all, and how the reported variance compares with the one of the cost's own curvature.
  void find_minimum(std::span<const Run> runs) {
    JointFit free(runs, options_);
    Eigen::VectorXd unknowns = prepare(free);
    Minimiser minimise(free, Minimiser::Kinks::LookBeyond);
    const Descent descent = minimise(free, unknowns, options_.max_iterations);
    if (!descent.possible) return;
    lowest_ = free.sum_of_squares();
    const ParameterMatrix own = cramer_rao(free.joint_normal(options_.held).information);
    reported_over_own_ = estimate_.covariance_normalised(index_, index_) / own(index_, index_);
    // d unknown / d value: logarithms of the parameters, but for k1; the initial states follow at once
    // anyway.
    follow_ = Eigen::VectorXd::Zero(centre_.unknowns.size());
    Eigen::Index next = 0;
    for (Eigen::Index i = 0; i < kTheta; ++i) {
      if (held_options_.held[static_cast<std::size_t>(i)]) continue;
      const double nominal = kParameterTable[static_cast<std::size_t>(i)].nominal;
      const double slope =
          own(i, index_) / own(index_, index_) / kParameterTable[static_cast<std::size_t>(index_)].nominal;
      follow_[next++] =
          i == static_cast<Eigen::Index>(k1) ? slope : slope * nominal / estimate_.parameters.theta[i];
    }
    centre_ = fit_at(centre_.value, centre_.unknowns);
  }

  Eigen::Index index_;
  Method method_;
  const Estimate& estimate_;
  EstimatorOptions options_;
  EstimatorOptions held_options_;  ///< `held_` looks at them: the value held is changed here
  JointFit held_;
  Minimiser minimise_;
  InnerFit centre_;
  Eigen::VectorXd follow_;
  double lowest_ = kInfinity;
  double reported_over_own_ = 0.0;
};

/// From the centre outwards, until the interval is closed or nothing more is to be found on this side.
std::vector<InnerFit> walk(ProfiledCost& cost, const ParameterInfo& info, double direction, double sd) {
  std::vector<InnerFit> fits{cost.centre()};
  double distance = 0.0;
  double step = kStep;
  for (int i = 1; distance < kFarthest; ++i) {
    if (i > kStepsToASide) {
      if (cost.deviance(fits.back(), cost.lowest()) >= kDeviance) break;
      step *= 2.0;
    }
    distance += step;
    const double margin = 1e-3 * std::abs(info.nominal);
    const double wanted = cost.centre().value + direction * distance * sd;
    const double value = std::clamp(wanted, info.lower + margin, info.upper - margin);
    if (direction * (value - fits.back().value) <= 0.0) break;
    const InnerFit& last = fits.back();
    Eigen::VectorXd start = cost.first_start(value);
    if (i > 1) {
      const InnerFit& before = fits[fits.size() - 2];
      const double share = (value - last.value) / (last.value - before.value);
      start = last.unknowns + std::min(share, 2.0) * (last.unknowns - before.unknowns);
    }
    InnerFit fit = cost.fit_at(value, start);
    if (!fit.settled) {
      InnerFit again = cost.fit_at(value, last.unknowns);
      if (again.cost < fit.cost) fit = std::move(again);
    }
    if (!std::isfinite(fit.cost)) fit.unknowns = last.unknowns;
    fits.push_back(std::move(fit));
    if (value != wanted) break;
  }
  return fits;
}

/// The same once more from the outside in, and out again from wherever that found a lower place: a fit that
/// got stuck is begun from both neighbours.
void begin_again_from_neighbours(ProfiledCost& cost, std::vector<InnerFit>& fits) {
  const auto improve = [&](std::size_t at, std::size_t from) {
    InnerFit again = cost.fit_at(fits[at].value, fits[from].unknowns);
    const bool better = again.cost < fits[at].cost;
    if (better) fits[at] = std::move(again);
    return better;
  };
  bool any = false;
  for (std::size_t i = fits.size() - 1; i-- > 1;) any = improve(i, i + 1) || any;
  for (std::size_t i = 2; any && i < fits.size(); ++i) improve(i, i - 1);
}

}  // namespace

}  // namespace identify

Profile profile_likelihood(Parameter parameter, Method method, std::span<const Run> runs,
                           const EstimatorOptions& options, const Estimate& estimate) {
  using namespace identify;
  CLAMPD_ASSERT(estimate.converged() && !options.held[parameter]);
  const auto index = static_cast<Eigen::Index>(parameter);
  const ParameterInfo& info = kParameterTable[parameter];
  const double sd = std::sqrt(estimate.covariance_normalised(index, index)) * std::abs(info.nominal);
  Profile profile{.parameter = parameter, .points = {}, .message = {}};
  ProfiledCost cost(parameter, method, runs, options, estimate);
  if (!cost.possible()) {
    profile.message = "the fit cannot be repeated at the estimate";
    return profile;
  }
  std::vector<InnerFit> below = walk(cost, info, -1.0, sd);
  std::vector<InnerFit> above = walk(cost, info, 1.0, sd);
  for (std::vector<InnerFit>* side : {&below, &above}) begin_again_from_neighbours(cost, *side);
  std::vector<InnerFit> fits(below.rbegin(), below.rend() - 1);
  const std::size_t middle = fits.size();
  fits.insert(fits.end(), above.begin(), above.end());
  double lowest = cost.lowest();
  for (const InnerFit& fit : fits) lowest = std::min(lowest, fit.cost);
  std::size_t stuck = 0;
  for (const InnerFit& fit : fits) {
    profile.points.push_back({fit.value, cost.deviance(fit, lowest), fit.settled});
    stuck += fit.settled ? 0 : 1;
  }
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
  const bool another = lowest < cost.lowest() - kSameCost;
  profile.converged = stuck == 0 && !another;
  if (another)
    profile.message = "elsewhere the runs fit better than at the estimate, which is not the best one";
  else if (stuck > 0)
    profile.message = fmt::format("{} of {} fits did not converge", stuck, fits.size());
  return profile;
}

}  // namespace clampd
