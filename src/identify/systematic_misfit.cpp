#include "clampd/identify/systematic_misfit.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/extended_run.hpp"

namespace clampd {

using namespace identify;

namespace {

/// Long enough that a block's sum is dominated by what the motion does, short against the motion.
constexpr Eigen::Index kBlock_rows = 10;
/// Of the jackknife: about as long as the residuals of a wrong model keep their sign.
constexpr Eigen::Index kStretch_rows = 25;

/// Whitened residuals and what moves them, one column per reading (force, velocity, force, ...), the initial
/// state following.
struct RepeatView {
  Eigen::VectorXd residual;
  Eigen::MatrixXd by_theta;  ///< d residual / d (theta / theta_nom)
  Eigen::MatrixXd by_tare;   ///< by an offset of the force and of the velocity readings
};

std::optional<RepeatView> view_of(const FitRun& run, const ExtendedParameters& model,
                                  const Eigen::VectorXd& initial, const NoiseLevels& noise,
                                  const std::array<bool, kParameterCount>& held) {
  const ExtendedBrake brake(model);
  const Unknowns unknowns(model, brake.places(), held, false);
  const int p = unknowns.count();
  const std::vector<double> prior = prior_deviations(model);
  const auto initial_states = static_cast<int>(prior.size());
  ExtendedRun linear;
  linear.resize(run.size(), brake.states(), p, initial_states);
  if (!linearise(run, brake, model, unknowns, initial, variances_of(noise), Gains::Renewed, linear))
    return std::nullopt;
  compute_normal(run, linear);
  if (!linear.innovations.allFinite()) return std::nullopt;
  const Eigen::Index rows = linear.innovations.cols();
  const auto ones = Eigen::MatrixXd::Ones(static_cast<Eigen::Index>(run.size()), 1);
  Eigen::MatrixXd all(p + 3, rows);
  all.topRows(p) = linear.innovations.topRows(p);
  all.row(p) = filter_signals(run, linear, SignalColumns::Kind::ForceReading, ones, model);
  all.row(p + 1) = filter_signals(run, linear, SignalColumns::Kind::VelocityReading, ones, model);
  all.row(p + 2) = linear.innovations.row(p + initial_states);
  const Eigen::MatrixXd of_start = linear.innovations.middleRows(p, initial_states);
  Eigen::MatrixXd normal = of_start * of_start.transpose();
  for (int i = 0; i < initial_states; ++i)
    normal(i, i) += 1.0 / (prior[static_cast<std::size_t>(i)] * prior[static_cast<std::size_t>(i)]);
  all -= (all * of_start.transpose()) * statistics::SymmetricFactor(normal).solve_columns(of_start);
  RepeatView view;
  view.by_theta.setZero(static_cast<Eigen::Index>(kParameterCount), rows);
  for (int i = 0; i < p; ++i) {
    const int k = unknowns.parameter(i);
    view.by_theta.row(k) =
        all.row(i) * (kParameterTable[static_cast<std::size_t>(k)].nominal / unknowns.slope(model, i));
  }
  view.by_tare = all.middleRows(p, 2);
  view.residual = all.row(p + 2).transpose();
  return view;
}

/// Sums over blocks of rows, of each reading by itself, over the root of their number.
Eigen::VectorXd in_blocks(const Eigen::VectorXd& readings) {
  const Eigen::Index rows = readings.size() / 2;
  const Eigen::Index blocks = std::max<Eigen::Index>(1, rows / kBlock_rows);
  Eigen::VectorXd sums = Eigen::VectorXd::Zero(2 * blocks);
  Eigen::VectorXd counts = Eigen::VectorXd::Zero(2 * blocks);
  for (Eigen::Index k = 0; k < rows; ++k)
    for (Eigen::Index reading = 0; reading < 2; ++reading) {
      const Eigen::Index at = 2 * std::min(k / kBlock_rows, blocks - 1) + reading;
      sums[at] += readings[2 * k + reading];
      counts[at] += 1.0;
    }
  return sums.cwiseQuotient(counts.cwiseSqrt());
}

/// Dempster's test of a mean of zero. `columns`: one repeat each.
void test_mean(const Eigen::MatrixXd& columns, SystematicMisfit& misfit) {
  const auto repeats = static_cast<double>(columns.cols());
  const double degrees = repeats - 1.0;
  const Eigen::VectorXd mean = columns.rowwise().mean();
  const Eigen::MatrixXd scatter = columns.colwise() - mean;
  const Eigen::MatrixXd gram = scatter.transpose() * scatter / degrees;  // the covariance's traces, smaller
  const double trace = gram.trace();
  const double square = gram.squaredNorm();
  if (!(trace > 0.0) || !std::isfinite(trace)) return;
  const double square_unbiased =
      degrees * degrees / ((degrees - 1.0) * (degrees + 2.0)) * (square - trace * trace / degrees);
  const double trace_square_unbiased = degrees * (degrees + 1.0) / ((degrees - 1.0) * (degrees + 2.0)) *
                                       (trace * trace - 2.0 * square / (degrees + 1.0));
  const double most = static_cast<double>(columns.rows());
  const double h =
      square_unbiased > 0.0 ? std::clamp(trace_square_unbiased / square_unbiased, 1.0, most) : most;
  const double statistic = repeats * mean.squaredNorm() / trace;
  misfit.p_value = statistics::fisher_f_p_value(statistic, h, degrees * h);
  misfit.over_noise = std::sqrt(std::max(0.0, mean.squaredNorm() / trace - 1.0 / repeats));
  misfit.can_tell = std::isfinite(misfit.p_value);
}

}  // namespace

double SystematicMisfit::moved_sd(const ParameterVector& sd_normalised) const {
  return covariance_normalised.diagonal().cwiseMax(0.0).cwiseSqrt().cwiseQuotient(sd_normalised).maxCoeff();
}

SystematicMisfit systematic_misfit(std::span<const Run> runs, const Estimate& joint) {
  SystematicMisfit misfit;
  if (runs.size() < kFewestRepeats || !joint.converged() || !joint.effects.empty() ||
      joint.initial_states.size() != runs.size() || !joint.parameters.theta.allFinite())
    return misfit;
  if (std::any_of(runs.begin(), runs.end(), [&](const Run& run) { return run.size() != runs[0].size(); }))
    return misfit;
  std::array<bool, kParameterCount> held{};
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    held[i] = joint.covariance_normalised(k, k) == 0.0;
  }
  ExtendedParameters model;
  model.base = joint.parameters;
  const NoiseLevels noise{{joint.noise_force_N, joint.noise_velocity_rad_s},
                          joint.method == Method::PredictionError ? joint.noise_torque_Nm : 0.0};
  if (!within_bounds(model)) return misfit;

  const std::vector<FitRun> fits = fit_runs(runs);
  const auto repeats = static_cast<Eigen::Index>(runs.size());
  const auto readings = static_cast<Eigen::Index>(2 * runs[0].size());
  Eigen::MatrixXd residuals(readings, repeats);
  Eigen::MatrixXd by_theta = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(kParameterCount), readings);
  Eigen::MatrixXd by_tare = Eigen::MatrixXd::Zero(2, readings);
  for (std::size_t r = 0; r < fits.size(); ++r) {
    const auto view = view_of(fits[r], model, joint.initial_states[r], noise, held);
    if (!view) return misfit;
    residuals.col(static_cast<Eigen::Index>(r)) = view->residual;
    by_theta += view->by_theta / static_cast<double>(repeats);
    by_tare += view->by_tare / static_cast<double>(repeats);
  }

  // What an error of theta or of the tare could answer is no misfit of the model.
  Eigen::MatrixXd answered(readings, by_theta.rows() + 2);
  answered << by_theta.transpose(), by_tare.transpose();
  for (Eigen::Index i = 0; i < answered.cols(); ++i)
    if (const double norm = answered.col(i).norm(); norm > 0.0) answered.col(i) /= norm;
  const Eigen::MatrixXd basis = statistics::orthonormal_basis(answered);
  const Eigen::MatrixXd left = residuals - basis * (basis.transpose() * residuals);
  Eigen::MatrixXd blocks(in_blocks(left.col(0)).size(), repeats);
  for (Eigen::Index r = 0; r < repeats; ++r) blocks.col(r) = in_blocks(left.col(r));
  test_mean(blocks, misfit);
  if (!misfit.can_tell) return misfit;

  const Eigen::VectorXd common = residuals.rowwise().mean();
  ParameterMatrix information = by_theta * by_theta.transpose();
  for (std::size_t i = 0; i < kParameterCount; ++i)
    if (held[i]) information(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(i)) = 1.0;
  ParameterMatrix spread = ParameterMatrix::Zero();
  int stretches = 0;
  for (Eigen::Index from = 0; from < readings; from += 2 * kStretch_rows, ++stretches) {
    const Eigen::Index count = std::min(2 * kStretch_rows, readings - from);
    const auto of_stretch = by_theta.middleCols(from, count);
    const ParameterVector score = of_stretch * common.segment(from, count);
    const ParameterMatrix others = information - of_stretch * of_stretch.transpose();
    const ParameterVector moved = statistics::ScaledFactor(others).solve(score);
    spread += moved * moved.transpose();
  }
  misfit.covariance_normalised = spread * (stretches - 1.0) / stretches;
  return misfit;
}

}  // namespace clampd
