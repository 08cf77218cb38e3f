#pragma once

// The tick: everything that happens once a millisecond, with time as an argument and the link behind
// BrakePort, so that the very code of the bench runs in the tests in virtual time.

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>

#include "clampd/base/clock.hpp"
#include "clampd/base/realtime.hpp"
#include "clampd/ports/brake_port.hpp"
#include "clampd/ports/interlocks.hpp"
#include "clampd/record/sample.hpp"
#include "rt/check_sequence.hpp"
#include "rt/flight_recorder.hpp"
#include "rt/histogram.hpp"
#include "rt/ring.hpp"
#include "rt/supervisor.hpp"

namespace clampd::rt {

/// What whoever asks for a start has seen of the station by then. The start is void once that has changed.
struct StartTicket {
  std::uint64_t stops = 0;          ///< RequestBoard::stops
  std::uint64_t fault_changes = 0;  ///< StatusBoard::fault_changes
  std::int64_t asked_ns = 0;        ///< by the loop's clock
};

/// A start that was not taken for longer is void: who asked for it no longer expects the brake to move.
inline constexpr std::int64_t kStartLife_ns = 300 * kNanosecondsPerMillisecond;

/// Why a start was not taken.
enum class StartRefusal : std::uint8_t {
  None,
  Stopped,  ///< a stop came after it was asked for
  Fault,    ///< it was asked for in FAULT, or the station went there since
  TooLate,  ///< not taken within kStartLife_ns
};

/// How a check ended, as the loop saw it there and then. Neither refusal nor fault: it reached its end.
struct CheckEnd {
  StartRefusal refusal = StartRefusal::None;  ///< unless None: nothing ever moved
  FaultCause fault = FaultCause::None;        ///< that ended the check, or was there when it was refused
  StationState state = StationState::Init;    ///< in which that fault was latched
};

/// What other threads may read at any time. Every field is atomic on its own; the ring carries the consistent
/// data. Who waits for a check watches checks_finished: what belongs to that check is already in place when
/// it counts up, the CheckEnd too, which stays until the next check ends, whatever the state then is.
struct StatusBoard {
  std::atomic<std::int64_t> now_ns{0};  ///< of the last tick, by the loop's clock
  /// Stops that have taken effect: the command that was sent before this counted up drives nothing that was
  /// asked for before them.
  std::atomic<std::uint64_t> stops{0};
  std::atomic<std::uint64_t> fault_changes{0};  ///< times that the station went to FAULT or left it
  std::atomic<StationState> state{StationState::Init};
  std::atomic<FaultCause> fault{FaultCause::None};
  std::atomic<std::int64_t> fault_time_ns{0};                 ///< when it was latched
  std::atomic<StationState> fault_state{StationState::Init};  ///< in which state it was latched
  std::atomic<bool> clearable{false};                         ///< in FAULT: a clear would be accepted now
  std::atomic<CheckPhase> phase{CheckPhase::None};
  std::atomic<std::uint16_t> repeat{0};
  std::atomic<std::uint64_t> ticks{0};
  std::atomic<std::uint64_t> skipped{0};
  std::atomic<std::uint64_t> ring_drops{0};
  std::atomic<std::uint64_t> check_ticks{0};  ///< of the present or last check, like the next three
  std::atomic<std::uint64_t> check_skipped{0};
  std::atomic<std::uint64_t> check_ring_drops{0};
  std::atomic<std::uint64_t> check_lost_samples{0};  ///< by the port's count, in any phase
  std::atomic<std::uint64_t> checks_finished{
      0};  ///< sequences that reached Done, were ended by a fault or whose start was refused
  std::atomic<StartRefusal> end_refusal{StartRefusal::None};  ///< CheckEnd of the last one, as the next two
  std::atomic<FaultCause> end_fault{FaultCause::None};
  std::atomic<StationState> end_state{StationState::Init};
  std::atomic<double> force_N{0.0};
  std::atomic<double> velocity_rad_s{0.0};
  std::atomic<double> torque_Nm{0.0};
};

/// Requests from other threads; the tick takes them. Lock-free.
struct RequestBoard {
  std::atomic<std::uint64_t> stops{0};          ///< operator stops, counted up by stop() only
  std::atomic<std::int64_t> stopped_ns{0};      ///< when the last one was asked for
  std::atomic<bool> emergency_stop{false};      ///< level, not edge: FAULT persists while true
  std::atomic<bool> clear{false};               ///< operator clears the fault; ignored unless clearable
  std::atomic<const CheckPlan*> plan{nullptr};  ///< given by start() only, taken by the tick
  /// The check whose runs are enough, by the number that checks_finished will have after it: it begins no
  /// further run. Numbers never come again, so that this is never about another check.
  std::atomic<std::uint64_t> enough_runs_in{0};
  /// Which trajectory the next run of a check follows: the check by that number, times kTrajectories, and the
  /// trajectory.
  static constexpr std::uint64_t kTrajectories = 256;
  std::atomic<std::uint64_t> next_trajectory{0};

  /// An operator stop: ends a check, and voids every start that was asked for before. Any thread. It has
  /// taken effect once StatusBoard::stops has reached what this returns.
  std::uint64_t stop(std::int64_t now_ns) noexcept {
    stopped_ns.store(now_ns, std::memory_order_relaxed);
    return stops.fetch_add(1, std::memory_order_acq_rel) + 1;
  }

  /// A check to start, one at a time: not before checks_finished has counted the last one. The tick takes it
  /// in IDLE; it waits in INIT; it is refused, and counted as finished, once its ticket is void.
  void start(const CheckPlan& check, const StartTicket& ticket) noexcept {
    ticket_stops_.store(ticket.stops, std::memory_order_relaxed);
    ticket_fault_changes_.store(ticket.fault_changes, std::memory_order_relaxed);
    ticket_asked_ns_.store(ticket.asked_ns, std::memory_order_relaxed);
    plan.store(&check, std::memory_order_release);
  }

  /// Of the plan that was read with acquire order.
  CLAMPD_REALTIME StartTicket ticket() const noexcept {
    return {ticket_stops_.load(std::memory_order_relaxed),
            ticket_fault_changes_.load(std::memory_order_relaxed),
            ticket_asked_ns_.load(std::memory_order_relaxed)};
  }

 private:
  std::atomic<std::uint64_t> ticket_stops_{0};
  std::atomic<std::uint64_t> ticket_fault_changes_{0};
  std::atomic<std::int64_t> ticket_asked_ns_{0};
};

/// The port's health for other threads, as of the last tick.
class HealthBoard {
 public:
  CLAMPD_REALTIME void store(const PortHealth& health) noexcept {
    link_.store(health.link, std::memory_order_relaxed);
    store(health, std::make_index_sequence<kCounters.size()>());
  }

  PortHealth load() const noexcept {
    PortHealth health;
    health.link = link_.load(std::memory_order_relaxed);
    for (std::size_t i = 0; i < kCounters.size(); ++i) {
      health.*kCounters[i] = counters_[i].load(std::memory_order_relaxed);
    }
    return health;
  }

 private:
  using Counter = std::uint64_t PortHealth::*;
  static constexpr std::array kCounters{
      &PortHealth::frames_received,   &PortHealth::frames_sent,    &PortHealth::send_failures,
      &PortHealth::crc_errors,        &PortHealth::counter_errors, &PortHealth::lost_samples,
      &PortHealth::implausible,       &PortHealth::error_frames,   &PortHealth::bus_off_events,
      &PortHealth::receive_overflows, &PortHealth::bus_bits};

  // Without a loop, so that each place is known to the compiler.
  template <std::size_t... i>
  void store(const PortHealth& health, std::index_sequence<i...>) noexcept {
    (counters_[i].store(health.*std::integral_constant<Counter, kCounters[i]>::value,
                        std::memory_order_relaxed),
     ...);
  }

  std::atomic<LinkState> link_{LinkState::Up};
  std::array<std::atomic<std::uint64_t>, kCounters.size()> counters_{};
};

/// One station's tick. `Sequence` has the interface of CheckSequence; tests put a toy there.
///
/// A plan handed over in the RequestBoard is used from ARMED until checks_finished counts up.
template <class Sequence>
class BasicControlCore {
 public:
  /// Samples taken in one tick at most. What piled up while the station started is worked off over several:
  /// ticks as long as the period would starve the panel's reader, which runs below the loop.
  static constexpr std::size_t kReceiveCapacity = 8;
  static constexpr std::size_t kRingCapacity = 8192;

  /// `port` and `interlocks` must outlive the core; without interlocks, the station has none.
  explicit BasicControlCore(BrakePort& port, const SupervisorSettings& settings = {},
                            std::size_t ring_capacity = kRingCapacity, const Policy& policy = kPolicy,
                            InterlockBoard* interlocks = nullptr)
      : port_(port),
        interlocks_(interlocks),
        settings_(settings),
        supervisor_(settings, policy),
        ring_(ring_capacity) {}

  /// Everything that happens in one period. `lateness_ns` is the wake-up's, `skipped_periods` how many grid
  /// points passed without a tick just before this one. Sends exactly one command.
  CLAMPD_REALTIME void tick(std::int64_t now_ns, std::int64_t lateness_ns,
                            std::uint64_t skipped_periods) noexcept {
    const std::size_t received = std::min(port_.receive(feedback_, now_ns), feedback_.size());
    begin(now_ns, skipped_periods);
    std::array<Sample*, kReceiveCapacity> samples;
    for (std::size_t i = 0; i < received; ++i) {
      samples[i] = &recorder_.next();
      take(feedback_[i], *samples[i], now_ns, lateness_ns);
    }
    supervisor_.end_samples();
    start_if_requested(now_ns);

    const DriveCommand command = safe_command();
    const bool handed_over = port_.send(command, now_ns);
    supervisor_.sent(handed_over, command);
    log({samples.data(), received}, command.torque_Nm);
    publish(now_ns, lateness_ns, skipped_periods);
  }

  /// Between two ticks, for a brake that wants commands more often: the last one again.
  CLAMPD_REALTIME void between(std::int64_t now_ns) noexcept { port_.repeat(now_ns); }

  /// The loop's last act: drive off, a running check counted as ended by that, a start that waits refused.
  CLAMPD_REALTIME void shutdown(std::int64_t now_ns) noexcept {
    supervisor_.raise(FaultCause::StationEnded);
    port_.send(DriveCommand{}, now_ns);
    port_.end(now_ns);
    end_check_on_fault();
    if (requests_.plan.load(std::memory_order_acquire) != nullptr) refuse(StartRefusal::Stopped);
    stops_taken_ = requests_.stops.load(std::memory_order_acquire);
    publish_state();
    if (interlocks_ != nullptr) interlocks_->beat({status_.ticks, StationState::Fault});
  }

  SampleRing& ring() noexcept { return ring_; }
  const StatusBoard& status() const noexcept { return status_; }
  RequestBoard& requests() noexcept { return requests_; }

  /// What a start that is asked for now carries. Any thread.
  StartTicket ticket() const noexcept {
    StartTicket ticket;
    ticket.asked_ns = status_.now_ns.load(std::memory_order_relaxed);
    ticket.fault_changes = status_.fault_changes.load(std::memory_order_acquire);
    ticket.stops = requests_.stops.load(std::memory_order_acquire);
    return ticket;
  }
  /// The same for a start that was asked for at `asked_ns`, by the loop's clock; nothing if a stop or a fault
  /// came since.
  std::optional<StartTicket> ticket_of(std::int64_t asked_ns) const noexcept {
    StartTicket ticket = this->ticket();
    if (asked_ns <= requests_.stopped_ns.load(std::memory_order_relaxed) ||
        asked_ns <= status_.fault_time_ns.load(std::memory_order_relaxed))
      return std::nullopt;
    ticket.asked_ns = asked_ns;
    return ticket;
  }
  /// Whether a start would be refused by now, FAULT itself aside. Any thread; the tick has the last word.
  StartRefusal refusal(const StartTicket& ticket) const noexcept {
    return refusal(ticket, requests_.stops.load(std::memory_order_acquire),
                   status_.fault_changes.load(std::memory_order_acquire),
                   status_.now_ns.load(std::memory_order_relaxed));
  }
  PortHealth health() const noexcept { return health_.load(); }
  /// Wake-up lateness within the present or last check.
  const DurationHistogram& lateness() const noexcept { return lateness_; }
  /// Samples before the latest fault, including the one that showed it.
  const FlightRecorder& flight_recorder() const noexcept { return recorder_; }

 private:
  void begin(std::int64_t now_ns, std::uint64_t skipped_periods) noexcept {
    // While the loop itself stood still, the panel had no chance either: only its silence beside a running
    // loop counts.
    const std::int64_t missed_ns = static_cast<std::int64_t>(skipped_periods) * supervisor_.period_ns();
    TickInputs inputs{
        .now_ns = now_ns,
        .skipped_periods = skipped_periods,
        .health = port_.health(),
        .interlocks = interlocks_ != nullptr ? interlocks_->read(now_ns - missed_ns) : Interlocks{},
        .operator_stop = take_stops(),
        .clear = take_clear()};
    if (requests_.emergency_stop.load(std::memory_order_acquire)) inputs.interlocks.emergency_stop = true;
    // Before the clear is looked at: a plan from before the fault was cleared must not start after it.
    if (supervisor_.state() == StationState::Fault &&
        requests_.plan.load(std::memory_order_acquire) != nullptr)
      refuse(StartRefusal::Fault);
    supervisor_.begin_tick(inputs);
    if (plan_ != nullptr && now_ns - armed_ns_ > deadline_ns_) supervisor_.raise(FaultCause::DeadlinePassed);
    health_.store(inputs.health);
    port_lost_samples_ = inputs.health.lost_samples;
  }

  bool take_stops() noexcept {
    const std::uint64_t before = stops_taken_;
    stops_taken_ = requests_.stops.load(std::memory_order_acquire);
    return stops_taken_ != before;
  }

  // Looked at before it is taken: an exchange in every tick would be its one locked operation. Only the loop
  // takes it.
  bool take_clear() noexcept {
    return requests_.clear.load(std::memory_order_acquire) &&
           requests_.clear.exchange(false, std::memory_order_acq_rel);
  }

  void take(const BrakeFeedback& feedback, Sample& sample, std::int64_t now_ns,
            std::int64_t lateness_ns) noexcept {
    const bool ran = supervisor_.sequence_runs();
    supervisor_.observe(feedback);
    if (supervisor_.sequence_runs())
      answer(feedback, sample, !ran);
    else
      note(SequenceOutput{}, sample);
    sample.sample_index = feedback.sample_index;
    sample.brake_time_ns = feedback.brake_time_ns;
    sample.host_time_ns = now_ns;
    sample.torque_Nm = feedback.torque_Nm;
    sample.velocity_rad_s = feedback.velocity_rad_s;
    sample.force_N = feedback.force_N;
    sample.position_rad = feedback.position_rad;
    sample.lateness_ns = static_cast<std::int32_t>(std::min<std::int64_t>(lateness_ns, INT32_MAX));
    sample.state = supervisor_.state();
    sample.fault = supervisor_.fault();
  }

  void answer(const BrakeFeedback& feedback, Sample& sample, bool first) noexcept {
    if (first) sequence_.start(plan_);
    if (requests_.enough_runs_in.load(std::memory_order_relaxed) == finished_ + 1) sequence_.conclude();
    const std::uint64_t next = requests_.next_trajectory.load(std::memory_order_relaxed);
    if (next / RequestBoard::kTrajectories == finished_ + 1)
      sequence_.follow(static_cast<std::uint8_t>(next % RequestBoard::kTrajectories));
    const SequenceOutput& output = sequence_.step(feedback);
    torque_Nm_ = output.torque_Nm;
    velocity_rad_s_ = output.velocity_rad_s;
    supervisor_.raise(output.fault);
    if (!std::isfinite(output.torque_Nm + output.velocity_rad_s)) supervisor_.raise(FaultCause::NonFinite);
    supervisor_.follow(output.phase, sequence_.done(), output.context);
    if (supervisor_.state() == StationState::Idle) end_check({});
    note(output, sample);
  }

  static void note(const SequenceOutput& output, Sample& sample) noexcept {
    sample.force_reference_N = output.force_reference_N;
    sample.trajectory_index = output.trajectory_index;
    sample.repeat = output.repeat;
    sample.trajectory = output.trajectory;
    sample.phase = output.phase;
  }

  static StartRefusal refusal(const StartTicket& ticket, std::uint64_t stops, std::uint64_t fault_changes,
                              std::int64_t now_ns) noexcept {
    if (ticket.stops < stops) return StartRefusal::Stopped;
    if (ticket.fault_changes != fault_changes) return StartRefusal::Fault;
    return now_ns - ticket.asked_ns > kStartLife_ns ? StartRefusal::TooLate : StartRefusal::None;
  }

  void start_if_requested(std::int64_t now_ns) noexcept {
    const CheckPlan* plan = requests_.plan.load(std::memory_order_acquire);
    if (plan == nullptr) return;
    const StartTicket ticket = requests_.ticket();
    const bool in_fault = supervisor_.state() == StationState::Fault;
    const StartRefusal why =
        in_fault ? StartRefusal::Fault : refusal(ticket, stops_taken_, fault_changes_, now_ns);
    if (why != StartRefusal::None) return refuse(why);
    // A stop that it has seen and this tick has not is taken first: the next tick starts it.
    if (supervisor_.state() != StationState::Idle || ticket.stops != stops_taken_) return;
    requests_.plan.store(nullptr, std::memory_order_release);
    plan_ = plan;
    armed_ns_ = now_ns;
    deadline_ns_ = static_cast<std::int64_t>(plan->deadline_s * 1e9);
    supervisor_.arm();
    lateness_.reset();
    status_.check_ticks.store(0, std::memory_order_relaxed);
    status_.check_skipped.store(0, std::memory_order_relaxed);
    status_.check_ring_drops.store(0, std::memory_order_relaxed);
    lost_samples_before_check_ = port_lost_samples_;
  }

  void refuse(StartRefusal why) noexcept {
    requests_.plan.store(nullptr, std::memory_order_release);
    end_check({why, supervisor_.fault(), supervisor_.fault_state()});
  }

  // The cause is taken here and now: a clear may follow before anybody looks.
  void end_check(const CheckEnd& end) noexcept {
    plan_ = nullptr;
    torque_Nm_ = velocity_rad_s_ = 0.0;
    status_.end_refusal.store(end.refusal, std::memory_order_relaxed);
    status_.end_fault.store(end.fault, std::memory_order_relaxed);
    status_.end_state.store(end.state, std::memory_order_relaxed);
    ++finished_;
  }

  void end_check_on_fault() noexcept {
    if (plan_ == nullptr || supervisor_.state() != StationState::Fault) return;
    sequence_.abandon();
    end_check({StartRefusal::None, supervisor_.fault(), supervisor_.fault_state()});
  }

  // The last word on what leaves the station: whatever happened above, nothing but a finite, limited torque
  // or speed of a running check passes.
  DriveCommand safe_command() noexcept {
    DriveCommand command{.enable = supervisor_.in_check()};
    if (plan_ != nullptr) command.commanded = plan_->commanded;
    if (supervisor_.sequence_runs()) {
      const double limit_Nm = std::max(0.0, std::min(settings_.torque_limit_Nm, plan_->torque_limit_Nm));
      const double limit_rad_s = settings_.speed_limit_rad_s;
      const double torque_Nm = std::clamp(torque_Nm_, -limit_Nm, limit_Nm);
      const double velocity_rad_s = std::clamp(velocity_rad_s_, -limit_rad_s, limit_rad_s);
      if (std::isfinite(torque_Nm + velocity_rad_s)) {
        command.torque_Nm = torque_Nm;
        command.velocity_rad_s = velocity_rad_s;
        return command;
      }
      supervisor_.raise(FaultCause::NonFinite);
      command.enable = false;
    }
    torque_Nm_ = velocity_rad_s_ = 0.0;
    return command;
  }

  void log(std::span<Sample* const> samples, double torque_command_Nm) noexcept {
    for (Sample* sample : samples) {
      // Of several samples in one tick only the last is answered: the command before still acted after the
      // others.
      sample->torque_command_Nm = sample == samples.back() ? torque_command_Nm : sent_torque_Nm_;
      if (!ring_.push(*sample)) {
        bump(status_.ring_drops, 1);
        if (plan_ != nullptr) bump(status_.check_ring_drops, 1);
      }
    }
    sent_torque_Nm_ = torque_command_Nm;
    if (!samples.empty()) {
      const Sample& last = *samples.back();
      status_.force_N.store(last.force_N, std::memory_order_relaxed);
      status_.velocity_rad_s.store(last.velocity_rad_s, std::memory_order_relaxed);
      status_.torque_Nm.store(last.torque_Nm, std::memory_order_relaxed);
      status_.phase.store(last.phase, std::memory_order_relaxed);
      status_.repeat.store(last.repeat, std::memory_order_relaxed);
    }
  }

  void publish(std::int64_t now_ns, std::int64_t lateness_ns, std::uint64_t skipped_periods) noexcept {
    status_.now_ns.store(now_ns, std::memory_order_relaxed);
    bump(status_.ticks, 1);
    bump(status_.skipped, skipped_periods);
    if (plan_ != nullptr) {
      lateness_.record(lateness_ns);
      bump(status_.check_ticks, 1);
      bump(status_.check_skipped, skipped_periods);
      status_.check_lost_samples.store(port_lost_samples_ - lost_samples_before_check_,
                                       std::memory_order_relaxed);
    }
    const bool in_fault = supervisor_.state() == StationState::Fault;
    if (!in_fault) {
      captured_ = false;
    } else if (!captured_) {
      captured_ = recorder_.capture();
    }
    end_check_on_fault();
    publish_state();
    if (interlocks_ != nullptr) interlocks_->beat({status_.ticks, supervisor_.state()});
  }

  void publish_state() noexcept {
    const bool in_fault = supervisor_.state() == StationState::Fault;
    // Outside of a fault nothing of it changes: the healthy tick saves these stores.
    if (in_fault || supervisor_.fault_time_ns() != status_.fault_time_ns.load(std::memory_order_relaxed) ||
        was_in_fault_)
      publish_fault(in_fault);
    status_.state.store(supervisor_.state(), std::memory_order_release);
    status_.checks_finished.store(finished_, std::memory_order_release);
    status_.stops.store(stops_taken_, std::memory_order_release);
  }

  void publish_fault(bool in_fault) noexcept {
    if (in_fault != was_in_fault_) ++fault_changes_;
    was_in_fault_ = in_fault;
    status_.fault.store(supervisor_.fault(), std::memory_order_relaxed);
    status_.fault_time_ns.store(supervisor_.fault_time_ns(), std::memory_order_relaxed);
    status_.fault_changes.store(fault_changes_, std::memory_order_release);
    status_.fault_state.store(supervisor_.fault_state(), std::memory_order_relaxed);
    status_.clearable.store(supervisor_.clearable(), std::memory_order_relaxed);
  }

  // With one writer a load and a store suffice.
  static void bump(std::atomic<std::uint64_t>& counter, std::uint64_t amount) noexcept {
    counter.store(counter.load(std::memory_order_relaxed) + amount, std::memory_order_relaxed);
  }

  BrakePort& port_;
  InterlockBoard* const interlocks_;
  const SupervisorSettings settings_;
  Supervisor supervisor_;
  Sequence sequence_;
  const CheckPlan* plan_ = nullptr;
  // What the sequence wants from the next sample on, of what the plan commands; held over an empty tick.
  double torque_Nm_ = 0.0;
  double velocity_rad_s_ = 0.0;
  double sent_torque_Nm_ = 0.0;  ///< what acts since the last tick
  std::uint64_t finished_ = 0;
  std::uint64_t stops_taken_ = 0;
  std::uint64_t fault_changes_ = 0;
  bool was_in_fault_ = false;
  std::int64_t armed_ns_ = 0;
  std::int64_t deadline_ns_ = 0;
  std::uint64_t port_lost_samples_ = 0;
  std::uint64_t lost_samples_before_check_ = 0;
  bool captured_ = false;
  std::array<BrakeFeedback, kReceiveCapacity> feedback_{};

  SampleRing ring_;
  FlightRecorder recorder_;
  DurationHistogram lateness_;
  StatusBoard status_;
  RequestBoard requests_;
  HealthBoard health_;
};

using ControlCore = BasicControlCore<CheckSequence>;
/// Compiled once, beside what it calls (rt/control_core.cpp).
extern template class BasicControlCore<CheckSequence>;

}  // namespace clampd::rt
