#include <memory>

#include <fmt/format.h>

#include "clampd/archive/store.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/line/line_statistics.hpp"
#include "clampd/views/limits_view.hpp"
#include "clampd/views/line_statistics_view.hpp"
#include "tools/clampctl/check_selection.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

constexpr std::uint32_t kMaxChecks = 1'000'000;

int statistics(const CheckFilter& filter, bool json, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  const Result<CheckStore> store = CheckStore::open(configuration->database, CheckStore::Access::ReadOnly);
  if (!store) return cli::refuse(store.error());
  Result<std::vector<CheckRecord>> checks = store->load_results(filter);
  if (!checks) return cli::refuse(checks.error());
  const LineStatistics found = line_statistics(std::move(*checks), configuration->master.serial);
  if (json)
    fmt::print("{}\n", statistics_json(found).dump(2));
  else
    fmt::print("{}", format_statistics(found));
  return cli::kSuccess;
}

int limits(bool json, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  const Result<CheckStore> store = CheckStore::open(configuration->database, CheckStore::Access::ReadOnly);
  if (!store) return cli::refuse(store.error());
  const Result<std::vector<LimitsRevision>> history = store->limits_history();
  if (!history) return cli::refuse(history.error());
  const std::vector<LimitsStep> steps = limits_steps(*history);
  if (json)
    fmt::print("{}\n", limits_json(steps).dump(2));
  else
    fmt::print("{}", format_limits(steps));
  return cli::kSuccess;
}

}  // namespace

void add_statistics_commands(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command = app.add_subcommand(
      "statistics", "yield, capability and control charts of the identified parameters over many brakes");
  const std::shared_ptr<CheckFilter> filter = add_check_selection(*command, kMaxChecks);
  command->add_flag("--json", *json, "as JSON on standard output");
  command->callback([filter, json, &common, &exit_code] { exit_code = statistics(*filter, *json, common); });

  auto limits_as_json = std::make_shared<bool>(false);
  CLI::App* history =
      app.add_subcommand("limits", "the limits files that checks were judged by: who changed what, and when");
  history->add_flag("--json", *limits_as_json, "as JSON on standard output");
  history->callback([limits_as_json, &common, &exit_code] { exit_code = limits(*limits_as_json, common); });
}

}  // namespace clampd::ctl
