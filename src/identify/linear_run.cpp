#include "src/identify/linear_run.hpp"

#include <algorithm>
#include <cmath>
#include <concepts>
#include <limits>

#include "clampd/base/assert.hpp"

namespace clampd::identify {

namespace {

/// R of a row.
Eigen::Matrix2d reading_covariance(const Variances& variances, const ReadingWeights& weights, std::size_t k) {
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  covariance(0, 0) = variances.force / (weights.force.empty() ? 1.0 : weights.force[k]);
  covariance(1, 1) = variances.velocity / (weights.velocity.empty() ? 1.0 : weights.velocity[k]);
  return covariance;
}

/// Gain and weight of a row with P(k|k-1) = gain.covariance; P(k|k) and log det S come back.
Eigen::Matrix2d correct(const Eigen::Matrix2d& by_state, const Eigen::Matrix2d& reading, RowGain& gain,
                        double& log_determinant) {
  const Eigen::Matrix2d cross = gain.covariance * by_state.transpose();
  Eigen::Matrix2d innovation = by_state * cross + reading;
  const double determinant = innovation(0, 0) * innovation(1, 1) - innovation(0, 1) * innovation(1, 0);
  gain.weight << innovation(1, 1), -innovation(0, 1), -innovation(1, 0), innovation(0, 0);
  gain.weight /= determinant;
  gain.gain = cross * gain.weight;
  log_determinant += std::log(determinant);
  const Eigen::Matrix2d filtered = gain.covariance - gain.gain * cross.transpose();
  return 0.5 * (filtered + filtered.transpose());
}

/// L with L L^T = covariance, which may be singular.
Eigen::Matrix2d root_of(const Eigen::Matrix2d& covariance) {
  Eigen::Matrix2d root = Eigen::Matrix2d::Zero();
  root(0, 0) = std::sqrt(std::max(0.0, covariance(0, 0)));
  if (root(0, 0) > 0.0) root(1, 0) = covariance(1, 0) / root(0, 0);
  root(1, 1) = std::sqrt(std::max(0.0, covariance(1, 1) - root(1, 0) * root(1, 0)));
  return root;
}

Eigen::Matrix2d propagate(const LinearRow& row, const Eigen::Matrix2d& filtered, double torque_variance) {
  return row.transition * filtered * row.transition.transpose() + torque_variance * row.torque_covariance;
}

/// Walks the run row by row; `correction(k, row)` says how the reference changes after row k's reading, and
/// `advanced(k, row)` sees the finished row.
template <class Correction, class Advanced>
bool walk(const Run& run, const BrakeParameters& parameters, const BrakeState& initial, LinearRun& out,
          const Correction& correction, const Advanced& advanced) {
  CLAMPD_ASSERT(out.rows.size() == run.size());
  const PaperBrake model = paper_brake(parameters);
  const ParameterVector scale = nominal_parameters();
  Eigen::Matrix<double, 2, kTheta> by_parameter;
  LinearStep<kTheta> step;
  BrakeState state = initial;
  const std::size_t size = run.size();
  for (std::size_t k = 0; k < size; ++k) {
    if (!is_bounded(state)) return false;
    LinearRow& row = out.rows[k];
    out.reference[k] = state;
    const Reading reading = model.read(state);
    row.residual << run.force_N[k] - reading.force_N, run.velocity_rad_s[k] - reading.velocity_rad_s;
    model.linearise_readings(state, row.by_state, by_parameter);
    row.by_parameter = by_parameter * scale.asDiagonal();
    row.correction = correction(k, row);
    if (k + 1 == size) {
      row.transition.setZero();
      row.step_by_parameter.setZero();
      row.torque_covariance.setZero();
      row.torque_root.setZero();
      break;
    }
    state += row.correction;
    if (!is_bounded(state)) return false;
    const double gap_s = run.time_s[k + 1] - run.time_s[k];
    const int steps = steps_in(gap_s);
    CLAMPD_ASSERT(steps > 0);
    state = linearise_step(model, state, run.torque_Nm[k], gap_s / steps, step);
    row.transition = step.transition;
    row.step_by_parameter = step.by_parameter;
    row.torque_covariance = step.by_torque * step.by_torque.transpose();
    for (int i = 1; i < steps && is_bounded(state); ++i) {
      state = linearise_step(model, state, run.torque_Nm[k], gap_s / steps, step);
      row.step_by_parameter = (step.transition * row.step_by_parameter + step.by_parameter).eval();
      row.torque_covariance = (step.transition * row.torque_covariance * step.transition.transpose() +
                               step.by_torque * step.by_torque.transpose())
                                  .eval();
      row.transition = (step.transition * row.transition).eval();
    }
    row.torque_root << step.by_torque, Eigen::Vector2d::Zero();
    if (steps > 1) row.torque_root = root_of(row.torque_covariance);
    row.step_by_parameter = row.step_by_parameter * scale.asDiagonal();
    advanced(k, row);
  }
  return true;
}

constexpr auto kNothing = [](std::size_t, const LinearRow&) {};

}  // namespace

Variances variances_of(const NoiseLevels& noise) noexcept {
  return {noise.sensors.force_N * noise.sensors.force_N,
          noise.sensors.velocity_rad_s * noise.sensors.velocity_rad_s, noise.torque_Nm * noise.torque_Nm};
}

NoiseLevels levels_of(const Variances& variances) noexcept {
  return {{std::sqrt(variances.force), std::sqrt(variances.velocity)}, std::sqrt(variances.torque)};
}

double change_between(const Variances& a, const Variances& b, double negligible_torque) noexcept {
  return 0.5 * std::max({std::abs(b.force / a.force - 1.0), std::abs(b.velocity / a.velocity - 1.0),
                         std::abs(b.torque - a.torque) / (std::max(a.torque, b.torque) + negligible_torque)});
}

void LinearRun::resize(std::size_t size) {
  rows.resize(size);
  gains.resize(size);
  reference.resize(size);
  const auto columns = static_cast<Eigen::Index>(size);
  innovations.resize(Eigen::NoChange, 2 * columns);
  weighted_innovations.resize(Eigen::NoChange, 2 * columns);
  scores.resize(Eigen::NoChange, 4 * columns);
  disturbances.resize(size);
}

Run run_without_readings(const Excitation& excitation) {
  Run run;
  run.torque_Nm.assign(excitation.torque_Nm.begin(), excitation.torque_Nm.end());
  run.force_N.assign(excitation.size(), 0.0);
  run.velocity_rad_s.assign(excitation.size(), 0.0);
  run.time_s.assign(excitation.time_s.begin(), excitation.time_s.end());
  for (std::size_t k = run.time_s.size(); k < excitation.size(); ++k)
    run.time_s.push_back(excitation.dt_s * static_cast<double>(k));
  return run;
}

bool linearise(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
               LinearRun& out) noexcept {
  return walk(
      run, parameters, initial, out,
      [](std::size_t, const LinearRow&) { return Eigen::Vector2d(Eigen::Vector2d::Zero()); }, kNothing);
}

bool linearise_with_gains(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                          LinearRun& out) noexcept {
  return walk(
      run, parameters, initial, out,
      [&](std::size_t k, const LinearRow& row) { return Eigen::Vector2d(out.gains[k].gain * row.residual); },
      kNothing);
}

bool extended_kalman_filter(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                            const Variances& variances, const ReadingWeights& weights,
                            LinearRun& out) noexcept {
  Eigen::Matrix2d predicted = Eigen::Matrix2d::Zero();
  Eigen::Matrix2d filtered;
  out.log_determinant = 0.0;
  return walk(
      run, parameters, initial, out,
      [&](std::size_t k, const LinearRow& row) {
        out.gains[k].covariance = predicted;
        filtered = correct(row.by_state, reading_covariance(variances, weights, k), out.gains[k],
                           out.log_determinant);
        return Eigen::Vector2d(out.gains[k].gain * row.residual);
      },
      [&](std::size_t, const LinearRow& row) { predicted = propagate(row, filtered, variances.torque); });
}

double sum_of_squares_of(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                         const std::vector<RowGain>& gains) noexcept {
  constexpr double kNever = std::numeric_limits<double>::infinity();
  const PaperBrake model = paper_brake(parameters);
  BrakeState state = initial;
  double squares = 0.0;
  for (std::size_t k = 0; k < run.size(); ++k) {
    if (!is_bounded(state)) return kNever;
    const Reading reading = model.read(state);
    const Eigen::Vector2d residual(run.force_N[k] - reading.force_N,
                                   run.velocity_rad_s[k] - reading.velocity_rad_s);
    squares += residual.dot(gains[k].weight * residual);
    if (k + 1 == run.size()) break;
    state += gains[k].gain * residual;
    if (!is_bounded(state)) return kNever;
    const double gap_s = run.time_s[k + 1] - run.time_s[k];
    const int steps = steps_in(gap_s);
    for (int i = 0; i < steps && is_bounded(state); ++i)
      state = advance(model, state, run.torque_Nm[k], gap_s / steps);
  }
  return squares;
}

void update_gains(const Variances& variances, const ReadingWeights& weights, LinearRun& run) noexcept {
  Eigen::Matrix2d predicted = Eigen::Matrix2d::Zero();
  run.log_determinant = 0.0;
  for (std::size_t k = 0; k < run.rows.size(); ++k) {
    const LinearRow& row = run.rows[k];
    run.gains[k].covariance = predicted;
    const Eigen::Matrix2d filtered =
        correct(row.by_state, reading_covariance(variances, weights, k), run.gains[k], run.log_determinant);
    predicted = propagate(row, filtered, variances.torque);
  }
}

void ignore_torque_noise(const Variances& variances, const ReadingWeights& weights, LinearRun& run) noexcept {
  for (std::size_t k = 0; k < run.rows.size(); ++k) {
    run.gains[k].covariance.setZero();
    run.gains[k].gain.setZero();
    run.gains[k].weight = reading_covariance(variances, weights, k).diagonal().cwiseInverse().asDiagonal();
  }
}

namespace {

/// Those parameters that the force reading depends on; beside them it depends on the position only, and the
/// velocity reading on nothing but the velocity, which it is (6).
constexpr int kStiffness = PaperBrake::Stiffness::kParameters;
static_assert(std::same_as<PaperBrake,
                           BrakeModel<PolynomialStiffness, StribeckFriction, IdealActuator, IdealReadings>>);

/// The sum of left right^T over the columns where it is symmetric: the lower triangle, two of its columns at
/// a time, which stay in the processor's registers.
template <int kFirst = 0, class Left, class Right>
void sum_lower_triangle(const Left& left, const Right& right, Normal& sum) {
  constexpr int kRows = kUnknowns + 1 - kFirst;
  using Column = Eigen::Matrix<double, kRows, 1>;
  Column first = Column::Zero();
  Column second = Column::Zero();
  for (Eigen::Index k = 0; k < left.cols(); ++k) {
    const auto rows = left.col(k).template tail<kRows>();
    first += right(kFirst, k) * rows;
    second += right(kFirst + 1, k) * rows;
  }
  sum.col(kFirst).template tail<kRows>() = first;
  sum.col(kFirst + 1).template tail<kRows>() = second;
  if constexpr (kRows > 2) sum_lower_triangle<kFirst + 2>(left, right, sum);
}

template <class Left, class Right>
Normal symmetric_product(const Left& left, const Right& right) {
  Normal sum;
  sum_lower_triangle(left, right, sum);
  sum.triangularView<Eigen::StrictlyUpper>() = sum.transpose();
  return sum;
}

}  // namespace

Normal normal_equations(LinearRun& run) noexcept {
  // Derivatives of the state's distance from the reference by the unknowns; last row: that distance itself.
  // Transposed, so that the unknowns lie side by side in memory.
  Columns distance = Columns::Zero();
  distance(kInitialPositionColumn, 0) = distance(kInitialVelocityColumn, 1) = 1.0;
  for (std::size_t k = 0; k < run.rows.size(); ++k) {
    const LinearRow& row = run.rows[k];
    const RowGain& gain = run.gains[k];
    Columns innovation;
    innovation.col(0) = -row.by_state(0, 0) * distance.col(0);
    innovation.col(1) = -distance.col(1);
    innovation.col(0).head<kStiffness>() -= row.by_parameter.row(0).head<kStiffness>().transpose();
    innovation.row(kDataColumn) += row.residual.transpose();
    const auto at = static_cast<Eigen::Index>(2 * k);
    run.innovations.middleCols<2>(at) = innovation;
    run.weighted_innovations.middleCols<2>(at).noalias() = innovation.lazyProduct(gain.weight);
    if (!(gain.gain.array() == 0.0).all())
      distance.noalias() += innovation.lazyProduct(gain.gain.transpose());
    distance.row(kDataColumn) -= row.correction.transpose();
    distance = distance.lazyProduct(row.transition.transpose()).eval();
    distance.topRows<kTheta>() += row.step_by_parameter.transpose();
  }
  return symmetric_product(run.innovations, run.weighted_innovations);
}

ScoreMoments score_moments(const ReadingWeights& weights, const Eigen::Matrix<double, kUnknowns, 1>& step,
                           LinearRun& run) noexcept {
  ScoreMoments moments;
  Eigen::Matrix<double, kUnknowns + 1, 1> at_step;
  at_step << step, 1.0;
  const auto size = static_cast<Eigen::Index>(run.rows.size());
  auto force = run.scores.leftCols(size);
  auto velocity = run.scores.middleCols(size, size);
  auto torque = run.scores.rightCols(2 * size);
  Eigen::Index torques = 0;
  // Of the state at the row after: derivatives of the later rows' products, and their expected square.
  Columns later = Columns::Zero();
  Eigen::Matrix2d later_square = Eigen::Matrix2d::Zero();
  for (std::size_t k = run.rows.size(); k-- > 0;) {
    const LinearRow& row = run.rows[k];
    const RowGain& gain = run.gains[k];
    const auto at = static_cast<Eigen::Index>(k);
    torque.col(torques++).noalias() = later.lazyProduct(row.torque_root.col(0));
    // A step alone moves the state in one direction.
    if (row.torque_root(1, 1) != 0.0)
      torque.col(torques++).noalias() = later.lazyProduct(row.torque_root.col(1));
    moments.torque_trace += (row.torque_covariance.array() * later_square.array()).sum();

    const Columns through = later.lazyProduct(row.transition);
    const Eigen::Matrix2d square = row.transition.transpose() * later_square * row.transition;
    const Columns of_reading =
        run.weighted_innovations.middleCols<2>(2 * at) - through.lazyProduct(gain.gain);
    const Eigen::Matrix2d reading_square = gain.weight + gain.gain.transpose() * square * gain.gain;
    const double force_share = weights.force.empty() ? 1.0 : 1.0 / weights.force[k];
    const double velocity_share = weights.velocity.empty() ? 1.0 : 1.0 / weights.velocity[k];
    force.col(at) = std::sqrt(force_share) * of_reading.col(0);
    velocity.col(at) = std::sqrt(velocity_share) * of_reading.col(1);
    moments.force_trace += force_share * reading_square(0, 0);
    moments.velocity_trace += velocity_share * reading_square(1, 1);
    moments.offsets += of_reading.topRows<kUnknowns>();
    run.disturbances[k] = {of_reading.transpose() * at_step, later.transpose() * at_step};

    later = through + of_reading.lazyProduct(row.by_state);
    const Eigen::Matrix2d remaining = Eigen::Matrix2d::Identity() - gain.gain * row.by_state;
    later_square =
        row.by_state.transpose() * gain.weight * row.by_state + remaining.transpose() * square * remaining;
  }
  moments.force = symmetric_product(force, force);
  moments.velocity = symmetric_product(velocity, velocity);
  moments.torque = symmetric_product(torque.leftCols(torques), torque.leftCols(torques));
  return moments;
}

WorkingProducts working_products(const ReadingWeights& weights, const LinearRun& run) noexcept {
  WorkingProducts products;
  using Three = Eigen::Matrix<double, 2, 3>;
  Eigen::Vector2d disturbed = Eigen::Vector2d::Zero();  // the state's distance by the torque's disturbances
  Three distance = Three::Zero();                       // the filter's
  for (std::size_t k = 0; k < run.rows.size(); ++k) {
    const LinearRow& row = run.rows[k];
    const RowGain& gain = run.gains[k];
    const Disturbance& disturbance = run.disturbances[k];
    Three innovation = -row.by_state.lazyProduct(distance);
    innovation(0, 0) += disturbance.reading[0] / (weights.force.empty() ? 1.0 : weights.force[k]);
    innovation(1, 1) += disturbance.reading[1] / (weights.velocity.empty() ? 1.0 : weights.velocity[k]);
    innovation.col(2) += row.by_state * disturbed;
    const Three weighted = gain.weight.lazyProduct(innovation);
    products.with_themselves.noalias() += innovation.transpose().lazyProduct(weighted);
    products.with_unknowns.noalias() +=
        run.innovations.block<kUnknowns, 2>(0, 2 * static_cast<Eigen::Index>(k)).lazyProduct(weighted);
    const Three corrected = distance + gain.gain.lazyProduct(innovation);
    distance.noalias() = row.transition.lazyProduct(corrected);
    disturbed = row.transition * disturbed + row.torque_covariance * disturbance.next_state;
  }
  return products;
}

}  // namespace clampd::identify
