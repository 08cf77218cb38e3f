#include <pwd.h>
#include <unistd.h>

#include <limits>
#include <map>
#include <memory>

#include <fmt/format.h>

#include "clampd/archive/csv.hpp"
#include "clampd/archive/dfq.hpp"
#include "clampd/archive/json.hpp"
#include "clampd/archive/raw_data.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/parameters/brake_parameters.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/text.hpp"
#include "clampd/record/utc.hpp"
#include "clampd/views/check_table.hpp"
#include "clampd/views/retention_view.hpp"
#include "drivers/can/candump.hpp"
#include "tools/clampctl/check_selection.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

constexpr std::uint32_t kListed = 50;
constexpr std::uint32_t kExported = 1'000'000;

struct ResultsOptions {
  std::shared_ptr<CheckFilter> filter;
  CLI::Option* limit = nullptr;
  CLI::Option* voiding = nullptr;
  std::string id;
  std::string csv;
  std::string dfq;
  std::string candump;
  std::string flight;
  std::string runs;
  std::string void_reason;
  bool json = false;
  bool prune = false;
  bool yes = false;
};

int show_one(const ResultsOptions& options, const CheckStore& store) {
  const Result<CheckRecord> record = store.load(options.id);
  if (!record) return cli::refuse(record.error());
  if (options.json)
    fmt::print("{}\n", check_json(*record).dump(2));
  else
    fmt::print("{}", format_check(*record, cli::colours_wanted()));
  return cli::kSuccess;
}

/// To standard output for "-".
Result<void> write_text(const std::string& file, const std::string& text) {
  if (file != "-") return write_file_atomically(file, text);
  fmt::print("{}", text);
  return {};
}

int write_candump(const ResultsOptions& options, const StationConfiguration& configuration,
                  const CheckStore& store) {
  if (options.id.empty()) return cli::refuse({"--candump exports one check: give its id, or `last`"});
  const Result<CheckRecord> record = store.load(options.id);
  if (!record) return cli::refuse(record.error());
  const Result<bench::PreparedStation> station = bench::prepare_station(configuration);
  if (!station) return cli::refuse(station.error());
  const std::string interface = configuration.embedded() ? "can0" : configuration.can.interface;
  const auto written =
      format_candump(*record, station->codec, interface).and_then([&](const std::string& log) {
        return write_text(options.candump, log);
      });
  if (!written) return cli::refuse(written.error());
  cli::print_notice(
      "frames were reconstructed from the record's samples; they are not those that were on the bus");
  return cli::kSuccess;
}

Result<std::string> dfq_of(const std::vector<CheckRecord>& checks) {
  std::map<std::string, double> nominal;
  for (const ParameterInfo& parameter : kParameterTable) nominal.emplace(parameter.name, parameter.nominal);
  return format_dfq(checks, nominal);
}

/// The one that `id` names, or all that were chosen.
Result<std::vector<CheckRecord>> chosen_checks(const ResultsOptions& options, const CheckStore& store) {
  if (!options.id.empty())
    return store.load(options.id).map([](CheckRecord&& check) { return std::vector{std::move(check)}; });
  CheckFilter filter = *options.filter;
  if (options.limit->count() == 0) filter.limit = kExported;  // an export that is cut short misleads
  return store.load_results(filter);
}

int write_tables(const ResultsOptions& options, const CheckStore& store) {
  const Result<std::vector<CheckRecord>> checks = chosen_checks(options, store);
  if (!checks) return cli::refuse(checks.error());
  if (!options.csv.empty())
    if (const auto written = write_text(options.csv, format_csv(*checks)); !written)
      return cli::refuse(written.error());
  if (!options.dfq.empty()) {
    const auto written =
        dfq_of(*checks).and_then([&](const std::string& text) { return write_text(options.dfq, text); });
    if (!written) return cli::refuse(written.error());
  }
  cli::print_notice(fmt::format("{} {} exported", checks->size(), checks->size() == 1 ? "check" : "checks"));
  return cli::kSuccess;
}

int write_raw_data(const ResultsOptions& options, const CheckStore& store) {
  if (options.id.empty())
    return cli::refuse({"--runs and --flight export one check: give its id, or `last`"});
  const Result<CheckRecord> record = store.load(options.id);
  if (!record) return cli::refuse(record.error());
  if (!options.flight.empty()) {
    const auto written = format_flight_recorder(*record).and_then(
        [&](const std::string& text) { return write_text(options.flight, text); });
    if (!written) return cli::refuse(written.error());
  }
  if (options.runs.empty()) return cli::kSuccess;
  const Result<std::size_t> written = write_run_files(*record, options.runs);
  if (!written) return cli::refuse(written.error());
  cli::print_notice(fmt::format("{} runs written; `clampctl diagnose {}/run-*.csv` looks for a cause",
                                *written, options.runs));
  return cli::kSuccess;
}

std::string user_name() {
  const passwd* user = ::getpwuid(::getuid());
  return user == nullptr ? fmt::format("user {}", ::getuid()) : user->pw_name;
}

int mark_void(const ResultsOptions& options, const StationConfiguration& configuration) {
  if (options.id.empty()) return cli::refuse({"--void marks one check: give its id, or `last`"});
  const std::string reason = trimmed(options.void_reason);
  if (reason.empty()) return cli::refuse({"--void needs a reason in words: it stays with the record"});
  const Result<std::string> id = CheckStore::open(configuration.database).and_then([&](CheckStore store) {
    return store.mark_void(options.id, {reason, user_name(), format_utc(utc_now_ns())});
  });
  if (!id) return cli::refuse(id.error());
  fmt::print("{} is void: it stays on record, and counts in no statistics.\n", *id);
  return cli::kSuccess;
}

int prune(const ResultsOptions& options, const StationConfiguration& configuration) {
  const RetentionPolicy policy = bench::retention_policy(configuration);
  if (policy.keeps_all())
    return cli::refuse(
        {"[retention] keeps all raw runs (raw_days = 0 and raw_megabytes = 0): nothing to remove"});
  Result<CheckStore> store = CheckStore::open(configuration.database);
  if (!store) return cli::refuse(store.error());
  const Result<RetentionSummary> summary =
      options.yes ? store->apply_retention(policy, utc_now_ns(), std::numeric_limits<std::size_t>::max())
                  : store->plan_retention(policy, utc_now_ns());
  if (!summary) return cli::refuse(summary.error());
  if (options.json)
    fmt::print("{}\n", retention_json(*summary, options.yes).dump(2));
  else
    fmt::print("{}", format_retention(*summary, options.yes));
  return cli::kSuccess;
}

int results(const ResultsOptions& options, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  if (options.prune) return prune(options, *configuration);
  if (options.voiding->count() > 0) return mark_void(options, *configuration);
  const Result<CheckStore> store = CheckStore::open(configuration->database, CheckStore::Access::ReadOnly);
  if (!store) return cli::refuse(store.error());
  if (!options.candump.empty()) return write_candump(options, *configuration, *store);
  if (!options.runs.empty() || !options.flight.empty()) return write_raw_data(options, *store);
  if (!options.csv.empty() || !options.dfq.empty()) return write_tables(options, *store);
  if (!options.id.empty()) return show_one(options, *store);

  const Result<std::vector<CheckSummary>> checks = store->list(*options.filter);
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
  CLI::App* command = app.add_subcommand("results", "past verdicts: list, show, export, prune");
  command->add_option("id", options->id, "show this check whole: its id, the beginning of it, or `last`");
  options->filter = add_check_selection(*command, kListed);
  options->limit = command->get_option("--limit");
  command->add_flag("--json", options->json, "as JSON on standard output");
  command
      ->add_option("--csv", options->csv,
                   "write the chosen checks (or the one of `id`), one a row, with all parameters; - for "
                   "standard output")
      ->type_name("FILE");
  command
      ->add_option("--dfq", options->dfq,
                   "write the chosen checks (or the one of `id`) as a Q-DAS (AQDEF) file: one characteristic "
                   "per parameter with "
                   "nominal value and limits (K2002, K2101, K2110, K2111), one value set per check (K0001; "
                   "K0002 255 where the check was invalid; K0004 time, K0006 batch, K0008 operator, K0010 "
                   "station, K0014 serial number). All must be of one part and one set of limits")
      ->type_name("FILE");
  command
      ->add_option("--candump", options->candump,
                   "write the runs of one check (`id`) as a `candump -l` log, for canplayer and log2asc; its "
                   "frames are reconstructed from the recorded samples")
      ->type_name("FILE");
  command
      ->add_option(
          "--runs", options->runs,
          "write the raw runs of one check (`id`) as run files into this folder, for `clampctl diagnose`")
      ->type_name("FOLDER");
  command
      ->add_option(
          "--flight", options->flight,
          "write the last samples before the fault of one check (`id`) as CSV; - for standard output")
      ->type_name("FILE");
  options->voiding =
      command
          ->add_option("--void", options->void_reason,
                       "mark one check (`id`) as void, for this reason: it stays on record, and "
                       "counts in no statistics")
          ->type_name("REASON");
  command->add_flag("--prune", options->prune,
                    "say which raw runs [retention] lets go; results and parameters always stay");
  command->add_flag("--yes", options->yes, "with --prune: remove them");
  command->callback([options, &common, &exit_code] { exit_code = results(*options, common); });
}

}  // namespace clampd::ctl
