#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <memory>
#include <string>
#include <thread>

#include <fmt/format.h>

#include "clampd/record/file.hpp"
#include "clampd/record/utc.hpp"
#include "tools/assembly/prepared_station.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"
#include "tools/control/messages.hpp"

namespace clampd::ctl {

namespace {

using namespace std::chrono_literals;

std::atomic<bool> interrupted{false};

/// From -1 to 1 around the middle, or from 0 to 1, in characters.
std::string bar(double fraction, bool both_ways) {
  constexpr int kWidth = 30;
  const double from = both_ways ? 0.5 : 0.0;
  const double to = std::clamp(both_ways ? 0.5 + fraction / 2 : fraction, 0.0, 1.0);
  std::string text;
  for (int i = 0; i < kWidth; ++i) {
    const double at = (i + 0.5) / kWidth;
    text += at > std::min(from, to) && at < std::max(from, to) ? "█" : "░";
  }
  return text;
}

std::string headline(const control::StationStatus& status) {
  std::string text = status.state;
  if (status.fault != "none") text += fmt::format("  {}", status.fault);
  if (status.judging)
    text += fmt::format("  {}: judging", status.serial);
  else if (status.repeats > 0)
    text += fmt::format("  {}: run {} of {}, {}", status.serial, std::min(status.repeat + 1, status.repeats),
                        status.repeats, status.phase);
  else if (!status.last_verdict.empty())
    text += fmt::format("  {}: {}", status.serial, status.last_verdict);
  return text;
}

/// What a line of a log is worth: not every sample, but every other state, run and verdict.
std::string log_line(const control::StationStatus& status) {
  std::string text = headline(status);
  if (status.fault != "none")
    text += fmt::format(": {}{}", status.fault_text, status.clearable ? " Its cause is gone." : "");
  return text;
}

std::string screen(const control::StationStatus& status, bool colour) {
  const auto paint = [colour](const char* code, const std::string& text) {
    return colour ? fmt::format("\033[{}m{}\033[0m", code, text) : text;
  };
  const auto verdict_colour = [](const std::string& verdict) {
    return verdict == "PASS" ? "1;32" : verdict == "FAIL" ? "1;31" : "1;33";
  };
  std::string text = fmt::format("{}{}\n\n", paint("1", status.station),
                                 status.simulated ? paint("33", "  SIMULATED BRAKE") : "");
  text += fmt::format("  {}\n\n", paint(status.fault != "none"         ? "1;31"
                                        : !status.last_verdict.empty() ? verdict_colour(status.last_verdict)
                                                                       : "1",
                                        headline(status)));
  text += fmt::format("  force    {} {:8.0f} N\n", bar(status.force_N / 30e3, false), status.force_N);
  text += fmt::format("  speed    {} {:8.1f} rad/s\n", bar(status.velocity_rad_s / 300.0, true),
                      status.velocity_rad_s);
  text += fmt::format("  torque   {} {:8.3f} N m\n\n", bar(status.torque_Nm / 3.0, true), status.torque_Nm);
  text += fmt::format("  loop     {} ticks, {} skipped, late by {:.0f} µs on average, {:.0f} µs at most{}\n",
                      status.ticks, status.skipped, status.lateness_avg_us, status.lateness_max_us,
                      status.realtime ? "" : " (not a real-time thread)");
  text += fmt::format("  bus      {} {}, load {:.0f} %\n", status.interface, status.link,
                      100.0 * status.bus_load);
  for (const control::PanelLine& line : status.panel)
    text += fmt::format("  panel    {:<7} {}\n", line.state, line.line);
  if (status.fault != "none")
    text +=
        fmt::format("\n  {}\n  {}\n", paint("31", status.fault_text),
                    status.clearable ? "its cause is gone: `clampctl clear`" : "its cause is still there");
  if (!status.next_serial.empty()) text += fmt::format("  next     {}\n", status.next_serial);
  for (const control::PublishingChannel& channel : status.publishing)
    text += fmt::format("  publish  {} ({}): {}, {} checks wait{}{}\n", channel.channel, channel.where,
                        channel.connected ? "connected" : "not connected", channel.pending,
                        channel.error.empty() ? "" : "; ", channel.error);
  for (const std::string& notice : {status.storage, status.clock, status.notice, status.master})
    if (!notice.empty()) text += fmt::format("  {}\n", paint("33", notice));
  return text;
}

/// Draws over what was there, each line cut at the terminal's width, so that nothing flickers or wraps.
void redraw(const std::string& text) {
  std::string out = "\033[H";
  for (const char character : text) {
    if (character == '\n') out += "\033[K";
    out += character;
  }
  fmt::print("{}\n\033[2mCtrl-C ends the view, not the check\033[0m\033[K\033[J", out);
  std::fflush(stdout);
}

Result<control::Client> client(const CommonOptions& common, StationConfiguration& configuration) {
  Result<StationConfiguration> loaded = assembly::load_configuration(common.config);
  if (!loaded) return tl::unexpected(loaded.error());
  configuration = std::move(*loaded);
  return control::Client(configuration.control.address, configuration.control.port,
                         configuration.control.token_file);
}

int watch(bool json, const CommonOptions& common) {
  StationConfiguration configuration;
  const Result<control::Client> daemon = client(common, configuration);
  if (!daemon) return cli::refuse(daemon.error());
  interrupted = false;
  struct sigaction action {};
  action.sa_handler = [](int) { interrupted = true; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);

  const bool terminal = isatty(STDOUT_FILENO) == 1 && !json;
  if (terminal) fmt::print("\033[?1049h\033[?25l\033[?7l");  // another screen, no cursor, no wrapping
  std::string last;
  std::string lost;
  while (!interrupted) {
    const Result<control::StationStatus> status = daemon->status();
    if (!status) {
      lost = status.error().message;
      if (!terminal) break;
      redraw(lost + "\n");
    } else {
      lost.clear();
      if (terminal) {
        redraw(screen(*status, cli::colours_wanted()));
      } else if (std::string line = log_line(*status); line != last) {
        if (json)
          fmt::print("{}\n",
                     nlohmann::json(*status).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
        else
          fmt::print("{}  {}\n", format_utc(utc_now_ns()), line);
        if (std::fflush(stdout) != 0) break;
        last = std::move(line);
      }
    }
    for (int i = 0; i < 4 && !interrupted; ++i) std::this_thread::sleep_for(50ms);
  }
  if (terminal) {
    fmt::print("\033[?7h\033[?25h\033[?1049l");
    std::fflush(stdout);
  }
  if (lost.empty()) return cli::kSuccess;
  cli::print_error(lost);
  return cli::kStation;
}

int print_address(const CommonOptions& common) {
  StationConfiguration configuration;
  const Result<control::Client> daemon = client(common, configuration);
  if (!daemon) return cli::refuse(daemon.error());
  if (const Result<control::StationStatus> status = daemon->status(); !status) {
    cli::print_error(status.error().message);
    return cli::kStation;
  }
  std::string address = configuration.control.address;
  if (address.find(':') != std::string::npos) address = "[" + address + "]";
  std::string token;
  if (!configuration.control.token_file.empty()) {
    const Result<std::string> read = read_file(configuration.control.token_file);
    if (!read) return cli::refuse(read.error());
    token = "#token=" + read->substr(0, read->find_last_not_of(" \r\n") + 1);
  }
  fmt::print("http://{}:{}/{}\n", address, configuration.control.port, token);
  return cli::kSuccess;
}

}  // namespace

void add_watch_commands(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command = app.add_subcommand(
      "watch", "the station live, five times a second; in a pipe, a line for each change. Ctrl-C ends it");
  command->add_flag("--json", *json, "each change as a line of JSON");
  command->callback([json, &common, &exit_code] { exit_code = watch(*json, common); });

  app.add_subcommand("screen",
                     "the address of the station's screen, with the token that lets it start checks")
      ->callback([&common, &exit_code] { exit_code = print_address(common); });
}

}  // namespace clampd::ctl
