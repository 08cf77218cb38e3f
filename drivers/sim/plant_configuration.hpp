#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "drivers/sim/effects.hpp"
#include "drivers/sim/episode.hpp"
#include "drivers/sim/spoiling.hpp"

namespace clampd::sim {

/// What the simulated brake's sensors add to the truth. Noise is white and Gaussian; a quantum of 0 does not
/// round.
struct SensorSettings {
  double force_noise_N = 0.0;
  double velocity_noise_rad_s = 0.0;
  double torque_noise_Nm = 0.0;  ///< on the reading: the commanded torque itself acts undisturbed
  double position_noise_rad = 0.0;
  double force_quantum_N = 0.0;
  double velocity_quantum_rad_s = 0.0;
  double torque_quantum_Nm = 0.0;
  double position_quantum_rad = 0.0;
  double force_offset_N = 0.0;  ///< of an untared load cell
  double velocity_offset_rad_s = 0.0;
};

/// Scripted misbehaviour of the brake on the bus; whoever puts the feedback on a bus applies it.
enum class FaultKind : std::uint8_t { CorruptCrc, FrozenCounter, ImpossibleValues, Silent };
std::string_view to_string(FaultKind kind) noexcept;  ///< as in the file: "corrupt-crc", ...

struct ScriptedFault {
  FaultKind kind = FaultKind::Silent;
  Episode when;
};

/// Everything that makes one simulated brake; together with its seed it determines every reading.
struct PlantConfiguration {
  BrakeParameters brake;  ///< the truth
  SensorSettings sensors;
  Effects effects;
  std::uint64_t seed = 1;
  double clearance_rad = 6.0;     ///< starts at rest, open by this much
  double encoder_zero_rad = 0.0;  ///< encoder reading at the contact point
  double open_stop_rad = 26.0;    ///< mechanical end stop, this far open from contact
  double closed_stop_rad = 90.0;  ///< and this far closed
  double torque_limit_Nm = 3.0;   ///< of the drive, both directions
  double watchdog_s = 0.020;      ///< without a valid command, torque is zero by then
  // Of the loop that makes the torque of a brake that is told its speed: proportional and integral, on the
  // velocity that its reading shows.
  double speed_bandwidth_rad_s = 400.0;
  double speed_period_s = 1e-3;  ///< how long it holds a torque, at most until the next sample
  /// False: a velocity that is spoiled lies on the bus only, and the loop sees it as it is.
  bool speed_loop_is_spoiled = true;
  double step_s = 20e-6;          ///< of the integrator, at most 20 us
  /// Of its sampling instants about the millisecond (standard deviation; cut off at three of them). Its clock
  /// tells them, and its frames come as late or early.
  double sampling_jitter_s = 0.0;
  std::vector<ScriptedFault> faults;
  std::vector<SpoiledReading> spoiled;

  bool fault_active(FaultKind kind, double time_s) const noexcept;

  /// Names the first setting that is not finite or outside of its range.
  Result<void> validate() const;
};

/// Reads [parameters] or [parameters_normalised] and [fixed] (as `read_brake_parameters`), [plant],
/// [sensors], [effects] (name = value), [[fault]] (kind) and [[spoil]] (reading, kind, amount), both with at_s,
/// duration_s and from_force_N. What is not named keeps its value in `base`, except that the brake's parameters
/// start from nominal; an unknown table or key is an error that names file and line.
Result<PlantConfiguration> read_plant_configuration(const std::string& path,
                                                    const PlantConfiguration& base = {});

/// The same from text; `path` stands for the file in messages.
Result<PlantConfiguration> parse_plant_configuration(std::string_view text, const std::string& path,
                                                     const PlantConfiguration& base = {});

}  // namespace clampd::sim
