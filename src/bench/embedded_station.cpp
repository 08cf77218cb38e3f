#include "clampd/bench/embedded_station.hpp"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/bench/check_conductor.hpp"
#include "clampd/bench/simulated_bench.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/record/checksum.hpp"
#include "clampd/station/drive_off.hpp"

namespace clampd::bench {

namespace {

std::int64_t utc_now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

}  // namespace

EmbeddedStation::EmbeddedStation(PreparedStation station, const sim::PlantConfiguration& plant)
    : station_(std::move(station)),
      as_configured_(station_),
      bus_(static_cast<double>(station_.configuration.can.bitrate),
           bus_format(station_.configuration, station_.codec)),
      port_(bus_.end(can::EmbeddedBus::End::Station), station_.codec),
      brake_(bus_.end(can::EmbeddedBus::End::Brake), station_.codec, plant, nullptr),
      core_(port_, station_.supervisor) {}

void EmbeddedStation::advance_one_period() {
  simulate_period(brake_, core_, station_.codec, now_ns_, 0);
  now_ns_ += station_.codec.period_ns;
}

Result<CheckRecord> EmbeddedStation::run_check(const CheckRequest& request, CheckStore* store,
                                               const Progress& progress) {
  CheckConductor conductor(station_, core_, store, WorkerMode::Synchronous);
  conductor.watch_search(search_);
  const std::int64_t utc_start_ns = utc_now_ns();
  const std::int64_t start_ns = now_ns_;
  const auto now = [&] { return Instant{now_ns_, utc_start_ns + now_ns_ - start_ns}; };

  const rt::StatusBoard& status = core_.status();
  while (status.state.load() == StationState::Init) advance_one_period();
  if (const Result<void> begun = conductor.begin(request, now()); !begun)
    return tl::unexpected(begun.error());
  while (true) {
    advance_one_period();
    if (std::optional<CheckRecord> record = conductor.pump(now())) {
      diagnosis_ = conductor.take_diagnosis();
      return *std::move(record);
    }
    constexpr std::int64_t kProgressEvery_ns = 20 * kNanosecondsPerMillisecond;
    if (progress && now_ns_ % kProgressEvery_ns == 0 &&
        !progress(status.phase.load(), status.repeat.load(), conductor.progress().repeats))
      core_.requests().stop(now_ns_);
  }
}

Result<Run> EmbeddedStation::stand_by(std::size_t rows) {
  DriveOffReadings readings(rows);
  while (readings.rows() < rows) {
    advance_one_period();
    Sample sample;
    while (core_.ring().pop(sample)) readings.consume(sample);
    if (core_.status().state.load() == StationState::Fault)
      return failure(fmt::format("the station is in FAULT ({}) while the drive is off",
                                 to_string(core_.status().fault.load())));
  }
  return readings.run();
}

Result<void> EmbeddedStation::use_trajectory(const Run& trajectory) {
  const double period_s = station_.configuration.can.period_s();
  Result<Reference> reference =
      build_reference(trajectory, station_.configuration.model, {.period_s = period_s});
  if (!reference) return tl::unexpected(reference.error());
  const std::string sha256 = sha256_hex(format_run(trajectory));
  const auto use_in = [&](PreparedCheck& check, const PreparedCheck& as_configured) {
    check.plan.reference = *reference;
    check.plan.further.clear();
    check.trajectories = {};
    check.trajectories_sha256.clear();
    check.trajectory_sha256 = sha256;
    const double own_rows = static_cast<double>(as_configured.plan.reference.rows.size());
    const double longer_s = std::max(0.0, static_cast<double>(reference->rows.size()) - own_rows) * period_s;
    check.configuration.check.deadline_s =
        as_configured.configuration.check.deadline_s + as_configured.plan.repeats * longer_s;
  };
  use_in(station_, as_configured_);
  for (std::size_t i = 0; i < station_.recipes.size(); ++i)
    use_in(station_.recipes[i], as_configured_.recipes[i]);
  return {};
}

}  // namespace clampd::bench
