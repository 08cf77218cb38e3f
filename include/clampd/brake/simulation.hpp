#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "clampd/base/assert.hpp"
#include "clampd/brake/integrator.hpp"
#include "clampd/brake/sensitivity.hpp"
#include "clampd/record/run.hpp"

namespace clampd {

/// No gap between two rows may be longer: a run with such a gap is two runs. A simulation stops there.
inline constexpr double kMaxGap_s = 1.0;

/// What drives a simulation: torque_Nm[k] acts from row k until the next row. Rows are dt_s apart unless
/// time_s (of the same length) says otherwise. A gap longer than kMaxStep_s is cut into equal steps of at
/// most that.
struct Excitation {
  std::span<const double> torque_Nm;
  double dt_s = kMaxStep_s;
  std::span<const double> time_s = {};

  std::size_t size() const noexcept { return torque_Nm.size(); }
};

inline Excitation excitation_of(const Run& run) {
  return {run.torque_Nm, kMaxStep_s, run.time_s};
}

/// Row k holds state and model readings at row k's time; row 0 is the initial state. Sized once, used many
/// times: simulating into it does not allocate.
struct Simulation {
  explicit Simulation(std::size_t rows = 0) { resize(rows); }
  void resize(std::size_t rows);
  /// NaN into the rows from valid_rows on.
  void invalidate_rest() noexcept;

  std::vector<double> position_rad;
  std::vector<double> velocity_rad_s;  ///< model reading, (6)
  std::vector<double> force_N;         ///< model reading, (6)
  /// Rows that could be computed; all of them unless the simulation diverged (is_bounded()) or met a gap
  /// longer than kMaxGap_s. The rows after are NaN.
  std::size_t valid_rows = 0;

  bool complete() const noexcept { return valid_rows == force_N.size(); }
};

/// The seven parameters normalised by (11), then initial position (rad) and velocity (rad/s).
inline constexpr int kSensitivityColumns = static_cast<int>(kParameterCount) + 2;
inline constexpr int kInitialPositionColumn = static_cast<int>(kParameterCount);
inline constexpr int kInitialVelocityColumn = static_cast<int>(kParameterCount) + 1;
using SensitivityRows = Eigen::Matrix<double, Eigen::Dynamic, kSensitivityColumns>;

/// A simulation with the exact derivatives of its rows.
struct SensitivitySimulation : Simulation {
  explicit SensitivitySimulation(std::size_t rows = 0) { resize(rows); }
  void resize(std::size_t rows);

  SensitivityRows force_sensitivity;     ///< n x 9: dforce_N[k] / dcolumn
  SensitivityRows velocity_sensitivity;  ///< n x 9: dvelocity_rad_s[k] / dcolumn
};

/// Simulates the paper's brake with the set-valued integrator. out must have excitation.size() rows.
void simulate(const BrakeParameters& parameters, const BrakeState& initial, const Excitation& excitation,
              Simulation& out) noexcept;

/// The same with sensitivities; its states are those of simulate(), bit for bit.
void simulate(const BrakeParameters& parameters, const BrakeState& initial, const Excitation& excitation,
              SensitivitySimulation& out) noexcept;

/// The same with any model composed of BrakeModel's parts.
template <class Model>
void simulate_model(const Model& model, const BrakeState& initial, const Excitation& excitation,
                    Simulation& out) noexcept;

/// Steps that a gap between two rows is cut into; 0 if it is too long, not positive or not a number.
int steps_in(double gap_s) noexcept;

template <class Model>
void simulate_model(const Model& model, const BrakeState& initial, const Excitation& excitation,
                    Simulation& out) noexcept {
  const std::size_t rows = excitation.size();
  CLAMPD_ASSERT(out.force_N.size() == rows);
  CLAMPD_ASSERT(excitation.time_s.empty() || excitation.time_s.size() == rows);
  BrakeState state = initial;
  out.valid_rows = 0;
  for (std::size_t k = 0; k < rows && is_bounded(state); ++k) {
    const Reading reading = model.read(state);
    out.position_rad[k] = state[0];
    out.force_N[k] = reading.force_N;
    out.velocity_rad_s[k] = reading.velocity_rad_s;
    out.valid_rows = k + 1;
    if (k + 1 == rows) break;
    const double gap_s =
        excitation.time_s.empty() ? excitation.dt_s : excitation.time_s[k + 1] - excitation.time_s[k];
    const int steps = steps_in(gap_s);
    if (steps == 0) break;
    for (int i = 0; i < steps && is_bounded(state); ++i)
      state = advance(model, state, excitation.torque_Nm[k], gap_s / steps);
  }
  out.invalidate_rest();
}

}  // namespace clampd
