#include <memory>

#include <fmt/format.h>

#include "clampd/archive/store.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/line/master.hpp"
#include "clampd/record/utc.hpp"
#include "clampd/views/master_view.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

int master(bool json, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  if (configuration->master.serial.empty())
    return cli::refuse(
        {"no master brake is configured: [master] names its serial number and its certified limits"});
  // A station that checked nothing yet has a master check due, not a missing database.
  const Result<CheckStore> store = CheckStore::open(configuration->database);
  if (!store) return cli::refuse(store.error());
  const Result<MasterReport> report = master_report(configuration->master, *store, utc_now_ns());
  if (!report) return cli::refuse(report.error());
  if (json)
    fmt::print("{}\n", master_json(*report).dump(2));
  else
    fmt::print("{}", format_master(*report));
  return report->state == MasterState::Good ? cli::kSuccess : cli::kStation;
}

}  // namespace

void add_master_command(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command = app.add_subcommand(
      "master",
      "whether the station still finds the certified values of its master brake; exit code 3 if not, if they "
      "drift, or if a check is due (`clampctl run --master` does it)");
  command->add_flag("--json", *json, "as JSON on standard output");
  command->callback([json, &common, &exit_code] { exit_code = master(*json, common); });
}

}  // namespace clampd::ctl
