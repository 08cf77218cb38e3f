// The linearised run against dense linear algebra and against finite differences of the simulation.

#include "src/identify/linear_run.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "src/identify/noise_estimation.hpp"
#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd::identify {
namespace {

using Dense = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;

constexpr double kTorqueNoise_Nm = 0.0142;
const NoiseLevels kNoise{{30.0, 0.3}, kTorqueNoise_Nm};

/// Rows [from, from + rows) of the strong torque.
clampd::Run stretch(std::size_t from, std::size_t rows, const BrakeState& initial, unsigned seed,
                    const NoiseLevels& noise = kNoise) {
  const auto torque = support::strong_torque();
  std::mt19937_64 generator(seed);
  return support::run_reference_brake({}, initial,
                                      {torque.begin() + static_cast<std::ptrdiff_t>(from),
                                       torque.begin() + static_cast<std::ptrdiff_t>(from + rows)},
                                      noise, generator)
      .run;
}

/// The same run without some of its rows; the torque is the same before and after each gap.
std::vector<std::size_t> with_gaps(const clampd::Run& run, clampd::Run& sparse) {
  std::vector<std::size_t> kept;
  for (std::size_t k = 0; k < run.size(); ++k) {
    const std::size_t in_block = k % support::kBlockSamples;
    if (in_block == 5 || (in_block >= 9 && in_block < 15)) continue;
    kept.push_back(k);
    sparse.time_s.push_back(run.time_s[k]);
    sparse.torque_Nm.push_back(run.torque_Nm[k]);
    sparse.force_N.push_back(run.force_N[k]);
    sparse.velocity_rad_s.push_back(run.velocity_rad_s[k]);
  }
  return kept;
}

LinearRun linearised(const clampd::Run& run, const BrakeParameters& parameters, const BrakeState& initial) {
  LinearRun linear;
  linear.resize(run.size());
  EXPECT_TRUE(linearise(run, parameters, initial, linear));
  return linear;
}

/// 2 x 9 derivatives of every row's model readings, chained row by row.
std::vector<Eigen::Matrix<double, 2, kUnknowns>> chained(const LinearRun& run) {
  std::vector<Eigen::Matrix<double, 2, kUnknowns>> readings;
  Eigen::Matrix<double, 2, kUnknowns> state = Eigen::Matrix<double, 2, kUnknowns>::Zero();
  state.rightCols<2>().setIdentity();
  for (const LinearRow& row : run.rows) {
    Eigen::Matrix<double, 2, kUnknowns> reading = row.by_state * state;
    reading.leftCols<kTheta>() += row.by_parameter;
    readings.push_back(reading);
    state = row.transition * state;
    state.leftCols<kTheta>() += row.step_by_parameter;
  }
  return readings;
}

/// A run as one dense problem, readings interleaved (force, velocity): [J e] of (unknowns, data), and what
/// the torque of each row does to the readings, by central differences of the simulation.
struct DenseRun {
  Dense columns;
  Dense by_torque;
  Vector force_share, velocity_share;  ///< one over the reading's weight

  Dense covariance(const Variances& variances) const {
    Dense sum = variances.torque * by_torque * by_torque.transpose();
    sum.diagonal() += variances.force * force_share + variances.velocity * velocity_share;
    return sum;
  }
};

DenseRun dense(const clampd::Run& run, const BrakeParameters& parameters, const BrakeState& initial,
               const ReadingWeights& weights = {}) {
  const auto size = static_cast<Eigen::Index>(run.size());
  DenseRun out;
  out.columns.resize(2 * size, kUnknowns + 1);
  out.by_torque = Dense::Zero(2 * size, size);
  out.force_share = out.velocity_share = Vector::Zero(2 * size);
  SensitivitySimulation simulation(run.size());
  simulate(parameters, initial, excitation_of(run), simulation);
  for (Eigen::Index k = 0; k < size; ++k) {
    const auto row = static_cast<std::size_t>(k);
    out.columns.row(2 * k) << -simulation.force_sensitivity.row(k),
        run.force_N[row] - simulation.force_N[row];
    out.columns.row(2 * k + 1) << -simulation.velocity_sensitivity.row(k),
        run.velocity_rad_s[row] - simulation.velocity_rad_s[row];
    out.force_share[2 * k] = weights.force.empty() ? 1.0 : 1.0 / weights.force[row];
    out.velocity_share[2 * k + 1] = weights.velocity.empty() ? 1.0 : 1.0 / weights.velocity[row];
  }
  constexpr double kStep_Nm = 1e-6;
  Simulation high(run.size());
  Simulation low(run.size());
  clampd::Run moved = run;
  for (Eigen::Index j = 0; j < size; ++j) {
    double& torque = moved.torque_Nm[static_cast<std::size_t>(j)];
    const double before = torque;
    torque = before + kStep_Nm;
    simulate(parameters, initial, excitation_of(moved), high);
    torque = before - kStep_Nm;
    simulate(parameters, initial, excitation_of(moved), low);
    torque = before;
    for (Eigen::Index k = 0; k < size; ++k) {
      const auto row = static_cast<std::size_t>(k);
      out.by_torque(2 * k, j) = (high.force_N[row] - low.force_N[row]) / (2.0 * kStep_Nm);
      out.by_torque(2 * k + 1, j) = (high.velocity_rad_s[row] - low.velocity_rad_s[row]) / (2.0 * kStep_Nm);
    }
  }
  return out;
}

/// Relative to the larger of the two diagonals, as units differ from entry to entry.
double largest_difference(const Dense& a, const Dense& b) {
  double largest = 0.0;
  for (Eigen::Index i = 0; i < a.rows(); ++i)
    for (Eigen::Index j = 0; j < a.cols(); ++j)
      largest =
          std::max(largest, std::abs(a(i, j) - b(i, j)) / (std::sqrt(std::abs(b(i, i) * b(j, j))) + 1e-300));
  return largest;
}

double log_determinant(const Dense& matrix) {
  return 2.0 * matrix.llt().matrixLLT().diagonal().array().log().sum();
}

ReadingWeights unequal_weights(std::size_t rows) {
  ReadingWeights weights;
  for (std::size_t k = 0; k < rows; ++k) {
    weights.force.push_back(k % 7 == 3 ? 0.2 : 1.0);
    weights.velocity.push_back(k % 5 == 1 ? 0.35 : 1.0);
  }
  return weights;
}

TEST(LinearRun, TheCostWithoutDerivativesIsThatOfTheNormalEquations) {
  const BrakeParameters brake = support::unlike_nominal();
  const BrakeState initial(-0.7, 0.4);
  const clampd::Run whole = stretch(100, 120, initial, 5);
  clampd::Run sparse;
  with_gaps(whole, sparse);
  const ReadingWeights weights = unequal_weights(sparse.size());
  LinearRun linear = linearised(sparse, brake, initial);
  ignore_torque_noise(variances_of(kNoise), weights, linear);
  const double of_output_errors = normal_equations(linear)(kDataColumn, kDataColumn);
  EXPECT_NEAR(sum_of_squares_of(sparse, brake, initial, linear.gains) / of_output_errors, 1.0, 1e-12);

  ASSERT_TRUE(extended_kalman_filter(sparse, brake, initial, variances_of(kNoise), weights, linear));
  const double of_innovations = normal_equations(linear)(kDataColumn, kDataColumn);
  EXPECT_GT(of_output_errors, 1.5 * of_innovations);
  EXPECT_NEAR(sum_of_squares_of(sparse, brake, initial, linear.gains) / of_innovations, 1.0, 1e-12);

  EXPECT_EQ(sum_of_squares_of(sparse, brake, {0.0, 2.0 * kDivergedVelocity_rad_s}, linear.gains),
            std::numeric_limits<double>::infinity());
}

TEST(LinearRun, RowsChainToTheSimulationsSensitivities) {
  const BrakeParameters brake = support::unlike_nominal();
  const BrakeState initial(-0.7, 0.4);
  const clampd::Run run = stretch(0, 300, initial, 1);
  SensitivitySimulation simulation(run.size());
  simulate(brake, initial, excitation_of(run), simulation);
  const LinearRun linear = linearised(run, brake, initial);
  const auto readings = chained(linear);
  const auto force_scale = simulation.force_sensitivity.colwise().lpNorm<Eigen::Infinity>().eval();
  const auto velocity_scale = simulation.velocity_sensitivity.colwise().lpNorm<Eigen::Infinity>().eval();
  for (std::size_t k = 0; k < run.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    ASSERT_EQ(linear.rows[k].residual[0], run.force_N[k] - simulation.force_N[k]) << k;
    ASSERT_EQ(linear.rows[k].residual[1], run.velocity_rad_s[k] - simulation.velocity_rad_s[k]) << k;
    for (int i = 0; i < kUnknowns; ++i) {
      ASSERT_NEAR(readings[k](0, i), simulation.force_sensitivity(row, i), 1e-10 * force_scale[i])
          << k << ' ' << i;
      ASSERT_NEAR(readings[k](1, i), simulation.velocity_sensitivity(row, i), 1e-10 * velocity_scale[i])
          << k << ' ' << i;
    }
  }
}

TEST(LinearRun, GapsOfSeveralMillisecondsAreStepsWithoutReadings) {
  const BrakeState initial(-0.5, 0.0);
  const clampd::Run run = stretch(0, 300, initial, 2);
  clampd::Run sparse;
  const std::vector<std::size_t> kept = with_gaps(run, sparse);
  LinearRun full = linearised(run, {}, initial);
  LinearRun gaps = linearised(sparse, {}, initial);
  // In the full run a reading of weight almost zero is no reading.
  ReadingWeights weights;
  weights.force.assign(run.size(), 1e-18);
  weights.velocity.assign(run.size(), 1e-18);
  for (const std::size_t k : kept) weights.force[k] = weights.velocity[k] = 1.0;
  const Variances variances = variances_of(kNoise);
  update_gains(variances, weights, full);
  update_gains(variances, {}, gaps);
  const Normal of_full = normal_equations(full);
  const Normal of_gaps = normal_equations(gaps);
  EXPECT_LT(largest_difference(of_gaps, of_full), 1e-6);
  double largest_sd = 0.0;
  for (std::size_t i = 0; i < kept.size(); ++i) {
    const Eigen::Matrix2d& expected = full.gains[kept[i]].covariance;
    const Eigen::Matrix2d& covariance = gaps.gains[i].covariance;
    largest_sd = std::max(largest_sd, std::sqrt(expected(1, 1)));
    for (int j = 0; j < 2; ++j)
      ASSERT_NEAR(std::sqrt(covariance(j, j)), std::sqrt(expected(j, j)), 1e-7) << kept[i];
    ASSERT_LT((gaps.reference[i] - full.reference[kept[i]]).norm(), 1e-9) << kept[i];
    const LinearRow& row = gaps.rows[i];
    ASSERT_LT((row.torque_root * row.torque_root.transpose() - row.torque_covariance).norm(),
              1e-9 * row.torque_covariance.norm() + 1e-12)
        << kept[i];
  }
  EXPECT_GT(largest_sd, 0.05);
}

TEST(LinearRun, InnovationsAreTheDenseProblemWhitened) {
  for (const std::size_t from : {0u, 40u, 80u}) {
    const BrakeState initial = from == 0 ? BrakeState(-0.2, 0.0) : BrakeState(18.0, 40.0);
    const clampd::Run run = stretch(from, 40, initial, 3);
    for (const ReadingWeights& weights : {ReadingWeights{}, unequal_weights(run.size())}) {
      const Variances variances = variances_of(kNoise);
      LinearRun linear = linearised(run, {}, initial);
      update_gains(variances, weights, linear);
      const Normal normal = normal_equations(linear);
      const DenseRun problem = dense(run, {}, initial, weights);
      const Dense covariance = problem.covariance(variances);
      const Dense expected = problem.columns.transpose() * covariance.llt().solve(problem.columns);
      EXPECT_LT(largest_difference(normal, expected), 1e-4) << from;
      EXPECT_NEAR(normal(kDataColumn, kDataColumn) / expected(kDataColumn, kDataColumn), 1.0, 1e-5) << from;
      EXPECT_NEAR(linear.log_determinant, log_determinant(covariance), 1e-3) << from;
      // The torque's noise is not negligible here, or all this says nothing.
      EXPECT_GT(log_determinant(covariance) -
                    log_determinant(problem.covariance({variances.force, variances.velocity, 0.0})),
                from == 0 ? 0.1 : 1.0);
    }
  }
}

TEST(LinearRun, IgnoringTorqueNoiseIsOrdinaryLeastSquares) {
  const BrakeState initial(18.0, 40.0);
  const clampd::Run run = stretch(40, 40, initial, 4);
  const ReadingWeights weights = unequal_weights(run.size());
  const Variances variances = variances_of(kNoise);
  LinearRun linear = linearised(run, {}, initial);
  ignore_torque_noise(variances, weights, linear);
  const DenseRun problem = dense(run, {}, initial, weights);
  const Dense covariance = problem.covariance({variances.force, variances.velocity, 0.0});
  const Dense expected = problem.columns.transpose() * covariance.llt().solve(problem.columns);
  EXPECT_LT(largest_difference(normal_equations(linear), expected), 1e-9);
}

/// (15)-(19) as in a textbook, with derivatives by central differences of the simulation.
struct TextbookFilter {
  std::vector<Eigen::Vector2d> innovations;
  double sum_of_squares = 0.0;
  double log_determinant = 0.0;
};

TextbookFilter textbook(const clampd::Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                        const NoiseLevels& noise) {
  const auto step = [&](const BrakeState& state, double torque_Nm) -> BrakeState {
    const std::vector<double> torque{torque_Nm, 0.0};
    Simulation simulation(2);
    simulate(parameters, state, {torque}, simulation);
    return {simulation.position_rad[1], simulation.velocity_rad_s[1]};
  };
  const auto read = [&](const BrakeState& state) -> Eigen::Vector2d {
    const std::vector<double> torque{0.0};
    Simulation simulation(1);
    simulate(parameters, state, {torque}, simulation);
    return {simulation.force_N[0], simulation.velocity_rad_s[0]};
  };
  const Eigen::Vector2d reading_variance(noise.sensors.force_N * noise.sensors.force_N,
                                         noise.sensors.velocity_rad_s * noise.sensors.velocity_rad_s);
  const double steps[2] = {1e-6, 1e-5};
  TextbookFilter filter;
  BrakeState state = initial;
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  for (std::size_t k = 0; k < run.size(); ++k) {
    Eigen::Matrix2d c;
    for (int i = 0; i < 2; ++i) {
      const Eigen::Vector2d by = steps[i] * Eigen::Vector2d::Unit(i);
      c.col(i) = (read(state + by) - read(state - by)) / (2.0 * steps[i]);
    }
    const Eigen::Vector2d innovation = Eigen::Vector2d(run.force_N[k], run.velocity_rad_s[k]) - read(state);
    Eigen::Matrix2d s = c * covariance * c.transpose();
    s.diagonal() += reading_variance;
    const Eigen::Matrix2d gain = covariance * c.transpose() * s.inverse();
    filter.innovations.push_back(innovation);
    filter.sum_of_squares += innovation.dot(s.inverse() * innovation);
    filter.log_determinant += std::log(s.determinant());
    state += gain * innovation;
    covariance = (Eigen::Matrix2d::Identity() - gain * c) * covariance;
    Eigen::Matrix2d a;
    for (int i = 0; i < 2; ++i) {
      const Eigen::Vector2d by = steps[i] * Eigen::Vector2d::Unit(i);
      a.col(i) = (step(state + by, run.torque_Nm[k]) - step(state - by, run.torque_Nm[k])) / (2.0 * steps[i]);
    }
    const Eigen::Vector2d b =
        (step(state, run.torque_Nm[k] + 1e-6) - step(state, run.torque_Nm[k] - 1e-6)) / 2e-6;
    state = step(state, run.torque_Nm[k]);
    covariance = a * covariance * a.transpose() + noise.torque_Nm * noise.torque_Nm * b * b.transpose();
  }
  return filter;
}

TEST(ExtendedKalmanFilter, IsTheTextbooks) {
  const BrakeParameters brake = support::unlike_nominal();
  const BrakeState initial(0.3, 0.0);
  const clampd::Run run = stretch(0, 300, initial, 5);
  const TextbookFilter expected = textbook(run, brake, initial, kNoise);
  LinearRun filter;
  filter.resize(run.size());
  ASSERT_TRUE(extended_kalman_filter(run, brake, initial, variances_of(kNoise), {}, filter));
  for (std::size_t k = 0; k < run.size(); ++k) {
    ASSERT_NEAR(filter.rows[k].residual[0], expected.innovations[k][0], 1e-3 * 30.0) << k;
    ASSERT_NEAR(filter.rows[k].residual[1], expected.innovations[k][1], 1e-3 * 0.3) << k;
  }
  EXPECT_NEAR(filter.log_determinant, expected.log_determinant, 1e-2);
  const Normal normal = normal_equations(filter);
  EXPECT_NEAR(normal(kDataColumn, kDataColumn), expected.sum_of_squares, 1e-3 * expected.sum_of_squares);
}

TEST(ExtendedKalmanFilter, ItsGainsAloneGiveTheSameRowsAgain) {
  const BrakeState initial(0.0, 0.0);
  const clampd::Run run = stretch(0, 300, initial, 6);
  LinearRun filter;
  filter.resize(run.size());
  ASSERT_TRUE(extended_kalman_filter(run, {}, initial, variances_of(kNoise), {}, filter));
  LinearRun replay;
  replay.resize(run.size());
  replay.gains = filter.gains;
  ASSERT_TRUE(linearise_with_gains(run, {}, initial, replay));
  LinearRun updated = filter;
  update_gains(variances_of(kNoise), {}, updated);
  EXPECT_NEAR(updated.log_determinant, filter.log_determinant, 1e-9 * std::abs(filter.log_determinant));
  for (std::size_t k = 0; k < run.size(); ++k) {
    ASSERT_EQ(replay.rows[k].residual, filter.rows[k].residual) << k;
    ASSERT_EQ(replay.reference[k], filter.reference[k]) << k;
    ASSERT_LT((updated.gains[k].gain - filter.gains[k].gain).norm(),
              1e-9 * (filter.gains[k].gain.norm() + 1e-9))
        << k;
  }
}

/// The derivatives of the innovations by the unknowns, through reference trajectory and corrections.
TEST(ExtendedKalmanFilter, InnovationsDerivativesAreThoseOfTheFilterWithTheseGains) {
  const BrakeState initial(0.1, 0.0);
  const clampd::Run run = stretch(0, 120, initial, 7);
  const ParameterVector nominal = nominal_parameters();
  LinearRun filter;
  filter.resize(run.size());
  ASSERT_TRUE(extended_kalman_filter(run, {}, initial, variances_of(kNoise), {}, filter));
  normal_equations(filter);
  LinearRun high = filter;
  LinearRun low = filter;
  constexpr double kStep = 1e-6;
  for (int i = 0; i < kUnknowns; ++i) {
    if (i == kInitialVelocityColumn) continue;  // at rest: a kink
    BrakeParameters up, down;
    BrakeState up_from = initial;
    BrakeState down_from = initial;
    if (i < kTheta) {
      up.theta[i] += kStep * nominal[i];
      down.theta[i] -= kStep * nominal[i];
    } else {
      up_from[i - kTheta] += kStep;
      down_from[i - kTheta] -= kStep;
    }
    ASSERT_TRUE(linearise_with_gains(run, up, up_from, high));
    ASSERT_TRUE(linearise_with_gains(run, down, down_from, low));
    const double force_scale = filter.innovations.row(i)(Eigen::seq(0, Eigen::last, 2)).cwiseAbs().maxCoeff();
    const double velocity_scale =
        filter.innovations.row(i)(Eigen::seq(1, Eigen::last, 2)).cwiseAbs().maxCoeff();
    for (std::size_t k = 0; k < run.size(); ++k) {
      const Eigen::Vector2d slope = (high.rows[k].residual - low.rows[k].residual) / (2.0 * kStep);
      const auto at = static_cast<Eigen::Index>(2 * k);
      ASSERT_NEAR(filter.innovations(i, at), slope[0], 1e-4 * force_scale) << i << " row " << k;
      ASSERT_NEAR(filter.innovations(i, at + 1), slope[1], 1e-4 * velocity_scale) << i << " row " << k;
    }
  }
}

TEST(ScoreMoments, AreTheScoresSquaredDerivativesOneNoiseAfterTheOther) {
  const BrakeState initial(18.0, 40.0);
  const clampd::Run run = stretch(40, 40, initial, 8);
  const ReadingWeights weights = unequal_weights(run.size());
  const Variances variances = variances_of(kNoise);
  LinearRun linear = linearised(run, {}, initial);
  update_gains(variances, weights, linear);
  const Normal normal = normal_equations(linear);
  const ScoreMoments moments = score_moments(weights, Eigen::Matrix<double, kUnknowns, 1>::Zero(), linear);
  const DenseRun problem = dense(run, {}, initial, weights);
  const Dense inverse = problem.covariance(variances).inverse();
  const Dense all = problem.columns.transpose() * inverse;  // derivative of [J e]^T W e by each reading
  const auto squared = [&](const Vector& share) -> Dense {
    return all * share.asDiagonal() * all.transpose();
  };
  EXPECT_LT(largest_difference(moments.force, squared(problem.force_share)), 1e-3);
  EXPECT_LT(largest_difference(moments.velocity, squared(problem.velocity_share)), 1e-3);
  const Dense by_torque = all * problem.by_torque;
  EXPECT_LT(largest_difference(moments.torque, by_torque * by_torque.transpose()), 1e-3);
  const Dense torque_part = problem.by_torque.transpose() * inverse * problem.by_torque;
  EXPECT_NEAR(moments.force_trace / inverse.diagonal().dot(problem.force_share), 1.0, 1e-4);
  EXPECT_NEAR(moments.velocity_trace / inverse.diagonal().dot(problem.velocity_share), 1.0, 1e-4);
  EXPECT_NEAR(moments.torque_trace / torque_part.trace(), 1.0, 1e-4);
  // Right weights: the score's covariance is the information.
  const Dense total = variances.force * moments.force + variances.velocity * moments.velocity +
                      variances.torque * moments.torque;
  EXPECT_LT(largest_difference(total, normal), 1e-6);

  // An offset common to all force readings, to all velocity readings.
  for (int channel = 0; channel < 2; ++channel) {
    LinearRun moved = linear;
    for (LinearRow& row : moved.rows) row.residual[channel] += 1.0;
    const Eigen::Matrix<double, kUnknowns, 1> slope =
        (normal_equations(moved) - normal).block<kUnknowns, 1>(0, kDataColumn);
    EXPECT_LT((moments.offsets.col(channel) - slope).norm(), 1e-8 * slope.norm()) << channel;
  }
}

/// Two runs of one brake, started differently, as one dense problem with the initial states' priors as
/// further readings.
class RestrictedLikelihoodTest : public ::testing::Test {
 protected:
  RestrictedLikelihoodTest() {
    held_[Tv] = true;
    for (int r = 0; r < 2; ++r) {
      const BrakeState initial = r == 0 ? BrakeState(18.0, 40.0) : BrakeState(10.0, 60.0);
      recorded_[r] = stretch(r == 0 ? 40 : 20, 34, initial, 20u + static_cast<unsigned>(r));
      weights_.push_back(r == 0 ? unequal_weights(34) : ReadingWeights{});
      runs_.push_back(linearised(recorded_[r], {}, initial));
      distances_.emplace_back(0.3 - r, 2.0 * r - 0.5);
      problems_.push_back(dense(recorded_[r], {}, initial, weights_.back()));
    }
  }

  double likelihood(const Eigen::Vector3d& values) {
    return restricted_likelihood(runs_, weights_, distances_, held_, {values[0], values[1], values[2]},
                                 normals_);
  }

  static constexpr Eigen::Index kRows = 2 * 34;
  static constexpr Eigen::Index kAll = 2 * kRows + 4;

  /// Covariance of all readings and priors.
  Dense covariance(const Eigen::Vector3d& values) const {
    Dense sum = Dense::Zero(kAll, kAll);
    for (int r = 0; r < 2; ++r)
      sum.block(r * kRows, r * kRows, kRows, kRows) =
          problems_[static_cast<std::size_t>(r)].covariance({values[0], values[1], values[2]});
    for (int r = 0; r < 2; ++r) {
      sum(2 * kRows + 2 * r, 2 * kRows + 2 * r) = kInitialPositionPrior_rad * kInitialPositionPrior_rad;
      sum(2 * kRows + 2 * r + 1, 2 * kRows + 2 * r + 1) =
          kInitialVelocityPrior_rad_s * kInitialVelocityPrior_rad_s;
    }
    return sum;
  }

  /// Derivative of covariance() by the i-th variance.
  Dense by_variance(int i) const {
    Dense sum = Dense::Zero(kAll, kAll);
    for (int r = 0; r < 2; ++r) {
      const DenseRun& problem = problems_[static_cast<std::size_t>(r)];
      auto block = sum.block(r * kRows, r * kRows, kRows, kRows);
      if (i == 0) block.diagonal() = problem.force_share;
      if (i == 1) block.diagonal() = problem.velocity_share;
      if (i == 2) block = problem.by_torque * problem.by_torque.transpose();
    }
    return sum;
  }

  void stack(Dense& jacobian, Vector& error) const {
    jacobian = Dense::Zero(kAll, kTheta - 1 + 4);
    error = Vector::Zero(kAll);
    for (int r = 0; r < 2; ++r) {
      const DenseRun& problem = problems_[static_cast<std::size_t>(r)];
      Eigen::Index column = 0;
      for (int i = 0; i < kTheta; ++i)
        if (!held_[static_cast<std::size_t>(i)])
          jacobian.block(r * kRows, column++, kRows, 1) = problem.columns.col(i);
      jacobian.block(r * kRows, kTheta - 1 + 2 * r, kRows, 2) = problem.columns.middleCols(kTheta, 2);
      error.segment(r * kRows, kRows) = problem.columns.col(kDataColumn);
      jacobian.block(2 * kRows + 2 * r, kTheta - 1 + 2 * r, 2, 2).setIdentity();
      error.segment(2 * kRows + 2 * r, 2) = distances_[static_cast<std::size_t>(r)];
    }
  }

  Held held_{};
  clampd::Run recorded_[2];
  std::vector<ReadingWeights> weights_;
  std::vector<LinearRun> runs_;
  std::vector<Eigen::Vector2d> distances_;
  std::vector<DenseRun> problems_;
  std::vector<Normal> normals_ = std::vector<Normal>(2);
  const Eigen::Vector3d at_{40.0 * 40.0, 0.25 * 0.25, 0.02 * 0.02};
};

TEST_F(RestrictedLikelihoodTest, IsTheDenseOne) {
  Dense jacobian;
  Vector error;
  stack(jacobian, error);
  const Dense inverse = covariance(at_).inverse();
  const Dense information = jacobian.transpose() * inverse * jacobian;
  const Dense projection =
      inverse - inverse * jacobian * information.inverse() * jacobian.transpose() * inverse;
  const double priors = 4.0 * std::log(kInitialPositionPrior_rad * kInitialVelocityPrior_rad_s);
  const double expected = 0.5 * (log_determinant(covariance(at_)) - priors + log_determinant(information) +
                                 error.dot(projection * error));
  EXPECT_NEAR(likelihood(at_), expected, 1e-4 * std::abs(expected));

  const LikelihoodSlopes slopes = restricted_likelihood_slopes(runs_, weights_, normals_, held_);
  Dense average(3, 3);
  for (int i = 0; i < 3; ++i) {
    const Dense of_i = by_variance(i);
    const double slope =
        0.5 * ((projection * of_i).trace() - error.dot(projection * of_i * projection * error));
    EXPECT_NEAR(slopes.gradient[i] * at_[i], slope * at_[i], 1e-2 + 1e-3 * std::abs(slope * at_[i])) << i;
    for (int j = 0; j < 3; ++j)
      average(i, j) = 0.5 * error.dot(projection * of_i * projection * by_variance(j) * projection * error);
  }
  EXPECT_LT(largest_difference(slopes.information, average), 1e-3);
}

TEST_F(RestrictedLikelihoodTest, ItsGradientIsThatOfItsCentralDifferences) {
  for (const double torque_Nm : {1e-3, 0.02, 0.1}) {
    const Eigen::Vector3d at(at_[0], at_[1], torque_Nm * torque_Nm);
    likelihood(at);
    const LikelihoodSlopes slopes = restricted_likelihood_slopes(runs_, weights_, normals_, held_);
    for (int i = 0; i < 3; ++i) {
      Eigen::Vector3d high = at;
      Eigen::Vector3d low = at;
      high[i] *= 1.0 + 1e-4;
      low[i] *= 1.0 - 1e-4;
      const double by_logarithm = (likelihood(high) - likelihood(low)) / 2e-4;
      EXPECT_NEAR(slopes.gradient[i] * at[i], by_logarithm, 1e-5 * (1.0 + std::abs(by_logarithm)))
          << i << " at " << torque_Nm;
    }
  }
}

TEST_F(RestrictedLikelihoodTest, AHeldParameterIsNotIntegratedOut) {
  likelihood(at_);
  const JointNormal joint = eliminate_initial_states(normals_, held_);
  EXPECT_EQ(joint.gradient[Tv], 0.0);
  EXPECT_EQ(joint.information(Tv, Tv), 1.0);
  const double held = likelihood(at_);
  // Integrated out with a flat prior instead: another likelihood.
  held_ = {};
  EXPECT_GT(std::abs(likelihood(at_) - held), 0.1);
}

TEST_F(RestrictedLikelihoodTest, ScoringEndsAtItsMinimum) {
  const NoiseFit fit = estimate_noise(runs_, weights_, distances_, held_, {at_[0], at_[1], at_[2]}, {}, 50);
  const Eigen::Vector3d found(fit.variances.force, fit.variances.velocity, fit.variances.torque);
  const double there = likelihood(found);
  // But for the faint pull away from zero torque noise: 0.03 log variance.
  for (int i = 0; i < 3; ++i)
    for (const double factor : {0.7, 1.4}) {
      Eigen::Vector3d beside = found;
      beside[i] *= factor;
      const double pull = i == 2 ? 0.03 * std::log(factor) : 0.0;
      EXPECT_GT(likelihood(beside) - pull, there) << i << ' ' << factor;
    }
}

TEST_F(RestrictedLikelihoodTest, KnownVariancesStay) {
  const NoiseFit fit = estimate_noise(runs_, weights_, distances_, held_, {900.0, 0.1, 1e-4},
                                      {.force = true, .velocity = false, .torque = true}, 50);
  EXPECT_EQ(fit.variances.force, 900.0);
  EXPECT_EQ(fit.variances.torque, 1e-4);
  EXPECT_NE(fit.variances.velocity, 0.1);
}

}  // namespace
}  // namespace clampd::identify
