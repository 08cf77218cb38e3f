#pragma once

#include <vector>

#include "clampd/brake/simulation.hpp"
#include "clampd/identify/information.hpp"
#include "clampd/record/run.hpp"

namespace clampd::identify {

inline constexpr int kTheta = static_cast<int>(kParameterCount);

/// The unknowns of one run: seven normalised parameters, initial position (rad) and velocity (rad/s). A
/// further column holds the data.
inline constexpr int kUnknowns = kSensitivityColumns;
inline constexpr int kDataColumn = kUnknowns;

/// [J e]^T W [J e], J the derivatives of the innovations e by the unknowns, W their weights.
using Normal = Eigen::Matrix<double, kUnknowns + 1, kUnknowns + 1>;

/// One row of a run, linearised about a reference trajectory. With d(k) the state's distance from the
/// reference before the row's reading is used:
///   innovation:   residual - by_state d(k) - by_parameter dp
///   next row:     d(k + 1) = transition (d(k) - correction) + step_by_parameter dp + torque noise
struct LinearRow {
  Eigen::Vector2d residual;  ///< reading minus the model's at the reference: force (N), velocity (rad/s)
  Eigen::Matrix2d by_state;  ///< C of (19)
  Eigen::Matrix<double, 2, kTheta> by_parameter;
  Eigen::Vector2d correction;  ///< of the reference by this row's reading
  Eigen::Matrix2d transition;  ///< A of (19)
  Eigen::Matrix<double, 2, kTheta, Eigen::RowMajor> step_by_parameter;
  Eigen::Matrix2d torque_covariance;  ///< of the next row's state, by torque noise of unit variance
  Eigen::Matrix2d torque_root;        ///< its root: torque_root torque_root^T = torque_covariance
};

/// Variances of the noise: of a force reading and of a velocity reading with weight one, of the torque.
struct Variances {
  double force = 1.0;
  double velocity = 1.0;
  double torque = 0.0;
};
Variances variances_of(const NoiseLevels& noise) noexcept;
NoiseLevels levels_of(const Variances& variances) noexcept;

/// The largest relative change of a standard deviation; the torque's counts once it is no longer lost in
/// `negligible_torque`, a variance.
double change_between(const Variances& a, const Variances& b, double negligible_torque) noexcept;

/// What a reading counts: its noise has the variance divided by its weight. Empty: one each.
struct ReadingWeights {
  std::vector<double> force;
  std::vector<double> velocity;
};

/// Of all unknowns and the data: of a row's two readings or two states.
using Columns = Eigen::Matrix<double, kUnknowns + 1, 2>;

/// The same of many rows: what is summed over all rows is then one matrix product.
using ColumnList = Eigen::Matrix<double, kUnknowns + 1, Eigen::Dynamic>;

struct RowGain {
  Eigen::Matrix2d gain;        ///< K of (16)
  Eigen::Matrix2d weight;      ///< inverse of S of (17)
  Eigen::Matrix2d covariance;  ///< P(k|k-1)
};

/// The disturbance smoother's result for a row, in units of the inverse noise: reading noise over its
/// variance, and what multiplies the torque noise's covariance to give the disturbance of the next state.
struct Disturbance {
  Eigen::Vector2d reading;
  Eigen::Vector2d next_state;
};

/// A run linearised, and the filter that goes with it. Sized once, used many times.
struct LinearRun {
  void resize(std::size_t size);

  std::vector<LinearRow> rows;
  std::vector<RowGain> gains;
  std::vector<Eigen::Vector2d> reference;  ///< state at each row, before its reading is used
  /// By normal_equations(): [J e] and W [J e], two columns a row (force, velocity).
  ColumnList innovations;
  ColumnList weighted_innovations;
  ColumnList scores;  ///< by score_moments(): of all forces, all velocities, all torques (up to two each)
  std::vector<Disturbance> disturbances;  ///< by score_moments()
  double log_determinant = 0.0;           ///< sum of log det S
};

/// A run with this torque whose readings are not known: what is left of it is minus the model's readings.
Run run_without_readings(const Excitation& excitation);

/// Linearises about the run's open-loop simulation. False where that leaves all bounds.
bool linearise(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
               LinearRun& out) noexcept;

/// Linearises about the estimates of the filter with out.gains as they are.
bool linearise_with_gains(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                          LinearRun& out) noexcept;

/// The extended Kalman filter (15)-(19) with x(1|1) = initial known: linearises about its estimates, and
/// writes its gains.
bool extended_kalman_filter(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                            const Variances& variances, const ReadingWeights& weights,
                            LinearRun& out) noexcept;

/// The innovations' squares under gains found before: the last element of normal_equations() once the run is
/// linearised with them, without the derivatives and for a small part of the time. Infinite where the state
/// leaves all bounds.
double sum_of_squares_of(const Run& run, const BrakeParameters& parameters, const BrakeState& initial,
                         const std::vector<RowGain>& gains) noexcept;

/// Rows fixed, gains and log determinant anew for these variances.
void update_gains(const Variances& variances, const ReadingWeights& weights, LinearRun& run) noexcept;

/// Gains zero and S = R: the output error method's view.
void ignore_torque_noise(const Variances& variances, const ReadingWeights& weights, LinearRun& run) noexcept;

/// The innovations' normal equations under the run's gains; keeps [J e] row by row.
Normal normal_equations(LinearRun& run) noexcept;

/// What the noise does to [J e]^T W e, by a pass backwards (the disturbance smoother's): moments are sums
/// over all rows of the squared derivative of that product by a reading of weight one, or by the torque.
struct ScoreMoments {
  Normal force = Normal::Zero();
  Normal velocity = Normal::Zero();
  Normal torque = Normal::Zero();
  /// Of the weights that the data themselves have: the same sums for white innovations.
  double force_trace = 0.0;
  double velocity_trace = 0.0;
  double torque_trace = 0.0;
  /// Derivative by an offset common to all force readings, to all velocity readings.
  Eigen::Matrix<double, kUnknowns, 2> offsets = Eigen::Matrix<double, kUnknowns, 2>::Zero();
};

/// After normal_equations(), for the same gains. Keeps the disturbances for the unknowns moved by `step`.
ScoreMoments score_moments(const ReadingWeights& weights, const Eigen::Matrix<double, kUnknowns, 1>& step,
                           LinearRun& run) noexcept;

/// The readings that each of the three noises (force, velocity, torque) alone would have caused if the
/// disturbances were true, filtered like the data: products among themselves and with J.
struct WorkingProducts {
  Eigen::Matrix3d with_themselves = Eigen::Matrix3d::Zero();
  Eigen::Matrix<double, kUnknowns, 3> with_unknowns = Eigen::Matrix<double, kUnknowns, 3>::Zero();
};

/// After score_moments().
WorkingProducts working_products(const ReadingWeights& weights, const LinearRun& run) noexcept;

}  // namespace clampd::identify
