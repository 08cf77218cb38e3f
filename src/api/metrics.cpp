#include "clampd/api/metrics.hpp"

#include <utility>
#include <vector>

#include "clampd/http/metrics.hpp"

namespace clampd::api {
namespace {

constexpr std::array kStates{StationState::Init,    StationState::Idle,      StationState::Armed,
                             StationState::Running, StationState::Releasing, StationState::Fault};
constexpr std::array kLinks{LinkState::Up, LinkState::ErrorPassive, LinkState::BusOff, LinkState::Down,
                            LinkState::Gone};
constexpr std::array<std::size_t, 9> kLateness_us{5, 10, 20, 50, 100, 200, 500, 800, 1000};

void one(http::Metrics& out, std::string_view name, std::string_view type, std::string_view help,
         double value) {
  out.family(name, type, help);
  out.sample(value);
}

void add_lateness(http::Metrics& out, const rt::HistogramSnapshot& lateness) {
  std::vector<std::pair<double, double>> at_most;
  std::size_t bin = 0;
  std::uint64_t sum = 0;
  for (const std::size_t bound_us : kLateness_us) {
    for (; bin < bound_us && bin < lateness.bins.size(); ++bin) sum += lateness.bins[bin];
    at_most.emplace_back(static_cast<double>(bound_us) * 1e-6, static_cast<double>(sum));
  }
  // The bins are read one after the other while the loop counts: their sum is the count that they agree with.
  for (; bin < lateness.bins.size(); ++bin) sum += lateness.bins[bin];
  const auto count = static_cast<double>(sum);
  out.family("clampd_loop_lateness_seconds", "histogram", "How late the loop woke up after each deadline.");
  out.buckets(at_most, lateness.avg_us * 1e-6 * count, count);
}

void add_bus(http::Metrics& out, const StationStatus& status, const PortHealth& bus) {
  out.family("clampd_bus_link", "gauge", "1 for the state that the CAN interface is in.");
  for (const LinkState link : kLinks)
    out.sample(status.link == to_string(link) ? 1.0 : 0.0,
               {{"interface", status.interface}, {"link", to_string(link)}});
  one(out, "clampd_bus_load_ratio", "gauge", "Share of the bus that its frames take, worst-case stuffing.",
      status.bus_load);
  out.family("clampd_bus_frames_total", "counter", "Frames by direction.");
  out.sample(static_cast<double>(bus.frames_received), {{"direction", "received"}});
  out.sample(static_cast<double>(bus.frames_sent), {{"direction", "sent"}});
  out.family("clampd_bus_errors_total", "counter", "What went wrong on the bus, by kind.");
  for (const auto& [kind, count] : {std::pair{"send", bus.send_failures},
                                    {"checksum", bus.crc_errors},
                                    {"counter", bus.counter_errors},
                                    {"implausible", bus.implausible},
                                    {"error-frame", bus.error_frames},
                                    {"bus-off", bus.bus_off_events},
                                    {"overflow", bus.receive_overflows}})
    out.sample(static_cast<double>(count), {{"kind", kind}});
  one(out, "clampd_bus_lost_samples_total", "counter", "Samples missing in the brake's own count.",
      static_cast<double>(bus.lost_samples));
  one(out, "clampd_bus_arrival_jitter_seconds", "gauge",
      "How the frames' arrivals vary, of a brake without a sample clock; 0 with one.",
      bus.arrival_jitter_ns * 1e-9);
}

void add_outboxes(http::Metrics& out, const StationStatus& status) {
  out.family("clampd_outbox_connected", "gauge", "1 if the server that checks are published to is reached.");
  for (const PublishingChannel& each : status.publishing)
    out.sample(each.connected ? 1.0 : 0.0, {{"channel", each.channel}});
  out.family("clampd_outbox_pending", "gauge", "Checks that wait to be published.");
  for (const PublishingChannel& each : status.publishing)
    out.sample(static_cast<double>(each.pending), {{"channel", each.channel}});
  out.family("clampd_outbox_oldest_seconds", "gauge", "For how long the oldest of them waits.");
  for (const PublishingChannel& each : status.publishing)
    out.sample(each.oldest_age_s, {{"channel", each.channel}});
}

}  // namespace

std::string station_metrics(const StationStatus& status, const StationCounts& counts) {
  http::Metrics out;
  out.family("clampd_build_info", "gauge", "Always 1; the labels tell what runs here.");
  out.sample(1.0, {{"version", status.version},
                   {"station", status.station},
                   {"simulated", status.simulated ? "true" : "false"},
                   {"realtime", status.realtime ? "true" : "false"}});
  out.family("clampd_state", "gauge", "1 for the state that the station is in.");
  for (const StationState state : kStates)
    out.sample(status.state == to_string(state) ? 1.0 : 0.0, {{"state", to_string(state)}});
  out.family("clampd_fault", "gauge", "1 while the fault that the label names stands; none otherwise.");
  if (status.fault != "none" && !status.fault.empty()) out.sample(1.0, {{"fault", status.fault}});
  one(out, "clampd_brake_clamped", "gauge", "1 while force stands on the brake though nothing drives it.",
      status.clamped ? 1.0 : 0.0);
  one(out, "clampd_brake_force_newtons", "gauge", "The latest force reading.", status.force_N);
  out.family("clampd_checks_total", "counter", "Checks since the daemon started, by verdict.");
  for (std::size_t i = 0; i < kVerdicts.size(); ++i)
    out.sample(static_cast<double>(counts.verdicts[i]), {{"verdict", to_string(kVerdicts[i])}});
  one(out, "clampd_stops_total", "counter", "Operator stops since the daemon started.",
      static_cast<double>(status.stops));
  one(out, "clampd_loop_ticks_total", "counter", "Periods of the loop.", static_cast<double>(status.ticks));
  one(out, "clampd_loop_skipped_total", "counter", "Periods that the loop missed.",
      static_cast<double>(status.skipped));
  add_lateness(out, counts.lateness);
  add_bus(out, status, counts.bus);
  one(out, "clampd_storage_failed", "gauge", "1 while the last result could not be put on record.",
      status.storage.empty() ? 0.0 : 1.0);
  add_outboxes(out, status);
  return out.text();
}

}  // namespace clampd::api
