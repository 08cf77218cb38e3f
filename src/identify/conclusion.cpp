#include "src/identify/conclusion.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"
#include "clampd/identify/validation.hpp"
#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/uncertainty.hpp"

namespace clampd {

namespace {

using identify::Held;
using identify::kTheta;
using identify::Uncertainty;

/// A standard deviation of so many times the nominal value: the runs say nothing about the parameter, and the
/// linear covariance itself means nothing any more.
constexpr double kUndetermined = 3.0;

/// With fewer degrees of freedom than the smaller the approximation means nothing, with more than the larger
/// it changes nothing.
constexpr double kFewestDegrees = 4.0;
constexpr double kManyDegrees = 1e6;

/// Chance that the runs' own scores scatter as much as they do by the noise alone: a test of the one covariance
/// against the other by a chi-square of the same expectation and variance (Satterthwaite 1946). 1 for a
/// single run.
double runs_agree_p(const Uncertainty& uncertainty, const Held& held, std::size_t runs) {
  if (!uncertainty.covariance_over_runs.allFinite() || !(uncertainty.scatter_variance > 0.0)) return 1.0;
  ParameterMatrix expected = uncertainty.covariance;
  for (int i = 0; i < kTheta; ++i)
    if (held[static_cast<std::size_t>(i)]) expected(i, i) = 1.0;
  const double statistic =
      static_cast<double>(runs - 1) *
      statistics::SymmetricFactor(expected).solve_columns(uncertainty.covariance_over_runs).trace();
  const double scale = 0.5 * uncertainty.scatter_variance / uncertainty.scatter_expected;
  return statistics::chi_squared_p_value(statistic / scale, uncertainty.scatter_expected / scale);
}

/// Of the standard deviations, where part of their variance is the torque's noise, estimated from the same
/// runs (Welch and Satterthwaite's formula, GUM, annex G.4).
ParameterVector degrees_of_freedom(const Uncertainty& uncertainty, double torque_spread) {
  ParameterVector degrees = ParameterVector::Constant(std::numeric_limits<double>::infinity());
  for (int i = 0; i < kTheta; ++i) {
    const double variance = uncertainty.covariance(i, i);
    const double by_torque = variance - uncertainty.covariance_exact_torque(i, i);
    if (!(by_torque > 0.0 && torque_spread > 0.0)) continue;
    const double share = by_torque / variance;
    degrees[i] = std::clamp(2.0 / (share * share * torque_spread), kFewestDegrees, kManyDegrees);
  }
  return degrees;
}

/// The covariance, its standard deviations as much larger as the torque's noise is uncertain that they rest
/// on: value ± 1.96 of them is then the 95 % interval of Student's t with these degrees of freedom. One run
/// tells the torque's noise badly, and where it seems small by chance, all uncertainties do. The correlations
/// stay.
ParameterMatrix with_uncertain_noise(const Uncertainty& uncertainty, const ParameterVector& degrees) {
  ParameterVector factor = ParameterVector::Ones();
  for (int i = 0; i < kTheta; ++i)
    if (std::isfinite(degrees[i]))
      factor[i] =
          statistics::student_t_upper_quantile(0.025, degrees[i]) / statistics::normal_quantile(0.975);
  return factor.asDiagonal() * uncertainty.covariance * factor.asDiagonal();
}

/// A parameter that the data do not determine, the worst first: no information, its bound reached, or a
/// standard deviation beyond sense.
std::optional<Parameter> undetermined(const Uncertainty& uncertainty, const ParameterVector& theta,
                                      const Held& held) {
  if (const auto parameter = unidentifiable_parameter(uncertainty.information)) {
    if (!held[*parameter]) return parameter;
    // Numerically worthless altogether: the one with the least information of its own.
    std::optional<Parameter> least;
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const auto k = static_cast<Eigen::Index>(i);
      if (!held[i] && (!least || !(uncertainty.information(k, k) >=
                                   uncertainty.information(static_cast<Eigen::Index>(*least),
                                                           static_cast<Eigen::Index>(*least)))))
        least = static_cast<Parameter>(i);
    }
    return least;
  }
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const ParameterInfo& info = kParameterTable[i];
    const double value = theta[static_cast<Eigen::Index>(i)];
    const double margin = 1e-3 * std::abs(value);
    if (!held[i] && (value < info.lower + margin || value > info.upper - margin))
      return static_cast<Parameter>(i);
  }
  // Numerically worthless: where an infinitesimal torque decides whether the brake sticks, sensitivities lose
  // all digits.
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    if (!held[i] && !(uncertainty.covariance(k, k) > 0.0)) return static_cast<Parameter>(i);
  }
  Eigen::Index vaguest = 0;
  if (uncertainty.covariance_exact_torque.diagonal().maxCoeff(&vaguest) > kUndetermined * kUndetermined &&
      !held[static_cast<std::size_t>(vaguest)])
    return static_cast<Parameter>(vaguest);
  return std::nullopt;
}

}  // namespace

Result<void> EstimatorOptions::validate() const {
  if (max_iterations < 1)
    return failure(fmt::format("max_iterations is {}; it must be at least 1", max_iterations));
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const ParameterInfo& info = kParameterTable[i];
    const double value = start.theta[static_cast<Eigen::Index>(i)];
    if (!(value >= info.lower && value <= info.upper))
      return failure(fmt::format("start value {} = {} {} is outside of {} ... {}", info.name, value,
                                 info.unit, info.lower, info.upper));
  }
  if (!(std::isfinite(start.fixed.inertia_kg_m2) && start.fixed.inertia_kg_m2 > 0.0 &&
        std::isfinite(start.fixed.ratio_m_rad) && start.fixed.ratio_m_rad > 0.0))
    return failure("inertia and gear ratio must be positive");
  for (const auto& noise : {noise_force_N, noise_velocity_rad_s})
    if (noise && !(std::isfinite(*noise) && *noise > 0.0))
      return failure(fmt::format("a sensor noise of {} is not possible; it must be positive", *noise));
  if (noise_torque_Nm && !(std::isfinite(*noise_torque_Nm) && *noise_torque_Nm >= 0.0))
    return failure(
        fmt::format("a torque noise of {} is not possible; it must not be negative", *noise_torque_Nm));
  if (std::count(held.begin(), held.end(), false) == 0)
    return failure("every parameter is held: nothing is left to estimate");
  return {};
}

std::string_view to_string(Termination termination) noexcept {
  switch (termination) {
    case Termination::Converged:
      return "converged";
    case Termination::IterationLimit:
      return "iteration limit";
    case Termination::NotIdentifiable:
      return "not identifiable";
    case Termination::NumericalFailure:
      return "numerical failure";
    case Termination::Unexplained:
      return "residual far above the noise";
  }
  return "unknown";
}

namespace identify {

Estimate empty_estimate(const EstimatorOptions& options) {
  Estimate estimate;
  estimate.parameters.fixed = options.start.fixed;
  estimate.parameters.theta.setConstant(kNaN);
  for (ParameterMatrix* matrix :
       {&estimate.covariance_normalised, &estimate.covariance_exact_torque, &estimate.covariance_over_runs})
    matrix->setConstant(kNaN);
  estimate.offset_sensitivity.setConstant(kNaN);
  for (double* value : {&estimate.noise_force_N, &estimate.noise_velocity_rad_s, &estimate.noise_torque_Nm,
                        &estimate.force_rms_N, &estimate.velocity_rms_rad_s, &estimate.log_likelihood})
    *value = kNaN;
  return estimate;
}

Result<void> check_input(std::span<const Run> runs, const EstimatorOptions& options) {
  if (auto valid = options.validate(); !valid) return valid;
  return check_runs(runs);
}

ResidualLevel level_of(std::span<const Run> runs, const Estimate& estimate) {
  if (estimate.method == Method::OutputError)
    return residual_level(runs, {{estimate.force_rms_N, estimate.velocity_rms_rad_s}, 0.0});
  // One-step predictions follow whatever the parameters are: what had to be taken for noise tells.
  return residual_level(runs,
                        {{estimate.noise_force_N, estimate.noise_velocity_rad_s}, estimate.noise_torque_Nm});
}

void withdraw(std::string why, Estimate& estimate) {
  estimate.termination = Termination::Unexplained;
  estimate.message = std::move(why);
  estimate.parameters.theta.setConstant(kNaN);
  for (ParameterMatrix* matrix :
       {&estimate.covariance_normalised, &estimate.covariance_exact_torque, &estimate.covariance_over_runs})
    matrix->setConstant(kNaN);
  estimate.offset_sensitivity.setConstant(kNaN);
  for (EffectEstimate& effect : estimate.effects) effect.value = effect.sd = kNaN;
}

void withdraw_unexplained(std::span<const Run> runs, Estimate& estimate) {
  if (!std::isfinite(estimate.force_rms_N)) return;
  const ResidualLevel level = level_of(runs, estimate);
  if (level.far_above_noise)
    withdraw(fmt::format("the prediction error method does not explain these runs, so that there is no "
                         "result: it takes for "
                         "noise what is none ({})",
                         level.words),
             estimate);
}

void conclude(JointFit& fit, const Eigen::VectorXd& unknowns, const Variances& variances,
              double torque_spread, bool settled, const EstimatorOptions& options, Estimate& estimate) {
  estimate.method = fit.uses_innovations() ? Method::PredictionError : Method::OutputError;
  estimate.parameters.theta = fit.theta_of(unknowns);
  estimate.noise_force_N = std::sqrt(variances.force);
  estimate.noise_velocity_rad_s = std::sqrt(variances.velocity);
  estimate.noise_torque_Nm = std::sqrt(variances.torque);
  const Eigen::Vector2d rms = fit.mean_squares().cwiseSqrt();
  estimate.log_likelihood = fit.log_likelihood();
  estimate.force_rms_N = rms[0];
  estimate.velocity_rms_rad_s = rms[1];
  for (std::size_t r = 0; r < fit.linear_runs().size(); ++r) {
    const Eigen::Vector2d of_run = fit.mean_squares(r).cwiseSqrt();
    estimate.initial_states.push_back(fit.initial_of(unknowns, r));
    estimate.run_force_rms_N.push_back(of_run[0]);
    estimate.run_velocity_rms_rad_s.push_back(of_run[1]);
  }
  const auto end = [&](Termination termination, std::string message) {
    estimate.termination = termination;
    estimate.message = std::move(message);
  };

  // What the data do not determine is set aside, one parameter after the other, until the rest stands.
  Held held = options.held;
  const std::vector<ScoreMoments> moments = score_moments_of(fit);
  Uncertainty uncertainty = uncertainty_of(fit, moments, variances, held);
  std::string unknown;
  while (const auto parameter = undetermined(uncertainty, estimate.parameters.theta, held)) {
    unknown += fmt::format("{}{}", unknown.empty() ? "" : ", ", kParameterTable[*parameter].name);
    held[*parameter] = true;
    if (std::find(held.begin(), held.end(), false) == held.end()) break;
    uncertainty = uncertainty_of(fit, moments, variances, held);
  }
  if (!unknown.empty()) {
    for (int i = 0; i < kTheta; ++i)
      if (held[static_cast<std::size_t>(i)] && !options.held[static_cast<std::size_t>(i)])
        estimate.parameters.theta[i] = kNaN;
    return end(
        Termination::NotIdentifiable,
        fmt::format("not identifiable from these data: {}; excite the brake more, or hold what is known",
                    unknown));
  }
  add_curvature_bias(fit, variances, held, uncertainty);
  const std::size_t runs = fit.linear_runs().size();
  const bool is_scatter_known = runs >= identify::kFewestRunsForScatter;
  estimate.runs_agree_p = runs_agree_p(uncertainty, options.held, runs);
  estimate.runs_differ = is_scatter_known && estimate.runs_agree_p < kRunsDiffer;
  estimate.degrees_of_freedom = estimate.runs_differ
                                    ? ParameterVector::Constant(static_cast<double>(runs - 1)).eval()
                                    : degrees_of_freedom(uncertainty, torque_spread);
  estimate.covariance_normalised = estimate.runs_differ
                                       ? uncertainty.covariance_over_runs
                                       : with_uncertain_noise(uncertainty, estimate.degrees_of_freedom);
  estimate.covariance_exact_torque = uncertainty.covariance_exact_torque;
  if (is_scatter_known) estimate.covariance_over_runs = uncertainty.covariance_over_runs;
  estimate.offset_sensitivity = uncertainty.offset_sensitivity;
  if (!settled)
    return end(Termination::IterationLimit,
               fmt::format("still improving after {} iterations from each start", options.max_iterations));
  end(Termination::Converged, "the cost no longer changes");
}

}  // namespace identify

}  // namespace clampd
