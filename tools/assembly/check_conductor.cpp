#include "tools/assembly/check_conductor.hpp"

#include <chrono>
#include <future>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/base/version.hpp"
#include "clampd/identify/method.hpp"
#include "rt/policy.hpp"

namespace clampd::assembly {

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

}  // namespace

CheckConductor::CheckConductor(const PreparedStation& station, rt::ControlCore& core, CheckStore* store,
                               WorkerMode mode)
    : station_(station), core_(core), store_(store), mode_(mode), plan_(station.plan) {}

CheckConductor::~CheckConductor() = default;

Result<void> CheckConductor::begin(const CheckRequest& request, Instant now) {
  if (const Result<void> valid = validate(request); !valid) return valid;
  if (busy())
    return failure(
        fmt::format("a check of {} is under way; wait for it or stop it with `clampctl stop`", serial_));
  if (unsaved_) return failure(storage_problem_);
  const StationState state = core_.status().state.load();
  if (state == StationState::Fault) {
    const rt::FaultRule& rule = rt::fault_rule(core_.status().fault.load());
    return failure(fmt::format("the station is in FAULT ({}): {} Clear it with `clampctl clear`",
                               to_string(rule.cause), rule.advice));
  }
  if (state != StationState::Idle)
    return failure(fmt::format("the station is not ready: it is in {}", to_string(state)));

  Sample before;
  while (core_.ring().pop(before)) off_.consume(before);
  if (request.repeats > 0)
    plan_.repeats = static_cast<std::uint16_t>(request.repeats);
  else
    plan_.repeats = station_.plan.repeats;
  CheckContext context;
  context.trajectory_rows = plan_.reference.rows.size();
  context.trajectory_sha256 = station_.trajectory_sha256;
  context.software_version = std::string(kVersion);
  context.started_utc_ns = now.utc_ns;
  const Run off = off_.run();
  context.torque_while_off = torque_while_off(std::span(&off, 1));
  session_ = std::make_unique<CheckSession>(
      station_.configuration, station_.limits, request, context,
      station_.model ? estimator_of(*station_.model) : estimator_of(station_.configuration.check.method),
      mode_);
  serial_ = request.serial;
  started_steady_ns_ = now.steady_ns;
  deadline_passed_ = false;
  health_before_ = core_.health();
  finished_before_ = core_.status().checks_finished.load();
  core_.requests().plan.store(&plan_, std::memory_order_release);
  return {};
}

std::optional<CheckRecord> CheckConductor::pump(Instant now) {
  if (concluding()) {
    Sample idle;
    while (core_.ring().pop(idle)) off_.consume(idle);
    if (conclusion_.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return std::nullopt;
    return keep(conclusion_.get(), now);
  }
  if (unsaved_ && now.steady_ns >= save_again_ns_) return keep(*std::exchange(unsaved_, std::nullopt), now);
  // Read before the ring is emptied: what belongs to a finished check is in the ring by then.
  const bool finished =
      busy() && core_.status().checks_finished.load(std::memory_order_acquire) != finished_before_;
  Sample sample;
  while (core_.ring().pop(sample)) {
    off_.consume(sample);
    if (busy() && sample.phase != CheckPhase::None) {
      session_->consume(sample);
      if (watcher_) watcher_(sample);
    }
  }
  if (finished) {
    if (mode_ == WorkerMode::Synchronous) return keep(session_->finish(outcome_at(now)), now);
    conclusion_ =
        std::async(std::launch::async, [session = session_.get(), outcome = outcome_at(now)]() mutable {
          return session->finish(std::move(outcome));
        });
    return std::nullopt;
  }
  if (busy() && !deadline_passed_ &&
      static_cast<double>(now.steady_ns - started_steady_ns_) >
          station_.configuration.check.deadline_s * 1e9) {
    deadline_passed_ = true;
    core_.requests().stop.store(true, std::memory_order_release);
  }
  return std::nullopt;
}

CheckSession::Progress CheckConductor::progress() const {
  return busy() ? session_->progress() : CheckSession::Progress{};
}

CheckOutcome CheckConductor::outcome_at(Instant now) {
  const rt::StatusBoard& status = core_.status();
  const rt::HistogramSnapshot lateness = core_.lateness().snapshot();
  CheckOutcome outcome;
  outcome.deadline_passed = deadline_passed_;
  outcome.stopped_utc_ns = now.utc_ns;
  if (status.state.load() == StationState::Fault) {
    outcome.fault = status.fault.load();
    const rt::FaultRule& rule = rt::fault_rule(outcome.fault);
    outcome.fault_verdict = rule.verdict;
    outcome.fault_text = std::string(rule.advice);
    if (const std::string detail = explain_ ? explain_(outcome.fault) : ""; !detail.empty())
      outcome.fault_text += " " + detail;
    // Silence is noticed before the kernel says why: whoever reads the record wants to know.
    if (const LinkState link = core_.health().link; link != LinkState::Up)
      outcome.fault_text +=
          fmt::format(" The CAN interface {} is {}.", station_.configuration.can.interface, to_string(link));
    outcome.flight_recorder = core_.flight_recorder().last_capture();
  }
  outcome.health = difference(core_.health(), health_before_);
  TimingRecord& timing = outcome.timing;
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
                      (static_cast<double>(station_.configuration.can.bitrate) * periods * kPeriod_s);
  return outcome;
}

Result<void> CheckConductor::save(const CheckRecord& record) {
  const LimitSet& limits = station_.limits;
  return store_
      ->save_limits({limits.sha256, limits.revision, limits.author, limits.changed, limits.file,
                     limits.contents, record.started})
      .and_then([&] { return store_->save(record); });
}

std::optional<CheckRecord> CheckConductor::keep(CheckRecord record, Instant now) {
  session_.reset();
  const Result<void> saved = store_ == nullptr ? Result<void>() : save(record);
  if (saved) {
    storage_problem_.clear();
    return record;
  }
  // A result that is not on record must not release a brake.
  if (mode_ == WorkerMode::Synchronous) {  // for whom nobody would try again
    record.verdict = Verdict::Error;
    record.reason = "the result could not be saved: " + saved.error().message;
    return record;
  }
  save_again_ns_ = now.steady_ns + kNanosecondsPerSecond;
  const bool known = !storage_problem_.empty();
  storage_problem_ = fmt::format(
      "the result of {} could not be saved: {}. The station keeps it and tries again every second; until "
      "then no brake is checked",
      record.serial, saved.error().message);
  unsaved_ = std::move(record);
  if (known) return std::nullopt;
  CheckRecord shown = *unsaved_;
  shown.reason = fmt::format("Judged {}, but {}.", to_string(shown.verdict), storage_problem_);
  shown.verdict = Verdict::Error;
  return shown;
}

}  // namespace clampd::assembly
