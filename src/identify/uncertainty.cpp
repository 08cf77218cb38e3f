#include "src/identify/uncertainty.hpp"

#include <algorithm>
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

/// Zero for what is held.
ParameterMatrix inverse_of(const ParameterMatrix& information, const Held& held) {
  ParameterMatrix inverse = cramer_rao(information);
  for (int i = 0; i < kTheta; ++i) {
    if (!held[static_cast<std::size_t>(i)]) continue;
    inverse.row(i).setZero();
    inverse.col(i).setZero();
  }
  return inverse;
}

/// The square of a run's score over its covariance, in the directions that the run tells of.
void add_score_squares(const ParameterVector& score, const ParameterMatrix& covariance, Uncertainty& result) {
  constexpr double kTold = 1e-8;  // of a unit diagonal: what is smaller has no correct digit
  const Eigen::VectorXd scale = statistics::deviations_of_diagonal(covariance);
  const statistics::Spectrum spectrum = statistics::spectrum_of(statistics::scaled_by(covariance, scale));
  if (!spectrum.ok) return;
  const Eigen::VectorXd along = spectrum.vectors.transpose() * score.cwiseQuotient(scale);
  for (Eigen::Index i = 0; i < along.size(); ++i) {
    if (!(spectrum.values[i] > kTold)) continue;
    result.score_squares += along[i] * along[i] / spectrum.values[i];
    result.score_degrees += 1.0;
  }
}

}  // namespace

std::vector<ScoreMoments> score_moments_of(JointFit& fit) {
  std::vector<ScoreMoments> moments;
  for (std::size_t r = 0; r < fit.linear_runs().size(); ++r)
    moments.push_back(
        score_moments(fit.weights()[r], Eigen::Matrix<double, kUnknowns, 1>::Zero(), fit.linear_runs()[r]));
  return moments;
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
  result.score_degrees = -static_cast<double>(std::count(held.begin(), held.end(), false));
  result.offset_sensitivity.setZero();
  for (std::size_t r = 0; r < moments.size(); ++r) {
    const Normal& normal = fit.normal(r);
    Eigen::Matrix<double, kTheta, kUnknowns> eliminate;
    eliminate << ParameterMatrix::Identity(), -elimination(normal);
    const Eigen::Matrix<double, kUnknowns, kUnknowns> reading =
        (variances.force * moments[r].force + variances.velocity * moments[r].velocity)
            .topLeftCorner<kUnknowns, kUnknowns>();
    const ParameterMatrix by_readings = eliminate * reading * eliminate.transpose();
    const ParameterMatrix by_torque = variances.torque * eliminate *
                                      moments[r].torque.topLeftCorner<kUnknowns, kUnknowns>() *
                                      eliminate.transpose();
    readings += by_readings;
    torque += by_torque;
    ParameterVector score = eliminate * normal.block<kUnknowns, 1>(0, kDataColumn);
    scatter += score * score.transpose();
    ParameterMatrix of_run = by_readings + by_torque;
    for (int i = 0; i < kTheta; ++i) {
      if (!held[static_cast<std::size_t>(i)]) continue;
      of_run.row(i).setZero();
      of_run.col(i).setZero();
      score[i] = 0.0;
    }
    add_score_squares(score, of_run, result);
    result.offset_sensitivity -= eliminate * moments[r].offsets;
  }
  result.offset_sensitivity = (inverse * result.offset_sensitivity).eval();
  result.covariance_exact_torque = inverse * readings * inverse;
  result.covariance = result.covariance_exact_torque + inverse * torque * inverse;
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
