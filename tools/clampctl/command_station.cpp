#include <atomic>
#include <chrono>
#include <csignal>
#include <memory>
#include <optional>
#include <thread>

#include <fmt/format.h>

#include "clampd/api/messages.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/bench/publishing.hpp"
#include "clampd/station/verdict.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

int report(const Error& error, int exit_code) {
  cli::print_error(error.message);
  return exit_code;
}

/// Runs `ask` with a client of the configured daemon.
template <class Ask>
int with_daemon(const CommonOptions& common, Ask ask) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return report(configuration.error(), cli::kBadInput);
  const api::Client daemon(configuration->control.address, configuration->control.port,
                           configuration->control.token_file);
  // One may run on a simulated brake all the same.
  if (configuration->embedded() && !daemon.status())
    return report({"no daemon is configured: without [can] interface, `clampctl run` checks an embedded "
                   "simulated brake. "
                   "Name a station configuration with --config"},
                  cli::kBadInput);
  return ask(daemon);
}

using namespace std::chrono_literals;

std::string clamped_text(const api::StationStatus& status) {
  return fmt::format("the brake is CLAMPED: {:.0f} N stand on it; `clampctl open` opens it",
                     status.clamped_N);
}

/// Waits until the loop confirms the stop, which takes a millisecond.
int stop_brake(const api::Client& daemon) {
  if (const Result<void> asked = daemon.stop(); !asked) return report(asked.error(), cli::kStation);
  for (int i = 0; i < 40; ++i) {
    const Result<api::StationStatus> status = daemon.status();
    if (!status) return report(status.error(), cli::kStation);
    if (status->stops_taken >= status->stops) {
      fmt::print("stopped; the station is in {}\n", status->state);
      if (status->clamped) fmt::print("{}\n", clamped_text(*status));
      return cli::kSuccess;
    }
    std::this_thread::sleep_for(25ms);
  }
  return report({"the station took the stop, but its loop does not confirm it: use the emergency stop"},
                cli::kStation);
}

std::atomic<bool> opening_interrupted{false};

/// Follows the opening to its end; Ctrl-C stops the brake.
int open_brake(const api::Client& daemon) {
  opening_interrupted = false;
  struct sigaction action {};
  action.sa_handler = [](int) { opening_interrupted = true; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  const Result<std::string> id = daemon.open();
  if (!id) return report(id.error(), cli::kStation);
  while (true) {
    if (opening_interrupted.exchange(false))
      if (const Result<void> stopped = daemon.stop(); !stopped) cli::print_error(stopped.error().message);
    const Result<api::StationStatus> status = daemon.status();
    if (!status) return report(status.error(), cli::kStation);
    if (status->open_id != *id)
      return report({"the station's daemon was restarted while the brake was being opened; look at the rig"},
                    cli::kStation);
    if (!status->opening) {
      if (status->open_result != "OPEN")
        return report({fmt::format("the brake was not opened: {}", status->open_reason)},
                      exit_code(parse_verdict(status->open_result).value_or(Verdict::Error)));
      fmt::print("the brake is open, {:.0f} N\n", status->force_N);
      return cli::kSuccess;
    }
    std::this_thread::sleep_for(50ms);
  }
}

void print_status(const api::StationStatus& status) {
  fmt::print("{}  {}{}\n", status.station, status.state, status.simulated ? "  (simulated brake)" : "");
  if (status.clamped) fmt::print("\n  {}\n\n", clamped_text(status));
  if (status.opening) fmt::print("  opening    under way\n");
  if (status.fault != "none") {
    fmt::print("  fault      {}: {}\n", status.fault, status.fault_text);
    fmt::print("             {}\n",
               status.clearable ? "its cause is gone: `clampctl clear`" : "its cause is still there");
  }
  if (!status.serial.empty())
    fmt::print("  check      {}{}{}\n", status.serial, status.last_verdict.empty() ? "" : ": ",
               status.last_verdict);
  if (status.repeats > 0)
    fmt::print("  running    {}, run {} of {}{}\n", status.phase, status.repeat + 1,
               status.repeats_auto ? "at most " : "", status.repeats);
  fmt::print("  brake      {:.0f} N, {:.1f} rad/s, {:.3f} N m\n", status.force_N, status.velocity_rad_s,
             status.torque_Nm);
  fmt::print("  bus        {} {}, load {:.0f} %\n", status.interface, status.link, 100.0 * status.bus_load);
  fmt::print("  loop       {} ticks, {} skipped, lateness avg {:.0f} µs, max {:.0f} µs{}\n", status.ticks,
             status.skipped, status.lateness_avg_us, status.lateness_max_us,
             status.realtime ? "" : " (not a real-time thread)");
  for (std::size_t i = 0; i < status.panel.size(); ++i)
    fmt::print("  {:<10} {:<7} {}\n", i == 0 ? "panel" : "", status.panel[i].state, status.panel[i].line);
  if (!status.next_serial.empty()) fmt::print("  next       {}\n", status.next_serial);
  if (!status.storage.empty()) fmt::print("  storage    {}\n", status.storage);
  if (!status.clock.empty()) fmt::print("  clock      {}\n", status.clock);
  if (!status.notice.empty()) fmt::print("  notice     {}\n", status.notice);
  if (!status.master.empty()) fmt::print("  master     {}\n", status.master);
  for (const api::PublishingChannel& channel : status.publishing) {
    fmt::print("  {:<10} {}: {}{}\n", channel.channel, channel.where,
               channel.connected ? "" : "not connected, ",
               bench::waiting_text(channel.pending, channel.oldest_age_s));
    if (!channel.error.empty()) fmt::print("             {}\n", channel.error);
  }
  fmt::print("  software   {}\n", status.version);
}

}  // namespace

void add_station_commands(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto json = std::make_shared<bool>(false);
  CLI::App* status = app.add_subcommand("status", "what the station is doing now");
  status->add_flag("--json", *json, "as JSON on standard output");
  status->callback([json, &common, &exit_code] {
    exit_code = with_daemon(common, [&](const api::Client& daemon) {
      const Result<api::StationStatus> now = daemon.status();
      if (!now) return report(now.error(), cli::kStation);
      if (*json)
        fmt::print("{}\n", nlohmann::ordered_json(nlohmann::json(*now)).dump(2));
      else
        print_status(*now);
      return static_cast<int>(cli::kSuccess);
    });
  });

  auto request = std::make_shared<CheckRequest>();
  CLI::App* next =
      app.add_subcommand("next", "the brake that the start button of the operator's panel checks");
  add_request_options(*next, *request);
  next->callback([request, &common, &exit_code] {
    exit_code = with_daemon(common, [&](const api::Client& daemon) {
      const Result<void> taken = daemon.next(*request);
      return taken ? static_cast<int>(cli::kSuccess) : report(taken.error(), cli::kStation);
    });
  });

  app.add_subcommand("stop", "stop the brake now")->callback([&common, &exit_code] {
    exit_code = with_daemon(common, stop_brake);
  });

  app.add_subcommand("open", "open a brake that stays clamped, supervised as a check is; Ctrl-C stops it")
      ->callback([&common, &exit_code] { exit_code = with_daemon(common, open_brake); });

  app.add_subcommand("clear", "clear a fault whose cause is gone")->callback([&common, &exit_code] {
    exit_code = with_daemon(common, [](const api::Client& daemon) {
      const Result<void> cleared = daemon.clear();
      if (!cleared) return report(cleared.error(), cli::kStation);
      fmt::print("cleared\n");
      return static_cast<int>(cli::kSuccess);
    });
  });
}

}  // namespace clampd::ctl
