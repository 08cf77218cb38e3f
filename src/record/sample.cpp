#include "clampd/record/sample.hpp"

namespace clampd {

std::string_view to_string(StationState state) noexcept {
  switch (state) {
    case StationState::Init:
      return "INIT";
    case StationState::Idle:
      return "IDLE";
    case StationState::Armed:
      return "ARMED";
    case StationState::Running:
      return "RUNNING";
    case StationState::Releasing:
      return "RELEASING";
    case StationState::Fault:
      return "FAULT";
  }
  return "?";
}

std::string_view to_string(CheckPhase phase) noexcept {
  switch (phase) {
    case CheckPhase::None:
      return "none";
    case CheckPhase::Tare:
      return "tare";
    case CheckPhase::Approach:
      return "approach";
    case CheckPhase::Settle:
      return "settle";
    case CheckPhase::Trajectory:
      return "trajectory";
    case CheckPhase::Return:
      return "return";
    case CheckPhase::Release:
      return "release";
    case CheckPhase::Done:
      return "done";
  }
  return "?";
}

std::string_view to_string(FaultCause cause) noexcept {
  switch (cause) {
    case FaultCause::None:
      return "none";
    case FaultCause::FeedbackMissing:
      return "feedback-missing";
    case FaultCause::FeedbackStale:
      return "feedback-stale";
    case FaultCause::FeedbackCorrupt:
      return "feedback-corrupt";
    case FaultCause::FeedbackFrozen:
      return "feedback-frozen";
    case FaultCause::FeedbackImplausible:
      return "feedback-implausible";
    case FaultCause::BusOff:
      return "bus-off";
    case FaultCause::LinkDown:
      return "link-down";
    case FaultCause::SendFailed:
      return "send-failed";
    case FaultCause::OverForce:
      return "over-force";
    case FaultCause::OverSpeed:
      return "over-speed";
    case FaultCause::OverTorque:
      return "over-torque";
    case FaultCause::OverTravel:
      return "over-travel";
    case FaultCause::MissedTicks:
      return "missed-ticks";
    case FaultCause::NonFinite:
      return "non-finite";
    case FaultCause::BrakeFault:
      return "brake-fault";
    case FaultCause::SequenceTimeout:
      return "sequence-timeout";
    case FaultCause::OperatorStop:
      return "operator-stop";
    case FaultCause::EmergencyStop:
      return "emergency-stop";
    case FaultCause::SampleLost:
      return "sample-lost";
    case FaultCause::FixtureOpen:
      return "fixture-open";
    case FaultCause::InterlockLost:
      return "interlock-lost";
    case FaultCause::StartButtonStuck:
      return "start-button-stuck";
    case FaultCause::ForceReading:
      return "force-reading";
    case FaultCause::VelocityReading:
      return "velocity-reading";
    case FaultCause::PositionReading:
      return "position-reading";
    case FaultCause::TorqueReading:
      return "torque-reading";
    case FaultCause::TorqueAgainstMotion:
      return "torque-against-motion";
    case FaultCause::DeadlinePassed:
      return "deadline-passed";
    case FaultCause::StationEnded:
      return "station-ended";
    case FaultCause::SpeedNotFollowed:
      return "speed-not-followed";
  }
  return "?";
}

}  // namespace clampd
