#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "clampd/record/check_record.hpp"
#include "clampd/record/sample.hpp"

namespace clampd::rt {

enum class FaultSeverity : std::uint8_t {
  Stop,   ///< the check cannot go on; the rig itself may be healthy
  Alarm,  ///< something is broken or unsafe: look before going on
};

/// In which states a cause takes the station to FAULT. Whatever the state, the drive is off at once.
enum class FaultScope : std::uint8_t {
  Check,  ///< in ARMED, RUNNING and RELEASING; meaningless outside of a check
  Ready,  ///< also in IDLE; in INIT it delays readiness, and is latched if the start-up time runs out over it
  Always,  ///< also in INIT
};

/// When the operator's clear is accepted.
enum class ClearCondition : std::uint8_t {
  AtOnce,    ///< the cause was an event
  WhenGone,  ///< neither this nor any other standing cause was seen for SupervisorSettings::clear_quiet_ns
};

/// What to do about one cause. The first action is the same for all and needs no column: zero torque and
/// drive off in the tick that sees the cause, the check ended, FAULT latched. The brake is self-locking and
/// holds its force.
struct FaultRule {
  FaultCause cause;
  std::string_view
      setting;  ///< the setting (of SupervisorSettings unless named) that governs it; empty: none
  FaultSeverity severity;
  FaultScope scope;
  Verdict verdict;  ///< of the check that it ends
  ClearCondition clear;
  std::string_view advice;  ///< for the technician: what happened and what to do
};

using Policy = std::array<FaultRule, kFaultCauseCount>;

/// THE table of causes, indexed by the cause's number. The mechanism is in rt/supervisor.hpp.
inline constexpr Policy kPolicy{{
    {FaultCause::None, "", FaultSeverity::Stop, FaultScope::Check, Verdict::Error, ClearCondition::AtOnce,
     "No fault."},
    {FaultCause::FeedbackMissing, "startup_timeout_ns", FaultSeverity::Stop, FaultScope::Always,
     Verdict::Error, ClearCondition::WhenGone,
     "The brake never answered. Check its supply and the CAN cable, then clear the fault."},
    {FaultCause::FeedbackStale, "stale_ns", FaultSeverity::Alarm, FaultScope::Ready, Verdict::Error,
     ClearCondition::WhenGone,
     "The brake stopped sending. Check its supply and the CAN connector, then clear the fault."},
    {FaultCause::FeedbackCorrupt, "corrupt_tolerated", FaultSeverity::Alarm, FaultScope::Ready,
     Verdict::Error, ClearCondition::WhenGone,
     "The brake's frames fail their checksum. Check that the DBC file belongs to this brake, and its "
     "electronics."},
    {FaultCause::FeedbackFrozen, "frozen_tolerated, clock_tolerance_ns", FaultSeverity::Alarm,
     FaultScope::Ready, Verdict::Error, ClearCondition::WhenGone,
     "The brake's frame counter or sample clock stands still or jumps. Restart the brake, then clear the "
     "fault."},
    {FaultCause::FeedbackImplausible, "implausible_tolerated, plausible_*", FaultSeverity::Alarm,
     FaultScope::Ready, Verdict::Error, ClearCondition::WhenGone,
     "The brake reports values that are physically impossible, or stand at the end of a signal's range. "
     "Check its "
     "sensors and their connectors."},
    {FaultCause::BusOff, "", FaultSeverity::Alarm, FaultScope::Ready, Verdict::Error,
     ClearCondition::WhenGone,
     "The CAN controller left the bus. Check wiring, termination and bit rate, then clear the fault."},
    {FaultCause::LinkDown, "", FaultSeverity::Alarm, FaultScope::Ready, Verdict::Error,
     ClearCondition::WhenGone,
     "The CAN interface is down or gone. Plug it in or bring it up, then clear the fault."},
    {FaultCause::SendFailed, "send_failures_tolerated", FaultSeverity::Alarm, FaultScope::Ready,
     Verdict::Error, ClearCondition::WhenGone,
     "Commands could not be sent. Check that the brake is on the bus and acknowledges, then clear the "
     "fault."},
    {FaultCause::OverForce, "force_limit_N, force_ceiling_N", FaultSeverity::Alarm, FaultScope::Ready,
     Verdict::Error, ClearCondition::WhenGone,
     "The clamp force passed its limit. The brake holds its force: the next check opens it first; beyond the "
     "ceiling the station moves it no more: open it by hand."},
    {FaultCause::OverSpeed, "speed_limit_rad_s", FaultSeverity::Alarm, FaultScope::Ready, Verdict::Error,
     ClearCondition::WhenGone, "The motor ran too fast. Check the brake and its velocity sensor."},
    {FaultCause::OverTorque, "torque_limit_Nm", FaultSeverity::Alarm, FaultScope::Ready, Verdict::Error,
     ClearCondition::WhenGone,
     "The motor torque passed its limit. Check the drive stage and its torque reading."},
    {FaultCause::OverTravel, "travel_limit_rad", FaultSeverity::Alarm, FaultScope::Check, Verdict::Error,
     ClearCondition::AtOnce,
     "The motor turned further than a brake can. Check that pads and disc are mounted, and the position "
     "sensor."},
    {FaultCause::MissedTicks, "skipped_in_a_row_tolerated, skipped_per_check_tolerated", FaultSeverity::Stop,
     FaultScope::Check, Verdict::Error, ClearCondition::AtOnce,
     "The station's computer missed its 1 ms ticks; this says nothing about the brake. Run clampctl doctor."},
    {FaultCause::NonFinite, "", FaultSeverity::Alarm, FaultScope::Check, Verdict::Error,
     ClearCondition::AtOnce,
     "The controller computed an impossible command. Check the station's trajectory and configuration, and "
     "report "
     "it with the flight recorder."},
    {FaultCause::BrakeFault, "drive_reports_live, armed_timeout_ns", FaultSeverity::Alarm, FaultScope::Ready,
     Verdict::Error, ClearCondition::WhenGone,
     "The brake reports a fault of its own, or its drive does not come or stay live. Check the brake's "
     "electronics."},
    {FaultCause::SequenceTimeout, "CheckPlan::phase_timeout_s", FaultSeverity::Stop, FaultScope::Check,
     Verdict::Timeout, ClearCondition::AtOnce,
     "A step of the check did not end in time. Check that pads and disc are mounted and the brake moves "
     "freely."},
    {FaultCause::OperatorStop, "", FaultSeverity::Stop, FaultScope::Check, Verdict::Aborted,
     ClearCondition::AtOnce, "The check was stopped by the operator."},
    {FaultCause::EmergencyStop, "", FaultSeverity::Alarm, FaultScope::Always, Verdict::Aborted,
     ClearCondition::WhenGone,
     "Emergency stop. Make the rig safe, release the button, then clear the fault."},
    {FaultCause::SampleLost, "lost_samples_tolerated", FaultSeverity::Stop, FaultScope::Check, Verdict::Error,
     ClearCondition::AtOnce,
     "Samples were lost within a run. Check the bus load and other programs on the bus, then repeat the "
     "check."},
    // An event: the part must come out, so the fixture may stay open while the fault is cleared.
    {FaultCause::FixtureOpen, "", FaultSeverity::Stop, FaultScope::Check, Verdict::Error,
     ClearCondition::AtOnce,
     "The fixture was opened during the check. Close it and keep it closed, then repeat the check."},
    {FaultCause::InterlockLost, "InterlockBoard's lost_after_ns", FaultSeverity::Alarm, FaultScope::Ready,
     Verdict::Error, ClearCondition::WhenGone,
     "A line of the operator's panel cannot be read or driven. Check the GPIO chip and its wiring, then "
     "clear "
     "the fault."},
    {FaultCause::StartButtonStuck, "", FaultSeverity::Stop, FaultScope::Ready, Verdict::Error,
     ClearCondition::WhenGone, "The start button is held or stuck. Free it, then clear the fault."},
    {FaultCause::ForceReading, "readings.force_N", FaultSeverity::Alarm, FaultScope::Check, Verdict::Error,
     ClearCondition::AtOnce,
     "The force reading is wrong: it does not follow the compression of the pads, or stands still. Check the "
     "load cell, its amplifier and its connector. The brake may be clamped harder than the reading says."},
    {FaultCause::VelocityReading, "readings.velocity_rad_s, readings.position_rad", FaultSeverity::Alarm,
     FaultScope::Check, Verdict::Error, ClearCondition::AtOnce,
     "The velocity reading is wrong: it contradicts position and torque, or stands still. Check the velocity "
     "sensor, its sign and scale in the DBC file, and its connector."},
    {FaultCause::PositionReading, "readings.position_rad, readings.velocity_rad_s, plausible_jump_rad",
     FaultSeverity::Alarm, FaultScope::Check, Verdict::Error, ClearCondition::AtOnce,
     "The position reading is wrong: it contradicts velocity and torque, or stands still. Check the encoder, "
     "its sign and scale in the DBC file, and its connector."},
    {FaultCause::TorqueReading, "readings.torque_Nm", FaultSeverity::Alarm, FaultScope::Check, Verdict::Error,
     ClearCondition::AtOnce,
     "The torque reading is not what was commanded. Check the drive's current measurement, and that its "
     "torque limit is not below the station's."},
    {FaultCause::TorqueAgainstMotion, "readings.velocity_rad_s, readings.force_N", FaultSeverity::Alarm,
     FaultScope::Check, Verdict::Error, ClearCondition::AtOnce,
     "Position and velocity agree, but not with torque and force. Check the encoder behind both readings, "
     "that "
     "the drive's torque reaches the motor, and that nothing blocks the brake."},
    {FaultCause::DeadlinePassed, "CheckPlan::deadline_s", FaultSeverity::Stop, FaultScope::Check,
     Verdict::Timeout, ClearCondition::AtOnce,
     "The check did not end before its deadline ([check] deadline_s). Check that the brake moves freely, or "
     "allow more time."},
    {FaultCause::StationEnded, "", FaultSeverity::Stop, FaultScope::Check, Verdict::Aborted,
     ClearCondition::AtOnce,
     "The station's program was stopped or restarted during the check. Check this brake again."},
    {FaultCause::SpeedNotFollowed, "readings.velocity_rad_s, torque_limit_Nm", FaultSeverity::Alarm,
     FaultScope::Check, Verdict::Error, ClearCondition::AtOnce,
     "The brake does not take up the speed that it is told. Check that its speed control is on and fast "
     "enough, that its torque limit is not below the station's, that nothing blocks the brake, and the "
     "encoder."},
}};

static_assert(
    [] {
      for (std::size_t i = 0; i < kPolicy.size(); ++i)
        if (kPolicy[i].cause != static_cast<FaultCause>(i) || kPolicy[i].advice.empty()) return false;
      return true;
    }(),
    "the policy needs one row for each cause, in the order of their numbers");

constexpr const FaultRule& fault_rule(FaultCause cause) noexcept {
  return kPolicy[static_cast<std::size_t>(cause)];
}

}  // namespace clampd::rt
