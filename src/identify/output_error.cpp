#include "clampd/identify/output_error.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include <ceres/tiny_solver.h>
#include <fmt/format.h>
#include <Eigen/Cholesky>

#include "clampd/brake/simulation.hpp"
#include "clampd/identify/information.hpp"
#include "src/identify/starting_point.hpp"

namespace clampd {

namespace {

using identify::kSmallestNoise;

constexpr int kTheta = static_cast<int>(kParameterCount);
constexpr int kColumns = kSensitivityColumns;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// Stands for the cost where the model cannot be simulated, so that the solver steps back.
constexpr double kImpossible = 1e30;

/// A standard deviation of so many times the nominal value: the runs say nothing about the parameter, and the
/// linear covariance itself means nothing any more.
constexpr double kUndetermined = 3.0;

/// Fewer clusters do not span seven parameters.
constexpr std::size_t kFewestRunsForSandwich = 8;

/// Change of the sum of squared weighted residuals at which a fit ends: a last step of 0.03 standard
/// deviations. The cost has faint kinks, where a stop crosses a sample, that make a finer search bounce.
constexpr double kCostTolerance = 1e-3;

/// The noise is re-estimated after each round of iterations, until it changes by less than this share.
constexpr double kNoiseTolerance = 1e-4;
constexpr int kFirstRoundIterations = 40;
constexpr int kRoundIterations = 8;

/// More attempts from other starts follow if a fit's residuals exceed the noise seen without a model this
/// often.
constexpr double kPoorFit = 1.25;

/// Two fits whose negative log-likelihoods per row differ by less are in the same minimum.
constexpr double kSameMinimum = 1e-5;

/// Logarithmic for what cannot change sign: all but k1. (11) for k1.
ParameterVector to_unknowns(const ParameterVector& theta) {
  ParameterVector unknowns = theta.cwiseQuotient(nominal_parameters());
  for (int i = 0; i < kTheta; ++i)
    if (i != static_cast<int>(k1)) unknowns[i] = std::log(unknowns[i]);
  return unknowns;
}

ParameterVector to_normalised(const double* unknowns) {
  ParameterVector normalised;
  for (int i = 0; i < kTheta; ++i)
    normalised[i] = i == static_cast<int>(k1) ? unknowns[i] : std::exp(unknowns[i]);
  return normalised;
}

bool within_bounds(const ParameterVector& theta) {
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double value = theta[static_cast<Eigen::Index>(i)];
    if (!(value >= kParameterTable[i].lower && value <= kParameterTable[i].upper)) return false;
  }
  return true;
}

/// Normal equations of one run over (theta normalised, x0) with the residuals as tenth column, for unit
/// noise.
struct RunNormal {
  using Matrix = Eigen::Matrix<double, kColumns + 1, kColumns + 1>;
  Matrix force;
  Matrix velocity;
  /// Column sums of the sensitivities: the gradient's change with an error common to all readings.
  Eigen::Matrix<double, kColumns, 1> force_sum;
  Eigen::Matrix<double, kColumns, 1> velocity_sum;
};

/// The weighted residuals of all runs as a function of the unknowns, for ceres::TinySolver. Each run's 2n
/// residuals are compressed to the ten rows of the triangular factor of [J r]: the same cost, gradient and
/// Gauss-Newton matrix, and the solver's work no longer grows with n.
class JointFit {
 public:
  using Scalar = double;
  enum { NUM_RESIDUALS = Eigen::Dynamic, NUM_PARAMETERS = Eigen::Dynamic };

  JointFit(std::span<const Run> runs, const FixedParameters& fixed) : runs_(runs), normals_(runs.size()) {
    parameters_.fixed = fixed;
    std::size_t longest = 0;
    for (const Run& run : runs) longest = std::max(longest, run.size());
    buffers_.resize(runs.size());
    for (std::size_t r = 0; r < runs.size(); ++r) buffers_[r].resize(runs[r].size());
    guesses_.resize(runs.size());
    force_residuals_.resize(static_cast<Eigen::Index>(longest));
    velocity_residuals_.resize(static_cast<Eigen::Index>(longest));
    evaluated_.setConstant(NumParameters(), kNaN);
  }

  int NumParameters() const { return kTheta + 2 * static_cast<int>(runs_.size()); }
  int NumResiduals() const { return (kColumns + 1) * static_cast<int>(runs_.size()); }

  void set_noise(const SensorNoise& noise) { noise_ = noise; }
  const SensorNoise& noise() const { return noise_; }

  /// Unknowns at theta, each run at its guessed initial state; that guess is the centre of its weak prior.
  Eigen::VectorXd start_from(const ParameterVector& theta) {
    Eigen::VectorXd unknowns(NumParameters());
    unknowns.head<kTheta>() = to_unknowns(theta);
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      guesses_[r] = identify::initial_state_guess(runs_[r], theta);
      unknowns.segment<2>(kTheta + 2 * static_cast<Eigen::Index>(r)) = guesses_[r];
    }
    return unknowns;
  }

  bool operator()(const double* unknowns, double* residuals, double* jacobian) const {
    Eigen::Map<Eigen::VectorXd> residual_rows(residuals, NumResiduals());
    const bool possible = evaluate(unknowns);
    if (!possible) {
      residual_rows.setConstant(std::sqrt(kImpossible / NumResiduals()));
      if (jacobian != nullptr)
        Eigen::Map<Eigen::MatrixXd>(jacobian, NumResiduals(), NumParameters()).setZero();
      return true;
    }
    residual_rows.setZero();
    if (jacobian == nullptr) {
      residual_rows[0] = std::sqrt(squared_cost());
      return true;
    }
    Eigen::Map<Eigen::MatrixXd> jacobian_rows(jacobian, NumResiduals(), NumParameters());
    jacobian_rows.setZero();
    const ParameterVector normalised = to_normalised(unknowns);
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      RunNormal::Matrix normal = weighted(r);
      for (int i = 0; i < kTheta; ++i) {
        if (i == static_cast<int>(k1)) continue;
        normal.row(i) *= normalised[i];
        normal.col(i) *= normalised[i];
      }
      const RunNormal::Matrix factor = semidefinite_factor(normal);
      const auto row = static_cast<Eigen::Index>(r) * (kColumns + 1);
      jacobian_rows.block<kColumns + 1, kTheta>(row, 0) = factor.leftCols<kTheta>();
      jacobian_rows.block<kColumns + 1, 2>(row, kTheta + 2 * static_cast<Eigen::Index>(r)) =
          factor.middleCols<2>(kTheta);
      residual_rows.segment<kColumns + 1>(row) = factor.col(kColumns);
    }
    return true;
  }

  /// Simulates all runs with sensitivities; false where that is impossible. Remembers the last point: the
  /// solver asks for the cost of a step first and for the derivatives when it has taken the step.
  bool evaluate(const double* unknowns) const {
    const Eigen::Map<const Eigen::VectorXd> point(unknowns, NumParameters());
    if (point == evaluated_) return possible_;
    evaluated_ = point;
    possible_ = false;
    parameters_.theta = to_normalised(unknowns).cwiseProduct(nominal_parameters());
    if (!within_bounds(parameters_.theta)) return false;
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      const Run& run = runs_[r];
      SensitivitySimulation& buffer = buffers_[r];
      const auto rows = static_cast<Eigen::Index>(run.size());
      const BrakeState initial = point.segment<2>(kTheta + 2 * static_cast<Eigen::Index>(r));
      simulate(parameters_, initial, excitation_of(run), buffer);
      if (!buffer.complete()) return false;
      const Eigen::Map<const Eigen::VectorXd> force(run.force_N.data(), rows);
      const Eigen::Map<const Eigen::VectorXd> velocity(run.velocity_rad_s.data(), rows);
      const Eigen::Map<const Eigen::VectorXd> model_force(buffer.force_N.data(), rows);
      const Eigen::Map<const Eigen::VectorXd> model_velocity(buffer.velocity_rad_s.data(), rows);
      force_residuals_.head(rows) = model_force - force;
      velocity_residuals_.head(rows) = model_velocity - velocity;
      accumulate(buffer.force_sensitivity, force_residuals_.head(rows), normals_[r].force);
      accumulate(buffer.velocity_sensitivity, velocity_residuals_.head(rows), normals_[r].velocity);
      normals_[r].force_sum = buffer.force_sensitivity.colwise().sum().transpose();
      normals_[r].velocity_sum = buffer.velocity_sensitivity.colwise().sum().transpose();
    }
    possible_ = true;
    return true;
  }

  /// Of the last evaluated point: R^-1-weighted normal equations of a run, with the prior of its initial
  /// state.
  RunNormal::Matrix weighted(std::size_t r) const {
    RunNormal::Matrix normal = normals_[r].force / (noise_.force_N * noise_.force_N) +
                               normals_[r].velocity / (noise_.velocity_rad_s * noise_.velocity_rad_s);
    const double prior[2] = {kInitialPositionPrior_rad, kInitialVelocityPrior_rad_s};
    for (int i = 0; i < 2; ++i) {
      const double weight = 1.0 / (prior[i] * prior[i]);
      const double distance = evaluated_[kTheta + 2 * static_cast<Eigen::Index>(r) + i] - guesses_[r][i];
      normal(kTheta + i, kTheta + i) += weight;
      normal(kTheta + i, kColumns) += weight * distance;
      normal(kColumns, kTheta + i) += weight * distance;
      normal(kColumns, kColumns) += weight * distance * distance;
    }
    return normal;
  }

  /// R^-1-weighted right-hand sides of a run for a unit offset of all its force readings, of all its
  /// velocities.
  Eigen::Matrix<double, kColumns, 2> weighted_offsets(std::size_t r) const {
    Eigen::Matrix<double, kColumns, 2> offsets;
    offsets << normals_[r].force_sum / (noise_.force_N * noise_.force_N),
        normals_[r].velocity_sum / (noise_.velocity_rad_s * noise_.velocity_rad_s);
    return offsets;
  }

  double squared_cost() const {
    double sum = 0.0;
    for (std::size_t r = 0; r < runs_.size(); ++r) sum += weighted(r)(kColumns, kColumns);
    return sum;
  }

  /// Equation (9) at the last evaluated point, its diagonal.
  SensorNoise residual_noise() const {
    double force = 0.0;
    double velocity = 0.0;
    double count = 0.0;
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      force += normals_[r].force(kColumns, kColumns);
      velocity += normals_[r].velocity(kColumns, kColumns);
      count += static_cast<double>(runs_[r].size());
    }
    return {std::sqrt(force / count), std::sqrt(velocity / count)};
  }

  SensorNoise run_residual_noise(std::size_t r) const {
    const auto count = static_cast<double>(runs_[r].size());
    return {std::sqrt(normals_[r].force(kColumns, kColumns) / count),
            std::sqrt(normals_[r].velocity(kColumns, kColumns) / count)};
  }

  const BrakeParameters& parameters() const { return parameters_; }

 private:
  template <class Residuals>
  static void accumulate(const SensitivityRows& jacobian, const Residuals& residuals,
                         RunNormal::Matrix& normal) {
    normal.topLeftCorner<kColumns, kColumns>() = jacobian.transpose().lazyProduct(jacobian);
    const Eigen::Matrix<double, kColumns, 1> right = jacobian.transpose().lazyProduct(residuals);
    normal.topRightCorner<kColumns, 1>() = right;
    normal.bottomLeftCorner<1, kColumns>() = right.transpose();
    normal(kColumns, kColumns) = residuals.squaredNorm();
  }

  /// Upper triangular U with U^T U = matrix, rows of vanishing pivots zero: a column that the run says
  /// nothing about.
  static RunNormal::Matrix semidefinite_factor(const RunNormal::Matrix& matrix) {
    RunNormal::Matrix factor = RunNormal::Matrix::Zero();
    for (int i = 0; i <= kColumns; ++i) {
      const double pivot = matrix(i, i) - factor.col(i).head(i).squaredNorm();
      if (!(pivot > 1e-14 * matrix(i, i))) continue;
      const double root = std::sqrt(pivot);
      for (int j = i; j <= kColumns; ++j)
        factor(i, j) = (matrix(i, j) - factor.col(i).head(i).dot(factor.col(j).head(i))) / root;
    }
    return factor;
  }

  std::span<const Run> runs_;
  SensorNoise noise_;
  std::vector<Eigen::Vector2d> guesses_;
  mutable BrakeParameters parameters_;
  mutable std::vector<SensitivitySimulation> buffers_;
  mutable std::vector<RunNormal> normals_;
  mutable Eigen::VectorXd force_residuals_, velocity_residuals_;
  mutable Eigen::VectorXd evaluated_;
  mutable bool possible_ = false;
};

struct Attempt {
  Eigen::VectorXd unknowns;
  SensorNoise noise;
  double score =
      std::numeric_limits<double>::infinity();  ///< negative log-likelihood per row; infinite if impossible
  bool settled = false;  ///< neither cost nor noise changed any more before the iterations ran out
  int iterations = 0;
};

class Solver {
 public:
  Solver(std::span<const Run> runs, const EstimatorOptions& options)
      : runs_(runs),
        options_(options),
        fit_(runs, options.start.fixed),
        seen_(identify::noise_without_model(runs)) {}

  Attempt attempt(const ParameterVector& theta) {
    Attempt result;
    result.unknowns = fit_.start_from(theta);
    fit_.set_noise(known_or(seen_));
    auto& solver_options = solver_.options;
    const double cost_tolerance = kCostTolerance * static_cast<double>(runs_.size());
    solver_options.function_tolerance = cost_tolerance;
    solver_options.parameter_tolerance = 1e-9;
    // In short rounds: at a kink of the cost the solver may bounce to its limit without gaining anything, and
    // that is an end as good as the solver's own.
    for (int used = 0; used < options_.max_iterations && !result.settled;) {
      solver_options.max_num_iterations = std::min(kRoundIterations, options_.max_iterations - used);
      const double cost_before = cost_of(result.unknowns);
      solver_.Solve(fit_, &result.unknowns);
      used += std::max(solver_.summary.iterations, 1);
      const double cost_after = cost_of(result.unknowns);
      if (!fit_.evaluate(result.unknowns.data())) break;
      const SensorNoise before = fit_.noise();
      const SensorNoise after = known_or(fit_.residual_noise());
      fit_.set_noise(after);
      const double change = std::max(std::abs(after.force_N / before.force_N - 1.0),
                                     std::abs(after.velocity_rad_s / before.velocity_rad_s - 1.0));
      result.settled = cost_before - cost_after < cost_tolerance && change < kNoiseTolerance;
      result.iterations = used;
    }
    iterations_ += result.iterations;
    if (!fit_.evaluate(result.unknowns.data())) return result;
    result.noise = fit_.noise();
    const SensorNoise residual = fit_.residual_noise();
    const double force = residual.force_N / result.noise.force_N;
    const double velocity = residual.velocity_rad_s / result.noise.velocity_rad_s;
    result.score = 0.5 * (force * force + velocity * velocity) + std::log(result.noise.force_N) +
                   std::log(result.noise.velocity_rad_s);
    return result;
  }

  bool poor(const Attempt& attempt) const {
    if (!attempt.settled) return true;
    fit_.evaluate(attempt.unknowns.data());
    const SensorNoise residual = fit_.residual_noise();
    return residual.force_N > kPoorFit * seen_.force_N ||
           residual.velocity_rad_s > kPoorFit * seen_.velocity_rad_s;
  }

  Attempt best() {
    const ParameterVector& given = options_.start.theta;
    Attempt kept = attempt(given);
    if (!poor(kept)) return kept;
    const double first_score = kept.score;
    double last_score = first_score;
    const auto consider = [&](const ParameterVector& theta) {
      Attempt other = attempt(theta);
      last_score = other.score;
      if (other.score < kept.score) kept = std::move(other);
    };
    consider(identify::equation_error_start(runs_, options_.start, seen_));
    // Torque noise makes the residuals of the right parameters larger than the sensors' noise too; that
    // unlike starts end alike tells this from a wrong minimum. Whether the brake stuck at some instant is
    // what minima differ in most, and both starts may have it wrong: so also from less and from more static
    // friction than found.
    if (kept.settled && std::abs(last_score - first_score) < kSameMinimum) {
      const double score = kept.score;
      const ParameterVector found = to_normalised(kept.unknowns.data()).cwiseProduct(nominal_parameters());
      for (const double factor : {0.75, 1.35}) {
        ParameterVector theta = found;
        theta[Ts0] *= factor;
        if (within_bounds(theta)) consider(theta);
      }
      if (score - kept.score < kSameMinimum) return kept;
    }
    consider(nominal_parameters());
    constexpr double kFactors[4][kParameterCount] = {{1.5, 0.7, 1.5, 0.7, 1.5, 0.7, 1.5},
                                                     {0.7, 1.3, 0.6, 1.5, 0.7, 1.3, 0.6},
                                                     {0.7, 0.7, 1.5, 1.5, 0.6, 0.8, 1.4},
                                                     {1.3, 1.3, 0.6, 0.6, 1.5, 1.2, 0.6}};
    for (const auto& factors : kFactors) {
      ParameterVector theta = given;
      for (int i = 0; i < kTheta; ++i) theta[i] *= factors[i];
      if (within_bounds(theta)) consider(theta);
    }
    return kept;
  }

  /// The fit, evaluated at an attempt's result.
  const JointFit& fit(const Attempt& attempt) {
    fit_.set_noise(attempt.noise);
    fit_.evaluate(attempt.unknowns.data());
    return fit_;
  }
  int iterations() const { return iterations_; }

 private:
  double cost_of(const Eigen::VectorXd& unknowns) const {
    return fit_.evaluate(unknowns.data()) ? fit_.squared_cost() : kImpossible;
  }

  SensorNoise known_or(const SensorNoise& estimate) const {
    return {options_.noise_force_N.value_or(std::max(estimate.force_N, kSmallestNoise.force_N)),
            options_.noise_velocity_rad_s.value_or(
                std::max(estimate.velocity_rad_s, kSmallestNoise.velocity_rad_s))};
  }

  std::span<const Run> runs_;
  const EstimatorOptions& options_;
  JointFit fit_;
  SensorNoise seen_;
  ceres::TinySolver<JointFit> solver_;
  int iterations_ = 0;
};

Result<void> check_runs(std::span<const Run> runs) {
  if (runs.empty()) return failure("no run to identify from");
  for (const Run& run : runs) {
    const std::size_t rows = run.size();
    if (rows < 2) return failure(fmt::format("run {}: has {} rows; at least 2 are needed", run.name, rows));
    const std::pair<std::string_view, const std::vector<double>*> columns[] = {
        {"time_s", &run.time_s},
        {"torque_Nm", &run.torque_Nm},
        {"velocity_rad_s", &run.velocity_rad_s},
        {"force_N", &run.force_N}};
    for (const auto& [name, column] : columns) {
      if (column->size() != rows)
        return failure(
            fmt::format("run {}: {} has {} rows, time_s {}", run.name, name, column->size(), rows));
      const auto bad =
          std::find_if_not(column->begin(), column->end(), [](double x) { return std::isfinite(x); });
      if (bad != column->end())
        return failure(
            fmt::format("run {}: row {} of {} is not finite", run.name, bad - column->begin(), name));
    }
    for (std::size_t k = 1; k < rows; ++k)
      if (steps_in(run.time_s[k] - run.time_s[k - 1]) == 0)
        return failure(
            fmt::format("run {}: from {} s to {} s time does not increase or leaps by more than {} s; split "
                        "the run there",
                        run.name, run.time_s[k - 1], run.time_s[k], kLongestGap_s));
  }
  return {};
}

std::optional<Parameter> parameter_at_bound(const ParameterVector& theta) {
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const ParameterInfo& info = kParameterTable[i];
    const double value = theta[static_cast<Eigen::Index>(i)];
    const double margin = 1e-3 * std::abs(value);
    if (value < info.lower + margin || value > info.upper - margin) return static_cast<Parameter>(i);
  }
  return std::nullopt;
}

/// Covariances, and the information they come from, at the fit's last evaluated point.
struct Uncertainty {
  ParameterMatrix information = ParameterMatrix::Zero();
  ParameterMatrix covariance;
  ParameterMatrix covariance_over_runs = ParameterMatrix::Constant(kNaN);
  OffsetSensitivity offset_sensitivity = OffsetSensitivity::Zero();
};

Uncertainty uncertainty_of(const JointFit& fit, std::size_t runs) {
  Uncertainty result;
  ParameterMatrix scatter = ParameterMatrix::Zero();
  for (std::size_t r = 0; r < runs; ++r) {
    const RunNormal::Matrix normal = fit.weighted(r);
    const Eigen::Matrix<double, 2, kTheta> cross = normal.block<2, kTheta>(kTheta, 0);
    const Eigen::Matrix<double, kTheta, 2> elimination =
        normal.block<2, 2>(kTheta, kTheta).ldlt().solve(cross).transpose();
    result.information += normal.topLeftCorner<kTheta, kTheta>() - elimination * cross;
    const ParameterVector score =
        normal.block<kTheta, 1>(0, kColumns) - elimination * normal.block<2, 1>(kTheta, kColumns);
    scatter += score * score.transpose();
    const Eigen::Matrix<double, kColumns, 2> offsets = fit.weighted_offsets(r);
    result.offset_sensitivity += offsets.topRows<kTheta>() - elimination * offsets.middleRows<2>(kTheta);
  }
  result.covariance = cramer_rao(result.information);
  result.offset_sensitivity = (result.covariance * result.offset_sensitivity).eval();
  if (runs >= kFewestRunsForSandwich) {
    const auto count = static_cast<double>(runs);
    result.covariance_over_runs = count / (count - 1.0) * result.covariance * scatter * result.covariance;
  }
  return result;
}

}  // namespace

Result<void> EstimatorOptions::validate() const {
  if (max_iterations < 1)
    return failure(fmt::format("max_iterations is {}; it must be at least 1", max_iterations));
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const ParameterInfo& info = kParameterTable[i];
    const double value = start.theta[static_cast<Eigen::Index>(i)];
    if (!(value >= info.lower && value <= info.upper))
      return failure(fmt::format("start value {} = {} {} is outside of {} ... {}", info.name, value,
                                 info.unit, info.lower, info.upper));
  }
  if (!(std::isfinite(start.fixed.inertia_kg_m2) && start.fixed.inertia_kg_m2 > 0.0 &&
        std::isfinite(start.fixed.ratio_m_rad) && start.fixed.ratio_m_rad > 0.0))
    return failure("inertia and gear ratio must be positive");
  for (const auto& noise : {noise_force_N, noise_velocity_rad_s})
    if (noise && !(std::isfinite(*noise) && *noise > 0.0))
      return failure(fmt::format("a sensor noise of {} is not possible; it must be positive", *noise));
  return {};
}

std::string_view to_string(Termination termination) noexcept {
  switch (termination) {
    case Termination::Converged:
      return "converged";
    case Termination::IterationLimit:
      return "iteration limit";
    case Termination::NotIdentifiable:
      return "not identifiable";
    case Termination::NumericalFailure:
      return "numerical failure";
  }
  return "unknown";
}

Estimate identify_output_error(std::span<const Run> runs, const EstimatorOptions& options) {
  const auto began = std::chrono::steady_clock::now();
  Estimate summary;
  summary.parameters.fixed = options.start.fixed;
  summary.parameters.theta.setConstant(kNaN);
  summary.covariance_normalised.setConstant(kNaN);
  summary.covariance_normalised_over_runs.setConstant(kNaN);
  summary.offset_sensitivity.setConstant(kNaN);
  summary.noise_force_N = summary.noise_velocity_rad_s = kNaN;
  summary.force_rms_N = summary.velocity_rms_rad_s = kNaN;
  const auto end = [&](Termination termination, std::string message) {
    summary.termination = termination;
    summary.message = std::move(message);
    summary.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
    return summary;
  };

  if (auto valid = options.validate(); !valid)
    return end(Termination::NumericalFailure, valid.error().message);
  if (auto valid = check_runs(runs); !valid) return end(Termination::NumericalFailure, valid.error().message);

  Solver solver(runs, options);
  const Attempt attempt = solver.best();
  summary.iterations = solver.iterations();
  const JointFit& fit = solver.fit(attempt);
  if (!std::isfinite(attempt.score))
    return end(Termination::NumericalFailure,
               "the model cannot follow the runs from any start: its simulation diverges under their torque");

  summary.parameters = fit.parameters();
  const SensorNoise residual = fit.residual_noise();
  summary.noise_force_N = summary.force_rms_N = residual.force_N;
  summary.noise_velocity_rad_s = summary.velocity_rms_rad_s = residual.velocity_rad_s;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const SensorNoise of_run = fit.run_residual_noise(r);
    summary.initial_states.push_back(attempt.unknowns.segment<2>(kTheta + 2 * static_cast<Eigen::Index>(r)));
    summary.run_force_rms_N.push_back(of_run.force_N);
    summary.run_velocity_rms_rad_s.push_back(of_run.velocity_rad_s);
  }

  const Uncertainty uncertainty = uncertainty_of(fit, runs.size());
  if (const auto unknown = unidentifiable_parameter(uncertainty.information))
    return end(
        Termination::NotIdentifiable,
        fmt::format("the runs do not tell the parameters apart, {} least of all: excite the brake more",
                    kParameterTable[*unknown].name));
  if (const auto bound = parameter_at_bound(summary.parameters.theta))
    return end(
        Termination::NotIdentifiable,
        fmt::format("{} ran into its bound: the runs do not determine it, or the model does not fit them",
                    kParameterTable[*bound].name));
  Eigen::Index vaguest = 0;
  const double variance = uncertainty.covariance.diagonal().maxCoeff(&vaguest);
  if (variance > kUndetermined * kUndetermined)
    return end(
        Termination::NotIdentifiable,
        fmt::format(
            "the runs do not determine {}: its standard deviation would be {:.0f} times its nominal value",
            kParameterTable[static_cast<std::size_t>(vaguest)].name, std::sqrt(variance)));
  summary.covariance_normalised = uncertainty.covariance;
  summary.covariance_normalised_over_runs = uncertainty.covariance_over_runs;
  summary.offset_sensitivity = uncertainty.offset_sensitivity;
  if (!attempt.settled)
    return end(Termination::IterationLimit,
               fmt::format("still improving after {} iterations from each start", options.max_iterations));
  return end(Termination::Converged, "the cost no longer changes");
}

}  // namespace clampd
