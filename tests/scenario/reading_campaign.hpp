#pragma once

// Checks of the simulated brake by the station's whole tick (supervisor, sequence, control law) in virtual
// time, one reading spoiled in each; judged by what the brake really did.

#include <cstdint>
#include <iosfwd>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "clampd/record/reference.hpp"
#include "clampd/record/sample.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "rt/supervisor.hpp"
#include "tests/support/told.hpp"

namespace clampd::scenario {

/// What became of one check.
struct CheckOutcome {
  FaultCause fault = FaultCause::None;
  CheckPhase phase = CheckPhase::None;  ///< in which the fault came
  double duration_s = 0.0;
  double fault_s = 0.0;          ///< on the brake's clock
  double speed_max_rad_s = 0.0;  ///< true extremes, until everything has come to rest
  double force_max_N = 0.0;
  double torque_after_fault_s = 0.0;  ///< how long torque still acted after the sample that showed the fault
  double deviation =
      0.0;  ///< largest rms of a run's spoiled reading from the true one, tared, over its noise
};

/// Drives one check to its end, and on for 0.3 s, so that the brake comes to rest.
CheckOutcome drive_check(const sim::PlantConfiguration& plant, const Reference& reference,
                         std::uint16_t repeats, const Told& told = {});

/// A brake as wide as Table II with the noisiest sensors.
sim::PlantConfiguration table_ii_brake(std::mt19937_64& random);

/// A gross spoiling of this reading and kind, some time within `duration_s`.
sim::SpoiledReading gross_spoil(sim::Reading reading, sim::Spoil spoil, double duration_s,
                                std::mt19937_64& random);

/// Whether the cause says which reading is wrong.
bool names(FaultCause cause, sim::Reading reading);

/// Counts of one reading and kind, or of all.
struct SpoilTally {
  int checks = 0;
  int faults = 0;
  int named = 0;
  int harmless = 0;    ///< no fault, and no run that differs from what it would have read
  int undetected = 0;  ///< no fault, and a run that differs
  int unsafe = 0;      ///< beyond 1.2 times the speed limit, or 1.1 times the force limit
  int errors = 0;      ///< of those without a fault: what the station's whole check calls an ERROR
  int wrong = 0;       ///< of those without a fault: PASS or FAIL with a parameter that is far from the truth
  double speed_max_rad_s = 0.0;
  double force_max_N = 0.0;
  double torque_after_fault_s = 0.0;
  std::vector<double> latencies_s;  ///< from the spoil's begin to the fault
};

struct SpoilCampaign {
  SpoilTally all;
  SpoilTally each[sim::kReadingCount][sim::kSpoilCount];
  std::vector<std::string> remarks;  ///< each check that was unsafe, undetected or named wrongly
};

/// `checks` checks, reading and kind in turn, everything else random from `seed`. Of those that no fault
/// ends, the first `judged` are followed to their verdict, which takes seconds each: their runs are
/// diagnosed. Of brakes that are told their speed, the loop of every other one sees what is spoiled, too.
SpoilCampaign run_spoil_campaign(int checks, std::uint64_t seed, int judged, const Told& told = {});

struct HealthyCampaign {
  int checks = 0;
  std::vector<std::string> faults;
};

/// `checks` healthy checks of all sorts of brakes, along all manoeuvres that can be replayed at this period;
/// each of them that ends in a fault is named.
HealthyCampaign run_healthy_campaign(int checks, std::uint64_t seed, const Told& told = {});

void print(std::ostream& out, const SpoilCampaign& campaign);

}  // namespace clampd::scenario
