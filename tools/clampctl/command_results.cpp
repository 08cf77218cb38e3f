#include <memory>

#include <fmt/format.h>

#include "clampd/archive/json.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/archive/table.hpp"
#include "tools/assembly/prepared_station.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

struct ResultsOptions {
  CheckFilter filter;
  std::string verdict;
  std::string id;
  bool json = false;
};

int results(ResultsOptions options, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = assembly::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  const Result<CheckStore> store = CheckStore::open(configuration->database, CheckStore::Access::ReadOnly);
  if (!store) return cli::refuse(store.error());

  if (!options.id.empty()) {
    const Result<CheckRecord> record = store->load(options.id);
    if (!record) return cli::refuse(record.error());
    if (options.json)
      fmt::print("{}\n", check_json(*record).dump(2));
    else
      fmt::print("{}", format_check(*record, cli::colours_wanted()));
    return cli::kSuccess;
  }

  options.filter.verdict = parse_verdict(options.verdict);
  const Result<std::vector<CheckSummary>> checks = store->list(options.filter);
  if (!checks) return cli::refuse(checks.error());
  if (options.json)
    fmt::print("{}\n", summaries_json(*checks).dump(2));
  else
    fmt::print("{}", format_checks(*checks, cli::colours_wanted()));
  return cli::kSuccess;
}

}  // namespace

void add_results_command(CLI::App& app, const CommonOptions& common, int& exit_code) {
  auto options = std::make_shared<ResultsOptions>();
  CLI::App* command = app.add_subcommand("results", "past verdicts");
  command->add_option("id", options->id, "show this check whole: its id, the beginning of it, or `last`");
  command->add_option("--serial", options->filter.serial, "only of this brake");
  command->add_option("--verdict", options->verdict, "only with this verdict")
      ->check(CLI::IsMember({"PASS", "FAIL", "ERROR", "TIMEOUT", "ABORTED"}));
  command->add_option("--since", options->filter.since, "only started then or later (date or RFC 3339)");
  command->add_option("--limit", options->filter.limit, "at most so many, newest first")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  command->add_flag("--json", options->json, "as JSON on standard output");
  command->callback([options, &common, &exit_code] { exit_code = results(*options, common); });
}

}  // namespace clampd::ctl
