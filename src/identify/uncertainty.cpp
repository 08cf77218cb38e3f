#include "src/identify/uncertainty.hpp"

#include <limits>

namespace clampd::identify {

namespace {

/// Fewer clusters do not span seven parameters.
constexpr std::size_t kFewestRunsForScatter = 8;

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
  if (runs.size() >= kFewestRunsForScatter) {
    const auto count = static_cast<double>(runs.size());
    result.covariance_over_runs = count / (count - 1.0) * inverse * scatter * inverse;
  } else {
    result.covariance_over_runs.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return result;
}

}  // namespace clampd::identify
