#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <type_traits>

namespace clampd {

enum class StationState : std::uint8_t { Init, Idle, Armed, Running, Releasing, Fault };
std::string_view to_string(StationState state) noexcept;

/// Where a check stands inside RUNNING and RELEASING.
enum class CheckPhase : std::uint8_t {
  None,
  Tare,        ///< at rest in the clearance, zero torque: offsets of force and velocity readings
  Approach,    ///< closing the clearance until contact is found
  Settle,      ///< at rest at the contact point, before each run
  Trajectory,  ///< the run itself
  Return,      ///< back to the contact point for the next run
  Release,     ///< opening the clearance at the end
  Done,
};
std::string_view to_string(CheckPhase phase) noexcept;

/// Why the station went to FAULT. Numbered: the numbers are stable and appear in records.
enum class FaultCause : std::uint8_t {
  None = 0,
  FeedbackMissing = 1,      ///< no feedback at all within the start-up time
  FeedbackStale = 2,        ///< feedback stopped
  FeedbackCorrupt = 3,      ///< CRC errors
  FeedbackFrozen = 4,       ///< alive counter or sample clock stands still or jumps
  FeedbackImplausible = 5,  ///< non-finite, or outside of what the brake can physically do
  BusOff = 6,
  LinkDown = 7,
  SendFailed = 8,
  OverForce = 9,
  OverSpeed = 10,
  OverTorque = 11,
  OverTravel = 12,
  MissedTicks = 13,
  NonFinite = 14,        ///< our own control law produced a non-finite value
  BrakeFault = 15,       ///< the brake reports its watchdog or an internal fault
  SequenceTimeout = 16,  ///< a phase of the check did not end in time (contact not found, never at rest)
  OperatorStop = 17,
  EmergencyStop = 18,
  SampleLost = 19,           ///< samples missing within a run
  FixtureOpen = 20,          ///< the fixture was opened during a check
  InterlockLost = 21,        ///< a line of the panel cannot be read or driven
  StartButtonStuck = 22,     ///< the start button is held
  ForceReading = 23,         ///< the force contradicts position or torque, or stands still while it cannot
  VelocityReading = 24,      ///< the velocity contradicts position or torque, or stands still while it cannot
  PositionReading = 25,      ///< the position contradicts velocity, torque or force
  TorqueReading = 26,        ///< the torque reading contradicts the command
  TorqueAgainstMotion = 27,  ///< position and velocity agree, and contradict the torque or the force: the
                             ///< encoder behind both, a drive without torque, or a brake that is blocked
  DeadlinePassed = 28,       ///< the whole check did not end in time
  StationEnded = 29,         ///< the station's program was told to end
  SpeedNotFollowed = 30,     ///< a brake that is told its speed does not take it up
};
inline constexpr std::size_t kFaultCauseCount = static_cast<std::size_t>(FaultCause::SpeedNotFollowed) + 1;
std::string_view to_string(FaultCause cause) noexcept;

/// One brake sample as the loop logs it. Trivially copyable: it travels through the lock-free ring.
struct Sample {
  std::int64_t sample_index = 0;   ///< brake's count
  std::int64_t brake_time_ns = 0;  ///< brake's sample clock
  std::int64_t host_time_ns = 0;   ///< host time of the tick that took it
  double torque_Nm = 0.0;
  double velocity_rad_s = 0.0;
  double force_N = 0.0;
  double position_rad = 0.0;
  double torque_command_Nm = 0.0;      ///< sent in answer to this sample; acts from the next one on; 0 to a
                                       ///< brake that is told its speed
  double force_reference_N = 0.0;      ///< the reference at this sample; 0 outside of a trajectory
  std::int32_t lateness_ns = 0;        ///< wake-up lateness of the tick that took it
  std::int32_t trajectory_index = -1;  ///< row of the trajectory, -1 outside of a run
  std::uint16_t repeat = 0;            ///< 0-based repeat of the check
  std::uint8_t trajectory = 0;         ///< which of the check's trajectories the repeat follows
  StationState state = StationState::Init;
  CheckPhase phase = CheckPhase::None;
  FaultCause fault = FaultCause::None;
};
static_assert(std::is_trivially_copyable_v<Sample>);

}  // namespace clampd
