#include "clampd/identify/systematic_misfit.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "clampd/base/assert.hpp"
#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/effect_misfit.hpp"
#include "src/identify/initial_state_prior.hpp"
#include "src/identify/joint_fit.hpp"

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

/// L of L^T L = weight, lower triangular: residuals times L^T are white, the force's first.
Eigen::Matrix2d whitening(const Eigen::Matrix2d& weight) {
  Eigen::Matrix2d lower = Eigen::Matrix2d::Zero();
  lower(1, 1) = std::sqrt(weight(1, 1));
  lower(1, 0) = weight(1, 0) / lower(1, 1);
  lower(0, 0) = std::sqrt(weight(0, 0) - lower(1, 0) * lower(1, 0));
  return lower;
}

std::optional<RepeatView> view_of(const Run& run, const BrakeParameters& parameters,
                                  const BrakeState& initial, const NoiseLevels& noise, const Held& held) {
  LinearRun linear;
  linear.resize(run.size());
  if (!extended_kalman_filter(run, parameters, initial, variances_of(noise), {}, linear)) return std::nullopt;
  normal_equations(linear);
  if (!linear.innovations.allFinite()) return std::nullopt;
  Eigen::Matrix<double, kUnknowns + 3, Eigen::Dynamic> all(kUnknowns + 3, linear.innovations.cols());
  Eigen::Matrix2d state_by_tare = Eigen::Matrix2d::Zero();
  for (std::size_t k = 0; k < run.size(); ++k) {
    const LinearRow& row = linear.rows[k];
    const RowGain& gain = linear.gains[k];
    const auto at = static_cast<Eigen::Index>(2 * k);
    const Eigen::Matrix2d by_tare = Eigen::Matrix2d::Identity() - row.by_state * state_by_tare;
    auto columns = all.middleCols<2>(at);
    columns << linear.innovations.middleCols<2>(at), by_tare.transpose();
    columns *= whitening(gain.weight).transpose().eval();
    state_by_tare = row.transition * (state_by_tare + gain.gain * by_tare).eval();
  }
  const Eigen::MatrixXd of_start = all.middleRows<2>(kTheta);
  Eigen::MatrixXd normal = of_start * of_start.transpose();
  for (int i = 0; i < 2; ++i) normal(i, i) += 1.0 / (kInitialStatePrior[i] * kInitialStatePrior[i]);
  all -= (all * of_start.transpose()) * statistics::SymmetricFactor(normal).solve_columns(of_start);
  RepeatView view{all.row(kDataColumn).transpose(), all.topRows<kTheta>(), all.bottomRows<2>()};
  for (int i = 0; i < kTheta; ++i)
    if (held[static_cast<std::size_t>(i)]) view.by_theta.row(i).setZero();
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

/// What repeats have in common; where that is significant, the jackknife over stretches. `held`: parameters
/// that did not move; `noise`: by which the estimate's own method weighs the residuals.
SystematicMisfit misfit_of_repeats(std::span<const Run> runs, const Estimate& joint, const Held& held,
                                   const NoiseLevels& noise, std::span<const std::uint8_t> motions) {
  SystematicMisfit misfit;
  std::vector<std::size_t> alike;
  for (std::size_t r = 0; r < runs.size(); ++r)
    if (motions.empty() || motions[r] == motions[0]) alike.push_back(r);
  if (alike.size() < kFewestRepeats || std::any_of(alike.begin(), alike.end(), [&](std::size_t r) {
        return runs[r].size() != runs[0].size();
      }))
    return misfit;

  const auto repeats = static_cast<Eigen::Index>(alike.size());
  const auto readings = static_cast<Eigen::Index>(2 * runs[0].size());
  Eigen::MatrixXd residuals(readings, repeats);
  Eigen::MatrixXd by_theta = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(kParameterCount), readings);
  Eigen::MatrixXd by_tare = Eigen::MatrixXd::Zero(2, readings);
  for (Eigen::Index column = 0; column < repeats; ++column) {
    const std::size_t r = alike[static_cast<std::size_t>(column)];
    const auto view = view_of(runs[r], joint.parameters, joint.initial_states[r], noise, held);
    if (!view) return misfit;
    residuals.col(column) = view->residual;
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
  if (!misfit.is_significant()) return misfit;

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

}  // namespace

double SystematicMisfit::moved_sd(const ParameterVector& sd_normalised) const {
  return covariance_normalised.diagonal().cwiseMax(0.0).cwiseSqrt().cwiseQuotient(sd_normalised).maxCoeff();
}

SystematicMisfit systematic_misfit(std::span<const Run> runs, const Estimate& joint,
                                   std::span<const std::uint8_t> motions) {
  CLAMPD_ASSERT(motions.empty() || motions.size() == runs.size());
  if (!joint.converged() || !joint.effects.empty() || joint.initial_states.size() != runs.size() ||
      !joint.parameters.theta.allFinite() || !within_bounds(joint.parameters.theta))
    return {};
  Held held{};
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    held[i] = joint.covariance_normalised(k, k) == 0.0;
  }
  const NoiseLevels noise{{joint.noise_force_N, joint.noise_velocity_rad_s},
                          joint.method == Method::PredictionError ? joint.noise_torque_Nm : 0.0};
  const SystematicMisfit of_repeats = misfit_of_repeats(runs, joint, held, noise, motions);
  const EffectMisfit of_effects = effect_misfit(runs, joint, held, noise);
  SystematicMisfit misfit{.can_tell = of_repeats.can_tell || of_effects.can_tell,
                          .over_noise = of_repeats.over_noise};
  const double tests = of_repeats.can_tell && of_effects.can_tell ? 2.0 : 1.0;
  for (const auto& [p_value, covariance] :
       {std::pair(tests * of_repeats.p_value, of_repeats.covariance_normalised),
        std::pair(tests * of_effects.p_value, of_effects.covariance_normalised)}) {
    misfit.p_value = std::min(misfit.p_value, p_value);
    if (p_value < kSystematic) misfit.covariance_normalised += covariance;
  }
  return misfit;
}

}  // namespace clampd
