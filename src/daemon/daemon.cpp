#include "clampd/daemon/daemon.hpp"

#include <chrono>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "clampd/api/metrics.hpp"
#include "clampd/archive/json.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/base/version.hpp"
#include "clampd/line/line_statistics.hpp"
#include "clampd/line/master.hpp"
#include "clampd/views/check_table.hpp"
#include "clampd/views/line_statistics_view.hpp"
#include "clampd/views/retention_view.hpp"
#include "rt/policy.hpp"

namespace clampd::daemon {

using namespace std::chrono_literals;

namespace {

/// Beside the database, by port: two daemons may share a database, but never a port.
std::string journal_file(const StationConfiguration& configuration) {
  return fmt::format("{}.under-way-{}", configuration.database, configuration.control.port);
}

bench::Instant instant_now() {
  const auto utc = std::chrono::system_clock::now().time_since_epoch();
  return {monotonic_now_ns(), std::chrono::duration_cast<std::chrono::nanoseconds>(utc).count()};
}

}  // namespace

Daemon::Daemon(const bench::PreparedStation& station, can::SocketCanBus& bus, CheckStore& store,
               gpio::Panel* panel)
    : Daemon(station, bus, store, panel, &bus, nullptr) {}

Daemon::Daemon(const bench::PreparedStation& station, bench::SimulatedBench& bench, CheckStore& store)
    : Daemon(station, bench.bus(), store, nullptr, nullptr, &bench) {}

Daemon::Daemon(const bench::PreparedStation& station, can::FrameBus& bus, CheckStore& store,
               gpio::Panel* panel, can::SocketCanBus* socket, bench::SimulatedBench* bench)
    : station_(station),
      store_(store),
      panel_(panel),
      socket_(socket),
      port_(bus, station.codec),
      core_(port_, station.supervisor, rt::ControlCore::kRingCapacity, rt::kPolicy,
            panel == nullptr ? nullptr : &panel->board()),
      finer_grid_(core_, station.codec.commands_per_period, station.codec.command_cycle_ns()),
      journal_(journal_file(station.configuration)),
      conductor_(station, core_, &store, WorkerMode::Background) {
  if (bench != nullptr) simulated_loop_.emplace(*bench, core_);
  store_.queue_for(bench::publication_channels(station.configuration));
  conductor_.show_samples_to([this](const Sample& sample) { live_.take(sample); });
  conductor_.journal_in(journal_file(station.configuration));
  conductor_.finish_records_by([this](CheckRecord& record) { judge_master(record); });
  if (panel_ != nullptr)
    conductor_.explain_faults_by([panel](FaultCause cause) { return panel->explain(cause); });
}

Result<void> Daemon::start() {
  // Threads like any other: none of them is the loop's, and a check waits for none.
  publishing_.emplace(station_.configuration, [](const std::string& channel, const std::string& error) {
    if (error.empty())
      spdlog::info("publishing to {} works", channel);
    else
      spdlog::warn("publishing to {}: {}", channel, error);
  });
  if (panel_ != nullptr)
    if (Result<void> reading = panel_->start(); !reading) return reading;
  const RealtimeSettings& realtime = station_.configuration.realtime;
  rt::CyclicThreadSettings settings{realtime.priority, realtime.cpu, realtime.lock_memory};
  settings.period_ns = station_.codec.period_ns;
  if (simulated_loop_) return loop_.start(settings, *simulated_loop_);
  if (station_.codec.commands_per_period == 1) return loop_.start(settings, core_);
  settings.period_ns = station_.codec.command_cycle_ns();
  return loop_.start(settings, finer_grid_);
}

void Daemon::serve(const std::atomic<bool>& quit, const std::function<void()>& each_round) {
  {
    // Not before the port is this daemon's own: the journal belongs to whoever has it.
    const std::lock_guard lock(mutex_);
    recovery_ = conductor_.disk().post([this] { return journal_.recover(store_); });
    serving_ = true;
  }
  while (!quit) {
    pump();
    each_round();
    std::this_thread::sleep_for(5ms);
  }
  // The loop's last act zeroes the torque and ends a check; its record is saved before the daemon goes.
  loop_.stop();
  pump();
  while (conductor_.concluding() || conductor_.saving()) {
    std::this_thread::sleep_for(5ms);
    pump();
    each_round();
  }
  // It was tried again until now, and no station gave it as anything but an ERROR.
  if (const CheckRecord* lost = conductor_.unsaved())
    spdlog::critical(
        "the result of {}, {}, could not be saved until the end and is lost; check this brake again",
        lost->serial, to_string(lost->verdict));
}

std::string Daemon::headline() const {
  const StationState state = core_.status().state.load();
  const std::string& interface = station_.configuration.can.interface;
  if (state != StationState::Fault) return fmt::format("{} on {}", to_string(state), interface);
  const FaultCause fault = core_.status().fault.load();
  return fmt::format("FAULT {} on {}: {}", to_string(fault), interface, rt::fault_rule(fault).advice);
}

void Daemon::pump() {
  const std::lock_guard lock(mutex_);
  const bench::Instant now = instant_now();
  if (std::string set = clock_watch_.look(now); !set.empty()) {
    spdlog::warn("{}", set);
    clock_ = std::move(set);
  }
  if (std::optional<CheckRecord> record = conductor_.pump(now)) keep(std::move(*record));
  report_state_changes();
  watch_clamping();
  reopen_bus_if_gone();
  serve_panel();
  look_after_records();
}

void Daemon::keep(CheckRecord record) {
  spdlog::info("check {} of {}: {}. {}", record.id, record.serial, to_string(record.verdict), record.reason);
  if (record.tare_force_sd_N > 0.0) force_zero_N_ = record.tare_force_N;
  ++verdicts_.at(static_cast<std::size_t>(record.verdict));
  last_record_ = std::move(record);
  if (publishing_) publishing_->notify();
  records_due_ns_ = 0;
}

/// Force that stands while nothing drives: the brake holds it by itself, and nobody must reach in.
void Daemon::watch_clamping() {
  const bool driven = gpio::may_drive(core_.status().state.load());
  const double force_N = core_.status().force_N.load() - force_zero_N_;
  const double threshold_N = station_.configuration.check.contact_force_N * (clamped_ ? 0.5 : 1.0);
  clamped_ = !driven && force_N > threshold_N;
}

/// Retention, the master brake's age and what waits to be published: now and then, the first two never while
/// a check may need the store.
void Daemon::look_after_records() {
  constexpr std::int64_t kRecordsEvery_ns = 60 * kNanosecondsPerSecond;
  constexpr std::int64_t kOutboxesEvery_ns = kNanosecondsPerSecond / 2;
  if (bench::is_ready(recovery_)) {
    const auto recovered = recovery_.get();
    if (!recovered)
      spdlog::error("a check that the station did not finish: {}", recovered.error().message);
    else if (*recovered)
      spdlog::warn("check {} of {}: {}", (*recovered)->id, (*recovered)->serial, (*recovered)->reason);
    if (recovered && publishing_) publishing_->notify();
  }
  if (bench::is_ready(upkeep_)) {
    Upkeep done = upkeep_.get();
    channels_ = std::move(done.publishing);
    if (done.master) {
      std::string asks = asks_for_something(*done.master) ? done.master->text : "";
      if (!asks.empty() && asks != master_) spdlog::warn("{}", asks);
      master_ = std::move(asks);
    }
  }
  const bench::Instant now = instant_now();
  const bool thorough = now.steady_ns >= records_due_ns_ && !conductor_.busy();
  if (upkeep_.valid() || (!thorough && now.steady_ns < outboxes_due_ns_)) return;
  outboxes_due_ns_ = now.steady_ns + kOutboxesEvery_ns;
  if (thorough) records_due_ns_ = now.steady_ns + kRecordsEvery_ns;
  upkeep_ =
      conductor_.disk().post([this, thorough, utc_ns = now.utc_ns] { return upkeep(thorough, utc_ns); });
}

Daemon::Upkeep Daemon::upkeep(bool thorough, std::int64_t now_utc_ns) {
  constexpr std::size_t kChecksAtOnce = 5;  // so that no check waits long for them; more than a line makes
  Upkeep done;
  if (publishing_) done.publishing = publishing_->report(store_);
  if (!thorough) return done;
  if (const RetentionPolicy policy = bench::retention_policy(station_.configuration); !policy.keeps_all()) {
    const Result<RetentionSummary> removed = store_.apply_retention(policy, now_utc_ns, kChecksAtOnce);
    if (!removed)
      spdlog::warn("retention: {}", removed.error().message);
    else if (!removed->checks.empty())
      spdlog::info("retention: raw runs of {} checks removed, up to {}", removed->checks.size(),
                   removed->checks.back());
  }
  done.master = master_now(now_utc_ns);
  return done;
}

MasterReport Daemon::master_now(std::int64_t now_utc_ns) {
  Result<MasterReport> report = master_report(station_.configuration.master, store_, now_utc_ns);
  if (report) return std::move(*report);
  MasterReport unknown;
  unknown.state = MasterState::Due;
  unknown.text = report.error().message;
  return unknown;
}

/// A check of the master brake judges the station: no PASS is shown where its certified values are not found.
void Daemon::judge_master(CheckRecord& record) {
  const MasterSettings& master = station_.configuration.master;
  if (master.serial.empty() || record.serial != master.serial || !is_about_the_brake(record.verdict)) return;
  const MasterReport report = master_now(instant_now().utc_ns);
  if (!asks_for_something(report)) return;
  record.verdict = Verdict::Error;
  record.marginal = false;
  record.reason = report.text;
}

void Daemon::serve_panel() {
  if (panel_ == nullptr) return;
  panel_->show({conductor_.concluding(),
                last_record_ ? std::optional<Verdict>(last_record_->verdict) : std::nullopt, clamped_});
  const auto press = panel_->take_start_press(monotonic_now_ns());
  if (!press) return;
  const Result<api::StartedCheck> begun = begin_pressed(*press);
  if (begun) {
    next_.reset();
    notice_.clear();
  } else {
    notice_ = "start button: " + begun.error().message;
    spdlog::warn("{}", notice_);
  }
}

Result<api::StartedCheck> Daemon::begin_pressed(const gpio::StartPress::Press& press) {
  if (const Result<void> ready = may_move(); !ready) return tl::unexpected(ready.error());
  const std::optional<rt::StartTicket> ticket = core_.ticket_of(press.stamp_ns);
  if (press.blocked || !ticket)
    return failure("a stop, a fault or an interlock came after it was pressed; press it again");
  if (!next_)
    return failure(
        "no serial number is known: enter or scan one (`clampctl next --serial`), then press start");
  return begin(*next_, *ticket);
}

std::string Daemon::fault_text(FaultCause fault) const {
  std::string text(rt::fault_rule(fault).advice);
  const std::string detail = panel_ == nullptr ? "" : panel_->explain(fault);
  if (!detail.empty()) text += " " + detail;
  return text;
}

void Daemon::report_state_changes() {
  if (const std::uint64_t stops = core_.status().stops.load(); stops != reported_stops_) {
    reported_stops_ = stops;
    spdlog::warn("operator stop");
  }
  if (const bench::Opening& opening = conductor_.opening();
      !opening.under_way && opening.id != reported_opening_) {
    reported_opening_ = opening.id;
    spdlog::info("opening: {}", opening.reason);
  }
  const StationState state = core_.status().state.load();
  if (state == reported_state_) return;
  reported_state_ = state;
  if (state == StationState::Fault) {
    const FaultCause fault = core_.status().fault.load();
    spdlog::error("FAULT {}: {}", to_string(fault), fault_text(fault));
    if (fault == FaultCause::EmergencyStop && panel_ != nullptr && panel_->emergency_stop_opened_ns() > 0)
      spdlog::info(
          "the tick that stopped came {:.3f} ms after the contact opened",
          static_cast<double>(core_.status().fault_time_ns.load() - panel_->emergency_stop_opened_ns()) *
              1e-6);
  } else {
    spdlog::info("station is {}", to_string(state));
  }
}

void Daemon::reopen_bus_if_gone() {
  if (socket_ == nullptr || core_.health().link != LinkState::Gone) return;
  if (socket_->reopen()) spdlog::info("interface {} is back", station_.configuration.can.interface);
}

api::StationStatus Daemon::status() {
  const std::lock_guard lock(mutex_);
  const rt::StatusBoard& board = core_.status();
  const rt::HistogramSnapshot lateness = loop_.statistics().lateness.snapshot();
  const PortHealth health = core_.health();
  api::StationStatus status;
  status.station = station_.configuration.name;
  status.version = std::string(kVersion);
  // IDLE says that a check may be started, which is not so before serve().
  const StationState state = board.state.load();
  status.state =
      std::string(to_string(state == StationState::Idle && !serving_ ? StationState::Init : state));
  const FaultCause fault = board.fault.load();
  status.fault = std::string(to_string(fault));
  if (fault != FaultCause::None) {
    status.fault_text = fault_text(fault);
    status.fault_state = std::string(to_string(board.fault_state.load()));
  }
  status.clearable = board.clearable.load();
  status.phase = std::string(to_string(board.phase.load()));
  status.repeat = board.repeat.load();
  status.repeats = conductor_.progress().repeats;
  status.repeats_auto = conductor_.progress().repeats_auto;
  status.serial = conductor_.serial();
  status.part_number = conductor_.part_number();
  for (const bench::PreparedRecipe& known : station_.recipes)
    status.part_numbers.push_back(known.recipe.part_number);
  status.check = check_number_;
  status.id = conductor_.id();
  status.judging = conductor_.concluding();
  status.cause_searched = conductor_.progress().cause_searched;
  if (last_record_) status.last_verdict = std::string(to_string(last_record_->verdict));
  status.ticks = board.ticks.load();
  // Of a finer grid, the points between two ticks, too.
  status.skipped = station_.codec.commands_per_period > 1 && !simulated_loop_
                       ? loop_.statistics().skipped.load()
                       : board.skipped.load();
  status.lateness_avg_us = lateness.avg_us;
  status.lateness_max_us = lateness.max_us;
  status.force_N = board.force_N.load();
  status.velocity_rad_s = board.velocity_rad_s.load();
  status.torque_Nm = board.torque_Nm.load();
  status.clamped = clamped_;
  if (clamped_) status.clamped_N = status.force_N - force_zero_N_;
  const bench::Opening& opening = conductor_.opening();
  status.open_id = opening.id;
  status.opening = opening.under_way;
  if (!opening.id.empty() && !opening.under_way) {
    status.open_result = opening.verdict == Verdict::Pass ? "OPEN" : std::string(to_string(opening.verdict));
    status.open_reason = opening.reason;
  }
  // In this order: a stop that comes in between is not yet taken.
  status.stops_taken = board.stops.load();
  status.stops = core_.requests().stops.load();
  status.interface = station_.configuration.can.interface;
  status.link = std::string(to_string(health.link));
  if (status.ticks > 0)
    status.bus_load = static_cast<double>(health.bus_bits) /
                      (static_cast<double>(station_.configuration.can.bitrate) *
                       static_cast<double>(status.ticks) * station_.configuration.can.period_s());
  status.simulated = station_.configuration.simulated_brake;
  status.realtime = station_.configuration.realtime.priority > 0;
  if (next_) status.next_serial = next_->serial;
  status.notice = notice_;
  if (panel_ != nullptr)
    for (gpio::LineReport& line : panel_->report())
      status.panel.push_back({std::move(line.line), std::move(line.role), std::move(line.state)});
  status.master = master_.value_or("");
  status.storage = conductor_.storage_problem();
  status.clock = clock_;
  for (const bench::ChannelReport& channel : channels_)
    status.publishing.push_back({channel.channel, channel.where, channel.connected, channel.pending,
                                 channel.oldest_age_s, channel.error});
  return status;
}

std::string Daemon::metrics() {
  const api::StationStatus now = status();
  api::StationCounts counts{{}, core_.health(), loop_.statistics().lateness.snapshot()};
  {
    const std::lock_guard lock(mutex_);
    counts.verdicts = verdicts_;
  }
  return api::station_metrics(now, counts);
}

namespace {

/// The ticket of whoever has seen so many stops.
Result<rt::StartTicket> ticket_of(rt::StartTicket ticket, std::optional<std::uint64_t> stops_seen) {
  if (stops_seen && *stops_seen > ticket.stops)
    return failure("the station was restarted since its state was looked at; look again");
  if (stops_seen) ticket.stops = *stops_seen;
  return ticket;
}

}  // namespace

rt::StartTicket Daemon::ticket() const {
  return core_.ticket();
}

Result<api::StartedCheck> Daemon::start(const CheckRequest& request, const rt::StartTicket& ticket,
                                        std::optional<std::uint64_t> stops_seen) {
  const Result<rt::StartTicket> asked = ticket_of(ticket, stops_seen);
  if (!asked) return tl::unexpected(asked.error());
  const std::lock_guard lock(mutex_);
  return begin(request, *asked);
}

Result<std::string> Daemon::open(const rt::StartTicket& ticket, std::optional<std::uint64_t> stops_seen) {
  const Result<rt::StartTicket> asked = ticket_of(ticket, stops_seen);
  if (!asked) return tl::unexpected(asked.error());
  const std::lock_guard lock(mutex_);
  return may_move().and_then([&] { return conductor_.open(*asked, instant_now()); }).map([&] {
    spdlog::info("the brake is opened");
    return conductor_.opening().id;
  });
}

Result<void> Daemon::next(const CheckRequest& request) {
  if (Result<void> valid = validate(request); !valid) return valid;
  const std::lock_guard lock(mutex_);
  // Whoever scans hears at once what the start button would refuse.
  if (const auto chosen = bench::choose_check(station_, normalised(request)); !chosen)
    return tl::unexpected(chosen.error());
  next_ = normalised(request);
  notice_.clear();
  spdlog::info("next is {}", next_->serial);
  return {};
}

Result<void> Daemon::may_move() const {
  if (!serving_) return failure("the station is still starting; try again");
  if (panel_ != nullptr && core_.status().state.load() == StationState::Idle &&
      panel_->board().read(monotonic_now_ns()).fixture_open)
    return failure(
        fmt::format("the fixture is open: close it ({})", panel_->name(gpio::LineRole::FixtureClosed)));
  return {};
}

Result<api::StartedCheck> Daemon::begin(const CheckRequest& request, const rt::StartTicket& ticket) {
  if (const Result<void> ready = may_move(); !ready) return tl::unexpected(ready.error());
  const MasterSettings& master = station_.configuration.master;
  if (master.required && request.serial != master.serial && (!master_ || !master_->empty()))
    return failure(master_.value_or("the state of the master brake is not known yet; try again"));
  if (const Result<void> begun = conductor_.begin(request, ticket, instant_now()); !begun)
    return tl::unexpected(begun.error());
  last_record_.reset();
  clock_.clear();
  const std::string& part = conductor_.part_number();
  spdlog::info("check {} of {}{} begins", conductor_.id(), request.serial,
               part.empty() ? "" : ", part number " + part);
  return api::StartedCheck{++check_number_, conductor_.id()};
}

api::CheckProgress Daemon::progress(bool colour) {
  const std::lock_guard lock(mutex_);
  api::CheckProgress progress;
  progress.check = check_number_;
  progress.id = conductor_.id();
  progress.finished = last_record_.has_value();
  progress.phase = std::string(to_string(core_.status().phase.load()));
  progress.repeat = core_.status().repeat.load();
  progress.repeats = conductor_.progress().repeats;
  progress.repeats_auto = conductor_.progress().repeats_auto;
  if (last_record_) {
    progress.record = check_json(*last_record_);
    progress.table = format_check(*last_record_, colour);
  }
  return progress;
}

Result<void> Daemon::stop() {
  core_.requests().stop(monotonic_now_ns());
  return {};
}

Result<void> Daemon::clear() {
  const rt::StatusBoard& board = core_.status();
  if (board.state.load() != StationState::Fault) return {};
  const rt::FaultRule& rule = rt::fault_rule(board.fault.load());
  if (!board.clearable.load())
    return failure(fmt::format("the fault cannot be cleared yet, its cause is still there ({}): {}",
                               to_string(rule.cause), fault_text(rule.cause)));
  core_.requests().clear.store(true, std::memory_order_release);
  for (int waited_ms = 0; waited_ms < 100; ++waited_ms) {
    if (board.state.load() != StationState::Fault) {
      spdlog::info("operator cleared {}", to_string(rule.cause));
      return {};
    }
    std::this_thread::sleep_for(1ms);
  }
  return failure(fmt::format("the fault came back at once ({}): {}", to_string(board.fault.load()),
                             fault_text(board.fault.load())));
}

// What reads the archive opens the store a second time, so that it holds up neither a check nor a status.

Result<CheckStore> Daemon::archive() const {
  return CheckStore::open(station_.configuration.database, CheckStore::Access::ReadOnly);
}

Result<nlohmann::ordered_json> Daemon::results(const CheckFilter& filter) {
  return archive()
      .and_then([&](const CheckStore& store) { return store.list(filter); })
      .map([](const std::vector<CheckSummary>& checks) { return summaries_json(checks); });
}

Result<nlohmann::ordered_json> Daemon::result(const std::string& id) {
  return archive()
      .and_then([&](const CheckStore& store) { return store.load(id); })
      .map([](const CheckRecord& record) { return check_json(record); });
}

Result<nlohmann::ordered_json> Daemon::run(const std::string& id, std::size_t number) {
  const Result<CheckRecord> record =
      archive().and_then([&](const CheckStore& store) { return store.load(id); });
  if (!record) return tl::unexpected(record.error());
  if (number >= record->runs.size())
    return failure(fmt::format("check {} has {} runs", record->id, record->runs.size()));
  const Run& run = record->runs[number].run;
  return nlohmann::ordered_json{{"run", number},
                                {"trajectory", record->runs[number].trajectory},
                                {"time_s", run.time_s},
                                {"force_N", run.force_N},
                                {"velocity_rad_s", run.velocity_rad_s},
                                {"torque_Nm", run.torque_Nm}};
}

Result<nlohmann::ordered_json> Daemon::statistics(const CheckFilter& filter) {
  return archive()
      .and_then([&](const CheckStore& store) { return store.load_results(filter); })
      .map([&](std::vector<CheckRecord> checks) {
        return statistics_json(line_statistics(std::move(checks), station_.configuration.master.serial));
      });
}

namespace {

nlohmann::ordered_json reference_json(const Reference& reference, double period_s) {
  nlohmann::ordered_json force = nlohmann::ordered_json::array();
  nlohmann::ordered_json velocity = force;
  nlohmann::ordered_json torque = force;
  for (const ReferenceRow& row : reference.rows) {
    force.push_back(row.force_N);
    velocity.push_back(row.velocity_rad_s);
    torque.push_back(row.torque_Nm);
  }
  return {{"period_s", period_s},
          {"force_N", std::move(force)},
          {"velocity_rad_s", std::move(velocity)},
          {"torque_Nm", std::move(torque)}};
}

}  // namespace

nlohmann::ordered_json Daemon::reference() {
  const std::lock_guard lock(mutex_);
  const rt::CheckPlan& plan = conductor_.plan();
  nlohmann::ordered_json document = reference_json(plan.reference, plan.drive.period_s);
  document["further"] = nlohmann::ordered_json::array();
  for (const Reference& further : plan.further)
    document["further"].push_back(reference_json(further, plan.drive.period_s));
  return document;
}

nlohmann::ordered_json Daemon::live(std::uint64_t run, std::size_t row) {
  return live_.since(run, row);
}

}  // namespace clampd::daemon
