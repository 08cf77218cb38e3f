#include "clampd/bench/check_conductor.hpp"

#include <algorithm>
#include <cctype>
#include <future>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/base/version.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/record/utc.hpp"
#include "rt/policy.hpp"

namespace clampd::bench {

namespace {

PortHealth difference(const PortHealth& now, const PortHealth& before) {
  PortHealth counts = now;
  counts.frames_received -= before.frames_received;
  counts.frames_sent -= before.frames_sent;
  counts.send_failures -= before.send_failures;
  counts.crc_errors -= before.crc_errors;
  counts.counter_errors -= before.counter_errors;
  counts.lost_samples -= before.lost_samples;
  counts.implausible -= before.implausible;
  counts.error_frames -= before.error_frames;
  counts.bus_off_events -= before.bus_off_events;
  counts.receive_overflows -= before.receive_overflows;
  counts.bus_bits -= before.bus_bits;
  return counts;
}

/// A disk that takes longer to save is worth a word.
constexpr std::int64_t kSlowSave_ns = 3 * kNanosecondsPerSecond;

std::string_view refusal_words(rt::StartRefusal refusal) {
  switch (refusal) {
    case rt::StartRefusal::None:
      return "";
    case rt::StartRefusal::Stopped:
      return "a stop came after the start was asked for, so that nothing moved; start it again if the brake "
             "shall move";
    case rt::StartRefusal::Fault:
      return "the station was in FAULT after the start was asked for, so that nothing moved; start it again";
    case rt::StartRefusal::TooLate:
      return "the start waited for more than 300 ms, so that nothing moved; start it again";
  }
  return "";
}

std::string as_sentence(std::string_view text) {
  std::string whole(text);
  whole.front() = static_cast<char>(std::toupper(static_cast<unsigned char>(whole.front())));
  return whole + ".";
}

/// The configured time is for the configured repeats: more of them have as much more.
double deadline_of(const PreparedCheck& check, std::uint32_t repeats) {
  return check.configuration.check.deadline_s *
         std::max(1.0, static_cast<double>(repeats) / static_cast<double>(check.plan.repeats));
}

}  // namespace

CheckConductor::CheckConductor(const PreparedStation& station, rt::ControlCore& core, CheckStore* store,
                               WorkerMode mode)
    : station_(station), core_(core), store_(store), mode_(mode), plan_(station.plan), check_(&station) {}

CheckConductor::~CheckConductor() = default;

Result<void> CheckConductor::may_start(const rt::StartTicket& ticket) const {
  if (opening_.under_way) return failure("the brake is being opened; wait for it or stop it");
  if (busy())
    return failure(
        fmt::format("a check of {} is under way; wait for it or stop it with `clampctl stop`", serial_));
  const StationState state = core_.status().state.load();
  if (state == StationState::Fault) {
    const rt::FaultRule& rule = rt::fault_rule(core_.status().fault.load());
    return failure(fmt::format("the station is in FAULT ({}): {} Clear it with `clampctl clear`",
                               to_string(rule.cause), rule.advice));
  }
  if (state != StationState::Idle)
    return failure(fmt::format("the station is not ready: it is in {}", to_string(state)));
  if (const rt::StartRefusal refusal = core_.refusal(ticket); refusal != rt::StartRefusal::None)
    return failure(std::string(refusal_words(refusal)));
  return {};
}

void CheckConductor::hand_over(const rt::StartTicket& ticket) {
  health_before_ = core_.health();
  finished_before_ = core_.status().checks_finished.load();
  core_.requests().start(plan_, ticket);
}

Result<void> CheckConductor::begin(const CheckRequest& request, const rt::StartTicket& ticket, Instant now) {
  if (const Result<void> valid = validate(request); !valid) return valid;
  if (!busy() && unsaved_) return failure(storage_problem_);
  const Result<ChosenCheck> chosen = choose_check(station_, normalised(request));
  if (!chosen) return tl::unexpected(chosen.error());
  if (const Result<void> ready = may_start(ticket); !ready) return ready;

  take_samples();
  check_ = chosen->check;
  plan_ = check_->plan;
  plan_.repeats = static_cast<std::uint16_t>(planned_repeats(request, check_->configuration.check).most);
  plan_.deadline_s = deadline_of(*check_, plan_.repeats);
  CheckContext context;
  context.trajectory_rows = plan_.reference.rows.size();
  context.trajectory_sha256 = check_->trajectory_sha256;
  context.trajectories = check_->trajectories;
  context.trajectories_sha256 = check_->trajectories_sha256;
  context.software_version = std::string(kVersion);
  context.started_utc_ns = now.utc_ns;
  context.sheet = check_->sheet;
  context.recipe = chosen->recipe;
  const Run off = off_.run();
  context.torque_while_off = torque_while_off(std::span(&off, 1));
  session_ = std::make_unique<CheckSession>(
      check_->configuration, check_->limits, request, context,
      check_->model ? estimator_of(*check_->model) : estimator_of(check_->configuration.check.method),
      mode_);
  session_->watch_search(search_);
  diagnosis_.reset();
  serial_ = normalised(request).serial;
  part_number_ = session_->head().part_number;
  id_ = session_->head().id;
  // The brake does not wait for the disk: at worst a kill within the first milliseconds leaves no trace. A
  // disk that refuses this will refuse the record too, and that is said.
  if (journal_) disk_.post([journal = *journal_, head = session_->head()] { return journal.begin(head); });
  hand_over(ticket);
  return {};
}

Result<void> CheckConductor::open(const rt::StartTicket& ticket, Instant now) {
  if (const Result<void> ready = may_start(ticket); !ready) return ready;
  take_samples();
  plan_.open_only = true;
  plan_.deadline_s = station_.configuration.check.deadline_s;
  opening_ = {make_record_id(now.utc_ns), true, Verdict::Error, ""};
  hand_over(ticket);
  return {};
}

/// What the looks at the runs so far ask of the ones to come.
void CheckConductor::advise_loop() {
  const std::uint64_t check = finished_before_ + 1;
  rt::RequestBoard& requests = core_.requests();
  requests.next_trajectory.store(check * rt::RequestBoard::kTrajectories + session_->next_trajectory(),
                                 std::memory_order_relaxed);
  if (session_->has_enough()) requests.enough_runs_in.store(check, std::memory_order_relaxed);
}

void CheckConductor::take_samples() {
  const bool recording = session_ != nullptr && !concluding();
  Sample sample;
  while (core_.ring().pop(sample)) {
    off_.consume(sample);
    if (!recording || sample.phase == CheckPhase::None) continue;
    session_->consume(sample);
    if (watcher_) watcher_(sample);
  }
}

std::optional<CheckRecord> CheckConductor::pump(Instant now) {
  // Read before the ring is emptied: what belongs to a finished check is in the ring by then.
  const bool finished = busy() && !concluding() &&
                        core_.status().checks_finished.load(std::memory_order_acquire) != finished_before_;
  take_samples();
  if (session_) advise_loop();
  if (finished && opening_.under_way) {
    end_opening(outcome_at(now));
  } else if (finished && mode_ == WorkerMode::Synchronous) {
    return keep(session_->finish(outcome_at(now)), now);
  } else if (finished) {
    conclusion_ =
        std::async(std::launch::async, [session = session_.get(), outcome = outcome_at(now)]() mutable {
          return session->finish(std::move(outcome));
        });
  } else if (is_ready(conclusion_)) {
    return keep(conclusion_.get(), now);
  } else if (is_ready(saving_)) {
    return after_saving(saving_.get(), now);
  } else if (saving_.valid() && now.steady_ns - saving_since_ns_ > kSlowSave_ns && storage_problem_.empty()) {
    storage_problem_ = fmt::format(
        "the result of {} is still being saved: the disk of the station's database is slow or stands still",
        unsaved_->serial);
  } else if (unsaved_ && !saving_.valid() && now.steady_ns >= save_again_ns_) {
    save_beside(now);
  }
  return std::nullopt;
}

CheckSession::Progress CheckConductor::progress() const {
  return session_ ? session_->progress() : CheckSession::Progress{};
}

CheckOutcome CheckConductor::outcome_at(Instant now) {
  const rt::StatusBoard& status = core_.status();
  const rt::CheckEnd end{status.end_refusal.load(), status.end_fault.load(), status.end_state.load()};
  const rt::HistogramSnapshot lateness = core_.lateness().snapshot();
  CheckOutcome outcome;
  outcome.stopped_utc_ns = now.utc_ns;
  explain_fault(outcome, end);
  outcome.health = difference(core_.health(), health_before_);
  TimingRecord& timing = outcome.timing;
  if (end.refusal != rt::StartRefusal::None) return outcome;  // the counts are those of the check before
  timing.ticks = status.check_ticks.load();
  timing.skipped = status.check_skipped.load();
  timing.lost_samples = status.check_ring_drops.load();
  timing.lateness_min_us = lateness.min_us;
  timing.lateness_avg_us = lateness.avg_us;
  timing.lateness_max_us = lateness.max_us;
  timing.lateness_histogram = lateness.bins;
  const double periods = static_cast<double>(timing.ticks + timing.skipped);
  if (periods > 0.0)
    timing.bus_load = static_cast<double>(outcome.health.bus_bits) /
                      (static_cast<double>(station_.configuration.can.bitrate) * periods *
                       station_.configuration.can.period_s());
  return outcome;
}

void CheckConductor::explain_fault(CheckOutcome& outcome, const rt::CheckEnd& end) const {
  if (end.refusal == rt::StartRefusal::Stopped) {
    outcome.fault = FaultCause::OperatorStop;
    outcome.fault_verdict = Verdict::Aborted;
    outcome.fault_text = as_sentence(refusal_words(end.refusal));
    return;
  }
  outcome.fault = end.fault;
  if (end.fault == FaultCause::None) {
    if (end.refusal != rt::StartRefusal::None) outcome.refusal = as_sentence(refusal_words(end.refusal));
    return;
  }
  const rt::FaultRule& rule = rt::fault_rule(end.fault);
  outcome.fault_verdict = rule.verdict;
  outcome.fault_text = std::string(rule.advice);
  if (const std::string detail = explain_ ? explain_(end.fault) : ""; !detail.empty())
    outcome.fault_text += " " + detail;
  // Silence is noticed before the kernel says why: whoever reads the record wants to know.
  if (const LinkState link = core_.health().link; link != LinkState::Up)
    outcome.fault_text +=
        fmt::format(" The CAN interface {} is {}.", station_.configuration.can.interface, to_string(link));
  outcome.flight_recorder = core_.flight_recorder().last_capture();
}

void CheckConductor::end_opening(const CheckOutcome& outcome) {
  opening_.under_way = false;
  const bool opened = outcome.fault == FaultCause::None && outcome.refusal.empty();
  opening_.verdict =
      opened ? Verdict::Pass : (outcome.refusal.empty() ? outcome.fault_verdict : Verdict::Error);
  opening_.reason = opened ? "The brake is open." : outcome.fault_text + outcome.refusal;
}

Result<void> CheckConductor::save(CheckRecord& record) const {
  if (store_ == nullptr) return {};
  const LimitSet& limits = check_->limits;
  return store_
      ->save_limits({limits.sha256, limits.revision, limits.author, limits.changed, limits.file,
                     limits.contents, record.started})
      .and_then([&] { return store_->save(record); })
      .map([&] {
        if (journal_) journal_->end();  // what stays there is found to be on record
        if (finish_) finish_(record);
      });
}

std::optional<CheckRecord> CheckConductor::keep(CheckRecord record, Instant now) {
  unsaved_ = std::make_shared<CheckRecord>(std::move(record));
  if (mode_ == WorkerMode::Background) {
    save_beside(now);
    return std::nullopt;
  }
  // Nobody would try again.
  if (session_) diagnosis_ = session_->take_diagnosis();
  session_.reset();
  const std::shared_ptr<CheckRecord> kept = std::exchange(unsaved_, nullptr);
  if (const Result<void> saved = save(*kept); !saved) {
    kept->verdict = Verdict::Error;
    kept->reason = "the result could not be saved: " + saved.error().message;
  }
  return std::move(*kept);
}

void CheckConductor::save_beside(Instant now) {
  saving_since_ns_ = now.steady_ns;
  saving_ = disk_.post([this, record = unsaved_] { return save(*record); });
}

std::optional<CheckRecord> CheckConductor::after_saving(const Result<void>& saved, Instant now) {
  if (session_) diagnosis_ = session_->take_diagnosis();
  session_.reset();
  if (saved) {
    storage_problem_.clear();
    shown_unsaved_ = false;
    return std::move(*std::exchange(unsaved_, nullptr));
  }
  save_again_ns_ = now.steady_ns + kNanosecondsPerSecond;
  storage_problem_ = fmt::format(
      "the result of {} could not be saved: {}. The station keeps it and tries again every second; until "
      "then no brake is checked",
      unsaved_->serial, saved.error().message);
  if (std::exchange(shown_unsaved_, true)) return std::nullopt;
  // A result that is not on record must not release a brake.
  CheckRecord shown = *unsaved_;
  shown.reason = fmt::format("Judged {}, but {}.", to_string(shown.verdict), storage_problem_);
  shown.verdict = Verdict::Error;
  return shown;
}

}  // namespace clampd::bench
