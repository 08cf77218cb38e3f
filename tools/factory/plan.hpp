#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "clampd/station/session.hpp"
#include "drivers/sim/plant_configuration.hpp"

namespace clampd::factory {

/// What a factory is made from: equal settings make the same checks, to the last bit.
struct Settings {
  int stations = 4;
  int checks = 200;  ///< of all stations together
  int days = 20;     ///< that they are spread over
  std::uint64_t seed = 1;
  int repeats = 3;  ///< of the trajectory in each check
};

/// What can be wrong with a station or a batch.
enum class Cause : std::uint8_t {
  ForceGain,        ///< a station: relative error of the force reading's gain
  TorqueGain,       ///< a station: relative error of the torque reading's gain
  ForceLag,         ///< a station: time constant of the force reading, in s
  Stiffness,        ///< a batch: relative difference of k1 and k2
  CoulombFriction,  ///< a batch: relative difference of TC
  Backlash,         ///< a batch: lost motion, in rad
};

/// How it comes.
enum class Course : std::uint8_t {
  Step,   ///< from one instant on
  Drift,  ///< in proportion to the time
  Whole,  ///< a batch has it from its first brake to its last
};

/// Something that the factory does not tell.
struct Hidden {
  Cause cause = Cause::ForceGain;
  Course course = Course::Step;
  int number = 0;     ///< of the station or batch, from 0
  double from = 0.0;  ///< share of the time at which a step comes
  double size = 0.0;  ///< in the unit of the cause; of a drift, what it has reached at the end
};

/// One check of one brake.
struct PlannedCheck {
  int station = 0;
  std::string id;  ///< of its record
  std::int64_t started_utc_ns = 0;
  CheckRequest request;
  sim::PlantConfiguration brake;  ///< as this station sees it at this time
};

/// "station-1", as records have it.
std::string station_name(int number);

/// Drawn from the seed: one station whose readings change, one batch that differs, and one effect beside the
/// model, at another station or in another batch.
std::vector<Hidden> hide(const Settings& settings);

/// One sentence, for a person.
std::string describe(const Hidden& hidden, const Settings& settings);

/// All checks in the order of their time. Brakes, batches and stations differ by chance, a tenth of the
/// brakes is checked again at another station, and each twentieth check is one of the master brake.
/// `shipped`: what else a simulated brake has.
std::vector<PlannedCheck> plan(const Settings& settings, const std::vector<Hidden>& hidden,
                               const sim::PlantConfiguration& shipped);

}  // namespace clampd::factory
