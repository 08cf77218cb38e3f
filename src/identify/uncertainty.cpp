#include "src/identify/uncertainty.hpp"

#include <limits>

namespace clampd::identify {

namespace {

/// Fewer clusters do not span seven parameters.
constexpr std::size_t kFewestRunsForScatter = 8;

using Scores = Eigen::Matrix<double, kUnknowns, 2>;
using UnknownMatrix = Eigen::Matrix<double, kUnknowns, kUnknowns>;

/// Of a run: what the noise does to the score J^T W e.
struct ScoreCovariance {
  UnknownMatrix readings = UnknownMatrix::Zero();
  UnknownMatrix torque = UnknownMatrix::Zero();
  Scores offsets = Scores::Zero();  ///< the score of a unit offset of all force readings, of all velocities
};

ScoreCovariance score_covariance(const LinearRun& run, const Variances& variances,
                                 const ReadingWeights& weights) {
  const std::size_t size = run.rows.size();
  std::vector<Scores> weighted(size);  // (W J)^T of each row
  Eigen::Matrix<double, 2, kUnknowns> distance = Eigen::Matrix<double, 2, kUnknowns>::Zero();
  distance(0, kInitialPositionColumn) = distance(1, kInitialVelocityColumn) = 1.0;
  Eigen::Matrix2d offset_distance = Eigen::Matrix2d::Zero();
  ScoreCovariance result;
  for (std::size_t k = 0; k < size; ++k) {
    const LinearRow& row = run.rows[k];
    const RowGain& gain = run.gains[k];
    Eigen::Matrix<double, 2, kUnknowns> innovation = -row.by_state * distance;
    innovation.leftCols<kTheta>() -= row.by_parameter;
    const Eigen::Matrix2d offset = Eigen::Matrix2d::Identity() - row.by_state * offset_distance;
    weighted[k] = innovation.transpose() * gain.weight;
    result.offsets += weighted[k] * offset;
    distance = (row.transition * (distance + gain.gain * innovation)).eval();
    distance.leftCols<kTheta>() += row.step_by_parameter;
    offset_distance = (row.transition * (offset_distance + gain.gain * offset)).eval();
  }
  // Backwards: later = the score of the state at row k + 1, through all rows from there on.
  Scores later = Scores::Zero();
  for (std::size_t k = size; k-- > 0;) {
    const LinearRow& row = run.rows[k];
    const Eigen::Matrix2d& gain = run.gains[k].gain;
    result.torque += later * row.torque_covariance * later.transpose();
    const Scores through = later * row.transition;  // of the state after row k's reading
    const Scores of_reading = weighted[k] + through * gain;
    const double force = variances.force / (weights.force.empty() ? 1.0 : weights.force[k]);
    const double velocity = variances.velocity / (weights.velocity.empty() ? 1.0 : weights.velocity[k]);
    result.readings += force * of_reading.col(0) * of_reading.col(0).transpose() +
                       velocity * of_reading.col(1) * of_reading.col(1).transpose();
    later = through - of_reading * row.by_state;
  }
  result.torque *= variances.torque;
  return result;
}

void clear_held(const Held& held, ParameterMatrix& matrix) {
  for (int i = 0; i < kTheta; ++i) {
    if (!held[static_cast<std::size_t>(i)]) continue;
    matrix.row(i).setZero();
    matrix.col(i).setZero();
  }
}

}  // namespace

Uncertainty uncertainty_of(const JointFit& fit, const Variances& variances, const Held& held) {
  Uncertainty result;
  const std::span<const LinearRun> runs = fit.linear_runs();
  const JointNormal joint = fit.joint_normal();
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
    const ScoreCovariance of_run = score_covariance(runs[r], variances, fit.weights()[r]);
    readings += eliminate * of_run.readings * eliminate.transpose();
    torque += eliminate * of_run.torque * eliminate.transpose();
    const ParameterVector score = eliminate * normal.block<kUnknowns, 1>(0, kDataColumn);
    scatter += score * score.transpose();
    result.offset_sensitivity -= eliminate * of_run.offsets;
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
