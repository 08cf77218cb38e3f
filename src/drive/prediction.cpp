#include "clampd/drive/prediction.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>
#include <Eigen/Core>

#include "clampd/statistics/symmetric.hpp"
#include "src/drive/data_check.hpp"

namespace clampd {
namespace {

constexpr std::size_t kFewestRows = 10;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

/// What moves. `sign` is that of the last motion, and `reversal` where it began.
struct Motion {
  double position = 0.0, velocity = 0.0;
  double sign = 0.0, travel = std::numeric_limits<double>::infinity();
};

/// The recorded motion about each row, by a quadratic through the rows within `half_width_s`, for the starts
/// of simulations.
Motion motion_at(const Run& run, std::size_t row, double half_width_s) {
  const std::span<const double> x(run.position_rad.empty() ? run.velocity_rad_s : run.position_rad);
  std::size_t first = row, last = row + 1;
  while (first > 0 && run.time_s[row] - run.time_s[first - 1] <= half_width_s) --first;
  while (last < run.size() &&
         (last < first + kFewestRows / 2 || run.time_s[last] - run.time_s[row] <= half_width_s))
    ++last;
  while (first > 0 && last - first < kFewestRows / 2) --first;
  const auto n = static_cast<Eigen::Index>(last - first);
  Eigen::MatrixXd columns(n, 3);
  Eigen::VectorXd target(n);
  const double scale_s =
      std::max(run.time_s[last - 1] - run.time_s[row], run.time_s[row] - run.time_s[first]);
  for (Eigen::Index k = 0; k < n; ++k) {
    const double u = (run.time_s[first + static_cast<std::size_t>(k)] - run.time_s[row]) / scale_s;
    columns.row(k) << 1.0, u, u * u;
    target[k] = x[first + static_cast<std::size_t>(k)] - x[row];
  }
  const Eigen::VectorXd fitted =
      statistics::SymmetricFactor(columns.transpose() * columns).solve(columns.transpose() * target);
  Motion motion;
  motion.position = run.position_rad.empty() ? 0.0 : x[row] + fitted[0];
  motion.velocity = run.position_rad.empty() ? x[row] + fitted[0] : fitted[1] / scale_s;
  return motion;
}

/// One run under one model.
class ForwardSimulation {
 public:
  ForwardSimulation(const Run& run, const FittedDrive& drive, int number)
      : run_(run), drive_(drive), torque_(settled(run.time_s, run.torque_Nm, drive.settling_s)) {
    state_.run = number;
    for (const FittedTerm& term : drive.terms)
      for (const BasisFunction& function : term.functions)
        if (function.factor == BasisFunction::Factor::Reversal) length_ = function.first;
    columns_.resize(drive.model.regressors.size());
    for (const DriveRegressor& regressor : drive.model.regressors)
      for (const RunColumn& column : run.others)
        if (column.name == regressor.name) recorded_.push_back(&column.values);
    const std::vector<double> velocity = run.velocity_rad_s.empty()
                                             ? data_check::differences(run.time_s, run.position_rad)
                                             : run.velocity_rad_s;
    for (const double v : velocity) fastest_ = std::max(fastest_, std::abs(v));
    double largest = 0.0;
    for (const double x : run.position_rad) largest = std::max(largest, std::abs(x));
    // What the torque could reach without any friction; a thousand times that is no motion but a simulation
    // that left all bounds.
    double strongest = 0.0;
    for (const double torque : run.torque_Nm) strongest = std::max(strongest, std::abs(torque));
    const double duration_s = run.time_s.back() - run.time_s.front();
    const double inertia = needed(1.0, 0.0, {}) - needed(0.0, 0.0, {});
    const double recorded = fastest_;
    fastest_ = std::max(fastest_, strongest / inertia * duration_s);
    farthest_ = 1e3 * (largest + fastest_ * duration_s);
    longest_step_s_ = 0.2 * viscous_time_s(recorded > 0.0 ? recorded : fastest_);
  }

  /// One row on; false: it left all bounds.
  bool advance(std::size_t row, Motion& motion) {
    const double gap_s = run_.time_s[row + 1] - run_.time_s[row];
    // Four steps a row for the order of the method, a millisecond for friction, and what stability asks for.
    constexpr double kMostSteps = 2000.0;
    const double longest_s = std::min({gap_s / 4.0, 1e-3, longest_step_s_});
    const auto steps = static_cast<int>(std::min(kMostSteps, std::ceil(gap_s / longest_s - 1e-9)));
    for (std::size_t c = 0; c < recorded_.size(); ++c) columns_[c] = (*recorded_[c])[row];
    state_.columns = columns_;
    for (int k = 0; k < steps; ++k) {
      const double share = (k + 0.5) / steps;
      state_.time_s = run_.time_s[row] + share * gap_s - run_.time_s.front();
      step(torque_at(row, run_.time_s[row] + share * gap_s), gap_s / steps, motion);
    }
    return std::abs(motion.position) < farthest_ && std::abs(motion.velocity) < 1e3 * fastest_;
  }

 private:
  double needed(double acceleration, double direction, const Motion& motion) {
    state_.acceleration = acceleration;
    state_.direction = direction;
    // After a reversal friction builds up anew: in the other direction it has not yet begun.
    const bool goes_on = direction == 0.0 || motion.sign == 0.0 || direction == motion.sign;
    state_.travel = goes_on ? motion.travel : travel_after_reversal(motion.travel, length_);
    return torque_of(drive_, state_);
  }

  /// Semi-implicit: the velocity first, friction as a projection that never drives, then the position.
  void step(double torque, double step_s, Motion& motion) {
    state_.position = motion.position;
    state_.velocity = motion.velocity;
    const double at_rest = needed(0.0, 0.0, motion);
    const double inertia = needed(1.0, 0.0, motion) - at_rest;
    const double acceleration = (torque - at_rest) / inertia;
    const double sliding = needed(acceleration, 0.0, motion);
    const double forward = std::max(0.0, needed(acceleration, 1.0, motion) - sliding);
    const double backward = std::max(0.0, sliding - needed(acceleration, -1.0, motion));
    const double free = motion.velocity + step_s * acceleration;
    if (free > step_s * forward / inertia)
      motion.velocity = free - step_s * forward / inertia;
    else if (free < -step_s * backward / inertia)
      motion.velocity = free + step_s * backward / inertia;
    else
      motion.velocity = 0.0;
    if (motion.velocity * motion.sign < 0.0) motion.travel = travel_after_reversal(motion.travel, length_);
    if (motion.velocity != 0.0) motion.sign = std::copysign(1.0, motion.velocity);
    motion.position += step_s * motion.velocity;
    motion.travel += step_s * std::abs(motion.velocity);
  }

  /// Inertia over viscous friction at a speed.
  double viscous_time_s(double speed) {
    const Motion rest;
    state_.velocity = 0.0;
    const double still = needed(0.0, 0.0, rest), inertia = needed(1.0, 0.0, rest) - still;
    state_.velocity = speed;
    const double viscous = std::abs(needed(0.0, 0.0, rest) - still) / std::max(speed, 1e-300);
    return viscous > 0.0 ? inertia / viscous : std::numeric_limits<double>::infinity();
  }

  /// The torque that acts at a time between rows `row` and `row` + 1, as the model file says: a command is
  /// held, a reading is one at its row's time.
  double torque_at(std::size_t row, double at_s) const {
    at_s -= drive_.lag_s;
    while (row > 0 && run_.time_s[row] > at_s) --row;
    while (row + 2 < run_.size() && run_.time_s[row + 1] <= at_s) ++row;
    if (drive_.model.torque_held && !(drive_.settling_s > 0.0)) return torque_[row];
    const double share =
        std::clamp((at_s - run_.time_s[row]) / (run_.time_s[row + 1] - run_.time_s[row]), 0.0, 1.0);
    return torque_[row] + share * (torque_[row + 1] - torque_[row]);
  }

  const Run& run_;
  const FittedDrive& drive_;
  DriveState state_;
  std::vector<double> torque_;  ///< that acts, a lag aside
  double length_ = 1.0;         ///< over which friction builds up after a reversal
  std::vector<double> columns_;
  std::vector<const std::vector<double>*> recorded_;
  double fastest_ = 0.0, farthest_ = 0.0, longest_step_s_ = 0.0;
};

std::vector<PredictedQuantity> recorded_quantities(const Run& run, const DriveModel& model) {
  std::vector<PredictedQuantity> quantities;
  if (!run.position_rad.empty())
    quantities.push_back({"position", std::string(model.position_unit()), run.position_rad,
                          std::vector<double>(run.size(), kNone)});
  quantities.push_back({"velocity", std::string(model.position_unit()) + "/s",
                        run.velocity_rad_s.empty() ? data_check::differences(run.time_s, run.position_rad)
                                                   : run.velocity_rad_s,
                        std::vector<double>(run.size(), kNone)});
  return quantities;
}

/// From the first row to the end, or anew every `horizon_s`. Returns when it diverged; NaN: never.
double simulate(const Run& run, const FittedDrive& drive, int number, double horizon_s,
                std::vector<PredictedQuantity>& quantities) {
  ForwardSimulation simulation(run, drive, number);
  // The model knows nothing faster than its cut-off, and the start need not either.
  const double half_width_s = std::isfinite(drive.cut_off_Hz) ? 0.2 / drive.cut_off_Hz : 0.0;
  Motion motion;
  double started_s = -std::numeric_limits<double>::infinity();
  for (std::size_t row = 0; row < run.size(); ++row) {
    if (row == 0 || run.time_s[row] - started_s >= horizon_s) {
      motion = motion_at(run, row, half_width_s);
      if (row > 0) motion.sign = motion.velocity > 0.0 ? 1.0 : -1.0;
      started_s = run.time_s[row];
    }
    if (quantities.size() > 1) quantities.front().predicted[row] = motion.position;
    quantities.back().predicted[row] = motion.velocity;
    if (row + 1 < run.size() && !simulation.advance(row, motion)) return run.time_s[row];
  }
  return kNone;
}

Result<void> check(const FittedDrive& drive) {
  const std::string& file = drive.model.file;
  if (drive.model.steady)
    return failure(
        fmt::format("{}: a model of steady speeds has no inertia, and without it no motion follows from a "
                    "{}. Fit a model to runs that accelerate (without steady = true)",
                    file, drive.model.effort()));
  double inertia = 0.0;
  for (const FittedTerm& term : drive.terms)
    if (term.term == DriveTerm::Inertia)
      for (const double coefficient : term.coefficients) inertia += coefficient;
  if (!(inertia > 0.0))
    return failure(fmt::format(
        "{}: the fitted model has no positive inertia, so that no motion follows from a {}. Fit one "
        "to runs that accelerate (inertia = \"estimate\"), or give its value in [model]",
        file, drive.model.effort()));
  return {};
}

Result<void> check(const Run& run, const DriveModel& model) {
  if (run.size() < kFewestRows)
    return failure(fmt::format("{}: {} rows are too few to simulate; at least {} are needed", run.name,
                               run.size(), kFewestRows));
  for (const DriveRegressor& regressor : model.regressors)
    if (std::ranges::none_of(run.others,
                             [&](const RunColumn& column) { return column.name == regressor.name; }))
      return failure(fmt::format("{}: the model needs the column {}, which the run does not have", run.name,
                                 regressor.name));
  return {};
}

}  // namespace

Result<std::vector<PredictedRun>> predict_drive(std::span<const Run> runs, const FittedDrive& drive) {
  if (Result<void> checked = check(drive); !checked) return tl::unexpected(checked.error());
  std::vector<PredictedRun> predicted;
  for (const Run& run : runs) {
    if (Result<void> checked = check(run, drive.model); !checked) return tl::unexpected(checked.error());
    const auto number = static_cast<int>(predicted.size());
    PredictedRun result;
    result.name = run.name;
    result.time_s = run.time_s;
    result.quantities = recorded_quantities(run, drive.model);
    result.diverged_s =
        simulate(run, drive, number, std::numeric_limits<double>::infinity(), result.quantities);
    for (const double horizon_s : {0.1, 1.0}) {
      if (run.time_s.back() - run.time_s.front() < 2.0 * horizon_s) continue;
      result.limited.push_back({horizon_s, recorded_quantities(run, drive.model)});
      simulate(run, drive, number, horizon_s, result.limited.back().quantities);
    }
    predicted.push_back(std::move(result));
  }
  return predicted;
}

}  // namespace clampd
