#include <atomic>
#include <chrono>
#include <csignal>
#include <memory>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/api/messages.hpp"
#include "clampd/archive/json.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/bench/embedded_station.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/line/master.hpp"
#include "clampd/record/utc.hpp"
#include "clampd/station/session.hpp"
#include "clampd/station/verdict.hpp"
#include "clampd/views/check_table.hpp"
#include "clampd/views/master_view.hpp"
#include "drivers/can/socketcan.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/clampctl/settle_check.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

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
                   std::uint32_t repeats, bool at_most) {
  if (repeats == 0) return;
  line.show(static_cast<double>(repeat) / repeats,
            fmt::format("run {} of {}{}, {}", std::min(repeat + 1, repeats), at_most ? "at most " : "",
                        repeats, phase));
}

/// What a check came to, before anybody is told.
struct Finished {
  nlohmann::ordered_json document;
  std::string table;
  int code = cli::kStation;
};

int show(const RunOptions& options, const Finished& finished) {
  if (options.json != "-") fmt::print("{}", finished.table);
  if (const Result<void> written = cli::write_json(options.json, finished.document); !written)
    return cli::refuse(written.error());
  return finished.code;
}

/// A check of the master brake judges the station, not the brake: it passes if the station finds the
/// certified values, and is an ERROR of the station if not, whatever the limits of other brakes say.
void judge_master(const StationConfiguration& configuration, const CheckStore& store, Finished& finished) {
  const bool about_the_brake = finished.code == cli::kSuccess || finished.code == cli::kBrakeFails;
  if (!about_the_brake && finished.code != cli::kStation) return;
  const Result<MasterReport> report = master_report(configuration.master, store, utc_now_ns());
  const std::string text = report ? format_master(*report) : report.error().message + "\n";
  finished.table = about_the_brake ? text : finished.table + "\n" + text;
  if (!about_the_brake) return;
  finished.code = cli::kSuccess;
  if (report && !asks_for_something(*report)) return;
  finished.document["verdict"] = std::string(to_string(Verdict::Error));
  finished.document["marginal"] = false;
  finished.document["reason"] = report ? report->text : report.error().message;
  finished.code = cli::kStation;
}

/// Before another brake is checked: what the master brake asks for is said, or refuses the check. False: it
/// does.
bool heed_master(const RunOptions& options, const MasterSettings& master, const std::string& asks) {
  if (options.master || asks.empty() || options.request.serial == master.serial) return true;
  if (!master.required) {
    cli::print_notice(asks);
    return true;
  }
  cli::print_error(asks);
  return false;
}

std::string asked_by_master(const MasterSettings& master, const CheckStore& store) {
  const Result<MasterReport> report = master_report(master, store, utc_now_ns());
  if (!report) return report.error().message;
  return asks_for_something(*report) ? report->text : "";
}

/// What a daemon says of a check that is not finished.
void show_progress(cli::ProgressLine& line, const api::CheckProgress& progress,
                   const Result<api::StationStatus>& status) {
  if (!status || !status->judging)
    show_progress(line, progress.phase, progress.repeat, progress.repeats, progress.repeats_auto);
  else if (status->cause_searched > 0.0)
    line.show(status->cause_searched, "the brake is done; searching for the cause");
  else
    line.show(1.0, "the brake is done; making the verdict");
}

int run_embedded(const RunOptions& options, const StationConfiguration& configuration) {
  const std::string& plant_file =
      options.simulated_brake.empty() ? configuration.plant_file : options.simulated_brake;
  const Result<sim::PlantConfiguration> plant = bench::load_plant(plant_file);
  if (!plant) return cli::refuse(plant.error());
  Result<bench::PreparedStation> prepared = bench::prepare_station(configuration);
  if (!prepared) return cli::refuse(prepared.error());
  Result<CheckStore> store = CheckStore::open(configuration.database);
  if (!store) return cli::refuse(store.error());
  if (!heed_master(options, configuration.master, asked_by_master(configuration.master, *store)))
    return cli::kStation;

  cli::ProgressLine line;
  const bool at_most = planned_repeats(options.request, configuration.check).automatic;
  const bench::EmbeddedStation::Progress progress = [&line, at_most](CheckPhase phase, std::uint32_t repeat,
                                                                     std::uint32_t repeats) {
    show_progress(line, to_string(phase), repeat, repeats, at_most);
    return !interrupted;
  };
  const CauseSearch search{[&line](double share, const std::string& words) {
                             line.show(share, "searching for the cause: " + words);
                           },
                           [] { return interrupted.load(); }};
  bench::EmbeddedStation station(std::move(*prepared), *plant);
  station.watch_search(search);
  Result<CheckRecord> record = station.run_check(options.request, &*store, progress);
  line.clear();
  if (!record) return cli::refuse(record.error());
  Finished finished{check_json(*record), format_check(*record, cli::colours_wanted()),
                    exit_code(record->verdict)};
  if (options.settle) {
    SettledCheck settled =
        settle_check(*record, station, *store, configuration.model, progress, search, line);
    line.clear();
    finished.table += "\n" + settled.text;
    finished.document = check_json(*record);  // with what was settled
    if (!settled.experiments.is_null())
      finished.document["cause"]["experiments"] = std::move(settled.experiments);
    if (!settled.problem.empty()) cli::print_error(settled.problem);
    finished.code = settled.exit_code.value_or(finished.code);
  }
  if (options.master) judge_master(configuration, *store, finished);
  return show(options, finished);
}

/// What a daemon that went away in the middle of a check leaves us with: a result that says so.
int daemon_lost(const RunOptions& options, const std::string& id, const std::string& why) {
  CheckRecord record;
  record.id = id;
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

int finish_through_daemon(const RunOptions& options, const StationConfiguration& configuration,
                          const api::CheckProgress& progress) {
  Finished finished{progress.record, progress.table,
                    exit_code(parse_verdict(progress.record.value("verdict", "")).value_or(Verdict::Error))};
  if (!options.master) return show(options, finished);
  const Result<CheckStore> store = CheckStore::open(configuration.database, CheckStore::Access::ReadOnly);
  if (!store) return cli::refuse(store.error());
  judge_master(configuration, *store, finished);
  return show(options, finished);
}

/// Follows this very check, and no other: after a restart of the daemon its numbers begin at 1 again, so that
/// it is told by its record's id.
int follow(const RunOptions& options, const StationConfiguration& configuration, const api::Client& daemon,
           const api::StartedCheck& check) {
  using namespace std::chrono_literals;
  cli::ProgressLine line;
  bool stop_sent = false;
  bool brake_was_done = false;
  int failures = 0;
  while (true) {
    if (interrupted && !stop_sent) {
      const Result<api::StationStatus> status = daemon.status();
      brake_was_done = status && status->judging;
      const Result<void> stopped = daemon.stop();
      if (!stopped) cli::print_error(stopped.error().message + "; trying again");
      stop_sent = stopped.has_value();
    }
    const Result<api::CheckProgress> progress = daemon.progress(options.json != "-" && cli::colours_wanted());
    if (!progress) {
      if (++failures < 3) continue;
      line.clear();
      return daemon_lost(options, check.id, progress.error().message);
    }
    failures = 0;
    const bool other_brake =
        progress->finished && (progress->record.value("serial", "") != normalised(options.request).serial ||
                               progress->record.value("record", "") != check.id);
    if (progress->check != check.check || progress->id != check.id || other_brake) {
      line.clear();
      return daemon_lost(options, check.id, "it was restarted or works on another check");
    }
    if (progress->finished) {
      line.clear();
      return finish_through_daemon(options, configuration, *progress);
    }
    if (stop_sent && brake_was_done) {
      line.clear();
      cli::print_notice(
          "the brake is done; the station goes on with the verdict, which `clampctl results last` will show");
      return cli::kAborted;
    }
    show_progress(line, *progress, daemon.status());
    std::this_thread::sleep_for(100ms);
  }
}

int run_through_daemon(const RunOptions& options, const StationConfiguration& configuration) {
  if (options.settle)
    return cli::refuse(
        {"--settle works with the simulated brake of this process only: a daemon replays the trajectory of "
         "its "
         "configuration and no other. Check without --settle, give the runs to `clampctl diagnose`, and let "
         "a "
         "second check replay the experiment that it designs ([check] trajectory)"});
  const api::Client daemon(configuration.control.address, configuration.control.port,
                           configuration.control.token_file);
  const Result<api::StationStatus> status = daemon.status();
  if (!status) {
    if (const auto interface = can::inspect_interface(configuration.can.interface); !interface)
      return cli::refuse(interface.error());
    cli::print_error(status.error().message);
    return cli::kStation;
  }
  if (!heed_master(options, configuration.master, status->master)) return cli::kStation;
  const Result<api::StartedCheck> check = daemon.start(options.request, status->stops);
  if (!check) {
    cli::print_error(check.error().message);
    return cli::kStation;
  }
  return follow(options, configuration, daemon, *check);
}

enum class Where { InThisProcess, ThroughTheDaemon };

/// A station that is configured without a bus is this process, unless a daemon on a simulated brake answers
/// where status, stop and next look for one: then that is the station.
Result<Where> where_to_check(const RunOptions& options, const StationConfiguration& configuration) {
  if (!options.simulated_brake.empty()) return Where::InThisProcess;
  if (!configuration.embedded()) return Where::ThroughTheDaemon;
  const ControlSettings& api = configuration.control;
  const auto answer = api::Client(api.address, api.port, api.token_file).status();
  if (!answer) return Where::InThisProcess;
  if (answer->simulated) return Where::ThroughTheDaemon;
  return failure(fmt::format(
      "a station with a real brake answers at {}:{}, and no [can] interface is configured here: name its "
      "configuration with --config, or a simulated brake with --simulated-brake",
      api.address, api.port));
}

int run(RunOptions options, const CommonOptions& common) {
  Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  if (options.master) {
    options.request.serial = configuration->master.serial;
    if (options.request.serial.empty())
      return cli::refuse(
          {"no master brake is configured: [master] names its serial number and its certified limits"});
  }
  if (const Result<void> valid = validate(options.request); !valid) return cli::refuse(valid.error());
  options.request = normalised(options.request);
  if (const Result<void> writable = cli::check_document(options.json); !writable)
    return cli::refuse(writable.error());
  watch_for_interrupt();
  const Result<Where> where = where_to_check(options, *configuration);
  if (!where) return cli::refuse(where.error());
  if (*where == Where::ThroughTheDaemon) return run_through_daemon(options, *configuration);
  simulate_brake(*configuration);
  return run_embedded(options, *configuration);
}

}  // namespace

void add_request_options(CLI::App& command, CheckRequest& request) {
  command.add_option("--serial", request.serial, "serial number of the brake")->required();
  command
      .add_option_function<std::string>(
          "--repeats",
          [&request](const std::string& given) {
            request.repeats_auto = given == "auto";
            request.repeats = request.repeats_auto ? 0 : static_cast<std::uint32_t>(std::stoul(given));
          },
          "how often to run the trajectory, or `auto`: until every limit is decided, the configured "
          "repeats_most at most (default: as configured, auto)")
      ->type_name("NUMBER|auto")
      ->check([](const std::string& given) {
        const std::string wrong = CLI::Range(1, 200)(given);
        return given == "auto" || wrong.empty() ? std::string()
                                                : "must be a whole number from 1 to 200, or auto: " + given;
      });
  command.add_option("--operator", request.operator_name, "who checks");
  command.add_option("--part-number", request.part_number, "part number of the brake: chooses its recipe where the station has recipes "
                     "(default: by the serial number)");
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
