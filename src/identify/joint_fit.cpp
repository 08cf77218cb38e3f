#include "src/identify/joint_fit.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/LU>

#include "src/identify/starting_point.hpp"

namespace clampd::identify {

namespace {

/// Huber's bend, in standard deviations, and the mean of the weighted square of a standard normal with it.
constexpr double kHuberBend = 2.5;
constexpr double kHuberSquare = 0.9876;

/// A step changes a logarithmic parameter by no more than this: linearised far beyond where that holds, a
/// first step can throw one next to zero, where its slope vanishes with it and nothing leads back.
constexpr double kReach = 0.7;

bool is_logarithmic(int parameter) {
  return parameter != static_cast<int>(k1);
}

}  // namespace

bool within_bounds(const ParameterVector& theta) {
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double value = theta[static_cast<Eigen::Index>(i)];
    if (!(value >= kParameterTable[i].lower && value <= kParameterTable[i].upper)) return false;
  }
  return true;
}

JointFit::JointFit(std::span<const Run> runs, const EstimatorOptions& options)
    : runs_(runs),
      options_(options),
      free_(static_cast<int>(std::count(options.held.begin(), options.held.end(), false))),
      weights_(runs.size()),
      guesses_(runs.size(), Eigen::Vector2d::Zero()) {
  for (Evaluation* evaluation : {&now_, &before_}) {
    evaluation->linear.resize(runs.size());
    for (std::size_t r = 0; r < runs.size(); ++r) evaluation->linear[r].resize(runs[r].size());
    evaluation->normals.resize(runs.size());
    evaluation->unknowns.resize(NumParameters());
  }
  invalidate();
}

void JointFit::invalidate() {
  for (Evaluation* evaluation : {&now_, &before_}) {
    evaluation->unknowns.setConstant(std::numeric_limits<double>::quiet_NaN());
    evaluation->possible = false;
  }
}

Eigen::VectorXd JointFit::start_from(const ParameterVector& theta) {
  for (std::size_t r = 0; r < runs_.size(); ++r) guesses_[r] = initial_state_guess(runs_[r], theta);
  invalidate();
  return unknowns_of(theta, guesses_);
}

Eigen::VectorXd JointFit::unknowns_of(const ParameterVector& theta,
                                      std::span<const Eigen::Vector2d> initial) const {
  Eigen::VectorXd unknowns(NumParameters());
  Eigen::Index next = 0;
  for (int i = 0; i < kTheta; ++i) {
    if (options_.held[static_cast<std::size_t>(i)]) continue;
    const double normalised = theta[i] / kParameterTable[static_cast<std::size_t>(i)].nominal;
    unknowns[next++] = is_logarithmic(i) ? std::log(normalised) : normalised;
  }
  for (const Eigen::Vector2d& state : initial) {
    unknowns.segment<2>(next) = state;
    next += 2;
  }
  return unknowns;
}

ParameterVector JointFit::theta_of(const Eigen::VectorXd& unknowns) const {
  ParameterVector theta = options_.start.theta;
  Eigen::Index next = 0;
  for (int i = 0; i < kTheta; ++i) {
    if (options_.held[static_cast<std::size_t>(i)]) continue;
    const double value = unknowns[next++];
    theta[i] =
        (is_logarithmic(i) ? std::exp(value) : value) * kParameterTable[static_cast<std::size_t>(i)].nominal;
  }
  return theta;
}

Eigen::Vector2d JointFit::initial_of(const Eigen::VectorXd& unknowns, std::size_t run) const {
  return unknowns.segment<2>(free_ + 2 * static_cast<Eigen::Index>(run));
}

void JointFit::use_output_errors(const Variances& variances) {
  const bool rows_hold = !innovations_ && now_.possible;
  variances_ = variances;
  innovations_ = false;
  if (!rows_hold) invalidate();
  before_.unknowns.setConstant(std::numeric_limits<double>::quiet_NaN());
  set_output_error_gains(now_);
  set_output_error_gains(before_);
  if (rows_hold) weigh();
}

void JointFit::restore_output_errors() {
  set_output_error_gains(now_);
  weigh();
}

void JointFit::set_output_error_gains(Evaluation& evaluation) {
  for (std::size_t r = 0; r < runs_.size(); ++r)
    ignore_torque_noise(variances_, weights_[r], evaluation.linear[r]);
}

void JointFit::weigh() const {
  for_each_index(runs_.size(), options_.threads, [&](std::size_t r) {
    now_.normals[r] = normal_equations(now_.linear[r]);
    add_initial_state_prior(initial_of(now_.unknowns, r) - guesses_[r], now_.normals[r]);
  });
}

bool JointFit::use_innovations(const Eigen::VectorXd& unknowns, const Variances& variances) {
  const BrakeParameters parameters{theta_of(unknowns), options_.start.fixed};
  const bool possible = for_each_index_while(runs_.size(), options_.threads, [&](std::size_t r) {
    return extended_kalman_filter(runs_[r], parameters, initial_of(unknowns, r), variances, weights_[r],
                                  now_.linear[r]);
  });
  if (!possible) return false;
  for (std::size_t r = 0; r < runs_.size(); ++r) before_.linear[r].gains = now_.linear[r].gains;
  variances_ = variances;
  innovations_ = true;
  invalidate();
  return true;
}

double JointFit::update_weights() {
  if (options_.loss == Loss::Squared) return 0.0;
  double change = 0.0;
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    ReadingWeights& weights = weights_[r];
    weights.force.resize(runs_[r].size(), 1.0);
    weights.velocity.resize(runs_[r].size(), 1.0);
    for (std::size_t k = 0; k < runs_[r].size(); ++k) {
      const LinearRow& row = now_.linear[r].rows[k];
      // Weighed with the covariance that the innovation has if its readings count fully.
      const Eigen::Matrix2d state =
          row.by_state * now_.linear[r].gains[k].covariance * row.by_state.transpose();
      const double deviation[2] = {std::sqrt(variances_.force + state(0, 0)),
                                   std::sqrt(variances_.velocity + state(1, 1))};
      double* const weight[2] = {&weights.force[k], &weights.velocity[k]};
      for (int i = 0; i < 2; ++i) {
        const double now = std::min(1.0, kHuberBend * deviation[i] / std::abs(row.residual[i]));
        change = std::max(change, std::abs(now - *weight[i]));
        *weight[i] = now;
      }
    }
  }
  return change;
}

bool JointFit::evaluate(const Eigen::VectorXd& unknowns) const {
  return evaluate(unknowns.data());
}

bool JointFit::evaluate(const double* unknowns) const {
  const Eigen::Map<const Eigen::VectorXd> point(unknowns, NumParameters());
  if (point == now_.unknowns) return now_.possible;
  std::swap(now_, before_);
  if (point == now_.unknowns) return now_.possible;
  now_.unknowns = point;
  now_.possible = false;
  const BrakeParameters parameters{theta_of(now_.unknowns), options_.start.fixed};
  if (!within_bounds(parameters.theta)) return false;
  now_.normalised = parameters.theta.cwiseQuotient(nominal_parameters());
  const bool possible = for_each_index_while(runs_.size(), options_.threads, [&](std::size_t r) {
    const Eigen::Vector2d initial = initial_of(now_.unknowns, r);
    return innovations_ ? linearise_with_gains(runs_[r], parameters, initial, now_.linear[r])
                        : linearise(runs_[r], parameters, initial, now_.linear[r]);
  });
  if (!possible) return false;
  weigh();
  now_.possible = true;
  return true;
}

bool JointFit::is_within_reach(const double* unknowns) const {
  if (anchor_.size() == 0) return true;
  Eigen::Index next = 0;
  for (int i = 0; i < kTheta; ++i) {
    if (options_.held[static_cast<std::size_t>(i)]) continue;
    if (is_logarithmic(i) && !(std::abs(unknowns[next] - anchor_[next]) <= kReach)) return false;
    ++next;
  }
  return true;
}

bool JointFit::operator()(const double* unknowns, double* residuals, double* jacobian) const {
  Eigen::Map<Eigen::VectorXd> residual_rows(residuals, NumResiduals());
  if (!is_within_reach(unknowns) || !evaluate(unknowns)) {
    residual_rows.setConstant(std::sqrt(kImpossible / NumResiduals()));
    if (jacobian != nullptr) Eigen::Map<Eigen::MatrixXd>(jacobian, NumResiduals(), NumParameters()).setZero();
    return true;
  }
  if (jacobian == nullptr) {
    residual_rows.setZero();
    residual_rows[0] = std::sqrt(sum_of_squares());
    return true;
  }
  Eigen::Map<Eigen::MatrixXd> jacobian_rows(jacobian, NumResiduals(), NumParameters());
  jacobian_rows.setZero();
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    Normal normal = now_.normals[r];
    for (int i = 0; i < kTheta; ++i) {
      if (!is_logarithmic(i)) continue;
      normal.row(i) *= now_.normalised[i];
      normal.col(i) *= now_.normalised[i];
    }
    const Normal factor = semidefinite_factor(normal);
    const auto row = static_cast<Eigen::Index>(r) * (kUnknowns + 1);
    Eigen::Index column = 0;
    for (int i = 0; i < kTheta; ++i)
      if (!options_.held[static_cast<std::size_t>(i)])
        jacobian_rows.block<kUnknowns + 1, 1>(row, column++) = factor.col(i);
    jacobian_rows.block<kUnknowns + 1, 2>(row, free_ + 2 * static_cast<Eigen::Index>(r)) =
        factor.middleCols<2>(kTheta);
    residual_rows.segment<kUnknowns + 1>(row) = factor.col(kDataColumn);
  }
  return true;
}

double JointFit::sum_of_squares() const {
  double sum = 0.0;
  for (const Normal& normal : now_.normals) sum += normal(kDataColumn, kDataColumn);
  return sum;
}

double JointFit::log_likelihood() const {
  double sum = sum_of_squares();
  for (const LinearRun& run : now_.linear) {
    sum += 2.0 * std::log(2.0 * std::numbers::pi) * static_cast<double>(run.rows.size());
    for (const RowGain& gain : run.gains) sum -= std::log(gain.weight.determinant());
  }
  return -0.5 * sum;
}

double JointFit::expected_decrease() const {
  const JointNormal joint = joint_normal(options_.held);
  return sum_of_squares() - joint.sum_of_squares - joint.gradient.dot(step_to_minimum(joint));
}

void JointFit::gauss_newton_step(Eigen::VectorXd& step) const {
  const JointNormal joint = joint_normal(options_.held);
  const ParameterVector theta = step_to_minimum(joint);
  Eigen::Index next = 0;
  for (int i = 0; i < kTheta; ++i) {
    if (options_.held[static_cast<std::size_t>(i)]) continue;
    step[next++] = is_logarithmic(i) ? std::clamp(theta[i] / now_.normalised[i], -0.5, 0.5) : theta[i];
  }
  for (const Normal& normal : now_.normals) {
    step.segment<2>(next) =
        -elimination(normal).transpose() * theta -
        normal.block<2, 2>(kTheta, kTheta).inverse() * normal.block<2, 1>(kTheta, kDataColumn);
    next += 2;
  }
}

Eigen::Vector2d JointFit::mean_squares(std::size_t run) const {
  const ReadingWeights& weights = weights_[run];
  const auto& rows = now_.linear[run].rows;
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const Eigen::Vector2d square = rows[k].residual.cwiseAbs2();
    sum[0] += weights.force.empty() ? square[0] : weights.force[k] * square[0];
    sum[1] += weights.velocity.empty() ? square[1] : weights.velocity[k] * square[1];
  }
  sum /= static_cast<double>(rows.size());
  return options_.loss == Loss::Robust ? Eigen::Vector2d(sum / kHuberSquare) : sum;
}

Eigen::Vector2d JointFit::mean_squares() const {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double rows = 0.0;
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    const auto size = static_cast<double>(runs_[r].size());
    sum += size * mean_squares(r);
    rows += size;
  }
  return sum / rows;
}

void LagSums::add(const Eigen::Vector2d& residual) {
  square_ += residual.cwiseAbs2();
  for (int lag = 0; lag < std::min(before_, kLags); ++lag) lagged_ += residual.cwiseProduct(past_[lag]);
  for (int lag = kLags - 1; lag > 0; --lag) past_[lag] = past_[lag - 1];
  past_[0] = residual;
  ++before_;
  rows_ += 1.0;
}

bool LagSums::white() const {
  constexpr double kDeviations = 3.3;
  // Each correlation has a variance of 1/n if the residuals are white.
  return (lagged_.array() < kDeviations * std::sqrt(kLags / rows_) * square_.array()).all();
}

bool JointFit::white() const {
  LagSums sums;
  for (const LinearRun& run : now_.linear) {
    sums.start_run();
    for (const LinearRow& row : run.rows) sums.add(row.residual);
  }
  return sums.white();
}

std::vector<Eigen::Vector2d> JointFit::prior_distances() const {
  std::vector<Eigen::Vector2d> distances;
  for (std::size_t r = 0; r < runs_.size(); ++r)
    distances.push_back(initial_of(now_.unknowns, r) - guesses_[r]);
  return distances;
}

}  // namespace clampd::identify
