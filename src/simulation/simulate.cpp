#include "clampd/simulation/simulate.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/experiment/reference.hpp"
#include "rt/check_sequence.hpp"

namespace clampd {
namespace {

void append(SimulatedRun& run, const BrakeFeedback& feedback, const sim::SimulatedBrake& brake,
            double period_s) {
  const sim::PlantConfiguration& plant = brake.configuration();
  Run& readings = run.readings;
  readings.time_s.push_back(static_cast<double>(readings.size()) * period_s);
  readings.torque_Nm.push_back(feedback.torque_Nm);
  readings.velocity_rad_s.push_back(feedback.velocity_rad_s - plant.sensors.velocity_offset_rad_s);
  readings.force_N.push_back(feedback.force_N - plant.sensors.force_offset_N);
  readings.position_rad.push_back(feedback.position_rad - plant.encoder_zero_rad);
  run.truth.push_back(brake.truth());
}

}  // namespace

SimulatedCheck simulate_check(const sim::PlantConfiguration& plant, const Reference& reference,
                              const BrakeParameters& nominal, const SimulationOptions& options) {
  rt::CheckPlan plan;
  plan.reference = reference;
  const double period_s = options.period_s;
  plan.drive = nominal_drive(nominal, period_s);
  plan.repeats = options.repeats;
  plan.commanded = options.commanded;
  rt::CheckSequence sequence;
  sequence.start(&plan);
  sim::SimulatedBrake brake(plant, std::llround(1e9 * period_s));
  brake.begin_run(options.first_run);

  SimulatedCheck check;
  SimulatedRun run;
  const auto limit = static_cast<std::int64_t>(options.timeout_s / period_s);
  for (std::int64_t k = 0; !sequence.done(); ++k) {
    const BrakeFeedback feedback = brake.sample();
    const rt::SequenceOutput output = sequence.step(feedback);
    brake.command({output.torque_Nm, true, output.velocity_rad_s, options.commanded});
    check.duration_s = static_cast<double>(k + 1) * period_s;
    check.phase = output.phase;
    check.force_max_N = std::max(check.force_max_N, brake.truth().force_N);
    check.speed_max_rad_s = std::max(check.speed_max_rad_s, std::abs(brake.truth().velocity_rad_s));
    if (output.trajectory_index >= 0) append(run, feedback, brake, period_s);
    if (run.readings.size() == reference.rows.size()) {
      run.readings.name = fmt::format("repeat {}", output.repeat + 1);
      check.runs.push_back(std::exchange(run, {}));
      brake.begin_run(options.first_run + output.repeat + 1u);
    }
    check.fault = k < limit ? output.fault : FaultCause::SequenceTimeout;
    if (check.fault != FaultCause::None) break;
  }
  return check;
}

Run simulate_drive_off(const sim::PlantConfiguration& plant, std::size_t rows) {
  sim::SimulatedBrake brake(plant);
  SimulatedRun run;
  for (std::size_t k = 0; k < rows; ++k) append(run, brake.sample(), brake, kPeriod_s);
  run.readings.name = "drive off";
  run.readings.drive_enabled.assign(rows, 0.0);
  return std::move(run.readings);
}

Result<std::vector<Run>> simulate_manoeuvre(const sim::PlantConfiguration& plant, const Reference& reference,
                                            const BrakeParameters& nominal, std::uint16_t repeats) {
  SimulatedCheck check = simulate_check(plant, reference, nominal, {.repeats = repeats});
  if (check.fault != FaultCause::None)
    return failure(fmt::format(
        "the simulated brake could not be driven through the manoeuvre: {} in phase {} after {:.1f} s",
        to_string(check.fault), to_string(check.phase), check.duration_s));
  std::vector<Run> runs;
  for (SimulatedRun& run : check.runs) runs.push_back(std::move(run.readings));
  return runs;
}

}  // namespace clampd
