#include <atomic>
#include <chrono>
#include <csignal>
#include <memory>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/archive/json.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/archive/table.hpp"
#include "clampd/record/utc.hpp"
#include "clampd/station/session.hpp"
#include "clampd/station/verdict.hpp"
#include "drivers/can/socketcan.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "tools/assembly/embedded_station.hpp"
#include "tools/assembly/prepared_station.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/clampctl/settle_check.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"
#include "tools/control/messages.hpp"
#include "tools/records/master.hpp"

namespace clampd::ctl {

namespace {

struct RunOptions {
  CheckRequest request;
  std::string simulated_brake;
  std::string json;
  bool settle = false;
  bool master = false;
};

std::atomic<bool> interrupted{false};

/// Ctrl-C stops the brake first; the command then ends with what the station made of it.
void watch_for_interrupt() {
  interrupted = false;
  struct sigaction action {};
  action.sa_handler = [](int) { interrupted = true; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

void show_progress(cli::ProgressLine& line, std::string_view phase, std::uint32_t repeat,
                   std::uint32_t repeats) {
  if (repeats == 0) return;
  line.show(static_cast<double>(repeat) / repeats,
            fmt::format("run {} of {}, {}", std::min(repeat + 1, repeats), repeats, phase));
}

int run_embedded(const RunOptions& options, StationConfiguration configuration) {
  configuration.simulated_brake = true;
  const std::string& plant_file =
      options.simulated_brake.empty() ? configuration.plant_file : options.simulated_brake;
  const Result<sim::PlantConfiguration> plant = assembly::load_plant(plant_file);
  if (!plant) return cli::refuse(plant.error());
  Result<assembly::PreparedStation> prepared = assembly::prepare_station(configuration);
  if (!prepared) return cli::refuse(prepared.error());
  Result<CheckStore> store = CheckStore::open(configuration.database);
  if (!store) return cli::refuse(store.error());

  cli::ProgressLine line;
  const assembly::EmbeddedStation::Progress progress = [&line](CheckPhase phase, std::uint32_t repeat,
                                                               std::uint32_t repeats) {
    show_progress(line, to_string(phase), repeat, repeats);
    return !interrupted;
  };
  assembly::EmbeddedStation station(std::move(*prepared), *plant);
  const Result<CheckRecord> record = station.run_check(options.request, &*store, progress);
  line.clear();
  if (!record) return cli::refuse(record.error());
  const bool for_people = options.json != "-";
  if (for_people) fmt::print("{}", format_check(*record, cli::colours_wanted()));
  nlohmann::ordered_json document = check_json(*record);
  int code = exit_code(record->verdict);
  if (options.settle) {
    SettledCheck settled = settle_check(*record, station, *store, configuration.model, progress, line);
    line.clear();
    if (for_people) fmt::print("\n{}", settled.text);
    document["cause"] = std::move(settled.cause);
    if (!settled.problem.empty()) cli::print_error(settled.problem);
    code = settled.exit_code.value_or(code);
  }
  if (const Result<void> written = cli::write_json(options.json, document); !written)
    return cli::refuse(written.error());
  return code;
}

int exit_code_of(const std::string& verdict) {
  return exit_code(parse_verdict(verdict).value_or(Verdict::Error));
}

/// What a daemon that went away in the middle of a check leaves us with: a result that says so.
int daemon_lost(const RunOptions& options, const std::string& why) {
  CheckRecord record;
  record.serial = options.request.serial;
  record.repeats = options.request.repeats;
  record.verdict = Verdict::Error;
  record.reason = "the station's daemon went away during the check: " + why;
  if (const Result<void> written = cli::write_json(options.json, check_json(record)); !written)
    cli::print_error(written.error().message);
  cli::print_error(
      record.reason +
      ". The brake drops its torque by itself after 20 ms; look at the rig before the next check");
  return cli::kStation;
}

int run_through_daemon(const RunOptions& options, const StationConfiguration& configuration) {
  using namespace std::chrono_literals;
  if (options.settle)
    return cli::refuse(
        {"--settle works with the simulated brake of this process only: a daemon replays the trajectory of "
         "its "
         "configuration and no other. Check without --settle, give the runs to `clampctl diagnose`, and let "
         "a "
         "second check replay the experiment that it designs ([check] trajectory)"});
  const control::Client daemon(configuration.control.address, configuration.control.port,
                               configuration.control.token_file);
  if (const Result<control::StationStatus> status = daemon.status(); !status) {
    if (const auto interface = can::inspect_interface(configuration.can.interface); !interface)
      return cli::refuse(interface.error());
    cli::print_error(status.error().message);
    return cli::kStation;
  }
  const Result<std::uint64_t> check = daemon.start(options.request);
  if (!check) {
    cli::print_error(check.error().message);
    return cli::kStation;
  }

  cli::ProgressLine line;
  bool stop_sent = false;
  int failures = 0;
  while (true) {
    if (interrupted && !stop_sent) {
      const Result<void> stopped = daemon.stop();
      if (!stopped) cli::print_error(stopped.error().message + "; trying again");
      stop_sent = stopped.has_value();
    }
    const Result<control::CheckProgress> progress =
        daemon.progress(options.json != "-" && cli::colours_wanted());
    if (!progress) {
      if (++failures < 3) continue;
      line.clear();
      return daemon_lost(options, progress.error().message);
    }
    failures = 0;
    if (progress->check != *check) {
      line.clear();
      return daemon_lost(options, "it was restarted or works on another check");
    }
    if (progress->finished) {
      line.clear();
      if (const Result<void> written = cli::write_json(options.json, progress->record); !written)
        return cli::refuse(written.error());
      if (options.json != "-") fmt::print("{}", progress->table);
      return exit_code_of(progress->record.value("verdict", ""));
    }
    show_progress(line, progress->phase, progress->repeat, progress->repeats);
    std::this_thread::sleep_for(100ms);
  }
}

/// A check of the master brake judges the station, not the brake.
int judge_master(const RunOptions& options, const StationConfiguration& configuration, int check_code) {
  if (check_code != cli::kSuccess && check_code != cli::kBrakeFails) return check_code;
  const Result<MasterReport> report = CheckStore::open(configuration.database, CheckStore::Access::ReadOnly)
                                          .and_then([&](const CheckStore& store) {
                                            return master_report(configuration.master, store, utc_now_ns());
                                          });
  if (!report) return cli::refuse(report.error());
  if (options.json != "-") fmt::print("\n{}", format_master(*report));
  return asks_for_something(*report) ? cli::kStation : cli::kSuccess;
}

int run(RunOptions options, const CommonOptions& common) {
  Result<StationConfiguration> configuration = assembly::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  if (options.master) {
    options.request.serial = configuration->master.serial;
    if (options.request.serial.empty())
      return cli::refuse(
          {"no master brake is configured: [master] names its serial number and its certified limits"});
  }
  if (const Result<void> valid = validate(options.request); !valid) return cli::refuse(valid.error());
  if (const Result<void> writable = cli::check_document(options.json); !writable)
    return cli::refuse(writable.error());
  watch_for_interrupt();
  const int code = configuration->embedded() || !options.simulated_brake.empty()
                       ? run_embedded(options, *configuration)
                       : run_through_daemon(options, *configuration);
  return options.master ? judge_master(options, *configuration, code) : code;
}

}  // namespace

void add_request_options(CLI::App& command, CheckRequest& request) {
  command.add_option("--serial", request.serial, "serial number of the brake")->required();
  command
      .add_option("--repeats", request.repeats,
                  "how often to run the trajectory (default: as configured, 20)")
      ->check(CLI::Range(1, 200));
  command.add_option("--operator", request.operator_name, "who checks");
  command.add_option("--part-number", request.part_number, "part number of the brake");
  command.add_option("--batch", request.batch, "batch of the brake");
}

void add_run_command(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command = app.add_subcommand("run", "check one brake and say pass or fail");
  add_request_options(*command, options->request);
  CLI::Option* serial = command->get_option("--serial");
  command
      ->add_flag("--master", options->master,
                 "check the master brake of [master] instead: exit code 3 if the station does not find its "
                 "certified values")
      ->excludes(serial);
  command
      ->add_option(
          "--simulated-brake", options->simulated_brake,
          "check a simulated brake, in virtual time and in this process, even if a daemon is configured")
      ->type_name("PLANT.toml");
  command->add_flag("--settle", options->settle,
                    "if the runs have several possible explanations, design the experiment that tells them "
                    "apart, run it, and decide");
  command->add_option("--json", options->json, "write the result as clampd.check/1; - for standard output")
      ->type_name("FILE");
  serial->required(false);
  command->callback([options, serial, &common, &exit_code] {
    if (!options->master && serial->count() == 0) throw CLI::RequiredError("--serial");
    exit_code = run(*options, common);
  });
}

}  // namespace clampd::ctl
