#include "src/identify/uncertainty.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <vector>

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
    simulate(fit.brake(), fit.initial(r), Excitation{.torque_Nm = torque, .time_s = run.time_s},
             simulation);
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

void clear_held(const Held& held, ParameterMatrix& matrix) {
  for (int i = 0; i < kTheta; ++i) {
    if (!held[static_cast<std::size_t>(i)]) continue;
    matrix.row(i).setZero();
    matrix.col(i).setZero();
  }
}

}  // namespace

Uncertainty uncertainty_of(JointFit& fit, const Variances& variances, const Held& held) {
  Uncertainty result;
  const std::span<LinearRun> runs = fit.linear_runs();
  const JointNormal joint = fit.joint_normal(held);
  result.information = joint.information;
  ParameterMatrix inverse = cramer_rao(joint.information);
  clear_held(held, inverse);
  ParameterMatrix readings = ParameterMatrix::Zero();
  ParameterMatrix torque = ParameterMatrix::Zero();
  ParameterMatrix scatter = ParameterMatrix::Zero();
  result.offset_sensitivity.setZero();
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const Normal& normal = fit.normal(r);
    Eigen::Matrix<double, kTheta, kUnknowns> eliminate;
    eliminate << ParameterMatrix::Identity(), -elimination(normal);
    const ScoreMoments moments =
        score_moments(fit.weights()[r], Eigen::Matrix<double, kUnknowns, 1>::Zero(), runs[r]);
    const Eigen::Matrix<double, kUnknowns, kUnknowns> reading =
        (variances.force * moments.force + variances.velocity * moments.velocity)
            .topLeftCorner<kUnknowns, kUnknowns>();
    readings += eliminate * reading * eliminate.transpose();
    torque += variances.torque * eliminate * moments.torque.topLeftCorner<kUnknowns, kUnknowns>() *
              eliminate.transpose();
    const ParameterVector score = eliminate * normal.block<kUnknowns, 1>(0, kDataColumn);
    scatter += score * score.transpose();
    result.offset_sensitivity -= eliminate * moments.offsets;
  }
  result.offset_sensitivity = (inverse * result.offset_sensitivity).eval();
  result.covariance_exact_torque = inverse * readings * inverse;
  result.covariance = result.covariance_exact_torque + inverse * torque * inverse;
  // Scatter falls with the number of runs, a bias does not: with a few runs it is lost in the scatter.
  const double torque_share = 1.0 - result.covariance_exact_torque.trace() / result.covariance.trace();
  if (!fit.uses_innovations() && runs.size() >= kFewestRunsForScatter && torque_share > kNoticeableShare) {
    std::mt19937_64 random(kCurvatureSeed);
    ParameterVector score = ParameterVector::Zero();
    for (std::size_t r = 0; r < runs.size(); ++r) {
      const auto of_run = curvature_score(fit, r, variances.torque, random);
      score += of_run.head<kTheta>() - elimination(fit.normal(r)) * of_run.tail<2>();
    }
    const ParameterVector bias = inverse * score;
    result.covariance += bias * bias.transpose();
  }
  if (runs.size() > 1) {
    const auto count = static_cast<double>(runs.size());
    result.covariance_over_runs = count / (count - 1.0) * inverse * scatter * inverse;
  } else {
    result.covariance_over_runs.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return result;
}

}  // namespace clampd::identify
