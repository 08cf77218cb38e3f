#include "closed_loop.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "clampd/brake/integrator.hpp"
#include "clampd/control/control_law.hpp"
#include "clampd/experiment/known_brake.hpp"

namespace clampd {

ClosedLoop::ClosedLoop(const NominalDrive& drive, double torque_limit_Nm)
    : drive_(drive), torque_limit_Nm_(torque_limit_Nm) {}

double ClosedLoop::torque_Nm(const ReferenceRow& row, const ReferenceRow& next, const PaperBrake& brake,
                             const BrakeState& state) const {
  return tracking_torque_Nm(row, next, drive_, known_motion(brake, state, drive_), known_stiffness(brake));
}

bool ClosedLoop::simulate(const Reference& reference, const PaperBrake& brake, bool held_back,
                          TrackedRun& out) const {
  const ControlLimits limits{.torque_Nm = torque_limit_Nm_};
  const StiffnessCurve stiffness = known_stiffness(brake);
  out = {.bounded = true, .torque_Nm = std::move(out.torque_Nm)};
  out.torque_Nm.clear();
  BrakeState state = BrakeState::Zero();
  double squares_N2 = 0.0;
  bool steps_in = false;
  for (std::size_t k = 0; k < reference.rows.size(); ++k) {
    const ReferenceRow& row = reference.rows[k];
    const ReferenceRow& next = reference.rows[std::min(k + 1, reference.rows.size() - 1)];
    const double force_N = brake.stiffness().force_N(state[0]);
    const double slope_N_rad = stiffness.slope_N_rad(state[0]);
    const double stopped_N = stop_force_N(state[1], force_N, slope_N_rad, torque_limit_Nm_, drive_);
    out.force_max_N = std::max(out.force_max_N, force_N);
    out.stop_force_max_N = std::max(out.stop_force_max_N, stopped_N);
    out.velocity_max_rad_s = std::max(out.velocity_max_rad_s, std::abs(state[1]));
    squares_N2 += (force_N - row.force_N) * (force_N - row.force_N);

    const double asked_Nm = torque_Nm(row, next, brake, state);
    const double possible_Nm = std::clamp(asked_Nm, -torque_limit_Nm_, torque_limit_Nm_);
    const double allowed_Nm = limited_torque_Nm(asked_Nm, limits, drive_, state[1], force_N, slope_N_rad);
    steps_in = steps_in || allowed_Nm != possible_Nm;
    out.torque_max_Nm = std::max(out.torque_max_Nm, std::abs(asked_Nm));
    out.torque_Nm.push_back(held_back ? allowed_Nm : possible_Nm);
    state = advance_over(brake, state, out.torque_Nm.back(), drive_.period_s);
    if (!is_bounded(state)) {
      out.bounded = false;
      return steps_in;
    }
  }
  out.tracking_rms_N = std::sqrt(squares_N2 / static_cast<double>(reference.rows.size()));
  return steps_in;
}

void ClosedLoop::track(const Reference& reference, const BrakeParameters& parameters, TrackedRun& out) const {
  const PaperBrake brake = paper_brake(parameters);
  const bool steps_in = simulate(reference, brake, false, out);
  if (!out.bounded || !steps_in) return;
  TrackedRun held;
  held.torque_Nm = std::move(out.torque_Nm);
  simulate(reference, brake, true, held);
  out.torque_Nm = std::move(held.torque_Nm);
  out.tracking_rms_N = held.tracking_rms_N;
  out.bounded = held.bounded;
}

}  // namespace clampd
