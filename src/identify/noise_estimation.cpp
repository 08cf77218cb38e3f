#include "src/identify/noise_estimation.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "src/identify/starting_point.hpp"

namespace clampd::identify {

namespace {

/// A gain in likelihood that no longer matters: a step of a twentieth of the variances' own uncertainty.
constexpr double kDecrement = 2.5e-3;

constexpr double kTorqueNoiseStart_Nm = 1e-2;


double smallest(int i) {
  const double deviation = i == 0 ? kSmallestNoise.force_N : kSmallestNoise.velocity_rad_s;
  return i == 2 ? 0.0 : deviation * deviation;
}

Eigen::Vector3d vector_of(const Variances& variances) {
  return {variances.force, variances.velocity, variances.torque};
}

Variances variances_from(const Eigen::Vector3d& values) { return {values[0], values[1], values[2]}; }

/// The joint normal equations solved: what is left of a run's unknowns when the data are given.
struct Posterior {
  ParameterMatrix covariance;  ///< of the parameters; zero for held ones
  ParameterVector step;
};

Posterior solve(const JointNormal& joint, const Held& held) {
  const Eigen::LDLT<ParameterMatrix> factor(joint.information);
  Posterior posterior{factor.solve(ParameterMatrix::Identity()), -factor.solve(joint.gradient)};
  for (int i = 0; i < kTheta; ++i)
    if (held[static_cast<std::size_t>(i)]) posterior.covariance(i, i) = 0.0;
  return posterior;
}

}  // namespace

double restricted_likelihood(std::span<LinearRun> runs, std::span<const ReadingWeights> weights,
                             std::span<const Eigen::Vector2d> prior_distances, const Held& held,
                             const Variances& variances, std::vector<Normal>& normals) {
  double sum = 0.0;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    update_gains(variances, weights[r], runs[r]);
    normals[r] = normal_equations(runs[r]);
    add_initial_state_prior(prior_distances[r], normals[r]);
    sum += runs[r].log_determinant;
  }
  const JointNormal joint = eliminate_initial_states(normals, held);
  const Eigen::LDLT<ParameterMatrix> factor(joint.information);
  // A direction that the runs do not show has no pivot; it then shows in no variance either.
  const ParameterVector pivots = factor.vectorD().cwiseMax(1e-12);
  return 0.5 * (sum + joint.log_determinant + pivots.array().log().sum() + joint.squares -
                joint.gradient.dot(factor.solve(joint.gradient)));
}

LikelihoodSlopes restricted_likelihood_slopes(std::span<LinearRun> runs,
                                              std::span<const ReadingWeights> weights,
                                              std::span<const Normal> normals, const Held& held) {
  const Posterior posterior = solve(eliminate_initial_states(normals, held), held);
  LikelihoodSlopes slopes{Eigen::Vector3d::Zero(), Eigen::Matrix3d::Zero()};
  Eigen::Matrix<double, kTheta, 3> with_parameters = Eigen::Matrix<double, kTheta, 3>::Zero();
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const Normal& normal = normals[r];
    const Eigen::Matrix<double, kTheta, 2> coefficients = elimination(normal);
    const Eigen::Matrix2d initial = normal.block<2, 2>(kTheta, kTheta).inverse();
    // Second moment of (unknowns, 1) given the data.
    Eigen::Matrix<double, kUnknowns + 1, 1> mean;
    mean << posterior.step,
        -coefficients.transpose() * posterior.step - initial * normal.block<2, 1>(kTheta, kDataColumn), 1.0;
    Normal moment = mean * mean.transpose();
    Eigen::Matrix<double, kUnknowns, kTheta> spread;
    spread << ParameterMatrix::Identity(), -coefficients.transpose();
    moment.topLeftCorner<kUnknowns, kUnknowns>() += spread * posterior.covariance * spread.transpose();
    moment.block<2, 2>(kTheta, kTheta) += initial;

    const ScoreMoments score = score_moments(weights[r], mean.head<kUnknowns>(), runs[r]);
    slopes.gradient[0] += score.force_trace - score.force.cwiseProduct(moment).sum();
    slopes.gradient[1] += score.velocity_trace - score.velocity.cwiseProduct(moment).sum();
    slopes.gradient[2] += score.torque_trace - score.torque.cwiseProduct(moment).sum();

    const WorkingProducts products = working_products(weights[r], runs[r]);
    const Eigen::Matrix<double, 2, 3> with_initial = products.with_unknowns.bottomRows<2>();
    slopes.information += products.with_themselves - with_initial.transpose() * initial * with_initial;
    with_parameters += products.with_unknowns.topRows<kTheta>() - coefficients * with_initial;
  }
  slopes.information -= with_parameters.transpose() * posterior.covariance * with_parameters;
  slopes.gradient *= 0.5;
  slopes.information *= 0.5;
  return slopes;
}

NoiseFit estimate_noise(std::span<LinearRun> runs, std::span<const ReadingWeights> weights,
                        std::span<const Eigen::Vector2d> prior_distances, const Held& held,
                        const Variances& start, const KnownVariances& known, int max_iterations) {
  const bool fixed[3] = {known.force, known.velocity, known.torque};
  std::vector<Normal> normals(runs.size());
  const auto criterion = [&](const Eigen::Vector3d& values) {
    return restricted_likelihood(runs, weights, prior_distances, held, variances_from(values), normals);
  };
  Eigen::Vector3d values = vector_of(start);
  for (int i = 0; i < 3; ++i)
    if (!fixed[i]) values[i] = std::max(values[i], smallest(i));
  NoiseFit fit;
  fit.criterion = criterion(values);
  bool settled = known.force && known.velocity && known.torque;
  for (; fit.iterations < max_iterations && !settled; ++fit.iterations) {
    // The gains are those of `values` here.
    const auto [gradient, information] = restricted_likelihood_slopes(runs, weights, normals, held);
    // Scoring on those variances that may move: not known, and not at zero with the likelihood pushing on.
    Eigen::Vector3d scale = information.diagonal().cwiseMax(0.0).cwiseSqrt();
    Eigen::Matrix3d scaled = Eigen::Matrix3d::Identity();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    bool free[3];
    for (int i = 0; i < 3; ++i)
      free[i] = !fixed[i] && scale[i] > 0.0 && !(values[i] <= smallest(i) && gradient[i] > 0.0);
    for (int i = 0; i < 3; ++i) {
      if (!free[i]) continue;
      right[i] = -gradient[i] / scale[i];
      for (int j = 0; j < 3; ++j)
        if (free[j] && j != i) scaled(i, j) = information(i, j) / (scale[i] * scale[j]);
    }
    const Eigen::Vector3d direction = scaled.ldlt().solve(right);
    settled = direction.dot(right) < kDecrement;
    double length = 1.0;
    bool improved = false;
    for (int halving = 0; halving < 6; ++halving, length *= 0.5) {
      Eigen::Vector3d next = values;
      for (int i = 0; i < 3; ++i) {
        if (!free[i]) continue;
        const double step = length * direction[i] / scale[i];
        next[i] = i == 2 ? std::max(0.0, std::min(values[i] + step, 10.0 * values[i] + 1.0 / scale[i]))
                         : std::clamp(values[i] + step, std::max(0.25 * values[i], smallest(i)), 16.0 * values[i]);
      }
      const double reached = criterion(next);
      if (!(reached <= fit.criterion)) continue;
      values = next;
      fit.criterion = reached;
      improved = true;
      break;
    }
    if (!improved) break;
  }
  // Leaves the gains of the result, whatever was tried last.
  fit.criterion = criterion(values);
  fit.variances = variances_from(values);
  return fit;
}

Variances noise_of_output_errors(JointFit& fit, const EstimatorOptions& options) {
  const KnownVariances known{options.noise_force_N.has_value(), options.noise_velocity_rad_s.has_value(),
                             options.noise_torque_Nm.has_value()};
  Variances start = fit.variances();
  start.torque = options.noise_torque_Nm ? *options.noise_torque_Nm * *options.noise_torque_Nm
                                         : kTorqueNoiseStart_Nm * kTorqueNoiseStart_Nm;
  const NoiseFit found = estimate_noise(fit.linear_runs(), fit.weights(), fit.prior_distances(), options.held,
                                        start, known, kScoringIterations);
  fit.restore_output_error_gains();
  return found.variances;
}

}  // namespace clampd::identify
