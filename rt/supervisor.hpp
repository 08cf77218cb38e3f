#pragma once

#include <cmath>
#include <cstdint>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/base/result.hpp"
#include "clampd/control/nominal_drive.hpp"
#include "clampd/ports/brake_port.hpp"
#include "clampd/ports/interlocks.hpp"
#include "clampd/record/sample.hpp"
#include "rt/policy.hpp"
#include "rt/reading_monitor.hpp"

namespace clampd::rt {

/// Thresholds of the causes in rt/policy.hpp. The defaults fit the paper's brake (30 kN, 300 rad/s, 3 N m).
struct SupervisorSettings {
  std::int64_t startup_timeout_ns = 2 * kNanosecondsPerSecond;  ///< INIT: good feedback must come within
  int good_samples_to_idle = 20;                                ///< in a row, INIT to IDLE
  int good_samples_to_run = 10;                                 ///< in a row at zero torque, ARMED to RUNNING
  std::int64_t armed_timeout_ns = 500 * kNanosecondsPerMillisecond;

  /// Two empty ticks happen when the phases of brake and host drift past each other; the third is a fault.
  /// The half period keeps wake-up jitter out of the decision.
  std::int64_t stale_ns = 2 * kPeriod_ns + kPeriod_ns / 2;

  std::int64_t event_window_ns = 10 * kNanosecondsPerMillisecond;  ///< for the three counts below
  /// The CAN controller's own CRC already catches wire noise, so a wrong CRC-8 means a broken node: tolerate
  /// none.
  std::uint64_t corrupt_tolerated = 0;
  /// CAN may deliver one frame twice (an error in its last bit), so one repeated counter is healthy.
  std::uint64_t frozen_tolerated = 1;
  std::uint64_t implausible_tolerated = 0;
  std::int64_t clock_tolerance_ns = kPeriod_ns / 5;  ///< brake clock step against its sample count
  std::uint64_t send_failures_tolerated = 1;         ///< in a row
  std::uint64_t lost_samples_tolerated = 0;          ///< within one check's trajectories

  double force_limit_N = 33e3;
  double force_ceiling_N = 36e3;  ///< no exemption lifts this one
  double speed_limit_rad_s = 350.0;
  double torque_limit_Nm = 3.1;     ///< measured; commands are limited to it too
  double travel_limit_rad = 120.0;  ///< from where the check started
  /// Over-force is no fault while the drive opens or rests: otherwise a clamped brake could never be opened
  /// again.
  double opening_velocity_rad_s = 10.0;

  double plausible_force_N = 60e3;  ///< magnitude beyond which a reading is a defect
  double plausible_velocity_rad_s = 1000.0;
  double plausible_torque_Nm = 20.0;
  double plausible_jump_rad = 1.0;  ///< position step against velocity, per sample, outside of a check

  NominalDrive drive;  ///< of the product, and how often it samples: what its readings are compared by
  ReadingTolerances readings;  ///< against each other, in a check

  std::uint64_t skipped_in_a_row_tolerated = 2;
  std::uint64_t skipped_per_check_tolerated = 5;

  bool drive_reports_live = true;  ///< false for a brake whose feedback has no drive-enabled signal
  std::int64_t clear_quiet_ns = 50 * kNanosecondsPerMillisecond;

  /// The defaults for this drive: what counts in samples lasts as long as its period makes it.
  static SupervisorSettings of(const NominalDrive& drive) noexcept {
    SupervisorSettings settings;
    settings.drive = drive;
    const auto period_ns = std::llround(1e9 * drive.period_s);
    settings.stale_ns = 2 * period_ns + period_ns / 2;
    settings.event_window_ns = 10 * period_ns;
    settings.clock_tolerance_ns = period_ns / 5;
    return settings;
  }

  /// Error: a threshold that is not positive and finite, or an empty plausible range; the message names it.
  Result<void> validate() const;
};

/// How many good samples came in a row. It stops counting where nobody asks any more: an idle station counts
/// for months, and would overflow 32 bits after 24.9 days.
class GoodRow {
 public:
  static constexpr int kMax = 1'000'000;
  CLAMPD_REALTIME void add() noexcept {
    if (count_ < kMax) ++count_;
  }
  CLAMPD_REALTIME void restart() noexcept { count_ = 0; }
  CLAMPD_REALTIME int count() const noexcept { return count_; }

 private:
  int count_ = 0;
};

/// What the supervisor learns at the beginning of a tick.
struct TickInputs {
  std::int64_t now_ns = 0;
  std::uint64_t skipped_periods = 0;
  PortHealth health;
  Interlocks interlocks;
  bool operator_stop = false;
  bool clear = false;
};

/// The station's state machine: INIT -> IDLE -> ARMED -> RUNNING -> RELEASING -> IDLE, and FAULT from
/// anywhere. Mechanism only: what each cause means stands in the policy. No I/O, no clock of its own.
///
/// A tick calls begin_tick, then for each sample observe and (while sequence_runs()) follow, then
/// end_samples, then sent. FAULT keeps its first cause until the cause is gone and the operator clears; then
/// the station starts over at INIT, and moves again only for a new check.
class Supervisor {
 public:
  /// `policy` must outlive the supervisor.
  explicit Supervisor(const SupervisorSettings& settings, const Policy& policy = kPolicy) noexcept
      : settings_(settings),
        policy_(&policy),
        period_ns_(std::llround(settings.drive.period_s * 1e9)),
        early_N_(kForceRate_N_s * (settings.drive.period_s - kPeriod_s)),
        monitor_(settings.readings, settings.drive, settings.torque_limit_Nm) {}

  CLAMPD_REALTIME void begin_tick(const TickInputs& inputs) noexcept;
  CLAMPD_REALTIME void observe(const BrakeFeedback& feedback) noexcept;
  /// Where the check stands after its step on the sample just observed, and what it knows of the brake.
  CLAMPD_REALTIME void follow(CheckPhase phase, bool done, const ReadingContext& context) noexcept;
  CLAMPD_REALTIME void end_samples() noexcept;
  CLAMPD_REALTIME void sent(bool handed_over, const DriveCommand& command) noexcept;

  /// Starts a check. False, and nothing happens, unless IDLE.
  CLAMPD_REALTIME bool arm() noexcept;
  /// Reports a cause. What it does depends on the policy and the state.
  CLAMPD_REALTIME void raise(FaultCause cause) noexcept {
    if (cause != FaultCause::None) judge(cause);
  }

  /// Of the loop.
  CLAMPD_REALTIME std::int64_t period_ns() const noexcept { return period_ns_; }
  CLAMPD_REALTIME StationState state() const noexcept { return state_; }
  CLAMPD_REALTIME FaultCause fault() const noexcept { return fault_; }
  /// When the fault was latched, and in which state: only meaningful in FAULT.
  CLAMPD_REALTIME std::int64_t fault_time_ns() const noexcept { return fault_time_ns_; }
  CLAMPD_REALTIME StationState fault_state() const noexcept { return fault_state_; }
  /// In FAULT: would a clear be accepted now?
  CLAMPD_REALTIME bool clearable() const noexcept;
  CLAMPD_REALTIME bool in_check() const noexcept { return state_ == StationState::Armed || sequence_runs(); }
  CLAMPD_REALTIME bool sequence_runs() const noexcept {
    return state_ == StationState::Running || state_ == StationState::Releasing;
  }

 private:
  /// Watches a cumulative count of events, and forgets them a window after the first.
  class EventBudget {
   public:
    void begin_at(std::uint64_t total) noexcept { total_ = total; }
    bool exceeded_by(std::uint64_t total, std::int64_t now_ns, std::int64_t window_ns,
                     std::uint64_t tolerated) noexcept {
      return total != total_ && count(total, now_ns, window_ns) > tolerated;
    }

   private:
    std::uint64_t count(std::uint64_t total, std::int64_t now_ns, std::int64_t window_ns) noexcept;

    std::uint64_t total_ = 0;
    std::int64_t first_ns_ = 0;
    std::uint64_t count_ = 0;
  };

  static constexpr double kForceRate_N_s = 300e3;  // 300 rad/s at 1 kN/rad

  void judge(FaultCause cause) noexcept;
  void enter_init() noexcept;
  void check_waiting() noexcept;
  void latch(FaultCause cause) noexcept;
  void check_stops(const TickInputs& inputs) noexcept;
  void check_link(const PortHealth& health) noexcept;
  void check_stream(const BrakeFeedback& feedback) noexcept;
  void check_drive(const BrakeFeedback& feedback) noexcept;
  void check_limits(const BrakeFeedback& feedback) noexcept;
  void check_readings(const BrakeFeedback& feedback) noexcept;
  bool plausible(const BrakeFeedback& feedback) const noexcept;
  void advance(const BrakeFeedback& feedback) noexcept;

  SupervisorSettings settings_;
  const Policy* policy_;
  std::int64_t period_ns_;
  /// A slow loop looks less often: by how much a force may grow until then, beyond what it does in a
  /// millisecond.
  double early_N_;

  StationState state_ = StationState::Init;
  FaultCause fault_ = FaultCause::None;
  StationState fault_state_ = StationState::Init;
  std::int64_t fault_time_ns_ = 0;

  std::int64_t now_ns_ = 0;
  bool started_ = false;
  std::int64_t state_entered_ns_ = 0;
  std::int64_t last_sample_ns_ = 0;
  std::int64_t last_trouble_ns_ = 0;  ///< a standing cause was seen, whatever the state
  FaultCause init_trouble_ = FaultCause::None;
  bool init_saw_sample_ = false;
  GoodRow good_samples_;

  std::uint64_t bus_off_events_ = 0;
  EventBudget corrupt_;
  EventBudget frozen_;
  EventBudget implausible_;
  std::uint64_t send_failures_in_a_row_ = 0;
  bool told_to_close_ = false;  ///< by the last command

  bool has_previous_ = false;
  BrakeFeedback previous_;
  CheckPhase phase_ = CheckPhase::None;
  ReadingContext context_;
  ReadingMonitor monitor_;

  bool travel_known_ = false;
  double travel_origin_rad_ = 0.0;
  std::uint64_t skipped_in_check_ = 0;
  std::uint64_t lost_in_check_ = 0;
};

inline void Supervisor::follow(CheckPhase phase, bool done, const ReadingContext& context) noexcept {
  if (!sequence_runs()) return;
  phase_ = phase;
  context_ = context;
  if (done) {
    state_ = StationState::Idle;
    state_entered_ns_ = now_ns_;
    phase_ = CheckPhase::None;
  } else if (phase == CheckPhase::Release && state_ == StationState::Running) {
    state_ = StationState::Releasing;
    state_entered_ns_ = now_ns_;
  }
}

inline void Supervisor::end_samples() noexcept {
  if (now_ns_ - last_sample_ns_ > settings_.stale_ns) raise(FaultCause::FeedbackStale);
  if (state_ == StationState::Init || state_ == StationState::Armed) check_waiting();
}

inline void Supervisor::sent(bool handed_over, const DriveCommand& command) noexcept {
  told_to_close_ = command.torque_Nm > 0.0 || command.velocity_rad_s > 0.0;
  monitor_.commanded(command);
  if (handed_over) {
    send_failures_in_a_row_ = 0;
  } else if (++send_failures_in_a_row_ > settings_.send_failures_tolerated) {
    raise(FaultCause::SendFailed);
  }
}

}  // namespace clampd::rt
