#include <atomic>
#include <csignal>
#include <memory>
#include <utility>

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/sinks/systemd_sink.h>
#include <spdlog/spdlog.h>
#include <CLI/CLI.hpp>

#include "clampd/api/messages.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/base/version.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/daemon/daemon.hpp"
#include "clampd/daemon/service_manager.hpp"
#include "drivers/gpio/panel.hpp"
#include "tools/cli/exit_code.hpp"
#include "tools/dashboard/assets.hpp"

namespace {

std::atomic<bool> quit{false};

void quit_on_signals() {
  struct sigaction action {};
  action.sa_handler = [](int) { quit = true; };
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
}

int refuse(const clampd::Error& error) {
  spdlog::critical("{}", error.message);
  return clampd::cli::kBadInput;
}

/// What is not there may come: the service tries again after this, and not after refuse().
int miss(const clampd::Error& error) {
  spdlog::critical("{}", error.message);
  return clampd::cli::kStation;
}

/// On a simulated brake the loop's clock is a count of ticks, which asks no real time of the machine.
void simulate_the_brake(clampd::StationConfiguration& configuration) {
  simulate_brake(configuration);
  configuration.can.interface = "simulated";
  configuration.realtime = {0, -1, false};
  configuration.gpio = {};
}

int serve(clampd::daemon::Daemon& daemon, const clampd::StationConfiguration& configuration) {
  using namespace clampd;
  const ControlSettings& api = configuration.control;
  const Result<int> inherited = daemon::ServiceManager::inherited_socket(api.address, api.port);
  if (!inherited) return refuse(inherited.error());
  if (const Result<void> started = daemon.start(); !started) return refuse(started.error());
  const auto server = api::ControlServer::start(daemon, api, dashboard::assets(), *inherited);
  if (!server) return refuse(server.error());
  spdlog::info("clampd {} on {}, control API on {}:{}", kVersion, configuration.can.interface,
               configuration.control.address, (*server)->port());
  if (const auto answer = api::Client(api.address, api.port, "").status(); !answer)
    return miss({"the control API does not answer: " + answer.error().message});
  daemon::ServiceManager manager;
  daemon.serve(quit, [&] {
    if (quit) manager.stopping();
    manager.round(daemon.ticks(), daemon.headline(), monotonic_now_ns());
  });
  spdlog::info("clampd ends; the drive is off");
  return cli::kSuccess;
}

int run(const std::string& file, bool simulated, const std::string& plant_file) {
  using namespace clampd;
  Result<StationConfiguration> configuration = bench::load_configuration(file);
  if (!configuration) return refuse(configuration.error());
  if (simulated) simulate_the_brake(*configuration);
  if (configuration->embedded())
    return refuse(
        {"no CAN interface is configured: set [can] interface in " +
         (configuration->file.empty() ? std::string("/etc/clampd/station.toml") : configuration->file) +
         ". For a simulated brake without CAN: `clampd --simulated`, or `clampctl run`, which needs no "
         "daemon"});
  const Result<bench::PreparedStation> station = bench::prepare_station(*configuration);
  if (!station) return refuse(station.error());
  // First of all: the relay's guard is forked off, and takes along what is open and which threads there are.
  std::unique_ptr<gpio::Panel> panel;
  if (station->panel) {
    Result<std::unique_ptr<gpio::Panel>> opened = gpio::Panel::open(*station->panel);
    if (!opened) return miss(opened.error());
    panel = std::move(*opened);
  }
  Result<CheckStore> store = CheckStore::open(configuration->database);
  if (!store) return refuse(store.error());
  quit_on_signals();
  if (simulated) {
    const Result<sim::PlantConfiguration> plant =
        bench::load_plant(plant_file.empty() ? configuration->plant_file : plant_file);
    if (!plant) return refuse(plant.error());
    bench::SimulatedBench bench(*station, *plant);
    daemon::Daemon daemon(*station, bench, *store);
    return serve(daemon, *configuration);
  }
  Result<std::unique_ptr<can::SocketCanBus>> bus =
      can::SocketCanBus::open(configuration->can.interface, station->codec.feedback_ids(),
                              bench::bus_format(*configuration, station->codec));
  if (!bus) return miss(bus.error());
  daemon::Daemon daemon(*station, **bus, *store, panel.get());
  return serve(daemon, *configuration);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "clampd, the station's daemon: drives the brake over CAN and judges it. Talk to it with clampctl."};
  app.set_version_flag("--version", std::string(clampd::kVersion));
  std::string configuration;
  std::string plant;
  bool simulated = false;
  app.add_option("--config", configuration, "station configuration (default: /etc/clampd/station.toml)")
      ->type_name("FILE");
  CLI::Option* simulation = app.add_flag("--simulated", simulated,
                                         "a simulated brake in this process instead of CAN: to try the "
                                         "station, results say nothing of hardware");
  app.add_option("--simulated-brake", plant, "which brake is simulated (default: the nominal one)")
      ->type_name("PLANT.toml")
      ->needs(simulation);
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& request) {
    return app.exit(request);
  } catch (const CLI::ParseError& mistake) {
    app.exit(mistake);
    return clampd::cli::kBadInput;
  }
  if (clampd::daemon::logs_to_journal())
    spdlog::set_default_logger(spdlog::systemd_logger_mt("clampd", "clampd"));
  else
    spdlog::set_default_logger(spdlog::stderr_color_mt("clampd"));
  return run(configuration, simulated, plant);
}
