#include "clampd/identify/kalman.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/LU>

#include "clampd/base/nan.hpp"
#include "src/identify/linear_run.hpp"

namespace clampd {

namespace {


/// Below this relative determinant a covariance has no inverse worth the name: the state is known exactly in
/// some direction, as at the known start or while the brake sticks.
constexpr double kSingularCovariance = 1e-12;

Eigen::Matrix2d pseudo_inverse(const Eigen::Matrix2d& covariance) {
  const double determinant = covariance.determinant();
  if (determinant > kSingularCovariance * covariance(0, 0) * covariance(1, 1)) return covariance.inverse();
  Eigen::Matrix2d inverse = Eigen::Matrix2d::Zero();
  for (int i = 0; i < 2; ++i)
    if (covariance(i, i) > 0.0) inverse(i, i) = 1.0 / covariance(i, i);
  return inverse;
}

void resize(BandedRun& run, std::size_t size) {
  for (Band* band : {&run.position_rad, &run.velocity_rad_s, &run.force_N}) {
    band->mean.assign(size, kNaN);
    band->sd.assign(size, kNaN);
  }
}

void write(const PaperBrake& model, const BrakeState& state, const Eigen::Matrix2d& covariance, std::size_t k,
           BandedRun& out) {
  Eigen::Matrix2d by_state;
  Eigen::Matrix<double, 2, PaperBrake::kParameters> by_parameter;
  model.linearise_readings(state, by_state, by_parameter);
  const Reading reading = model.read(state);
  const Eigen::Matrix2d of_readings = by_state * covariance * by_state.transpose();
  out.position_rad.mean[k] = state[0];
  out.position_rad.sd[k] = std::sqrt(std::max(0.0, covariance(0, 0)));
  out.force_N.mean[k] = reading.force_N;
  out.force_N.sd[k] = std::sqrt(std::max(0.0, of_readings(0, 0)));
  out.velocity_rad_s.mean[k] = reading.velocity_rad_s;
  out.velocity_rad_s.sd[k] = std::sqrt(std::max(0.0, of_readings(1, 1)));
}

}  // namespace

KalmanViews kalman_views(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                         const NoiseLevels& noise) {
  const std::size_t size = run.size();
  KalmanViews views;
  for (BandedRun* view : {&views.one_step, &views.filtered, &views.smoothed}) resize(*view, size);
  if (size == 0) return views;
  const PaperBrake model = paper_brake(parameters);
  identify::LinearRun linear;
  linear.resize(size);
  if (!identify::extended_kalman_filter(run, parameters, initial, identify::variances_of(noise), {}, linear))
    return views;

  std::vector<Eigen::Matrix2d> filtered(size);
  for (std::size_t k = 0; k < size; ++k) {
    const identify::RowGain& gain = linear.gains[k];
    const identify::LinearRow& row = linear.rows[k];
    filtered[k] = gain.covariance - gain.gain * row.by_state * gain.covariance;
    write(model, linear.reference[k], gain.covariance, k, views.one_step);
    write(model, linear.reference[k] + row.correction, filtered[k], k, views.filtered);
  }
  BrakeState smoothed = linear.reference.back() + linear.rows.back().correction;
  Eigen::Matrix2d covariance = filtered.back();
  write(model, smoothed, covariance, size - 1, views.smoothed);
  for (std::size_t k = size - 1; k-- > 0;) {
    const identify::LinearRow& row = linear.rows[k];
    const Eigen::Matrix2d& predicted = linear.gains[k + 1].covariance;
    const Eigen::Matrix2d back = filtered[k] * row.transition.transpose() * pseudo_inverse(predicted);
    smoothed = linear.reference[k] + row.correction + back * (smoothed - linear.reference[k + 1]);
    covariance = filtered[k] + back * (covariance - predicted) * back.transpose();
    write(model, smoothed, covariance, k, views.smoothed);
  }
  return views;
}

PredictionCosts prediction_costs(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                                 const NoiseLevels& noise) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  identify::LinearRun linear;
  linear.resize(run.size());
  if (!identify::extended_kalman_filter(run, parameters, initial, identify::variances_of(noise), {}, linear))
    return {kInfinity, kInfinity};
  const PaperBrake model = paper_brake(parameters);
  double innovations = linear.log_determinant;
  double as_printed = linear.log_determinant;
  for (std::size_t k = 0; k < run.size(); ++k) {
    const identify::LinearRow& row = linear.rows[k];
    const Eigen::Matrix2d& weight = linear.gains[k].weight;
    const Reading corrected = model.read(linear.reference[k] + row.correction);
    const Eigen::Vector2d left(run.force_N[k] - corrected.force_N,
                               run.velocity_rad_s[k] - corrected.velocity_rad_s);
    innovations += row.residual.dot(weight * row.residual);
    as_printed += left.dot(weight * left);
  }
  return {0.5 * innovations, 0.5 * as_printed};
}

BandedRun free_run(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                   const NoiseLevels& noise) {
  BandedRun out;
  resize(out, run.size());
  const PaperBrake model = paper_brake(parameters);
  identify::LinearRun linear;
  linear.resize(run.size());
  const bool complete = identify::linearise(run, parameters, initial, linear);
  if (!complete) return out;
  const double variance = noise.torque_Nm * noise.torque_Nm;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  for (std::size_t k = 0; k < run.size(); ++k) {
    const identify::LinearRow& row = linear.rows[k];
    write(model, linear.reference[k], covariance, k, out);
    covariance = row.transition * covariance * row.transition.transpose() + variance * row.torque_covariance;
  }
  return out;
}

}  // namespace clampd
