#pragma once

// A brake link and a check sequence without physics, to drive the tick through every situation.

#include <algorithm>
#include <cstdint>
#include <span>

#include "rt/control_core.hpp"

namespace clampd::rt::test {

/// A brake without physics cannot be held to them.
inline SupervisorSettings without_physics(SupervisorSettings settings = {}) {
  settings.readings = {1e6, 1e6, 1e6, 1e9};
  return settings;
}

/// A healthy brake that stands still and obeys, until told otherwise. Never allocates while it runs.
class ToyPort final : public BrakePort {
 public:
  std::size_t receive(std::span<BrakeFeedback> out, std::int64_t now_ns) noexcept override {
    const std::size_t count = silent ? 0 : std::min(samples_per_tick, out.size());
    for (std::size_t i = 0; i < count; ++i) {
      if (!frozen_clock) ++sample_index;
      BrakeFeedback& feedback = out[i];
      feedback = reading;
      feedback.sample_index = sample_index;
      feedback.brake_time_ns = sample_index * kPeriod_ns;
      feedback.arrival_time_ns = now_ns;
      feedback.drive_enabled = drive_works && last.enable;
    }
    if (silent) ++sample_index;  // the brake samples on, nobody hears it
    counts.frames_received += count;
    return count;
  }

  bool send(const DriveCommand& command, std::int64_t) noexcept override {
    ++sends;
    attempted = command;
    if (command.enable && (command.torque_Nm != 0.0 || command.velocity_rad_s != 0.0)) ++driven_sends;
    if (send_fails) return false;
    last = command;
    return true;
  }

  PortHealth health() const noexcept override { return counts; }

  BrakeFeedback reading;
  PortHealth counts;
  std::int64_t sample_index = 1000;
  std::size_t samples_per_tick = 1;
  bool silent = false;
  bool frozen_clock = false;
  bool send_fails = false;
  bool drive_works = true;
  DriveCommand last;       ///< that reached the brake
  DriveCommand attempted;  ///< that the station wanted to send
  std::uint64_t sends = 0;
  std::uint64_t driven_sends = 0;
};

/// Drives with a constant torque: `kTrajectorySteps` of Trajectory, then `kReleaseSteps` of Release, then
/// done. Steered through statics, since the core owns its sequence.
class ToySequence {
 public:
  static constexpr int kTrajectorySteps = 200;
  static constexpr int kReleaseSteps = 20;
  static constexpr double kTorque_Nm = 0.5;

  static inline double torque_Nm = kTorque_Nm;
  static inline double velocity_rad_s = 0.0;  ///< for a plan that commands speeds
  static inline FaultCause fault = FaultCause::None;
  static inline int abandoned = 0;
  static inline int concluded = 0;  ///< samples for which it was told so
  static inline int followed = -1;  ///< the trajectory that it was last told; -1: none
  static inline int steps_after_end = 0;
  static void reset() {
    torque_Nm = kTorque_Nm;
    velocity_rad_s = 0.0;
    fault = FaultCause::None;
    abandoned = 0;
    concluded = 0;
    followed = -1;
    steps_after_end = 0;
  }

  void start(const CheckPlan* plan) noexcept {
    plan_ = plan;
    step_ = 0;
  }
  SequenceOutput step(const BrakeFeedback&) noexcept {
    if (plan_ == nullptr) ++steps_after_end;
    SequenceOutput output;
    output.torque_Nm = torque_Nm;
    output.velocity_rad_s = velocity_rad_s;
    output.fault = fault;
    output.repeat = 3;
    if (step_ < kTrajectorySteps) {
      output.phase = CheckPhase::Trajectory;
      output.trajectory_index = step_;
      output.force_reference_N = 10.0 * step_;
    } else if (step_ < kTrajectorySteps + kReleaseSteps) {
      output.phase = CheckPhase::Release;
    } else {
      output.phase = CheckPhase::Done;
      output.torque_Nm = output.velocity_rad_s = 0.0;
    }
    ++step_;
    return output;
  }
  void conclude() noexcept { ++concluded; }
  void follow(std::uint8_t trajectory) noexcept { followed = trajectory; }
  void abandon() noexcept {
    plan_ = nullptr;
    ++abandoned;
  }
  bool done() const noexcept { return step_ > kTrajectorySteps + kReleaseSteps; }

 private:
  const CheckPlan* plan_ = nullptr;
  int step_ = 0;
};

using ToyCore = BasicControlCore<ToySequence>;

/// Port, core and virtual time together.
struct ToyStation {
  explicit ToyStation(const SupervisorSettings& settings = {}, std::size_t ring_capacity = 4096,
                      InterlockBoard* interlocks = nullptr)
      : core(port, without_physics(settings), ring_capacity, kPolicy, interlocks) {
    ToySequence::reset();
  }

  void tick(std::uint64_t skipped_periods = 0) {
    now_ns += static_cast<std::int64_t>(1 + skipped_periods) * kPeriod_ns;
    core.tick(now_ns, 5'000 + static_cast<std::int64_t>(skipped_periods) * kPeriod_ns, skipped_periods);
  }
  void ticks(int count) {
    for (int i = 0; i < count; ++i) tick();
  }
  void start() { core.requests().start(plan, core.ticket()); }
  std::uint64_t stop() { return core.requests().stop(now_ns); }
  StationState state() const { return core.status().state.load(); }
  FaultCause fault() const { return core.status().fault.load(); }
  bool drive_is_off() const {
    const DriveCommand& command = port.attempted;
    return !command.enable && command.torque_Nm == 0.0 && command.velocity_rad_s == 0.0;
  }

  /// Brings a fresh station to `target` by ordinary means. False if it did not get there.
  bool reach(StationState target) {
    if (target == StationState::Init) return tick(), state() == target;
    ticks(50);
    if (target == StationState::Idle) return state() == target;
    if (target == StationState::Fault) {
      core.requests().emergency_stop = true;
      tick();
      core.requests().emergency_stop = false;
      return state() == target;
    }
    start();
    for (int i = 0; i < 500 && state() != target; ++i) tick();
    tick();  // one further, so that the drive is live in RUNNING
    return state() == target;
  }

  CheckPlan plan;
  ToyPort port;
  ToyCore core;
  std::int64_t now_ns = 1'000'000'000;
};

}  // namespace clampd::rt::test
