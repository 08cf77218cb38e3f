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

double nominal_of(int parameter) {
  return kParameterTable[static_cast<std::size_t>(parameter)].nominal;
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
    : FitOfRuns(runs, options.threads), options_(options), weights_(runs.size()) {
  for (int i = 0; i < kTheta; ++i)
    if (!options.held[static_cast<std::size_t>(i)]) free_.push_back(i);
  set_size(static_cast<int>(free_.size()), kInitialStatePrior, kUnknowns + 1,
           [](const Run& run, LinearRun& linear) { linear.resize(run.size()); });
}

Eigen::VectorXd JointFit::start_from(const ParameterVector& theta) {
  for (std::size_t r = 0; r < runs_.size(); ++r) centres_[r] = initial_state_guess(runs_[r], theta);
  invalidate();
  return unknowns_of(theta, centres_);
}

Eigen::VectorXd JointFit::unknowns_of(const ParameterVector& theta,
                                      std::span<const Eigen::Vector2d> initial) const {
  Eigen::VectorXd unknowns(NumParameters());
  for (int i = 0; i < parameters_; ++i) {
    const double normalised = theta[column(i)] / nominal_of(column(i));
    unknowns[i] = is_logarithmic(column(i)) ? std::log(normalised) : normalised;
  }
  for (std::size_t r = 0; r < runs_.size(); ++r) unknowns.segment<2>(first_of(r)) = initial[r];
  return unknowns;
}

ParameterVector JointFit::theta_of(const Point& unknowns) const {
  ParameterVector theta = options_.start.theta;
  for (int i = 0; i < parameters_; ++i)
    theta[column(i)] =
        (is_logarithmic(column(i)) ? std::exp(unknowns[i]) : unknowns[i]) * nominal_of(column(i));
  return theta;
}

void JointFit::use_output_errors(const Variances& variances) {
  const bool rows_hold = !innovations_ && now_.possible;
  variances_ = variances;
  innovations_ = false;
  if (!rows_hold) invalidate();
  before_.point.setConstant(std::numeric_limits<double>::quiet_NaN());
  use_output_error_gains(now_);
  use_output_error_gains(before_);
  if (rows_hold) weigh_all();
}

void JointFit::restore_output_errors() {
  use_output_error_gains(now_);
  weigh_all();
}

void JointFit::use_output_error_gains(Evaluation& evaluation) {
  for (std::size_t r = 0; r < runs_.size(); ++r)
    ignore_torque_noise(variances_, weights_[r], evaluation.linear[r]);
}

void JointFit::weigh_all() {
  for_each_run([&](std::size_t r) { weigh(r); });
}

bool JointFit::use_innovations(const Eigen::VectorXd& unknowns, const Variances& variances) {
  invalidate();
  variances_ = variances;
  innovations_ = true;
  const auto filter = [&](const BrakeParameters& parameters, std::size_t r, const Eigen::Vector2d& initial,
                          LinearRun& linear) {
    return extended_kalman_filter(runs_[r], parameters, initial, variances, weights_[r], linear);
  };
  if (!linearise_at(unknowns, filter)) return false;
  for (std::size_t r = 0; r < runs_.size(); ++r) before_.linear[r].gains = now_.linear[r].gains;
  return true;
}

Normal JointFit::normal_by_unknowns(std::size_t r) const {
  Normal normal = now_.normals[r];
  for (int i = 0; i < parameters_; ++i) {
    if (!is_logarithmic(column(i))) continue;
    const double normalised = std::exp(now_.point[i]);
    normal.row(column(i)) *= normalised;
    normal.col(column(i)) *= normalised;
  }
  return normal;
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

bool JointFit::is_within_reach(const double* unknowns) const {
  for (int i = 0; i < parameters_ && anchor_.size() > 0; ++i)
    if (is_logarithmic(column(i)) && !(std::abs(unknowns[i] - anchor_[i]) <= kReach)) return false;
  return true;
}

bool JointFit::operator()(const double* unknowns, double* residuals, double* jacobian) const {
  if (jacobian == nullptr && !is_within_reach(unknowns)) {
    Eigen::Map<Eigen::VectorXd>(residuals, NumResiduals())
        .setConstant(std::sqrt(kImpossible / NumResiduals()));
    return true;
  }
  return FitOfRuns::operator()(unknowns, residuals, jacobian);
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
  for (int i = 0; i < parameters_; ++i) {
    const double move = theta[column(i)];
    step[i] = is_logarithmic(column(i)) ? std::clamp(move / std::exp(now_.point[i]), -0.5, 0.5) : move;
  }
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    const Normal& normal = now_.normals[r];
    step.segment<2>(first_of(r)) =
        -elimination(normal).transpose() * theta -
        normal.block<2, 2>(kTheta, kTheta).inverse() * normal.block<2, 1>(kTheta, kDataColumn);
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
  for (std::size_t r = 0; r < runs_.size(); ++r) distances.push_back(prior_distance(r));
  return distances;
}

}  // namespace clampd::identify
