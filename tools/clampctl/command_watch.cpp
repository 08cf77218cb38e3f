#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>

#include <fmt/format.h>

#include "clampd/api/messages.hpp"
#include "clampd/api/secret_file.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/utc.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

using namespace std::chrono_literals;

std::atomic<bool> watch_interrupted{false};

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

/// What must be seen from the other end of the hall.
std::string banner(const std::string& text, const char* code, bool colour) {
  if (!colour) return fmt::format("  =====  {}  =====\n", text);
  const std::string line = fmt::format("  \033[{}m{:<60}\033[0m\n", code, "");
  return line + fmt::format("  \033[{}m{:^60}\033[0m\n", code, text) + line;
}

std::string headline(const api::StationStatus& status) {
  std::string text = status.state;
  if (status.clamped) text += fmt::format("  CLAMPED {:.0f} kN", status.clamped_N * 1e-3);
  if (status.opening) text += "  opening";
  if (status.fault != "none") text += fmt::format("  {}", status.fault);
  if (status.judging)
    text += fmt::format("  {}: judging{}", status.serial,
                        status.cause_searched > 0.0 ? ", searching for the cause" : "");
  else if (status.repeats > 0)
    text +=
        fmt::format("  {}: run {} of {}{}, {}", status.serial, std::min(status.repeat + 1, status.repeats),
                    status.repeats_auto ? "at most " : "", status.repeats, status.phase);
  else if (!status.last_verdict.empty())
    text += fmt::format("  {}: {}", status.serial, status.last_verdict);
  return text;
}

/// What a line of a log is worth: not every sample, but every other state, run and verdict.
std::string log_line(const api::StationStatus& status) {
  std::string text = headline(status);
  if (status.fault != "none")
    text += fmt::format(": {}{}", status.fault_text, status.clearable ? " Its cause is gone." : "");
  return text;
}

std::string screen(const api::StationStatus& status, bool colour) {
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
  if (status.clamped)
    text += paint("1;37;41",
                  fmt::format("   THE BRAKE IS CLAMPED: {:.0f} N stand on it; `clampctl open` opens it   ",
                              status.clamped_N)) +
            "\n\n";
  text += fmt::format("  force    {} {:8.0f} N\n", bar(status.force_N / 30e3, false), status.force_N);
  text += fmt::format("  speed    {} {:8.1f} rad/s\n", bar(status.velocity_rad_s / 300.0, true),
                      status.velocity_rad_s);
  text += fmt::format("  torque   {} {:8.3f} N m\n\n", bar(status.torque_Nm / 3.0, true), status.torque_Nm);
  text += fmt::format("  loop     {} ticks, {} skipped, late by {:.0f} µs on average, {:.0f} µs at most{}\n",
                      status.ticks, status.skipped, status.lateness_avg_us, status.lateness_max_us,
                      status.realtime ? "" : " (not a real-time thread)");
  text += fmt::format("  bus      {} {}, load {:.0f} %\n", status.interface, status.link,
                      100.0 * status.bus_load);
  for (const api::PanelLine& line : status.panel)
    text += fmt::format("  panel    {:<7} {}\n", line.state, line.line);
  if (status.fault != "none")
    text +=
        fmt::format("\n  {}\n  {}\n", paint("31", status.fault_text),
                    status.clearable ? "its cause is gone: `clampctl clear`" : "its cause is still there");
  if (!status.next_serial.empty()) text += fmt::format("  next     {}\n", status.next_serial);
  for (const api::PublishingChannel& channel : status.publishing)
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

Result<api::Client> client(const CommonOptions& common, StationConfiguration& configuration) {
  Result<StationConfiguration> loaded = bench::load_configuration(common.config);
  if (!loaded) return tl::unexpected(loaded.error());
  configuration = std::move(*loaded);
  return api::Client(configuration.control.address, configuration.control.port,
                     configuration.control.token_file);
}

/// How long the station may stay silent before the picture of it is taken away.
constexpr std::chrono::milliseconds kPatience = 1500ms;

std::string silence_screen(const std::string& why, std::chrono::nanoseconds silent, bool colour) {
  return banner("NO ANSWER", "1;97;41", colour) +
         fmt::format("\n  What the station does is not known, for {} s now: {}\n",
                     std::chrono::duration_cast<std::chrono::seconds>(silent).count(), why);
}

/// Writes each change of the station as a line.
class ChangeLog {
 public:
  explicit ChangeLog(bool json) : json_(json) {}

  /// False where nobody reads any more.
  bool take(const api::StationStatus& status) {
    std::string line = log_line(status);
    if (line == last_) return true;
    last_ = std::move(line);
    if (!json_) return write(last_);
    fmt::print("{}\n", nlohmann::json(status).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    return std::fflush(stdout) == 0;
  }

  bool take_silence(const std::string& why) {
    if (json_ || last_ == why) return true;
    last_ = why;
    return write("NO ANSWER  " + why);
  }

 private:
  static bool write(const std::string& line) {
    fmt::print("{}  {}\n", format_utc(utc_now_ns()), line);
    return std::fflush(stdout) == 0;
  }

  bool json_;
  std::string last_;
};

int watch(bool json, const CommonOptions& common) {
  StationConfiguration configuration;
  const Result<api::Client> daemon = client(common, configuration);
  if (!daemon) return cli::refuse(daemon.error());
  watch_interrupted = false;
  struct sigaction action {};
  action.sa_handler = [](int) { watch_interrupted = true; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);

  const bool terminal = isatty(STDOUT_FILENO) == 1 && !json;
  if (terminal) fmt::print("\033[?1049h\033[?25l\033[?7l");  // another screen, no cursor, no wrapping
  ChangeLog log(json);
  std::string lost;
  using Clock = std::chrono::steady_clock;
  auto answered = Clock::now();
  while (!watch_interrupted) {
    const auto asked = Clock::now();
    const Result<api::StationStatus> status = daemon->status(kPatience);
    lost = status ? std::string() : status.error().message;
    if (status) answered = Clock::now();
    // Who keeps silent may speak again; where nobody listens at once, a log has come to its end.
    const bool hung = Clock::now() - asked >= kPatience / 2;
    if (terminal)
      redraw(status ? screen(*status, cli::colours_wanted())
                    : silence_screen(lost, Clock::now() - answered, cli::colours_wanted()));
    else if (!(status ? log.take(*status) : hung && log.take_silence(lost)))
      break;
    for (int i = 0; i < 4 && !watch_interrupted; ++i) std::this_thread::sleep_for(50ms);
  }
  if (terminal) {
    fmt::print("\033[?7h\033[?25h\033[?1049l");
    std::fflush(stdout);
  }
  if (lost.empty()) return cli::kSuccess;
  cli::print_error(lost);
  return cli::kStation;
}

/// The screen's address with the token that lets it start checks.
Result<std::string> screen_address(const ControlSettings& control) {
  const bool v6 = control.address.find(':') != std::string::npos;
  const std::string host = v6 ? "[" + control.address + "]" : control.address;
  std::string token;
  if (!control.token_file.empty()) {
    const Result<std::string> read = read_file(control.token_file);
    if (!read) return tl::unexpected(read.error());
    token = "#token=" + read->substr(0, read->find_last_not_of(" \r\n") + 1);
  }
  return fmt::format("http://{}:{}/{}", host, control.port, token);
}

/// A page that leads to the screen. On a browser's command line the address itself, and the token in it,
/// could be read by every user of the machine.
std::string kiosk_page(const std::string& address) {
  return fmt::format(
      "<!doctype html><meta charset=\"utf-8\"><title>clampd</title>"
      "<meta http-equiv=\"refresh\" content=\"0;url={}\">\n",
      address);
}

int print_address(const CommonOptions& common, const std::string& kiosk_file) {
  StationConfiguration configuration;
  const Result<api::Client> daemon = client(common, configuration);
  if (!daemon) return cli::refuse(daemon.error());
  if (const Result<api::StationStatus> status = daemon->status(); !status) {
    cli::print_error(status.error().message);
    return cli::kStation;
  }
  const Result<std::string> address = screen_address(configuration.control);
  if (!address) return cli::refuse(address.error());
  if (kiosk_file.empty()) {
    fmt::print("{}\n", *address);
    return cli::kSuccess;
  }
  if (const Result<void> written = api::write_secret_file(kiosk_file, kiosk_page(*address), 0600); !written)
    return cli::refuse(written.error());
  fmt::print("{}\n", std::filesystem::absolute(kiosk_file).string());
  return cli::kSuccess;
}

}  // namespace

void add_watch_commands(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command = app.add_subcommand(
      "watch", "the station live, five times a second; in a pipe, a line for each change. Ctrl-C ends it");
  command->add_flag("--json", *json, "each change as a line of JSON");
  command->callback([json, &common, &exit_code] { exit_code = watch(*json, common); });

  auto kiosk_file = std::make_shared<std::string>();
  CLI::App* address = app.add_subcommand(
      "screen", "the address of the station's screen, with the token that lets it start checks");
  address
      ->add_option(
          "--kiosk-file", *kiosk_file,
          "writes a page that leads there instead, which only you can read, and prints its path: for a "
          "browser's command line, where the address would show the token to every user of the machine")
      ->type_name("FILE.html");
  address->callback([kiosk_file, &common, &exit_code] { exit_code = print_address(common, *kiosk_file); });
}

}  // namespace clampd::ctl
