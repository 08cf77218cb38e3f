#pragma once

#include <cstdint>
#include <vector>

#include "clampd/base/clock.hpp"
#include "clampd/base/result.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/reference.hpp"
#include "clampd/record/run.hpp"
#include "clampd/record/sample.hpp"
#include "drivers/sim/simulated_brake.hpp"

namespace clampd {

/// One repeat: the readings as a run file holds them, and what really was at each of its rows.
struct SimulatedRun {
  /// Time from the first row; the sensors' constant offsets are taken off, as a perfect tare does; position
  /// from contact. Effects on the readings stay in.
  Run readings;
  std::vector<sim::Truth> truth;
};

/// A check of the simulated brake in virtual time, by the very control code of the bench.
struct SimulatedCheck {
  std::vector<SimulatedRun> runs;  ///< complete ones only
  FaultCause fault = FaultCause::None;
  CheckPhase phase = CheckPhase::None;  ///< where it ended: Done unless there was a fault
  double duration_s = 0.0;              ///< bench time
  double force_max_N = 0.0;             ///< true extremes over the whole check
  double speed_max_rad_s = 0.0;
};

struct SimulationOptions {
  std::uint16_t repeats = 1;
  std::uint32_t first_run = 0;  ///< how many this brake has done before, for what changes from run to run
  double timeout_s = 600.0;     ///< of bench time; then the fault is SequenceTimeout
  CommandedQuantity commanded = CommandedQuantity::Torque;
  double period_s = kPeriod_s;  ///< of brake, loop and reference
};

/// Runs a whole check (open, tare, approach, repeats, release) of the brake `plant`, tracking `reference`.
SimulatedCheck simulate_check(const sim::PlantConfiguration& plant, const Reference& reference,
                              const BrakeParameters& nominal, const SimulationOptions& options = {});

/// So many readings of the brake in the clearance with its drive off; tared and marked as such.
Run simulate_drive_off(const sim::PlantConfiguration& plant, std::size_t rows);

/// The readings of a check that must not fail. Error: in which phase and why the brake could not be driven
/// through.
Result<std::vector<Run>> simulate_manoeuvre(const sim::PlantConfiguration& plant, const Reference& reference,
                                            const BrakeParameters& nominal, std::uint16_t repeats = 1);

}  // namespace clampd
