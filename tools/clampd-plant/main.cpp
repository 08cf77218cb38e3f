#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <csignal>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "clampd/base/clock.hpp"
#include "clampd/base/version.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/simulation/plant.hpp"
#include "drivers/can/codec.hpp"
#include "drivers/can/socketcan.hpp"
#include "rt/cyclic_thread.hpp"
#include "tools/cli/exit_code.hpp"
#include "tools/cli/terminal.hpp"

namespace {

using namespace clampd;

struct Options {
  std::string interface;
  std::string configuration;
  std::string dbc;
  std::string station;
  std::string trace;
  int priority = 0;
  double duration_s = 0.0;
};

std::atomic<bool> quit{false};

void quit_on_signals() {
  struct sigaction action {};
  action.sa_handler = [](int) { quit = true; };
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
}

int refuse(const std::string& message) {
  cli::print_error(message);
  return cli::kBadInput;
}

/// The work of the ordinary thread while the brake runs: trace, vanished interfaces, the end.
int attend(can::SocketCanBus& bus, plant::Trace* trace, const Options& options) {
  using namespace std::chrono_literals;
  const std::int64_t end_ns = monotonic_now_ns() + static_cast<std::int64_t>(options.duration_s * 1e9);
  LinkState reported = LinkState::Up;
  for (int round = 0; !quit && (options.duration_s == 0.0 || monotonic_now_ns() < end_ns); ++round) {
    if (trace != nullptr) {
      if (const auto flushed = trace->flush(); !flushed) {
        cli::print_error(flushed.error().message);
        return cli::kStation;
      }
    }
    const LinkState link = bus.link();
    if (link != reported) {
      cli::print_notice(fmt::format("{}: {}", options.interface, to_string(link)));
      reported = link;
    }
    // An error means that the interface is still missing; the next round tries again.
    if (link == LinkState::Gone && round % 10 == 0) (void)bus.reopen();
    std::this_thread::sleep_for(10ms);
  }
  return cli::kSuccess;
}

int run(const Options& options) {
  const auto configuration = sim::read_plant_configuration(options.configuration);
  if (!configuration) return refuse(configuration.error().message);
  StationConfiguration station;
  if (!options.station.empty()) {
    const auto read = bench::load_configuration(options.station);
    if (!read) return refuse(read.error().message);
    station = *read;
  }
  if (!options.dbc.empty()) station.can.dbc = options.dbc;  // left out: the frames that ship with clampd
  const auto codec = bench::build_codec(station);
  if (!codec) return refuse(codec.error().message);
  const auto bus =
      can::SocketCanBus::open(options.interface, codec->command_ids(), bench::bus_format(station, *codec));
  if (!bus) return refuse(bus.error().message);
  std::optional<plant::Trace> trace;
  if (!options.trace.empty()) {
    auto created = plant::Trace::create(options.trace);
    if (!created) return refuse(created.error().message);
    trace.emplace(std::move(*created));
  }

  quit_on_signals();
  plant::Trace* trace_or_null = trace ? &*trace : nullptr;
  plant::Plant plant{**bus, *codec, *configuration, trace_or_null};
  rt::CyclicThread thread;
  rt::CyclicThreadSettings settings;
  settings.priority = options.priority;
  settings.lock_memory = options.priority > 0;
  settings.period_ns = codec->feedback_cycle_ns();
  if (const auto started = thread.start(settings, plant); !started) return refuse(started.error().message);
  fmt::print(stderr, "clampd-plant {}: a simulated brake on {}\n", kVersion, options.interface);
  int code = attend(**bus, trace_or_null, options);
  thread.stop();
  if (trace && code == cli::kSuccess) {
    if (const auto flushed = trace->flush(); !flushed) {
      cli::print_error(flushed.error().message);
      code = cli::kStation;
    }
    if (trace->dropped() > 0)
      cli::print_notice(fmt::format("{}: {} rows lost", options.trace, trace->dropped()));
  }

  const can::BusHealth health = (*bus)->health();
  const can::ProtocolCounts& counts = plant.counts();
  fmt::print(stderr,
             "{} samples, {} periods skipped, {} commands received; refused: {} CRC, {} counter, {} range; "
             "{} frames sent, {} not sent\n",
             plant.samples(), thread.statistics().skipped.load(), health.frames_received, counts.crc_errors,
             counts.counter_errors, counts.implausible, health.frames_sent, health.send_failures);
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{"A simulated brake on a CAN interface, in real time."};
  app.set_version_flag("--version", std::string{kVersion});
  app.add_option("--interface", options.interface, "CAN interface, e.g. vcan0 or can0")->required();
  app.add_option("--config", options.configuration,
                 "The brake: parameters, sensors, faults (TOML), e.g. configs/plant.toml")
      ->required();
  CLI::Option* dbc = app.add_option("--dbc", options.dbc, "The frames (DBC), e.g. configs/brake.dbc");
  app.add_option("--station", options.station,
                 "A station's configuration, whose DBC file, mapping and protection this brake speaks")
      ->excludes(dbc);
  app.add_option("--realtime", options.priority, "SCHED_FIFO priority; without it an ordinary thread")
      ->check(CLI::Range(1, 99));
  app.add_option("--trace", options.trace, "Writes the brake's true state at every sample (CSV)");
  app.add_option("--duration", options.duration_s,
                 "Ends after so many seconds; without it at SIGTERM or Ctrl-C")
      ->check(CLI::PositiveNumber);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? cli::kSuccess : cli::kBadInput;
  }
  return run(options);
}
