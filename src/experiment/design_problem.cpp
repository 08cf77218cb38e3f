#include "design_problem.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "clampd/base/assert.hpp"

namespace clampd {

namespace {

constexpr double kNegligibleAmplification = 1e-6;

/// Share of nominal by which neighbours differ, and the change of log det M that is still steady: somewhat
/// stricter than certify().
constexpr double kNeighbour = 1.1e-5;
constexpr double kSteady = 0.25;
/// Beyond, two good integrators differ by more than certify() grants.
constexpr double kSteadyAmplification_rad_s_Nm = 6e5;

}  // namespace

DesignProblem::DesignProblem(const DesignOptions& options, double tightening)
    : model_(paper_brake(options.brake)),
      brake_(options.brake),
      noise_(options.noise),
      initial_(options.initial),
      samples_(options.samples),
      block_samples_(options.block_samples),
      blocks_(options.samples / options.block_samples),
      kind_(options.objective),
      caution_(options.objective == Objective::D ? options.caution
                                                 : options.caution / static_cast<double>(kParameterCount)),
      amplification_limited_(std::isfinite(options.limits.amplification_rad_s_Nm)),
      end_limited_(std::isfinite(options.limits.end_velocity_rad_s)),
      torque_limit_Nm_(options.limits.torque_Nm),
      force_limit_N_(options.limits.force_N * (1.0 - tightening)),
      speed_limit_rad_s_(options.limits.velocity_rad_s * (1.0 - tightening)),
      end_speed_limit_rad_s_(options.limits.end_velocity_rad_s),
      amplification_limit_(options.limits.amplification_rad_s_Nm * (1.0 - tightening)),
      ratio_m_rad_(options.brake.fixed.ratio_m_rad),
      inertia_kg_m2_(options.brake.fixed.inertia_kg_m2),
      point_(blocks_),
      sweep_(options.brake, options.noise, samples_, block_samples_),
      above_(samples_),
      below_(samples_),
      differences_(static_cast<Eigen::Index>(2 * samples_), static_cast<Eigen::Index>(kParameterCount)),
      block_torque_Nm_(blocks_),
      force_peak_(blocks_),
      speed_peak_(blocks_) {
  CLAMPD_ASSERT(blocks_ * block_samples_ == samples_ && blocks_ > 0);
  constraint_.resize(static_cast<Eigen::Index>(constraints()));
  objective_gradient_.resize(static_cast<Eigen::Index>(blocks_));
  constraint_gradient_.resize(static_cast<Eigen::Index>(constraints()), static_cast<Eigen::Index>(blocks_));
}

void DesignProblem::evaluate(std::span<const double> x) {
  if (evaluated_ && std::equal(x.begin(), x.end(), point_.begin())) return;
  std::copy(x.begin(), x.end(), point_.begin());
  evaluated_ = true;
  differentiated_ = false;
  ++simulations_;
  for (std::size_t block = 0; block < blocks_; ++block) block_torque_Nm_[block] = x[block] * torque_limit_Nm_;
  if (!sweep_.forward(initial_, block_torque_Nm_)) {
    // Far beyond the limits: any large violation tells the search to come back.
    objective_ = std::numeric_limits<double>::infinity();
    constraint_.setConstant(10.0);
    slope_.setZero();
    return;
  }
  information_.noalias() = sweep_.sensitivity().transpose() * sweep_.sensitivity();
  const ObjectivePoint point = clampd::evaluate(kind_, information_);
  objective_ = point.value;
  slope_ = point.slope;
  const auto larger = [](double a, double b) { return std::abs(a) < std::abs(b); };
  for (std::size_t block = 0; block < blocks_; ++block) {
    const auto first = static_cast<std::ptrdiff_t>(block * block_samples_ + 1);
    const auto last = static_cast<std::ptrdiff_t>(std::min((block + 1) * block_samples_ + 1, samples_));
    const auto peak = [&](const std::vector<double>& values) {
      // A block of one sample at the very end has no sample of its own; it repeats the one before.
      const auto begin = values.begin() + std::min(first, last - 1);
      return static_cast<std::size_t>(std::max_element(begin, values.begin() + last, larger) -
                                      values.begin());
    };
    force_peak_[block] = peak(sweep_.force_N());
    speed_peak_[block] = peak(sweep_.velocity_rad_s());
    constraint_[static_cast<Eigen::Index>(block)] =
        sweep_.force_N()[force_peak_[block]] / force_limit_N_ - 1.0;
    constraint_[static_cast<Eigen::Index>(blocks_ + block)] =
        std::abs(sweep_.velocity_rad_s()[speed_peak_[block]]) / speed_limit_rad_s_ - 1.0;
  }
  amplification_peak_ = 0;
  for (std::size_t row = 1; row < samples_; ++row)
    if (larger(sweep_.amplification(amplification_peak_), sweep_.amplification(row)))
      amplification_peak_ = row;
  objective_ += caution_ *
                std::log1p(std::abs(sweep_.amplification(amplification_peak_)) / kEasyAmplification_rad_s_Nm);
  if (amplification_limited_) {
    // It grows exponentially in the torques. Far below the limit its logarithm says nothing of use.
    const double amplification = std::abs(sweep_.amplification(amplification_peak_)) / amplification_limit_;
    constraint_[amplification_row()] = std::log(std::max(amplification, kNegligibleAmplification));
  }
  if (end_limited_)
    constraint_[end_row()] =
        (std::abs(sweep_.velocity_rad_s().back()) - end_speed_limit_rad_s_) / speed_limit_rad_s_;
}

void DesignProblem::differentiate_constraints() {
  std::vector<double> force(blocks_);
  std::vector<double> velocity(blocks_);
  const auto put = [&](Eigen::Index row, const std::vector<double>& values, double factor) {
    for (std::size_t block = 0; block < blocks_; ++block)
      constraint_gradient_(row, static_cast<Eigen::Index>(block)) = factor * values[block];
  };
  const auto speed_factor = [&](std::size_t row) {
    return std::copysign(torque_limit_Nm_ / speed_limit_rad_s_, sweep_.velocity_rad_s()[row]);
  };
  for (std::size_t block = 0; block < blocks_; ++block) {
    sweep_.output_gradients(force_peak_[block], force, velocity);
    put(static_cast<Eigen::Index>(block), force, torque_limit_Nm_ / force_limit_N_);
    sweep_.output_gradients(speed_peak_[block], force, velocity);
    put(static_cast<Eigen::Index>(blocks_ + block), velocity, speed_factor(speed_peak_[block]));
  }
  if (amplification_limited_ && constraint_[amplification_row()] > std::log(kNegligibleAmplification)) {
    std::fill(velocity.begin(), velocity.end(), 0.0);
    sweep_.backward_amplification({.row = amplification_peak_, .weight = 1.0}, velocity);
    put(amplification_row(), velocity, torque_limit_Nm_ / sweep_.amplification(amplification_peak_));
  }
  if (end_limited_) {
    sweep_.output_gradients(samples_ - 1, force, velocity);
    put(end_row(), velocity, speed_factor(samples_ - 1));
  }
}

void DesignProblem::differentiate(std::span<const double> x) {
  evaluate(x);
  if (differentiated_) return;
  differentiated_ = true;
  objective_gradient_.setZero();
  constraint_gradient_.setZero();
  if (!std::isfinite(objective_)) return;
  // dJ = trace(slope dM) with M = S^T S, so that dJ = <2 S slope, dS>.
  weights_.noalias() = 2.0 * sweep_.sensitivity() * slope_;
  const double amplification = sweep_.amplification(amplification_peak_);
  const double price =
      std::copysign(caution_ / (kEasyAmplification_rad_s_Nm + std::abs(amplification)), amplification);
  sweep_.backward(weights_, {.row = amplification_peak_, .weight = price},
                  {objective_gradient_.data(), blocks_});
  objective_gradient_ *= torque_limit_Nm_;
  differentiate_constraints();
}

bool DesignProblem::is_steady(std::span<const double> x) {
  evaluate(x);
  if (std::abs(sweep_.amplification(amplification_peak_)) > kSteadyAmplification_rad_s_Nm) return false;
  std::vector<double> torque_Nm(samples_);
  for (std::size_t row = 0; row < samples_; ++row) torque_Nm[row] = block_torque_Nm_[row / block_samples_];
  const ParameterVector nominal = nominal_parameters();
  for (Eigen::Index i = 0; i < nominal.size(); ++i) {
    BrakeParameters neighbour = brake_;
    neighbour.theta[i] += kNeighbour * nominal[i];
    simulate(neighbour, initial_, Excitation{.torque_Nm = torque_Nm}, above_);
    neighbour.theta[i] = brake_.theta[i] - kNeighbour * nominal[i];
    simulate(neighbour, initial_, Excitation{.torque_Nm = torque_Nm}, below_);
    simulations_ += 2;
    for (std::size_t row = 0; row < samples_; ++row) {
      const auto at = static_cast<Eigen::Index>(2 * row);
      differences_(at, i) = (above_.force_N[row] - below_.force_N[row]) / (2.0 * kNeighbour * noise_.force_N);
      differences_(at + 1, i) = (above_.velocity_rad_s[row] - below_.velocity_rad_s[row]) /
                                (2.0 * kNeighbour * noise_.velocity_rad_s);
    }
  }
  const ParameterMatrix information = differences_.transpose() * differences_;
  return std::abs(log_det(information) - log_det(information_)) <= kSteady;
}

bool DesignProblem::keeps_limits(BrakeState& state, double torque_Nm) const {
  for (std::size_t i = 0; i < block_samples_; ++i) {
    state = advance(model_, state, torque_Nm, kMaxStep_s);
    if (!is_bounded(state) || std::abs(state[1]) > speed_limit_rad_s_ ||
        model_.read(state).force_N > force_limit_N_)
      return false;
  }
  // Full reverse torque from here on must stop the brake within the force limit.
  if (state[1] <= 0.0) return true;
  const double braking = (torque_limit_Nm_ + ratio_m_rad_ * model_.read(state).force_N) / inertia_kg_m2_;
  const BrakeState stopped(state[0] + 0.5 * state[1] * state[1] / braking, 0.0);
  return model_.read(stopped).force_N <= force_limit_N_;
}

void DesignProblem::random_tail(std::mt19937_64& random, std::size_t from, std::span<double> x) {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> normal;
  BrakeState state = initial_;
  for (std::size_t block = 0; block < from; ++block)
    for (std::size_t i = 0; i < block_samples_ && is_bounded(state); ++i)
      state = advance(model_, state, x[block] * torque_limit_Nm_, kMaxStep_s);
  ++simulations_;
  double previous = from > 0 ? x[from - 1] : 0.0;
  for (std::size_t block = from; block < blocks_; ++block) {
    const double kind = unit(random);
    double share;
    if (kind < 0.3)
      share = unit(random) < 0.5 ? -1.0 : 1.0;
    else if (kind < 0.6)
      share = 2.0 * unit(random) - 1.0;
    else if (kind < 0.8)
      share = previous + 0.2 * normal(random);
    else  // near the balance of the clamp force
      share = ratio_m_rad_ * model_.read(state).force_N / torque_limit_Nm_ + 0.3 * normal(random);
    share = std::clamp(share, -1.0, 1.0);
    BrakeState reached = state;
    constexpr int kAttempts = 8;
    for (int attempt = 0; attempt < kAttempts; ++attempt) {
      reached = state;
      if (keeps_limits(reached, share * torque_limit_Nm_)) break;
      const double other = state[1] > 0.0 ? -1.0 : 1.0;
      share += (other - share) * unit(random);
    }
    state = reached;
    x[block] = previous = share;
  }
}

}  // namespace clampd
