#include "rt/supervisor.hpp"

#include <cmath>
#include <utility>

namespace clampd::rt {

std::uint64_t Supervisor::EventBudget::count(std::uint64_t total, std::int64_t now_ns,
                                             std::int64_t window_ns) noexcept {
  const std::uint64_t before = std::exchange(total_, total);
  // A port that was opened again starts its counts at zero: that is no event.
  if (total < before) return 0;
  if (count_ > 0 && now_ns - first_ns_ > window_ns) count_ = 0;
  if (count_ == 0) first_ns_ = now_ns;
  count_ += total - before;
  return count_;
}

void Supervisor::enter_init() noexcept {
  state_ = StationState::Init;
  fault_ = FaultCause::None;
  state_entered_ns_ = now_ns_;
  init_trouble_ = FaultCause::None;
  init_saw_sample_ = false;
  good_samples_.restart();
}

void Supervisor::judge(FaultCause cause) noexcept {
  const FaultRule& rule = (*policy_)[static_cast<std::size_t>(cause)];
  // An open fixture, for one, may stand as long as it likes between checks.
  if (rule.scope == FaultScope::Check && !in_check()) return;
  good_samples_.restart();
  if (rule.clear == ClearCondition::WhenGone) last_trouble_ns_ = now_ns_;
  switch (state_) {
    case StationState::Fault:
      return;  // the first cause stays
    case StationState::Init:
      if (rule.scope != FaultScope::Always) {
        init_trouble_ = cause;
        return;
      }
      break;
    case StationState::Idle:
    case StationState::Armed:
    case StationState::Running:
    case StationState::Releasing:
      break;
  }
  latch(cause);
}

void Supervisor::latch(FaultCause cause) noexcept {
  fault_state_ = state_;
  state_ = StationState::Fault;
  fault_ = cause;
  fault_time_ns_ = now_ns_;
  state_entered_ns_ = now_ns_;
  phase_ = CheckPhase::None;
}

bool Supervisor::clearable() const noexcept {
  if (state_ != StationState::Fault) return false;
  const FaultRule& rule = (*policy_)[static_cast<std::size_t>(fault_)];
  return rule.clear == ClearCondition::AtOnce || now_ns_ - last_trouble_ns_ > settings_.clear_quiet_ns;
}

void Supervisor::begin_tick(const TickInputs& inputs) noexcept {
  now_ns_ = inputs.now_ns;
  if (!started_) {
    started_ = true;
    bus_off_events_ = inputs.health.bus_off_events;
    corrupt_.begin_at(inputs.health.crc_errors);
    frozen_.begin_at(inputs.health.counter_errors);
    implausible_.begin_at(inputs.health.implausible);
    last_sample_ns_ = now_ns_;
    enter_init();
  }
  if (inputs.operator_stop || !inputs.interlocks.none()) check_stops(inputs);
  check_link(inputs.health);
  if (in_check() && inputs.skipped_periods > 0) {
    skipped_in_check_ += inputs.skipped_periods;
    if (inputs.skipped_periods > settings_.skipped_in_a_row_tolerated ||
        skipped_in_check_ > settings_.skipped_per_check_tolerated) {
      raise(FaultCause::MissedTicks);
    }
  }
  if (inputs.clear && clearable()) enter_init();
}

void Supervisor::check_stops(const TickInputs& inputs) noexcept {
  // Emergency stop first: should several causes meet, the operator's own is the one to report.
  if (inputs.interlocks.emergency_stop) raise(FaultCause::EmergencyStop);
  if (inputs.operator_stop) raise(FaultCause::OperatorStop);
  if (inputs.interlocks.lost) raise(FaultCause::InterlockLost);
  if (inputs.interlocks.fixture_open) raise(FaultCause::FixtureOpen);
  if (inputs.interlocks.start_button_stuck) raise(FaultCause::StartButtonStuck);
}

inline void Supervisor::check_link(const PortHealth& health) noexcept {
  if (health.link == LinkState::BusOff || health.bus_off_events > bus_off_events_) raise(FaultCause::BusOff);
  bus_off_events_ = health.bus_off_events;
  if (health.link == LinkState::Down || health.link == LinkState::Gone) raise(FaultCause::LinkDown);
  const std::int64_t window_ns = settings_.event_window_ns;
  if (corrupt_.exceeded_by(health.crc_errors, now_ns_, window_ns, settings_.corrupt_tolerated))
    raise(FaultCause::FeedbackCorrupt);
  if (frozen_.exceeded_by(health.counter_errors, now_ns_, window_ns, settings_.frozen_tolerated))
    raise(FaultCause::FeedbackFrozen);
  if (implausible_.exceeded_by(health.implausible, now_ns_, window_ns, settings_.implausible_tolerated))
    raise(FaultCause::FeedbackImplausible);
}

void Supervisor::observe(const BrakeFeedback& feedback) noexcept {
  last_sample_ns_ = now_ns_;
  init_saw_sample_ = true;
  good_samples_.add();  // a raise() below starts the count over
  if (!plausible(feedback)) {
    has_previous_ = false;
    raise(FaultCause::FeedbackImplausible);
    return;
  }
  check_stream(feedback);
  check_drive(feedback);
  // Before the limits: of a reading that lies, its name is the better answer.
  check_readings(feedback);
  check_limits(feedback);
  previous_ = feedback;
  has_previous_ = true;
  advance(feedback);
}

inline bool Supervisor::plausible(const BrakeFeedback& feedback) const noexcept {
  // Written so that NaN fails.
  return std::abs(feedback.force_N) <= settings_.plausible_force_N &&
         std::abs(feedback.velocity_rad_s) <= settings_.plausible_velocity_rad_s &&
         std::abs(feedback.torque_Nm) <= settings_.plausible_torque_Nm &&
         std::isfinite(feedback.position_rad);
}

inline void Supervisor::check_stream(const BrakeFeedback& feedback) noexcept {
  if (!has_previous_) return;
  const std::int64_t samples = feedback.sample_index - previous_.sample_index;
  const std::int64_t elapsed_ns = feedback.brake_time_ns - previous_.brake_time_ns;
  if (samples <= 0 || std::abs(elapsed_ns - samples * period_ns_) > settings_.clock_tolerance_ns) {
    raise(FaultCause::FeedbackFrozen);
    return;
  }
  const double elapsed_s = static_cast<double>(elapsed_ns) * 1e-9;
  const double unexplained_rad =
      std::abs(feedback.position_rad - previous_.position_rad -
               0.5 * (feedback.velocity_rad_s + previous_.velocity_rad_s) * elapsed_s);
  // In a check the monitor knows better: it tells which of the two is wrong.
  if (!in_check() && unexplained_rad > settings_.plausible_jump_rad * static_cast<double>(samples)) {
    raise(FaultCause::FeedbackImplausible);
  }
  if (samples > 1 && phase_ == CheckPhase::Trajectory) {
    lost_in_check_ += static_cast<std::uint64_t>(samples - 1);
    if (lost_in_check_ > settings_.lost_samples_tolerated) raise(FaultCause::SampleLost);
  }
}

inline void Supervisor::check_drive(const BrakeFeedback& feedback) noexcept {
  const bool drive_dropped_out = sequence_runs() && settings_.drive_reports_live && !feedback.drive_enabled;
  if (feedback.brake_fault || feedback.watchdog_tripped || drive_dropped_out) raise(FaultCause::BrakeFault);
}

inline void Supervisor::check_limits(const BrakeFeedback& feedback) noexcept {
  const bool closing = told_to_close_ || feedback.velocity_rad_s > settings_.opening_velocity_rad_s;
  if (feedback.force_N > (closing ? settings_.force_limit_N - early_N_ : settings_.force_ceiling_N))
    raise(FaultCause::OverForce);
  if (std::abs(feedback.velocity_rad_s) > settings_.speed_limit_rad_s) raise(FaultCause::OverSpeed);
  if (std::abs(feedback.torque_Nm) > settings_.torque_limit_Nm) raise(FaultCause::OverTorque);
  if (in_check()) {
    if (!travel_known_) {
      travel_known_ = true;
      travel_origin_rad_ = feedback.position_rad;
    }
    if (std::abs(feedback.position_rad - travel_origin_rad_) > settings_.travel_limit_rad) {
      raise(FaultCause::OverTravel);
    }
  }
}

inline void Supervisor::check_readings(const BrakeFeedback& feedback) noexcept {
  if (!in_check()) return;
  raise(monitor_.observe(feedback, context_));
}

inline void Supervisor::advance(const BrakeFeedback& feedback) noexcept {
  switch (state_) {
    case StationState::Init:
      if (good_samples_.count() >= settings_.good_samples_to_idle) {
        state_ = StationState::Idle;
        state_entered_ns_ = now_ns_;
      }
      break;
    case StationState::Armed:
      if (settings_.drive_reports_live && !feedback.drive_enabled) good_samples_.restart();
      if (good_samples_.count() >= settings_.good_samples_to_run) {
        state_ = StationState::Running;
        state_entered_ns_ = now_ns_;
      }
      break;
    case StationState::Idle:
    case StationState::Running:
    case StationState::Releasing:
    case StationState::Fault:
      break;
  }
}

bool Supervisor::arm() noexcept {
  if (state_ != StationState::Idle) return false;
  state_ = StationState::Armed;
  state_entered_ns_ = now_ns_;
  good_samples_.restart();
  travel_known_ = false;
  skipped_in_check_ = 0;
  lost_in_check_ = 0;
  phase_ = CheckPhase::None;
  context_ = {};
  monitor_.restart();
  return true;
}

/// Whether the brake has had its time to get ready.
void Supervisor::check_waiting() noexcept {
  const std::int64_t in_state_ns = now_ns_ - state_entered_ns_;
  if (state_ == StationState::Init && in_state_ns > settings_.startup_timeout_ns) {
    const FaultCause trouble = init_trouble_;
    const bool silent =
        trouble == FaultCause::None || (trouble == FaultCause::FeedbackStale && !init_saw_sample_);
    latch(silent ? FaultCause::FeedbackMissing : trouble);
  }
  if (state_ == StationState::Armed && in_state_ns > settings_.armed_timeout_ns)
    raise(FaultCause::BrakeFault);
}

}  // namespace clampd::rt
