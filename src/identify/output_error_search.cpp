#include "src/identify/output_error_search.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "src/identify/starting_point.hpp"

namespace clampd::identify {

namespace {

/// R is re-estimated after each descent, until its variances change by less than this share: such a change of
/// the weights costs far less than a hundredth of the estimate's efficiency.
constexpr double kOutputErrorNoiseTolerance = 0.2;
constexpr double kOutputErrorWeightTolerance = 0.02;
constexpr int kOutputErrorUndampedRounds = 2;
/// With weights that are far off, as of a model that does not fit, more would be spent on the wrong problem.
constexpr int kFirstRoundIterations = 40;
constexpr int kRoundIterations = 15;

/// More attempts from other starts follow if a fit's residuals exceed the noise seen without a model this
/// often, or are not white.
constexpr double kPoorFit = 1.25;

/// A filter that believes in this much torque noise follows the readings also where the parameters are wrong:
/// its cost is free of the minima that differ in when the simulated brake sticks, and leads near the right
/// one.
constexpr double kSmoothingTorque_Nm = 0.2;
constexpr int kSmoothingRounds = 3;
constexpr int kSmoothingIterations = 10;

/// More torque noise than any drive has: a wrong minimum taken for noise.
constexpr double kMaxTorqueNoise_Nm = 0.1;

/// A gain in weighted squares, as of a step of one standard deviation, that the slopes promise at the end of
/// a search: a kink with a lower minimum behind it.
constexpr double kPromise = 1.0;

/// Of its nominal value: a static friction that ran away to nothing is how most fits get lost.
constexpr double kVanished = 0.05;

/// Times nominal: the means of the paper's Table II, a brake after a long life.
constexpr std::array<double, kParameterCount> kWorn{0.8, 0.9, 1.66, 0.93, 2.2, 1.05, 0.43};

}  // namespace

OutputErrorSearch::OutputErrorSearch(std::span<const Run> runs, const EstimatorOptions& options)
    : runs_(runs), options_(options), fit_(runs, options), minimise_(fit_, Minimiser::Kinks::LookBeyond) {
  const SensorNoise seen = noise_without_model(runs);
  seen_ = variances_of({seen, 0.0});
}

Variances OutputErrorSearch::known_or(const Eigen::Vector2d& mean_squares) const {
  const double force = options_.noise_force_N.value_or(kSmallestNoise.force_N);
  const double velocity = options_.noise_velocity_rad_s.value_or(kSmallestNoise.velocity_rad_s);
  return {
      options_.noise_force_N ? force * force : std::max(mean_squares[0], force * force),
      options_.noise_velocity_rad_s ? velocity * velocity : std::max(mean_squares[1], velocity * velocity),
      0.0};
}

OutputErrorAttempt OutputErrorSearch::attempt(const ParameterVector& theta) {
  OutputErrorAttempt result;
  result.unknowns = fit_.start_from(theta);
  result.weights = known_or({seen_.force, seen_.velocity});
  int used = 0;
  for (int round = 0; used < options_.max_iterations; ++round) {
    fit_.use_output_errors(result.weights);
    const Descent descent = minimise_(
        fit_, result.unknowns,
        std::min(round == 0 ? kFirstRoundIterations : kRoundIterations, options_.max_iterations - used));
    iterations_ += descent.iterations;
    if (!descent.possible) return result;
    used += std::max(1, descent.iterations);
    const Variances found = known_or(fit_.mean_squares());
    const double reweighted = fit_.update_weights();
    const double share = 1.0 / std::max(1, round - kOutputErrorUndampedRounds);
    const double change = share * std::max(std::abs(found.force / result.weights.force - 1.0),
                                           std::abs(found.velocity / result.weights.velocity - 1.0));
    result.settled =
        descent.settled && change < kOutputErrorNoiseTolerance && reweighted < kOutputErrorWeightTolerance;
    if (result.settled) break;
    // Where the model does not fit, weights and parameters can chase each other: then in ever smaller steps.
    result.weights.force *= std::pow(found.force / result.weights.force, share);
    result.weights.velocity *= std::pow(found.velocity / result.weights.velocity, share);
  }
  result.promised = fit_.expected_decrease();
  const Eigen::Vector2d squares = fit_.mean_squares();
  const Variances found = known_or(squares);
  result.score = 0.5 * (squares[0] / found.force + squares[1] / found.velocity + std::log(found.force) +
                        std::log(found.velocity));
  return result;
}

JointFit& OutputErrorSearch::fit_at(const OutputErrorAttempt& attempt) {
  const Variances& present = fit_.variances();
  if (fit_.uses_innovations() || attempt.weights.force != present.force ||
      attempt.weights.velocity != present.velocity)
    fit_.use_output_errors(attempt.weights);
  fit_.evaluate(attempt.unknowns);
  return fit_;
}

const NoiseFit& OutputErrorSearch::noise_at(OutputErrorAttempt& attempt) {
  if (!attempt.noise) attempt.noise = noise_of_output_errors(fit_at(attempt), options_);
  return *attempt.noise;
}

Variances OutputErrorSearch::variances_without_model() const {
  Variances variances = known_or({seen_.force, seen_.velocity});
  const double torque = options_.noise_torque_Nm.value_or(kTorqueNoiseStart_Nm);
  variances.torque = torque * torque;
  return variances;
}

bool OutputErrorSearch::plausible(const Variances& variances) const {
  return variances.force < kPoorFit * kPoorFit * seen_.force &&
         variances.velocity < kPoorFit * kPoorFit * seen_.velocity;
}

bool OutputErrorSearch::poor(OutputErrorAttempt& attempt) {
  if (!attempt.settled) return true;
  const JointFit& fit = fit_at(attempt);
  const Eigen::Vector2d squares = fit.mean_squares();
  if (plausible({squares[0], squares[1], 0.0}) && fit.white()) return false;
  const NoiseFit& noise = noise_at(attempt);
  return !(noise.white && plausible(noise.variances) &&
           noise.variances.torque < kMaxTorqueNoise_Nm * kMaxTorqueNoise_Nm);
}

ParameterVector OutputErrorSearch::filtered_start(const ParameterVector& theta) {
  Eigen::VectorXd unknowns = fit_.start_from(theta);
  Variances noise = seen_;
  noise.torque = kSmoothingTorque_Nm * kSmoothingTorque_Nm;
  for (int round = 0; round < kSmoothingRounds; ++round) {
    if (!fit_.use_innovations(unknowns, noise)) break;
    iterations_ += minimise_(fit_, unknowns, kSmoothingIterations).iterations;
  }
  return fit_.theta_of(unknowns);
}

ParameterVector revived(ParameterVector theta, const Held& held) {
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    double& value = theta[static_cast<Eigen::Index>(i)];
    if (!held[i] && std::abs(value / kParameterTable[i].nominal) < kVanished)
      value = kParameterTable[i].nominal;
  }
  return theta;
}

bool has_vanished(const ParameterVector& theta, const Held& held) {
  return revived(theta, held) != theta;
}

bool OutputErrorSearch::doubtful(OutputErrorAttempt& attempt) {
  if (attempt.promised > kPromise || poor(attempt)) return true;
  const Eigen::Vector2d squares = fit_at(attempt).mean_squares();
  return !plausible({squares[0], squares[1], 0.0}) ||
         has_vanished(fit_.theta_of(attempt.unknowns), options_.held);
}

std::optional<ParameterVector> OutputErrorSearch::other_start(int index) {
  const auto by_equation_error = [&]() -> const ParameterVector& {
    if (!by_equation_error_)
      by_equation_error_ =
          equation_error_start(runs_, options_.start, {std::sqrt(seen_.force), std::sqrt(seen_.velocity)});
    return *by_equation_error_;
  };
  // Where everything began at the nominal brake already, a worn one is the other brake that is likely.
  const auto elsewhere = [&] {
    ParameterVector theta = nominal_parameters();
    if (is_nominal_start())
      for (int i = 0; i < kTheta; ++i) theta[i] *= kWorn[static_cast<std::size_t>(i)];
    return theta;
  };
  ParameterVector theta = index == 0   ? filtered_start(options_.start.theta)
                          : index == 1 ? by_equation_error()
                          : index == 2 ? filtered_start(by_equation_error())
                          : index == 3 ? elsewhere()
                                       : filtered_start(elsewhere());
  if (!within_bounds(theta)) return std::nullopt;
  for (int i = 0; i < kTheta; ++i)
    if (options_.held[static_cast<std::size_t>(i)]) theta[i] = options_.start.theta[i];
  return theta;
}

OutputErrorAttempt& OutputErrorSearch::first() {
  if (!first_) first_ = attempt(options_.start.theta);
  return *first_;
}

OutputErrorAttempt& OutputErrorSearch::best() {
  if (!best_) best_ = best_of_all_starts();
  return *best_;
}

OutputErrorAttempt OutputErrorSearch::best_of_all_starts() {
  OutputErrorAttempt kept = first();
  if (!poor(kept)) return kept;
  for (int i = 0; i < kOtherStarts; ++i) {
    const std::optional<ParameterVector> start = other_start(i);
    if (!start) continue;
    OutputErrorAttempt other = attempt(*start);
    if (other.score < kept.score) kept = std::move(other);
    if (!poor(kept)) return kept;
  }
  return kept;
}

}  // namespace clampd::identify
