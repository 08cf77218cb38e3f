#include <memory>

#include <fmt/format.h>

#include "clampd/archive/store.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/record/file.hpp"
#include "clampd/views/check_report.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

struct ReportOptions {
  std::string serial;
  std::string id;
  std::string out;
};

Result<CheckRecord> chosen_check(const ReportOptions& options, const CheckStore& store) {
  CheckFilter filter;
  filter.serial = options.serial;
  filter.limit = 1;
  if (options.id.empty()) {
    const Result<std::vector<CheckSummary>> newest = store.list(filter);
    if (!newest) return tl::unexpected(newest.error());
    if (newest->empty())
      return failure(fmt::format("no check of {}; `clampctl results` lists what there is", options.serial));
    return store.load(newest->front().id);
  }
  Result<CheckRecord> check = store.load(options.id);
  if (check && check->serial != options.serial)
    return failure(fmt::format("check {} is one of {}, not of {}", check->id, check->serial, options.serial));
  return check;
}

int report(const ReportOptions& options, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  const Result<CheckStore> store = CheckStore::open(configuration->database, CheckStore::Access::ReadOnly);
  if (!store) return cli::refuse(store.error());
  CheckReportContents contents;
  Result<CheckRecord> check = chosen_check(options, *store);
  if (!check) return cli::refuse(check.error());
  contents.check = std::move(*check);
  CheckFilter of_serial;
  of_serial.serial = options.serial;
  Result<std::vector<CheckRecord>> history = store->load_results(of_serial);
  if (!history) return cli::refuse(history.error());
  contents.history = std::move(*history);
  // Trajectory and guard band are those of today's configuration and recipes: shown only where the check had the same.
  const Result<bench::PreparedStation> station = bench::prepare_station(*configuration);
  std::vector<const bench::PreparedCheck*> checks;
  if (station) {
    checks.push_back(&*station);
    for (const bench::PreparedRecipe& recipe : station->recipes) checks.push_back(&recipe);
  }
  for (const bench::PreparedCheck* of_today : checks) {
    if (of_today->trajectory_sha256 == contents.check.trajectory_sha256)
      contents.reference = &of_today->plan.reference;
    if (of_today->limits.sha256 == contents.check.limits_sha256)
      contents.guard_band_k = of_today->limits.guard_band_k;
  }

  const Result<std::string> page = check_report(contents);
  if (!page) return cli::refuse(page.error());
  if (options.out == "-") {
    fmt::print("{}", *page);
    return cli::kSuccess;
  }
  const std::string path =
      options.out.empty() ? fmt::format("check-{}.html", contents.check.id) : options.out;
  if (const Result<void> written = write_file_atomically(path, *page); !written)
    return cli::refuse(written.error());
  fmt::print("{}\n", path);
  return cli::kSuccess;
}

}  // namespace

void add_report_command(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto options = std::make_shared<ReportOptions>();
  CLI::App* command =
      app.add_subcommand("report", "a report on one brake as an HTML file that needs nothing else");
  command->add_option("serial", options->serial, "serial number of the brake")->required();
  command->add_option("--id", options->id, "this check of it (default: its newest)");
  command->add_option("--out", options->out, "where to (default: check-ID.html here); - for standard output")
      ->type_name("FILE.html");
  command->callback([options, &common, &exit_code] { exit_code = report(*options, common); });
}

}  // namespace clampd::ctl
