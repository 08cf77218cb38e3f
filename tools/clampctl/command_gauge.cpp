#include <map>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/line/gauge_study.hpp"
#include "clampd/record/file.hpp"
#include "clampd/views/gauge_view.hpp"
#include "tools/clampctl/check_selection.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

constexpr std::uint32_t kMaxChecks = 100'000;

struct GaugeCommandOptions {
  std::shared_ptr<CheckFilter> filter;
  std::string study;
  std::vector<std::string> tolerances;
  std::string report;
  bool json = false;
};

Result<std::map<std::string, double>> parse_tolerances(const std::vector<std::string>& texts) {
  std::map<std::string, double> tolerances;
  for (const std::string& text : texts) {
    const std::size_t equals = text.find('=');
    double value = 0.0;
    if (equals == std::string::npos || !CLI::detail::lexical_cast(text.substr(equals + 1), value) ||
        !(value > 0.0))
      return failure(fmt::format("--tolerance {}: write COLUMN=VALUE with a positive value", text));
    tolerances[text.substr(0, equals)] = value;
  }
  return tolerances;
}

Result<std::vector<GaugeQuantity>> from_file(const GaugeCommandOptions& options) {
  const Result<std::map<std::string, double>> tolerances = parse_tolerances(options.tolerances);
  if (!tolerances) return tl::unexpected(tolerances.error());
  return read_file(options.study).and_then([&](const std::string& text) {
    return gauge_of_csv(text, options.study, *tolerances);
  });
}

Result<std::vector<GaugeQuantity>> from_archive(const GaugeCommandOptions& options,
                                                const CommonOptions& common) {
  return bench::load_configuration(common.config).and_then([&](const StationConfiguration& configuration) {
    return CheckStore::open(configuration.database, CheckStore::Access::ReadOnly)
        .and_then([&](const CheckStore& store) { return store.load_results(*options.filter); })
        .and_then([](const std::vector<CheckRecord>& checks) { return gauge_of_checks(checks); });
  });
}

int gauge(const GaugeCommandOptions& options, const CommonOptions& common) {
  const Result<std::vector<GaugeQuantity>> quantities =
      options.study.empty() ? from_archive(options, common) : from_file(options);
  if (!quantities) return cli::refuse(quantities.error());
  if (!options.report.empty()) {
    const auto written =
        gauge_report(*quantities, options.study.empty() ? "from the station's checks" : options.study)
            .and_then([&](const std::string& page) { return write_file_atomically(options.report, page); });
    if (!written) return cli::refuse(written.error());
  }
  if (options.json)
    fmt::print("{}\n", gauge_json(*quantities).dump(2));
  else
    fmt::print("{}", format_gauge(*quantities));
  return cli::kSuccess;
}

}  // namespace

void add_gauge_command(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto options = std::make_shared<GaugeCommandOptions>();
  CLI::App* command = app.add_subcommand(
      "gauge",
      "gauge R&R of the identified parameters, crossed, by analysis of variance: from checks (parts are "
      "serial numbers; every operator checks every brake equally often), or from a file");
  command
      ->add_option("--study", options->study,
                   "a CSV file instead: columns part, operator, and one column per quantity")
      ->type_name("FILE.csv");
  command
      ->add_option("--tolerance", options->tolerances,
                   "with --study: upper minus lower limit of a column, COLUMN=VALUE")
      ->needs("--study");
  options->filter = add_check_selection(*command, kMaxChecks);
  command->add_option("--report", options->report, "write a page with figures")->type_name("FILE.html");
  command->add_flag("--json", options->json, "as JSON on standard output");
  command->callback([options, &common, &exit_code] { exit_code = gauge(*options, common); });
}

}  // namespace clampd::ctl
