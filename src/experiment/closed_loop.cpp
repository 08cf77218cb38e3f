#include "closed_loop.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/clock.hpp"
#include "clampd/brake/integrator.hpp"

namespace clampd {

namespace {

constexpr double kReach_rad = 6.0;
constexpr double kLeastStretch = 0.6;
constexpr double kMostStretch = 1.6;
constexpr double kSignWidth_rad_s = 3.0;

double slope_at(const PolynomialStiffness& stiffness, double position_rad) {
  double unused[PolynomialStiffness::kParameters];
  return stiffness.evaluate(position_rad, unused).slope_N_rad;
}

/// Where this stiffness has the row's force: within reach of the row's position and where it is still steep.
double position_for(const PolynomialStiffness& stiffness, const ReferenceRow& row) {
  if (row.position_rad <= 0.0 || row.force_N <= 0.0) return row.position_rad;
  double highest = row.position_rad + kReach_rad;
  if (stiffness.cubic_N_rad3 < 0.0)
    highest = std::min(highest, 1.6 * stiffness.quadratic_N_rad2 / (-3.0 * stiffness.cubic_N_rad3));
  const double lowest = std::max(0.5 * row.position_rad, row.position_rad - kReach_rad);
  highest = std::max(highest, lowest);
  double x = std::clamp(row.position_rad, lowest, highest);
  for (int iteration = 0; iteration < 6; ++iteration)
    x = std::clamp(x + (row.force_N - stiffness.force_N(x)) / std::max(slope_at(stiffness, x), 1.0), lowest,
                   highest);
  return x;
}

}  // namespace

ClosedLoop::ClosedLoop(const BrakeParameters& nominal, double torque_limit_Nm)
    : nominal_(nominal), nominal_brake_(paper_brake(nominal)), torque_limit_Nm_(torque_limit_Nm) {}

double ClosedLoop::torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const PaperBrake& brake,
                             const BrakeState& state) const {
  const double position_rad = position_for(brake.stiffness(), row);
  double stretch = 1.0;
  if (row.position_rad > 0.0)
    stretch = row.position_rad > 1.0
                  ? row.stiffness_N_rad / std::max(slope_at(brake.stiffness(), position_rad), 1.0)
                  : position_rad / row.position_rad;
  stretch = std::clamp(stretch, kLeastStretch, kMostStretch);
  const double velocity_rad_s = stretch * row.velocity_rad_s;
  const double acceleration_rad_s2 = (next.velocity_rad_s - row.velocity_rad_s) / kPeriod_s;
  const double force_N = brake.stiffness().force_N(state[0]);
  const double speed_rad_s = std::abs(state[1]);
  const double excess_Nm = brake.friction().sliding_Nm(force_N, speed_rad_s, 1.0) -
                           nominal_brake_.friction().sliding_Nm(force_N, speed_rad_s, 1.0);
  return row.torque_Nm +
         (stretch - 1.0) *
             (nominal_.fixed.inertia_kg_m2 * acceleration_rad_s2 + nominal_.theta[Tv] * row.velocity_rad_s) +
         excess_Nm * std::clamp(velocity_rad_s / kSignWidth_rad_s, -1.0, 1.0) +
         row.gain_position * (position_rad - state[0]) + row.gain_velocity * (velocity_rad_s - state[1]);
}

void ClosedLoop::track(const Reference& reference, const BrakeParameters& parameters, TrackedRun& out) const {
  const PaperBrake brake = paper_brake(parameters);
  const double braking_rad_s2 = torque_limit_Nm_ / parameters.fixed.inertia_kg_m2;
  out = {.bounded = true, .torque_Nm = std::move(out.torque_Nm)};
  out.torque_Nm.clear();
  BrakeState state = BrakeState::Zero();
  double squares_N2 = 0.0;
  for (std::size_t k = 0; k < reference.rows.size(); ++k) {
    const ReferenceRow& row = reference.rows[k];
    const double force_N = brake.stiffness().force_N(state[0]);
    // Along the tangent, as the loop's own guard judges it.
    const double stop_rad = state[1] > 0.0 ? state[1] * (kPeriod_s + 0.5 * state[1] / braking_rad_s2) : 0.0;
    out.force_max_N = std::max(out.force_max_N, force_N);
    out.stop_force_max_N =
        std::max(out.stop_force_max_N, force_N + slope_at(brake.stiffness(), state[0]) * stop_rad);
    out.velocity_max_rad_s = std::max(out.velocity_max_rad_s, std::abs(state[1]));
    squares_N2 += (force_N - row.force_N) * (force_N - row.force_N);
    const ReferenceRow& next = reference.rows[std::min(k + 1, reference.rows.size() - 1)];
    const double torque = torque_Nm(row, next, brake, state);
    out.torque_max_Nm = std::max(out.torque_max_Nm, std::abs(torque));
    out.torque_Nm.push_back(std::clamp(torque, -torque_limit_Nm_, torque_limit_Nm_));
    state = advance(brake, state, out.torque_Nm.back(), kPeriod_s);
    if (!is_bounded(state)) {
      out.bounded = false;
      return;
    }
  }
  out.tracking_rms_N = std::sqrt(squares_N2 / static_cast<double>(reference.rows.size()));
}

}  // namespace clampd
