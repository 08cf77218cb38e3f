#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/attribution/attribution.hpp"
#include "clampd/views/attribution_view.hpp"
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
  const Result<attribution::LineTable> table = attribution::read_line_table(options.files);
  if (!table) return cli::refuse(table.error());
  const attribution::LineAttribution found = attribution::attribute(*table, options.attribution);
  if (options.json)
    fmt::print("{}\n", attribution_json(*table, found, options.attribution.false_alarms).dump(2));
  else
    fmt::print("{}", format_attribution(*table, found, options.attribution.false_alarms));
  return cli::kSuccess;
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
      ->required()
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
  command->callback([options, &exit_code] { exit_code = line(*options); });
}

}  // namespace clampd::ctl
