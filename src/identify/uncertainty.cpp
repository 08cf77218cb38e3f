#include "src/identify/uncertainty.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "clampd/statistics/symmetric.hpp"

namespace clampd::identify {

namespace {

/// Of torque noise in the variances; less has no noticeable second-order effect either.
constexpr double kNoticeableShare = 0.2;
constexpr std::uint64_t kCurvatureSeed = 1;

/// Score that the curvature of the simulation in the torque brings about: torque noise moves the readings'
/// mean too. By a pair of opposite draws of the noise a run, so that what is linear in it cancels.
Eigen::Matrix<double, kUnknowns, 1> curvature_score(const JointFit& fit, std::size_t r,
                                                    double torque_variance, std::mt19937_64& random) {
  const Run& run = fit.run(r);
  const LinearRun& linear = fit.linear_runs()[r];
  std::normal_distribution<double> noise(0.0, std::sqrt(torque_variance));
  std::vector<double> draw(run.size());
  for (double& value : draw) value = noise(random);
  Eigen::VectorXd shift = Eigen::VectorXd::Zero(2 * static_cast<Eigen::Index>(run.size()));
  Simulation simulation(run.size());
  for (const double sign : {1.0, -1.0}) {
    std::vector<double> torque = run.torque_Nm;
    for (std::size_t k = 0; k < torque.size(); ++k) torque[k] += sign * draw[k];
    simulate(fit.brake(), fit.initial(r), Excitation{.torque_Nm = torque, .time_s = run.time_s}, simulation);
    if (!simulation.complete()) return Eigen::Matrix<double, kUnknowns, 1>::Zero();
    for (std::size_t k = 0; k < run.size(); ++k) {
      const auto at = static_cast<Eigen::Index>(2 * k);
      const Eigen::Vector2d nominal =
          Eigen::Vector2d(run.force_N[k], run.velocity_rad_s[k]) - linear.rows[k].residual;
      shift[at] += 0.5 * (simulation.force_N[k] - nominal[0]);
      shift[at + 1] += 0.5 * (simulation.velocity_rad_s[k] - nominal[1]);
    }
  }
  return (linear.weighted_innovations * shift).head<kUnknowns>();
}

ParameterMatrix without_held(ParameterMatrix matrix, const Held& held) {
  for (int i = 0; i < kTheta; ++i) {
    if (!held[static_cast<std::size_t>(i)]) continue;
    matrix.row(i).setZero();
    matrix.col(i).setZero();
  }
  return matrix;
}

/// Zero for what is held.
ParameterMatrix inverse_of(const ParameterMatrix& information, const Held& held) {
  return without_held(cramer_rao(information), held);
}

/// Moments of the scatter of scores with these covariances, whose sum is taken to be zero by the shared
/// parameters: with A_r the share of run r in all of the covariance, s_r has A_r - A_r^2 and s_r, s_q have
/// -A_r A_q in common.
void expect_scatter(std::span<const ParameterMatrix> of_runs, const Held& held, Uncertainty& result) {
  ParameterMatrix all = ParameterMatrix::Zero();
  for (const ParameterMatrix& of_run : of_runs) all += of_run;
  for (int i = 0; i < kTheta; ++i)
    if (held[static_cast<std::size_t>(i)]) all(i, i) = 1.0;
  const statistics::SymmetricFactor factor(all);
  const auto runs = static_cast<double>(of_runs.size());
  ParameterMatrix squares = ParameterMatrix::Zero();
  double expected = 0.0, variance = 0.0;
  for (const ParameterMatrix& of_run : of_runs) {
    const ParameterMatrix share = factor.solve_columns(of_run);
    const ParameterMatrix square = share * share;
    squares += square;
    expected += share.trace() - square.trace();
    variance += square.trace() - 2.0 * (square * share).trace();
  }
  result.scatter_expected = runs * expected;
  result.scatter_variance = 2.0 * runs * runs * (variance + (squares * squares).trace());
}

}  // namespace

std::vector<ScoreMoments> score_moments_of(JointFit& fit) {
  std::vector<ScoreMoments> moments;
  for (std::size_t r = 0; r < fit.linear_runs().size(); ++r)
    moments.push_back(
        score_moments(fit.weights()[r], Eigen::Matrix<double, kUnknowns, 1>::Zero(), fit.linear_runs()[r]));
  return moments;
}

RunScore run_score(const Normal& normal, const ScoreMoments& moments, const Variances& variances) {
  RunScore score;
  score.eliminate << ParameterMatrix::Identity(), -elimination(normal);
  const auto eliminated = [&](const Normal& moment) -> ParameterMatrix {
    return score.eliminate * moment.topLeftCorner<kUnknowns, kUnknowns>() * score.eliminate.transpose();
  };
  score.by_readings = eliminated(variances.force * moments.force + variances.velocity * moments.velocity);
  score.by_torque = eliminated(variances.torque * moments.torque);
  return score;
}

Uncertainty uncertainty_of(const JointFit& fit, std::span<const ScoreMoments> moments,
                           const Variances& variances, const Held& held) {
  Uncertainty result;
  const JointNormal joint = fit.joint_normal(held);
  result.information = joint.information;
  const ParameterMatrix inverse = inverse_of(joint.information, held);
  ParameterMatrix readings = ParameterMatrix::Zero();
  ParameterMatrix torque = ParameterMatrix::Zero();
  ParameterMatrix scatter = ParameterMatrix::Zero();
  std::vector<ParameterMatrix> of_runs;
  result.offset_sensitivity.setZero();
  for (std::size_t r = 0; r < moments.size(); ++r) {
    const Normal& normal = fit.normal(r);
    const RunScore of_run = run_score(normal, moments[r], variances);
    readings += of_run.by_readings;
    torque += of_run.by_torque;
    const ParameterVector score = of_run.eliminate * normal.block<kUnknowns, 1>(0, kDataColumn);
    scatter += score * score.transpose();
    of_runs.push_back(without_held(of_run.by_readings + of_run.by_torque, held));
    result.offset_sensitivity -= of_run.eliminate * moments[r].offsets;
  }
  result.offset_sensitivity = (inverse * result.offset_sensitivity).eval();
  result.covariance_exact_torque = inverse * readings * inverse;
  result.covariance = result.covariance_exact_torque + inverse * torque * inverse;
  expect_scatter(of_runs, held, result);
  if (moments.size() > 1) {
    const auto count = static_cast<double>(moments.size());
    result.covariance_over_runs = count / (count - 1.0) * inverse * scatter * inverse;
  } else {
    result.covariance_over_runs.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return result;
}

void add_curvature_bias(const JointFit& fit, const Variances& variances, const Held& held,
                        Uncertainty& uncertainty) {
  const std::size_t runs = fit.linear_runs().size();
  // Scatter falls with the number of runs, a bias does not: with a few runs it is lost in the scatter.
  const double torque_share =
      1.0 - uncertainty.covariance_exact_torque.trace() / uncertainty.covariance.trace();
  if (fit.uses_innovations() || runs < kFewestRunsForScatter || !(torque_share > kNoticeableShare)) return;
  std::mt19937_64 random(kCurvatureSeed);
  ParameterVector score = ParameterVector::Zero();
  for (std::size_t r = 0; r < runs; ++r) {
    const auto of_run = curvature_score(fit, r, variances.torque, random);
    score += of_run.head<kTheta>() - elimination(fit.normal(r)) * of_run.tail<2>();
  }
  const ParameterVector bias = inverse_of(uncertainty.information, held) * score;
  uncertainty.covariance += bias * bias.transpose();
}

}  // namespace clampd::identify
