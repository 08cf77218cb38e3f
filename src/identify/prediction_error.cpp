#include "clampd/identify/prediction_error.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "src/identify/conclusion.hpp"
#include "src/identify/noise_estimation.hpp"
#include "src/identify/output_error_search.hpp"

namespace clampd {

namespace identify {

namespace {

/// Gains and noise are renewed until the noise's standard deviations change by less than this share, which
/// moves the parameters by far less than their uncertainty.
constexpr double kPredictionErrorNoiseTolerance = 0.02;
constexpr double kNegligibleTorque = 1e-8;  // a variance: lost in the noise of the readings
constexpr double kPredictionErrorWeightTolerance = 0.02;
constexpr int kPredictionErrorUndampedRounds = 3;
constexpr double kMaxBelievedTorqueNoise_Nm = 0.03;  // twice the paper's
constexpr int kMaxRounds = 20;

/// Two ends of a search are the same place if their parameters differ by less than what lowers the likelihood
/// by this (nats). Likelihoods themselves differ by more if many runs, each with kinks of its own, have settled.
constexpr double kSamePlace = 0.5;

/// Where the prediction error method ended from one start.
struct Attempt {
  Eigen::VectorXd unknowns;
  Variances variances;
  double criterion = std::numeric_limits<double>::infinity();  ///< minus the restricted log-likelihood
  bool settled = false;
  bool white = false;          ///< the innovations
  double torque_spread = 0.0;  ///< as in NoiseFit
  ParameterMatrix information = ParameterMatrix::Zero();  ///< of the normalised parameters
};

KnownVariances known_by(const EstimatorOptions& options) {
  return {options.noise_force_N.has_value(), options.noise_velocity_rad_s.has_value(),
          options.noise_torque_Nm.has_value()};
}

class PredictionErrorSearch {
 public:
  PredictionErrorSearch(JointFit& fit, const EstimatorOptions& options)
      : fit_(fit), options_(options), minimise_(fit, Minimiser::Kinks::Accept) {}

  /// Alternates between the parameters under fixed gains and the noise under fixed parameters: to first order
  /// neither knows of the other, so few rounds suffice.
  Attempt attempt(const Eigen::VectorXd& start, const Variances& noise) {
    Attempt result{start, noise};
    for (int round = 0; round < kMaxRounds && !result.settled; ++round) {
      if (!fit_.use_innovations(result.unknowns, result.variances)) return result;
      const Descent descent = minimise_(fit_, result.unknowns, options_.max_iterations);
      iterations_ += descent.iterations;
      if (!descent.possible) return result;
      // At a kink the slopes promise what is not there, and the noise would be estimated as if it were.
      const double promised = fit_.expected_decrease();
      const ParameterMatrix information = fit_.joint_normal(options_.held).information;
      const double reweighted = fit_.update_weights();
      const NoiseFit found =
          estimate_noise(fit_.linear_runs(), fit_.weights(), fit_.prior_distances(), options_.held,
                         result.variances, known_by(options_), kScoringIterations);
      result.criterion = found.criterion + 0.5 * promised;
      result.information = information;
      result.white = found.white;
      result.torque_spread = found.torque_spread;
      result.settled = descent.settled && reweighted < kPredictionErrorWeightTolerance &&
                       change_between(result.variances, found.variances, kNegligibleTorque) <
                           kPredictionErrorNoiseTolerance;
      // Kinks of the filter can make the two answer each other for ever: then in ever smaller steps.
      const double share = 1.0 / std::max(1, round - kPredictionErrorUndampedRounds);
      const auto towards = [&](double from, double to) { return from * std::pow(to / from, share); };
      result.variances = {towards(result.variances.force, found.variances.force),
                          towards(result.variances.velocity, found.variances.velocity),
                          options_.noise_torque_Nm
                              ? found.variances.torque
                              : towards(result.variances.torque, found.variances.torque)};
    }
    return result;
  }

  int iterations() const { return iterations_; }

 private:
  JointFit& fit_;
  const EstimatorOptions& options_;
  Minimiser minimise_;
  int iterations_ = 0;
};

/// The runs with what has vanished held where it is in the nominal brake: from there the others, which made
/// up for it, lead to the right place once it is free again.
Estimate with_vanished_held(std::span<const Run> runs, EstimatorOptions options,
                            const ParameterVector& theta) {
  const ParameterVector whole = revived(theta, options.held);
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    if (whole[k] == theta[k]) continue;
    options.held[i] = true;
    options.start.theta[k] = whole[k];
  }
  if (std::find(options.held.begin(), options.held.end(), false) == options.held.end())
    return empty_estimate(options);
  return identify_prediction_error(runs, options);
}

}  // namespace

Estimate prediction_error_estimate(OutputErrorSearch& output_errors, std::span<const Run> runs,
                                   const EstimatorOptions& options) {
  Estimate estimate = empty_estimate(options);
  estimate.method = Method::PredictionError;
  const int before = output_errors.iterations();
  OutputErrorAttempt& warm = output_errors.first();
  JointFit& fit = output_errors.fit_at(warm);
  PredictionErrorSearch search(fit, options);
  const bool doubtful = output_errors.doubtful(warm);
  Attempt best;
  if (std::isfinite(warm.score)) best = search.attempt(warm.unknowns, output_errors.noise_at(warm).variances);
  const auto good = [&](const Attempt& attempt) {
    return attempt.settled && attempt.white && output_errors.plausible(attempt.variances);
  };
  const auto consider = [&](Attempt&& other) {
    if (other.criterion < best.criterion) best = std::move(other);
  };
  const auto alike = [&](const Attempt& a, const Attempt& b) {
    const ParameterVector theta = fit.theta_of(b.unknowns);
    const ParameterVector apart = (fit.theta_of(a.unknowns) - theta).cwiseQuotient(nominal_parameters());
    return 0.5 * apart.dot(b.information * apart) < kSamePlace && !has_vanished(theta, options.held);
  };
  // A filter can call almost any parameters good if only it believes in enough torque noise: the output
  // errors from several starts say more. Where those got lost, as in slow motion under load, or are off by
  // more than the readings' noise, likelihood must choose, until two unlike starts have met where it is best.
  if (doubtful) {
    OutputErrorAttempt& thorough = output_errors.best();
    if (std::isfinite(thorough.score) && thorough.unknowns != warm.unknowns) {
      const Variances noise = output_errors.noise_at(thorough).variances;
      // With more, the model does not follow the brake there either.
      if (noise.torque < kMaxBelievedTorqueNoise_Nm * kMaxBelievedTorqueNoise_Nm)
        consider(search.attempt(thorough.unknowns, noise));
    }
  }
  if (std::isfinite(best.criterion) && has_vanished(fit.theta_of(best.unknowns), options.held)) {
    const Estimate others = with_vanished_held(runs, options, fit.theta_of(best.unknowns));
    if (others.parameters.theta.allFinite())
      consider(search.attempt(
          fit.start_from(others.parameters.theta),
          variances_of({{others.noise_force_N, others.noise_velocity_rad_s}, others.noise_torque_Nm})));
  }
  if (doubtful || !good(best)) {
    const Variances start = output_errors.variances_without_model();
    for (int i = 0; i < OutputErrorSearch::kOtherStarts; ++i) {
      const std::optional<ParameterVector> theta = output_errors.other_start(i);
      if (!theta) continue;
      Attempt other = search.attempt(fit.start_from(*theta), good(best) ? best.variances : start);
      const bool met = good(other) && good(best) && alike(other, best);
      consider(std::move(other));
      if (met) break;
    }
  }
  estimate.iterations = output_errors.iterations() - before + search.iterations();
  if (!std::isfinite(best.criterion) || !fit.use_innovations(best.unknowns, best.variances))
    estimate.message =
        "the Kalman filter cannot follow the runs from any start: it diverges under their torque";
  else
    conclude(fit, best.unknowns, best.variances, best.torque_spread, best.settled, options, estimate);
  return estimate;
}

}  // namespace identify

Estimate identify_prediction_error(std::span<const Run> runs, const EstimatorOptions& options) {
  using namespace identify;
  const Stopwatch stopwatch;
  if (const Result<void> valid = check_input(runs, options); !valid) {
    Estimate estimate = empty_estimate(options);
    estimate.method = Method::PredictionError;
    estimate.message = valid.error().message;
    return estimate;
  }
  OutputErrorSearch output_errors(runs, options);
  Estimate estimate = prediction_error_estimate(output_errors, runs, options);
  estimate.wall_s = stopwatch.seconds();
  return estimate;
}

}  // namespace clampd
