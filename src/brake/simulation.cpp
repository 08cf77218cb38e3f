#include "clampd/brake/simulation.hpp"

#include <algorithm>
#include <limits>

#include "clampd/base/assert.hpp"
#include "clampd/base/nan.hpp"

namespace clampd {

namespace {}  // namespace

void Simulation::resize(std::size_t rows) {
  position_rad.assign(rows, kNaN);
  velocity_rad_s.assign(rows, kNaN);
  force_N.assign(rows, kNaN);
  valid_rows = 0;
}

void SensitivitySimulation::resize(std::size_t rows) {
  Simulation::resize(rows);
  force_sensitivity.setConstant(static_cast<Eigen::Index>(rows), kSensitivityColumns, kNaN);
  velocity_sensitivity.setConstant(static_cast<Eigen::Index>(rows), kSensitivityColumns, kNaN);
}

void Simulation::invalidate_rest() noexcept {
  const auto from = static_cast<std::ptrdiff_t>(valid_rows);
  for (auto* column : {&position_rad, &velocity_rad_s, &force_N})
    std::fill(column->begin() + from, column->end(), kNaN);
}

int steps_in(double gap_s) noexcept {
  if (!(gap_s > 0.0 && gap_s <= kMaxGap_s)) return 0;
  // Time stamps of a 1 kHz recording are off by rounding; that is not a longer gap.
  return std::max(1, static_cast<int>(std::ceil(gap_s / kMaxStep_s - 1e-6)));
}

void simulate(const BrakeParameters& parameters, const BrakeState& initial, const Excitation& excitation,
              Simulation& out) noexcept {
  simulate_model(paper_brake(parameters), initial, excitation, out);
}

void simulate(const BrakeParameters& parameters, const BrakeState& initial, const Excitation& excitation,
              SensitivitySimulation& out) noexcept {
  const PaperBrake model = paper_brake(parameters);
  const std::size_t rows = excitation.size();
  CLAMPD_ASSERT(out.force_N.size() == rows);
  CLAMPD_ASSERT(excitation.time_s.empty() || excitation.time_s.size() == rows);

  using T = Tangent<PaperBrake::kParameters>;
  constexpr int kStateColumns = T::kTorque;  // parameters and initial state, without the torque
  static_assert(kStateColumns == kSensitivityColumns);
  Eigen::Array<double, 1, kSensitivityColumns> scale;
  for (std::size_t i = 0; i < kParameterCount; ++i)
    scale[static_cast<Eigen::Index>(i)] = kParameterTable[i].nominal;
  scale[kInitialPositionColumn] = scale[kInitialVelocityColumn] = 1.0;

  BrakeState state = initial;
  T tangent = T::identity();
  Eigen::Matrix2d by_state;
  Eigen::Matrix<double, 2, PaperBrake::kParameters> by_parameter;
  out.valid_rows = 0;
  for (std::size_t k = 0; k < rows && is_bounded(state); ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    const Reading reading = model.read(state);
    out.position_rad[k] = state[0];
    out.force_N[k] = reading.force_N;
    out.velocity_rad_s[k] = reading.velocity_rad_s;
    model.linearise_readings(state, by_state, by_parameter);
    for (int i = 0; i < kSensitivityColumns; ++i) {
      double force = by_state(0, 0) * tangent.position[i] + by_state(0, 1) * tangent.velocity[i];
      double velocity = by_state(1, 0) * tangent.position[i] + by_state(1, 1) * tangent.velocity[i];
      if (i < PaperBrake::kParameters) {
        force += by_parameter(0, i);
        velocity += by_parameter(1, i);
      }
      out.force_sensitivity(row, i) = scale[i] * force;
      out.velocity_sensitivity(row, i) = scale[i] * velocity;
    }
    out.valid_rows = k + 1;
    if (k + 1 == rows) break;
    const double gap_s =
        excitation.time_s.empty() ? excitation.dt_s : excitation.time_s[k + 1] - excitation.time_s[k];
    const int steps = steps_in(gap_s);
    if (steps == 0) break;
    for (int i = 0; i < steps && is_bounded(state); ++i)
      state = advance_with_tangent(model, state, tangent, excitation.torque_Nm[k], gap_s / steps);
  }
  out.invalidate_rest();
  const auto invalid = static_cast<Eigen::Index>(rows - out.valid_rows);
  out.force_sensitivity.bottomRows(invalid).setConstant(kNaN);
  out.velocity_sensitivity.bottomRows(invalid).setConstant(kNaN);
}

}  // namespace clampd
