#include "src/drive/forward_simulation.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <fmt/format.h>

#include "src/drive/data_check.hpp"

namespace clampd::drive {
namespace {

constexpr std::size_t kFewestRows = 10;

double largest(const std::vector<double>& values) {
  double most = 0.0;
  for (const double value : values) most = std::max(most, std::abs(value));
  return most;
}

}  // namespace

void Motion::advance(double step_s, double length) {
  if (velocity * sign < 0.0) travel = travel_after_reversal(travel, length);
  if (velocity != 0.0) sign = std::copysign(1.0, velocity);
  position += step_s * velocity;
  travel += step_s * std::abs(velocity);
}

double length_of_reversals(const FittedDrive& drive) {
  double length = 1.0;
  for (const FittedTerm& term : drive.terms)
    for (const BasisFunction& function : term.functions)
      if (function.factor == BasisFunction::Factor::Reversal) length = function.first;
  return length;
}

std::vector<const std::vector<double>*> columns_for(const DriveModel& model, const Run& run) {
  std::vector<const std::vector<double>*> columns;
  for (const DriveRegressor& regressor : model.regressors)
    for (const RunColumn& column : run.others)
      if (column.name == regressor.name) columns.push_back(&column.values);
  return columns;
}

Result<void> check_moves(const FittedDrive& drive) {
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

Result<void> check_run(const Run& run, const DriveModel& model) {
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

ForwardSimulation::ForwardSimulation(const Run& run, const FittedDrive& drive, int number, double start)
    : run_(run),
      drive_(drive),
      torque_(settled(run.time_s, run.torque_Nm, drive.settling_s)),
      length_(length_of_reversals(drive)),
      columns_(drive.model.regressors.size()),
      recorded_(columns_for(drive.model, run)) {
  state_.run = number;
  const double recorded =
      largest(run.velocity_rad_s.empty() ? data_check::differences(run.time_s, run.position_rad)
                                         : run.velocity_rad_s);
  // What the torque could reach without any friction; a thousand times that is no motion but a simulation
  // that left all bounds.
  const double duration_s = run.time_s.back() - run.time_s.front();
  const double inertia = needed(1.0, 0.0, {}) - needed(0.0, 0.0, {});
  const double strongest = largest(run.torque_Nm) + torque_at_rest(start);
  fastest_ = std::max(recorded, strongest / inertia * duration_s);
  farthest_ = 1e3 * (std::max(std::abs(start), largest(run.position_rad)) + fastest_ * duration_s);
  longest_step_s_ = 0.2 * viscous_time_s(recorded > 0.0 ? recorded : fastest_);
}

bool ForwardSimulation::advance(std::size_t row, Motion& motion) {
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
  return std::abs(motion.position) <= farthest_ && std::abs(motion.velocity) <= 1e3 * fastest_;
}

/// The most that gravity, springs and offsets ask for around the place where it begins, a turn to either
/// side.
double ForwardSimulation::torque_at_rest(double start) {
  constexpr int kPlaces = 16;
  const std::vector<double> none(columns_.size(), 0.0);
  state_.columns = none;
  double most = 0.0;
  for (int k = -kPlaces; k <= kPlaces; ++k) {
    state_.position = start + 2.0 * std::numbers::pi * k / kPlaces;
    most = std::max(most, std::abs(needed(0.0, 0.0, {})));
  }
  state_.position = 0.0;
  state_.columns = {};
  return most;
}

double ForwardSimulation::needed(double acceleration, double direction, const Motion& motion) {
  state_.acceleration = acceleration;
  state_.direction = direction;
  // After a reversal friction builds up anew: in the other direction it has not yet begun.
  const bool goes_on = direction == 0.0 || motion.sign == 0.0 || direction == motion.sign;
  state_.travel = goes_on ? motion.travel : travel_after_reversal(motion.travel, length_);
  return torque_of(drive_, state_);
}

/// Semi-implicit: the velocity first, friction as a projection that never drives, then the position.
void ForwardSimulation::step(double torque, double step_s, Motion& motion) {
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
  motion.advance(step_s, length_);
}

/// Inertia over viscous friction at a speed, right after a reversal, where bristles damp most.
double ForwardSimulation::viscous_time_s(double speed) {
  const Motion rest{.travel = 0.0};
  state_.velocity = 0.0;
  const double still = needed(0.0, 0.0, rest), inertia = needed(1.0, 0.0, rest) - still;
  state_.velocity = speed;
  const double viscous = std::abs(needed(0.0, 0.0, rest) - still) / std::max(speed, 1e-300);
  return viscous > 0.0 ? inertia / viscous : std::numeric_limits<double>::infinity();
}

/// The torque that acts at a time between rows `row` and `row` + 1, as the model file says: a command is
/// held, a reading is one at its row's time.
double ForwardSimulation::torque_at(std::size_t row, double at_s) const {
  at_s -= drive_.lag_s;
  while (row > 0 && run_.time_s[row] > at_s) --row;
  while (row + 2 < run_.size() && run_.time_s[row + 1] <= at_s) ++row;
  if (drive_.model.torque_held && !(drive_.settling_s > 0.0)) return torque_[row];
  const double share =
      std::clamp((at_s - run_.time_s[row]) / (run_.time_s[row + 1] - run_.time_s[row]), 0.0, 1.0);
  return torque_[row] + share * (torque_[row + 1] - torque_[row]);
}

}  // namespace clampd::drive
