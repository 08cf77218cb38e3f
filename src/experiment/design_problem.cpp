#include "design_problem.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "clampd/base/assert.hpp"

namespace clampd {

namespace {

/// Step of the forward differences, as a share of the torque limit: truncation and rounding both stay some
/// orders below what the search needs, since sensitivities to the torque itself are exact and smooth.
constexpr double kDifferenceStep = 3e-7;

constexpr double kNegligibleAmplification = 1e-6;

}  // namespace

DesignProblem::DesignProblem(const DesignOptions& options, double tightening)
    : model_(paper_brake(options.brake)),
      initial_(options.initial),
      samples_(options.samples),
      block_samples_(options.block_samples),
      blocks_(options.samples / options.block_samples),
      kind_(options.objective),
      end_limited_(std::isfinite(options.limits.end_velocity_rad_s)),
      torque_limit_Nm_(options.limits.torque_Nm),
      force_limit_N_(options.limits.force_N * (1.0 - tightening)),
      speed_limit_rad_s_(options.limits.velocity_rad_s * (1.0 - tightening)),
      end_speed_limit_rad_s_(options.limits.end_velocity_rad_s),
      amplification_limit_(options.limits.amplification_rad_s_Nm * (1.0 - tightening)),
      ratio_m_rad_(options.brake.fixed.ratio_m_rad),
      inertia_kg_m2_(options.brake.fixed.inertia_kg_m2),
      point_(blocks_),
      nodes_(blocks_),
      force_peak_(blocks_),
      speed_peak_(blocks_),
      moved_point_(blocks_) {
  CLAMPD_ASSERT(blocks_ * block_samples_ == samples_ && blocks_ > 0);
  const ParameterVector nominal = nominal_parameters();
  force_scale_ = nominal.transpose().array() / options.noise.force_N;
  velocity_scale_ = nominal.transpose().array() / options.noise.velocity_rad_s;
  for (Trace* trace : {&trace_, &moved_}) {
    trace->force_N.resize(samples_);
    trace->speed_rad_s.resize(samples_);
    trace->amplification.resize(samples_);
    trace->sensitivity.resize(static_cast<Eigen::Index>(2 * samples_), Eigen::NoChange);
  }
  weights_.resize(static_cast<Eigen::Index>(2 * samples_), Eigen::NoChange);
  constraint_.resize(static_cast<Eigen::Index>(constraints()));
  objective_gradient_.resize(static_cast<Eigen::Index>(blocks_));
  constraint_gradient_.resize(static_cast<Eigen::Index>(constraints()), static_cast<Eigen::Index>(blocks_));
}

void DesignProblem::record(const Node& node, std::size_t row, Trace& trace) const {
  Eigen::Matrix2d by_state;
  Eigen::Matrix<double, 2, PaperBrake::kParameters> by_parameter;
  const Reading reading = model_.read(node.state);
  model_.linearise_readings(node.state, by_state, by_parameter);
  trace.force_N[row] = reading.force_N;
  trace.speed_rad_s[row] = std::abs(reading.velocity_rad_s);
  trace.amplification[row] = std::abs(node.tangent.velocity[T::kTorque]);
  const auto position = node.tangent.position.head<PaperBrake::kParameters>();
  const auto velocity = node.tangent.velocity.head<PaperBrake::kParameters>();
  const auto at = static_cast<Eigen::Index>(2 * row);
  for (int i = 0; i < PaperBrake::kParameters; ++i) {
    trace.sensitivity(at, i) =
        force_scale_[i] * (by_state(0, 0) * position[i] + by_state(0, 1) * velocity[i] + by_parameter(0, i));
    trace.sensitivity(at + 1, i) = velocity_scale_[i] * (by_state(1, 0) * position[i] +
                                                         by_state(1, 1) * velocity[i] + by_parameter(1, i));
  }
}

bool DesignProblem::simulate_from(std::size_t from, std::span<const double> x, Trace& trace,
                                  bool keep_nodes) {
  Node node = nodes_[from];
  simulated_rows_ += static_cast<double>(samples_ - from * block_samples_);
  std::size_t row = from * block_samples_;
  for (std::size_t block = from; block < blocks_; ++block) {
    if (keep_nodes) nodes_[block] = node;
    const double torque_Nm = x[block] * torque_limit_Nm_;
    for (std::size_t i = 0; i < block_samples_ && row + 1 < samples_; ++i) {
      node.state = advance_with_tangent(model_, node.state, node.tangent, torque_Nm, kLargestStep_s);
      if (!is_bounded(node.state)) return false;
      record(node, ++row, trace);
    }
  }
  return true;
}

void DesignProblem::evaluate(std::span<const double> x) {
  if (evaluated_ && std::equal(x.begin(), x.end(), point_.begin())) return;
  std::copy(x.begin(), x.end(), point_.begin());
  evaluated_ = true;
  differentiated_ = false;
  nodes_[0].state = initial_;
  nodes_[0].tangent = T::identity();
  record(nodes_[0], 0, trace_);
  if (!simulate_from(0, x, trace_, true)) {
    // Far beyond the limits: any large violation tells the search to come back.
    objective_ = std::numeric_limits<double>::infinity();
    constraint_.setConstant(10.0);
    slope_.setZero();
    return;
  }
  information_.noalias() = trace_.sensitivity.transpose() * trace_.sensitivity;
  const ObjectivePoint point = clampd::evaluate(kind_, information_);
  objective_ = point.value;
  slope_ = point.slope;
  for (std::size_t block = 0; block < blocks_; ++block) {
    const auto first = static_cast<std::ptrdiff_t>(block * block_samples_ + 1);
    const auto last = static_cast<std::ptrdiff_t>(std::min((block + 1) * block_samples_ + 1, samples_));
    const auto peak = [&](const std::vector<double>& values) {
      // A block of one sample at the very end has no sample of its own; it repeats the one before.
      const auto begin = values.begin() + std::min(first, last - 1);
      return static_cast<std::size_t>(std::max_element(begin, values.begin() + last) - values.begin());
    };
    force_peak_[block] = peak(trace_.force_N);
    speed_peak_[block] = peak(trace_.speed_rad_s);
    constraint_[static_cast<Eigen::Index>(block)] = trace_.force_N[force_peak_[block]] / force_limit_N_ - 1.0;
    constraint_[static_cast<Eigen::Index>(blocks_ + block)] =
        trace_.speed_rad_s[speed_peak_[block]] / speed_limit_rad_s_ - 1.0;
  }
  amplification_peak_ =
      static_cast<std::size_t>(std::max_element(trace_.amplification.begin(), trace_.amplification.end()) -
                               trace_.amplification.begin());
  // It grows exponentially in the torques. Far below the limit its logarithm says nothing of use.
  const double amplification = trace_.amplification[amplification_peak_] / amplification_limit_;
  constraint_[amplification_row()] = std::log(std::max(amplification, kNegligibleAmplification));
  if (end_limited_)
    constraint_[end_row()] = (trace_.speed_rad_s.back() - end_speed_limit_rad_s_) / speed_limit_rad_s_;
}

void DesignProblem::differentiate(std::span<const double> x) {
  evaluate(x);
  if (differentiated_) return;
  differentiated_ = true;
  objective_gradient_.setZero();
  constraint_gradient_.setZero();
  if (!std::isfinite(objective_)) return;
  // dJ = trace(slope dM) with M = S^T S, so that dJ = <2 S slope, dS>.
  weights_.noalias() = 2.0 * trace_.sensitivity * slope_;
  std::copy(x.begin(), x.end(), moved_point_.begin());
  for (std::size_t block = 0; block < blocks_; ++block) {
    // Towards the inside, so that no step leaves the bounds.
    const double step = x[block] > 0.0 ? -kDifferenceStep : kDifferenceStep;
    moved_point_[block] = x[block] + step;
    const double taken = moved_point_[block] - x[block];
    const bool bounded = simulate_from(block, moved_point_, moved_, false);
    moved_point_[block] = x[block];
    if (!bounded) continue;
    const auto column = static_cast<Eigen::Index>(block);
    const std::size_t first = block * block_samples_ + 1;
    if (first >= samples_) continue;
    const auto rows = static_cast<Eigen::Index>(2 * (samples_ - first));
    objective_gradient_[column] =
        (weights_.bottomRows(rows).array() *
         (moved_.sensitivity.bottomRows(rows) - trace_.sensitivity.bottomRows(rows)).array())
            .sum() /
        taken;
    for (std::size_t later = block; later < blocks_; ++later) {
      const std::size_t force_row = force_peak_[later];
      const std::size_t speed_row = speed_peak_[later];
      if (force_row >= first)
        constraint_gradient_(static_cast<Eigen::Index>(later), column) =
            (moved_.force_N[force_row] - trace_.force_N[force_row]) / (taken * force_limit_N_);
      if (speed_row >= first)
        constraint_gradient_(static_cast<Eigen::Index>(blocks_ + later), column) =
            (moved_.speed_rad_s[speed_row] - trace_.speed_rad_s[speed_row]) / (taken * speed_limit_rad_s_);
    }
    if (amplification_peak_ >= first && constraint_[amplification_row()] > std::log(kNegligibleAmplification))
      constraint_gradient_(amplification_row(), column) =
          std::log(moved_.amplification[amplification_peak_] / trace_.amplification[amplification_peak_]) /
          taken;
    if (end_limited_)
      constraint_gradient_(end_row(), column) =
          (moved_.speed_rad_s.back() - trace_.speed_rad_s.back()) / (taken * speed_limit_rad_s_);
  }
}

bool DesignProblem::keeps_limits(BrakeState& state, double torque_Nm) const {
  for (std::size_t i = 0; i < block_samples_; ++i) {
    state = advance(model_, state, torque_Nm, kLargestStep_s);
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
      state = advance(model_, state, x[block] * torque_limit_Nm_, kLargestStep_s);
  simulated_rows_ += static_cast<double>(samples_);
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
