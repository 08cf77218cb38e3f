#include "tools/clampd/daemon.hpp"

#include <chrono>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "clampd/archive/json.hpp"
#include "clampd/archive/table.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/base/version.hpp"
#include "rt/policy.hpp"
#include "tools/records/line_statistics.hpp"
#include "tools/records/master.hpp"
#include "tools/records/retention.hpp"

namespace clampd::daemon {

using namespace std::chrono_literals;

namespace {

assembly::Instant instant_now() {
  const auto utc = std::chrono::system_clock::now().time_since_epoch();
  return {monotonic_now_ns(), std::chrono::duration_cast<std::chrono::nanoseconds>(utc).count()};
}

}  // namespace

Daemon::Daemon(const assembly::PreparedStation& station, can::SocketCanBus& bus, CheckStore& store,
               gpio::Panel* panel)
    : Daemon(station, bus, store, panel, &bus, nullptr) {}

Daemon::Daemon(const assembly::PreparedStation& station, assembly::SimulatedBench& bench, CheckStore& store)
    : Daemon(station, bench.bus(), store, nullptr, nullptr, &bench) {}

Daemon::Daemon(const assembly::PreparedStation& station, can::FrameBus& bus, CheckStore& store,
               gpio::Panel* panel, can::SocketCanBus* socket, assembly::SimulatedBench* bench)
    : station_(station),
      store_(store),
      panel_(panel),
      socket_(socket),
      port_(bus, station.codec),
      core_(port_, station.supervisor, rt::ControlCore::kRingCapacity, rt::kPolicy,
            panel == nullptr ? nullptr : &panel->board()),
      conductor_(station, core_, &store, WorkerMode::Background) {
  if (bench != nullptr) simulated_loop_.emplace(*bench, core_);
  store_.queue_for(assembly::publication_channels(station.configuration));
  conductor_.show_samples_to([this](const Sample& sample) { live_.take(sample); });
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
  const rt::CyclicThreadSettings settings{realtime.priority, realtime.cpu, realtime.lock_memory};
  return simulated_loop_ ? loop_.start(settings, *simulated_loop_) : loop_.start(settings, core_);
}

void Daemon::serve(const std::atomic<bool>& quit, const std::function<void()>& each_round) {
  while (!quit) {
    pump();
    each_round();
    std::this_thread::sleep_for(5ms);
  }
  // The loop's last act zeroes the torque and ends a check; its record is saved before the daemon goes.
  loop_.stop();
  pump();
  while (conductor_.concluding()) {
    std::this_thread::sleep_for(5ms);
    pump();
    each_round();
  }
  // It was tried again until now, and no station gave it as anything but an ERROR.
  if (const std::optional<CheckRecord>& lost = conductor_.unsaved())
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
  const assembly::Instant now = instant_now();
  if (std::string set = clock_watch_.look(now); !set.empty()) {
    spdlog::warn("{}", set);
    clock_ = std::move(set);
  }
  if (std::optional<CheckRecord> record = conductor_.pump(now)) {
    spdlog::info("check {} of {}: {}. {}", record->id, record->serial, to_string(record->verdict),
                 record->reason);
    last_record_ = std::move(record);
    if (publishing_) publishing_->notify();
    records_due_ns_ = 0;
  }
  report_state_changes();
  reopen_bus_if_gone();
  serve_panel();
  look_after_records();
}

/// Retention and the master brake's age: now and then, and never while a check may need the store.
void Daemon::look_after_records() {
  constexpr std::int64_t kEvery_ns = 60 * kNanosecondsPerSecond;
  constexpr std::size_t kChecksAtOnce = 5;  // so that no check waits long for them; more than a line makes
  const assembly::Instant now = instant_now();
  if (conductor_.busy() || now.steady_ns < records_due_ns_) return;
  records_due_ns_ = now.steady_ns + kEvery_ns;
  if (const RetentionPolicy policy = retention_policy(station_.configuration); !policy.keeps_all()) {
    const Result<RetentionSummary> removed = store_.apply_retention(policy, now.utc_ns, kChecksAtOnce);
    if (!removed)
      spdlog::warn("retention: {}", removed.error().message);
    else if (!removed->checks.empty())
      spdlog::info("retention: raw runs of {} checks removed, up to {}", removed->checks.size(),
                   removed->checks.back());
  }
  const Result<MasterReport> master = master_report(station_.configuration.master, store_, now.utc_ns);
  const std::string before = std::exchange(master_, !master                       ? master.error().message
                                                    : asks_for_something(*master) ? master->text
                                                                                  : "");
  if (!master_.empty() && master_ != before) spdlog::warn("{}", master_);
}

void Daemon::serve_panel() {
  if (panel_ == nullptr) return;
  panel_->show(conductor_.concluding(),
               last_record_ ? std::optional<Verdict>(last_record_->verdict) : std::nullopt);
  if (!panel_->take_start_press()) return;
  const Result<std::uint64_t> begun =
      next_
          ? begin(*next_)
          : failure(
                "no serial number is known: enter or scan one (`clampctl next --serial`), then press start");
  if (begun) {
    next_.reset();
    notice_.clear();
  } else {
    notice_ = "start button: " + begun.error().message;
    spdlog::warn("{}", notice_);
  }
}

std::string Daemon::fault_text(FaultCause fault) const {
  std::string text(rt::fault_rule(fault).advice);
  const std::string detail = panel_ == nullptr ? "" : panel_->explain(fault);
  if (!detail.empty()) text += " " + detail;
  return text;
}

void Daemon::report_state_changes() {
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

control::StationStatus Daemon::status() {
  const std::lock_guard lock(mutex_);
  const rt::StatusBoard& board = core_.status();
  const rt::HistogramSnapshot lateness = loop_.statistics().lateness.snapshot();
  const PortHealth health = core_.health();
  control::StationStatus status;
  status.station = station_.configuration.name;
  status.version = std::string(kVersion);
  status.state = std::string(to_string(board.state.load()));
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
  status.serial = conductor_.serial();
  status.check = check_number_;
  status.judging = conductor_.concluding();
  if (last_record_) status.last_verdict = std::string(to_string(last_record_->verdict));
  status.ticks = board.ticks.load();
  status.skipped = board.skipped.load();
  status.lateness_avg_us = lateness.avg_us;
  status.lateness_max_us = lateness.max_us;
  status.force_N = board.force_N.load();
  status.velocity_rad_s = board.velocity_rad_s.load();
  status.torque_Nm = board.torque_Nm.load();
  status.interface = station_.configuration.can.interface;
  status.link = std::string(to_string(health.link));
  if (status.ticks > 0)
    status.bus_load =
        static_cast<double>(health.bus_bits) / (static_cast<double>(station_.configuration.can.bitrate) *
                                                static_cast<double>(status.ticks) * kPeriod_s);
  status.simulated = station_.configuration.simulated_brake;
  status.realtime = station_.configuration.realtime.priority > 0;
  if (next_) status.next_serial = next_->serial;
  status.notice = notice_;
  if (panel_ != nullptr)
    for (gpio::LineReport& line : panel_->report())
      status.panel.push_back({std::move(line.line), std::move(line.role), std::move(line.state)});
  status.master = master_;
  status.storage = conductor_.storage_problem();
  status.clock = clock_;
  if (publishing_)
    for (assembly::ChannelReport& channel : publishing_->report(store_))
      status.publishing.push_back({std::move(channel.channel), std::move(channel.where), channel.connected,
                                   channel.pending, channel.oldest_age_s, std::move(channel.error)});
  return status;
}

Result<std::uint64_t> Daemon::start(const CheckRequest& request) {
  const std::lock_guard lock(mutex_);
  return begin(request);
}

Result<void> Daemon::next(const CheckRequest& request) {
  if (Result<void> valid = validate(request); !valid) return valid;
  const std::lock_guard lock(mutex_);
  next_ = request;
  notice_.clear();
  spdlog::info("next is {}", request.serial);
  return {};
}

Result<std::uint64_t> Daemon::begin(const CheckRequest& request) {
  if (panel_ != nullptr && core_.status().state.load() == StationState::Idle &&
      panel_->board().read(monotonic_now_ns()).fixture_open)
    return failure(
        fmt::format("the fixture is open: close it ({})", panel_->name(gpio::LineRole::FixtureClosed)));
  if (const Result<void> begun = conductor_.begin(request, instant_now()); !begun)
    return tl::unexpected(begun.error());
  last_record_.reset();
  clock_.clear();
  spdlog::info("check of {} begins", request.serial);
  return ++check_number_;
}

control::CheckProgress Daemon::progress(bool colour) {
  const std::lock_guard lock(mutex_);
  control::CheckProgress progress;
  progress.check = check_number_;
  progress.finished = last_record_.has_value();
  progress.phase = std::string(to_string(core_.status().phase.load()));
  progress.repeat = core_.status().repeat.load();
  progress.repeats = conductor_.progress().repeats;
  if (last_record_) {
    progress.record = check_json(*last_record_);
    progress.table = format_check(*last_record_, colour);
  }
  return progress;
}

Result<void> Daemon::stop() {
  spdlog::warn("operator stop");
  core_.requests().stop.store(true, std::memory_order_release);
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

Result<nlohmann::ordered_json> Daemon::results(const CheckFilter& filter) {
  const std::lock_guard lock(mutex_);
  return store_.list(filter).map(
      [](const std::vector<CheckSummary>& checks) { return summaries_json(checks); });
}

Result<nlohmann::ordered_json> Daemon::result(const std::string& id) {
  const std::lock_guard lock(mutex_);
  return store_.load(id).map([](const CheckRecord& record) { return check_json(record); });
}

// What follows reads much of the archive and must not hold up a check: it opens the store a second time.

Result<nlohmann::ordered_json> Daemon::run(const std::string& id, std::size_t number) {
  const Result<CheckStore> archive =
      CheckStore::open(station_.configuration.database, CheckStore::Access::ReadOnly);
  if (!archive) return tl::unexpected(archive.error());
  const Result<CheckRecord> record = archive->load(id);
  if (!record) return tl::unexpected(record.error());
  if (number >= record->runs.size())
    return failure(fmt::format("check {} has {} runs", record->id, record->runs.size()));
  const Run& run = record->runs[number].run;
  return nlohmann::ordered_json{{"run", number},
                                {"time_s", run.time_s},
                                {"force_N", run.force_N},
                                {"velocity_rad_s", run.velocity_rad_s},
                                {"torque_Nm", run.torque_Nm}};
}

Result<nlohmann::ordered_json> Daemon::statistics(std::uint32_t limit) {
  CheckFilter filter;
  filter.limit = limit;
  return CheckStore::open(station_.configuration.database, CheckStore::Access::ReadOnly)
      .and_then([&](const CheckStore& archive) { return archive.load_results(filter); })
      .map([&](std::vector<CheckRecord> checks) {
        return statistics_json(line_statistics(std::move(checks), station_.configuration.master.serial));
      });
}

nlohmann::ordered_json Daemon::reference() {
  nlohmann::ordered_json force = nlohmann::ordered_json::array();
  nlohmann::ordered_json velocity = force;
  nlohmann::ordered_json torque = force;
  for (const ReferenceRow& row : station_.plan.reference.rows) {
    force.push_back(row.force_N);
    velocity.push_back(row.velocity_rad_s);
    torque.push_back(row.torque_Nm);
  }
  return {{"period_s", kPeriod_s},
          {"force_N", std::move(force)},
          {"velocity_rad_s", std::move(velocity)},
          {"torque_Nm", std::move(torque)}};
}

nlohmann::ordered_json Daemon::live(std::uint64_t run, std::size_t row) {
  return live_.since(run, row);
}

}  // namespace clampd::daemon
