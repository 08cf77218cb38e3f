#include <array>
#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/attribution/attribution.hpp"
#include "clampd/attribution/line_monitor.hpp"
#include "clampd/record/file.hpp"
#include "clampd/views/attribution_view.hpp"
#include "clampd/views/monitor_view.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

struct LineOptions {
  std::vector<std::string> files;
  attribution::AttributionOptions attribution;
  bool json = false;
};

int line(const LineOptions& options) {
  if (options.files.empty())
    return cli::refuse(
        {"no file named: give the stations' checks, as `clampctl results --csv FILE` writes them"});
  const Result<attribution::LineTable> table = attribution::read_line_table(options.files);
  if (!table) return cli::refuse(table.error());
  const attribution::LineAttribution found = attribution::attribute(*table, options.attribution);
  if (options.json)
    fmt::print("{}\n", attribution_json(*table, found, options.attribution.false_alarms).dump(2));
  else
    fmt::print("{}", format_attribution(*table, found, options.attribution.false_alarms));
  return cli::kSuccess;
}

constexpr auto kPatience = std::chrono::seconds(5);  // for another monitor that has the state

struct MonitorOptions {
  std::vector<std::string> files;
  std::string state;
  std::optional<double> false_alarms_per_year;
  std::vector<std::string> acknowledged;
  std::string json;
};

/// From the state file, or a new one where there is none.
Result<attribution::LineMonitor> load_monitor(const MonitorOptions& options) {
  attribution::LineMonitor monitor;
  monitor.false_alarms_per_year = options.false_alarms_per_year.value_or(monitor.false_alarms_per_year);
  std::error_code ignored;
  if (options.state.empty() || !std::filesystem::exists(options.state, ignored)) return monitor;
  const Result<std::string> text = read_file(options.state);
  if (!text) return tl::unexpected(text.error());
  Result<attribution::LineMonitor> known = parse_monitor_state(*text, options.state);
  if (known && options.false_alarms_per_year &&
      *options.false_alarms_per_year != known->false_alarms_per_year)
    return failure(
        fmt::format("{}: was begun with --false-alarms-per-year {:g}, not {:g}: leave the option out, or "
                    "name a new state file",
                    options.state, known->false_alarms_per_year, *options.false_alarms_per_year));
  return known;
}

Result<void> acknowledge_all(attribution::LineMonitor& monitor, const MonitorOptions& options) {
  for (const std::string& name : options.acknowledged) {
    const std::size_t slash = name.rfind('/');
    if (slash == std::string::npos)
      return failure(fmt::format("--acknowledge {}: is not STATION/PARAMETER", name));
    const Result<void> done =
        attribution::acknowledge(monitor, name.substr(0, slash), name.substr(slash + 1));
    if (!done) return failure("--acknowledge " + done.error().message);
  }
  return {};
}

int monitor_line(const MonitorOptions& options) {
  if (options.files.empty() && options.acknowledged.empty())
    return cli::refuse(
        {"no file named: give the stations' checks, as `clampctl results --csv FILE` writes them"});
  if (!options.acknowledged.empty() && options.state.empty())
    return cli::refuse({"--acknowledge needs the state file that holds the alarm: --state FILE"});
  const std::array<cli::OutputOption, 2> outputs{{{"--state", options.state}, {"--json", options.json}}};
  if (const Result<void> can = cli::check_outputs(outputs, options.files); !can)
    return cli::refuse(can.error());
  std::optional<FileLock> lock;
  if (!options.state.empty()) {
    Result<FileLock> taken = FileLock::take(options.state, kPatience);
    if (!taken) return cli::refuse(taken.error());
    lock.emplace(std::move(*taken));
  }
  Result<attribution::LineMonitor> monitor = load_monitor(options);
  if (!monitor) return cli::refuse(monitor.error());
  if (const Result<void> done = acknowledge_all(*monitor, options); !done) return cli::refuse(done.error());
  attribution::MonitorCount count;
  if (!options.files.empty()) {
    const Result<attribution::LineTable> table = attribution::read_line_table(options.files, 0);
    if (!table) return cli::refuse(table.error());
    const Result<attribution::MonitorCount> counted = attribution::monitor(*monitor, *table);
    if (!counted) return cli::refuse(counted.error());
    count = *counted;
  }
  if (!options.state.empty())
    if (const Result<void> done =
            write_file_atomically(options.state, monitor_state_json(*monitor).dump() + "\n");
        !done)
      return cli::refuse(done.error());
  if (options.json != "-") fmt::print("{}", format_monitor(*monitor, count));
  if (const Result<void> done = cli::write_json(options.json, monitor_json(*monitor, count)); !done)
    return cli::refuse(done.error());
  for (const attribution::ParameterMonitor& parameter : monitor->parameters)
    for (const attribution::StationMonitor& station : parameter.stations)
      if (station.alarm) return cli::kStation;
  return cli::kSuccess;
}

void add_monitor_command(CLI::App& line, int& exit_code) {
  auto options = std::make_shared<MonitorOptions>();
  CLI::App* command =
      line.add_subcommand("monitor",
                          "which station changed in which parameter, day by day, with a promised number of "
                          "false alarms. Goes on from the state file; a day is "
                          "counted once, as soon as a later one has checks. Exit code 3 while there is an "
                          "alarm, 0 without (docs/monitor.md)");
  command
      ->add_option(
          "FILES", options->files,
          "checks of all stations, as `clampctl results --csv FILE` writes them; old ones may be among them")
      ->type_name("CHECKS.csv");
  command
      ->add_option("--state", options->state,
                   "where the monitor goes on and what it writes (clampd.line_monitor_state/1); begun if it "
                   "is not there")
      ->type_name("FILE");
  command
      ->add_option("--false-alarms-per-year", options->false_alarms_per_year,
                   "so many false alarms of the whole line on average, at most; 1 unless the state file says "
                   "otherwise")
      ->check(CLI::Range(1e-3, 100.0));
  command
      ->add_option("--acknowledge", options->acknowledged,
                   "the cause of this alarm was mended: its detector begins anew, before FILES are read")
      ->type_name("STATION/PARAMETER")
      ->expected(1)
      ->take_all();
  command->add_option("--json", options->json, "as JSON (clampd.line_monitor/1); - is standard output")
      ->type_name("FILE");
  command->callback([options, &exit_code] { exit_code = monitor_line(*options); });
}

}  // namespace

void add_line_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<LineOptions>();
  CLI::App* command = app.add_subcommand("line",
                                         "whose fault it is: which station or batch differs, drifts or "
                                         "changed in which parameter, and how much of the spread "
                                         "comes from brakes, batches, stations, time and repeats");
  command
      ->add_option("FILES", options->files,
                   "checks of the stations, as `clampctl results --csv FILE` of each writes them; "
                   "docs/attribution.md has a query "
                   "that takes them from the database")
      ->type_name("CHECKS.csv");
  command
      ->add_option("--false-alarms", options->attribution.false_alarms,
                   "probability that anything is found on a line where there is nothing")
      ->check(CLI::Range(1e-6, 0.5))
      ->capture_default_str();
  command->add_option("--threads", options->attribution.threads, "0: all processors")
      ->check(CLI::Range(0, 64))
      ->capture_default_str();
  command->add_flag("--json", options->json, "as JSON on standard output (clampd.line/1)");
  add_monitor_command(*command, exit_code);
  command->callback([options, command, &exit_code] {
    if (command->get_subcommands().empty()) exit_code = line(*options);
  });
}

}  // namespace clampd::ctl
