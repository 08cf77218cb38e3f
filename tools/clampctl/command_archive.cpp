#include <cmath>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "clampd/archive/store.hpp"
#include "clampd/base/json.hpp"
#include "clampd/bench/builtin.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/reanalysis/comparison.hpp"
#include "clampd/reanalysis/database.hpp"
#include "clampd/reanalysis/jobs.hpp"
#include "clampd/reanalysis/population.hpp"
#include "clampd/reanalysis/task.hpp"
#include "clampd/record/file.hpp"
#include "clampd/views/population_view.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

using nlohmann::ordered_json;
using reanalysis::Comparison;
using reanalysis::JobResult;
using reanalysis::Jobs;
using reanalysis::JobStatus;

struct ArchiveOptions {
  std::string job;
  std::string name;
  std::string method;
  std::string model;
  std::string limits;
  std::string sheet;
  reanalysis::Selection selection;
  bool diagnose = false;
  bool score_effects = false;
  std::string with;
  std::string csv;
  double false_alarms = 0.01;
  bool json = false;
};

Result<Jobs> open_jobs(const CommonOptions& common, bool may_migrate) {
  return bench::load_configuration(common.config)
      .and_then(reanalysis::archive_of)
      .and_then([&](const auto& settings) { return Jobs::open(settings, may_migrate); });
}

/// The station's way of judging, with what the command line says otherwise.
Result<reanalysis::Task> task_of(const ArchiveOptions& options, const StationConfiguration& configuration) {
  reanalysis::Task task;
  task.nominal = configuration.model;
  task.tare_samples =
      static_cast<std::uint64_t>(std::lround(configuration.check.tare_s / configuration.can.period_s()));
  task.kind = options.diagnose        ? reanalysis::Task::Kind::Diagnose
              : options.score_effects ? reanalysis::Task::Kind::ScoreEffects
                                      : reanalysis::Task::Kind::Identify;
  if (task.kind != reanalysis::Task::Kind::Identify) return task;
  task.validity = configuration.validity;
  task.method = options.method.empty() ? configuration.check.method
                                       : parse_method(options.method).value_or(task.method);
  const std::string& model = options.model.empty() ? configuration.check.model : options.model;
  if (!model.empty()) {
    Result<ExtendedParameters> read = read_extended_parameters(model);
    if (!read) return tl::unexpected(read.error());
    task.model = std::move(*read);
    task.method = Method::PredictionError;
  }
  const std::string& file = options.limits.empty() ? configuration.limits_file : options.limits;
  Result<LimitSet> limits = file.empty()
                                ? parse_limits(std::string(bench::kBuiltinLimits), "built-in limits.toml")
                                : read_limits(file);
  if (!limits) return tl::unexpected(limits.error());
  task.limits = std::move(*limits);
  if (!options.sheet.empty()) {
    Result<Sheet> sheet = read_sheet(options.sheet);
    if (!sheet) return tl::unexpected(sheet.error());
    task.sheet = std::move(*sheet);
  }
  return reanalysis::check_task(task).map([&] { return std::move(task); });
}

int submit(const ArchiveOptions& options, const CommonOptions& common) {
  const Result<StationConfiguration> configuration = bench::load_configuration(common.config);
  if (!configuration) return cli::refuse(configuration.error());
  const Result<reanalysis::Task> task = task_of(options, *configuration);
  if (!task) return cli::refuse(task.error());
  Result<Jobs> jobs = open_jobs(common, true);
  if (!jobs) return cli::refuse(jobs.error());
  const Result<reanalysis::SubmittedJob> job = jobs->submit(options.name, *task, options.selection);
  if (!job) return cli::refuse(job.error());
  if (job->without_runs > 0)
    cli::print_notice(
        fmt::format("{} of the chosen checks are left out, since their raw runs are not in the database "
                    "([postgresql] raw_runs, or dropped)",
                    job->without_runs));
  if (job->tasks == 0) return cli::refuse({"no check was chosen that has its raw runs in the database"});
  if (options.json)
    fmt::print("{}\n", ordered_json{{"schema", "clampd.archive_job/1"},
                                    {"job", job->id},
                                    {"tasks", job->tasks},
                                    {"known", job->known},
                                    {"without_runs", job->without_runs}}
                           .dump(2));
  else
    fmt::print("job {}: {} checks{}; `clampd-worker` does them, on as many machines as there are\n", job->id,
               job->tasks,
               job->known > 0 ? fmt::format(", {} of them known from an earlier job", job->known) : "");
  return cli::kSuccess;
}

void print_status(const JobStatus& status) {
  fmt::print("job {}{}: {} of {} done", status.id, status.name.empty() ? "" : " (" + status.name + ")",
             status.done, status.all());
  for (const auto& [count, word] :
       {std::pair(status.claimed, "under way"), std::pair(status.waiting, "waiting"),
        std::pair(status.failed, "failed"), std::pair(status.cancelled, "cancelled")})
    if (count > 0) fmt::print(", {} {}", count, word);
  fmt::print("\n  submitted {} by {}\n", status.submitted, status.submitted_by);
  if (status.waiting + status.claimed > 0) {
    if (status.left_s)
      fmt::print("  {} workers, {:.2g} checks a second: done in {:.0f} s, {}\n", status.workers,
                 status.done_per_s, *status.left_s, status.end);
    else
      fmt::print("  {} workers; none has come to an end in the last ten minutes\n", status.workers);
  }
  for (const auto& [reason, count] : status.failures) fmt::print("  {} failed: {}\n", count, reason);
}

int show_status(const ArchiveOptions& options, const CommonOptions& common) {
  Result<Jobs> jobs = open_jobs(common, false);
  if (!jobs) return cli::refuse(jobs.error());
  Result<std::vector<JobStatus>> list = std::vector<JobStatus>();
  if (options.job.empty())
    list = jobs->list();
  else
    list = jobs->find(options.job)
               .and_then([&](std::int64_t id) { return jobs->status(id); })
               .map([](JobStatus one) { return std::vector{std::move(one)}; });
  if (!list) return cli::refuse(list.error());
  if (!options.json) {
    for (const JobStatus& status : *list) print_status(status);
    if (list->empty()) fmt::print("there is no job yet; `clampctl archive submit` makes one\n");
    return cli::kSuccess;
  }
  ordered_json documents = ordered_json::array();
  for (const JobStatus& status : *list) documents.push_back(reanalysis::job_json(status));
  fmt::print("{}\n", ordered_json{{"schema", "clampd.archive_status/1"}, {"jobs", documents}}.dump(2));
  return cli::kSuccess;
}

/// As RFC 4180 has it.
std::string csv_field(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + '"';
}

std::string csv_number(const ordered_json& number) {
  return number.is_number() ? number.dump() : "";
}

/// Of any kind of job; a job of scores has no verdicts.
std::string verdict_of(const ordered_json& document) {
  return document.contains("diagnosis") ? document["diagnosis"].value("verdict", "") : document.value("verdict", "");
}

std::string reason_of(const ordered_json& document) {
  if (document.contains("diagnosis")) return document["diagnosis"].value("summary", "");
  return document.value("reason", document.contains("scores") ? "see `clampctl archive population`" : "");
}

/// One row a check, the seven parameters with their deviations; empty fields where there is no estimate.
std::string results_csv(const std::vector<JobResult>& results) {
  std::string text = "record,state,serial,verdict,marginal,reason,software_version,task_sha256";
  for (const ParameterInfo& info : kParameterTable)
    text += fmt::format(",{0} ({1}),{0} sd ({1})", info.name, info.unit);
  text += '\n';
  for (const JobResult& result : results) {
    const ordered_json document = ordered_json::parse(result.document.empty() ? "{}" : result.document);
    const auto word = [&](const char* key) { return csv_field(document.value(key, std::string())); };
    text += fmt::format("{},{},{},{},{},{},{},{}", csv_field(result.check), result.state, word("serial"),
                        csv_field(verdict_of(document)), document.contains("marginal") ? document["marginal"].dump() : "",
                        csv_field(result.reason.empty() ? reason_of(document) : result.reason),
                        word("software_version"), word("task_sha256"));
    const ordered_json parameters = document.value("parameters", ordered_json::array());
    for (std::size_t i = 0; i < kParameterCount; ++i)
      text += i < parameters.size()
                  ? fmt::format(",{},{}", csv_number(parameters[i]["value"]), csv_number(parameters[i]["sd"]))
                  : std::string(",,");
    text += '\n';
  }
  return text;
}

ordered_json results_json(std::int64_t job, const std::vector<JobResult>& results) {
  ordered_json list = ordered_json::array();
  for (const JobResult& result : results)
    list.push_back(
        {{"record", result.check},
         {"state", result.state},
         {"reason", result.reason.empty() ? ordered_json(nullptr) : ordered_json(result.reason)},
         {"result", result.document.empty() ? ordered_json(nullptr) : ordered_json::parse(result.document)}});
  return {{"schema", "clampd.archive_results/1"}, {"job", job}, {"results", std::move(list)}};
}

void print_results(const std::vector<JobResult>& results) {
  for (const JobResult& result : results) {
    if (result.document.empty()) {
      fmt::print("{}  {}{}\n", result.check, result.state, result.reason.empty() ? "" : ": " + result.reason);
      continue;
    }
    const ordered_json document = ordered_json::parse(result.document);
    fmt::print("{}  {:<16} {:<5} {}\n", result.check, document["serial"].get<std::string>(), verdict_of(document),
               reason_of(document));
  }
}

int show_results(const ArchiveOptions& options, const CommonOptions& common) {
  Result<Jobs> jobs = open_jobs(common, false);
  if (!jobs) return cli::refuse(jobs.error());
  const Result<std::int64_t> job = jobs->find(options.job);
  if (!job) return cli::refuse(job.error());
  const Result<std::vector<JobResult>> results = jobs->results(*job);
  if (!results) return cli::refuse(results.error());
  if (!options.csv.empty() && options.csv != "-") {
    const Result<void> written = write_file_atomically(options.csv, results_csv(*results));
    if (!written) return cli::refuse(written.error());
  }
  if (options.csv == "-")
    fmt::print("{}", results_csv(*results));
  else if (options.json)
    fmt::print("{}\n", results_json(*job, *results).dump(2));
  else if (options.csv.empty())
    print_results(*results);
  return cli::kSuccess;
}

ordered_json comparison_json(const Comparison& comparison, std::int64_t job,
                             std::optional<std::int64_t> with) {
  ordered_json verdicts = ordered_json::array();
  for (const reanalysis::ChangedVerdict& changed : comparison.verdicts)
    verdicts.push_back({{"record", changed.check},
                        {"serial", changed.serial},
                        {"before", changed.before},
                        {"after", changed.after},
                        {"reason", changed.reason}});
  const auto or_null = [](const std::string& verdict) {
    return verdict.empty() ? ordered_json(nullptr) : ordered_json(verdict);
  };
  ordered_json lines = ordered_json::array();
  for (const reanalysis::ChangedLine& changed : comparison.lines)
    lines.push_back({{"record", changed.check},
                     {"serial", changed.serial},
                     {"line", changed.line},
                     {"before", or_null(changed.before)},
                     {"after", or_null(changed.after)}});
  ordered_json parameters = ordered_json::array();
  for (const reanalysis::MovedParameter& moved : comparison.parameters)
    parameters.push_back({{"name", moved.name},
                          {"unit", moved.unit},
                          {"checks", moved.checks},
                          {"mean", number_or_null(moved.mean)},
                          {"largest", number_or_null(moved.largest)},
                          {"largest_in", moved.largest_in},
                          {"largest_sd", number_or_null(moved.largest_sd)}});
  return {{"schema", "clampd.archive_comparison/1"},
          {"job", job},
          {"with", with ? ordered_json(*with) : ordered_json(nullptr)},
          {"checks", comparison.checks},
          {"verdicts_changed", std::move(verdicts)},
          {"parameters", std::move(parameters)},
          {"sheet_lines_changed", std::move(lines)},
          {"other_guard_bands", comparison.other_guard_bands},
          {"unknown_stopping", comparison.unknown_stopping}};
}

void print_comparison(const Comparison& comparison, std::optional<std::int64_t> with) {
  fmt::print("{} checks compared with {}: {} verdicts change\n", comparison.checks,
             with ? fmt::format("job {}", *with) : "what was recorded", comparison.verdicts.size());
  for (const reanalysis::ChangedVerdict& changed : comparison.verdicts)
    fmt::print("  {}  {:<16} {} -> {}: {}\n", changed.check, changed.serial, changed.before, changed.after,
               changed.reason);
  for (const reanalysis::MovedParameter& moved : comparison.parameters)
    fmt::print(
        "  {:<5} moves by {:.3g} {} on average, by {:.3g} at most ({}), {:.2g} standard deviations at most\n",
        moved.name, moved.mean, moved.unit, moved.largest, moved.largest_in, moved.largest_sd);
  const auto in_words = [](const std::string& verdict) { return verdict.empty() ? "no verdict" : verdict; };
  for (const reanalysis::ChangedLine& changed : comparison.lines)
    fmt::print("  {}  {:<16} {}: {} -> {}\n", changed.check, changed.serial, changed.line,
               in_words(changed.before), in_words(changed.after));
  if (comparison.other_guard_bands > 0)
    cli::print_notice(fmt::format("{} checks of as many repeats as they needed are judged with other guard bands than before: by another "
                                  "guard_band_k of the limits, or another version",
                                  comparison.other_guard_bands));
  if (comparison.unknown_stopping > 0)
    cli::print_notice(fmt::format("of {} checks it is not on record whether they took as many repeats as they needed (published before "
                                  "schema 6 of the database): their guard bands are those of a fixed number",
                                  comparison.unknown_stopping));
}

int show_comparison(const ArchiveOptions& options, const CommonOptions& common) {
  Result<Jobs> jobs = open_jobs(common, false);
  if (!jobs) return cli::refuse(jobs.error());
  const Result<std::int64_t> job = jobs->find(options.job);
  if (!job) return cli::refuse(job.error());
  std::optional<std::int64_t> with;
  if (!options.with.empty()) {
    const Result<std::int64_t> other = jobs->find(options.with);
    if (!other) return cli::refuse(other.error());
    with = *other;
  }
  const Result<Comparison> comparison = jobs->compared(*job, with).and_then(reanalysis::compare);
  if (!comparison) return cli::refuse(comparison.error());
  if (options.json)
    fmt::print("{}\n", comparison_json(*comparison, *job, with).dump(2));
  else
    print_comparison(*comparison, with);
  return cli::kSuccess;
}

int show_population(const ArchiveOptions& options, const CommonOptions& common) {
  Result<Jobs> jobs = open_jobs(common, false);
  if (!jobs) return cli::refuse(jobs.error());
  const Result<std::int64_t> job = jobs->find(options.job);
  if (!job) return cli::refuse(job.error());
  const Result<JobStatus> status = jobs->status(*job);
  if (!status) return cli::refuse(status.error());
  const Result<reanalysis::Population> population =
      jobs->scored(*job).and_then([](const auto& checks) { return reanalysis::population_of(checks); });
  if (!population) return cli::refuse(population.error());
  if (population->directions.empty())
    return cli::refuse({fmt::format("job {}: no check is done yet: let `clampd-worker` work, and see `clampctl archive status {}`",
                                    *job, *job)});
  if (const std::int64_t missing = status->all() - status->done; missing > 0)
    cli::print_notice(fmt::format("{} of the job's {} checks are not done and do not count", missing, status->all()));
  if (population->repeated > 0)
    cli::print_notice(fmt::format("{} checks of brakes that the same station had checked before do not count", population->repeated));
  const attribution::PopulationResult result =
      attribution::attribute_effects(population->table, {.false_alarms = options.false_alarms});
  if (options.json)
    fmt::print("{}\n", population_json(population->table, population->directions, result, options.false_alarms).dump(2));
  else
    fmt::print("{}", format_population(population->table, population->directions, result, options.false_alarms));
  return cli::kSuccess;
}

/// `retry` and `cancel`.
int change(const ArchiveOptions& options, const CommonOptions& common,
           Result<std::int64_t> (Jobs::*action)(std::int64_t), const char* words) {
  Result<Jobs> jobs = open_jobs(common, false);
  if (!jobs) return cli::refuse(jobs.error());
  const Result<std::int64_t> job = jobs->find(options.job);
  if (!job) return cli::refuse(job.error());
  const Result<std::int64_t> tasks = ((*jobs).*action)(*job);
  if (!tasks) return cli::refuse(tasks.error());
  if (options.json)
    fmt::print("{}\n",
               ordered_json{{"schema", "clampd.archive_change/1"}, {"job", *job}, {"tasks", *tasks}}.dump(2));
  else
    fmt::print("job {}: {} tasks {}\n", *job, *tasks, words);
  return cli::kSuccess;
}

const CLI::Validator kTime(
    [](std::string& text) -> std::string {
      if (is_filter_time(text)) return {};
      return "'" + text + "' is no date 2026-11-21 or time 2026-11-21T14:30Z (UTC)";
    },
    "TIME");

CLI::App* add_action(CLI::App& archive, const char* name, const char* what,
                     const std::shared_ptr<ArchiveOptions>& options, bool of_a_job) {
  CLI::App* command = archive.add_subcommand(name, what);
  if (of_a_job)
    command->add_option("job", options->job, "its number, or `last`")->required()->type_name("JOB");
  command->add_flag("--json", options->json, "as JSON on standard output");
  return command;
}

void add_submit(CLI::App& archive, const CommonOptions& common, int& exit_code) {
  auto options = std::make_shared<ArchiveOptions>();
  CLI::App* command =
      add_action(archive, "submit",
                 "a job: identify and judge the chosen checks anew, as the station of --config would, "
                 "or otherwise as said here",
                 options, false);
  command->add_option("--name", options->name, "what the job is about, in words");
  command->add_option("--method", options->method, "oem or pem (default: the configuration's)")
      ->check(CLI::IsMember({"oem", "pem"}));
  CLI::Option* model =
      command
          ->add_option("--model", options->model,
                       "estimate the effects of this saved model too, by the prediction error method")
          ->type_name("MODEL.toml");
  command->get_option("--method")->excludes(model);
  command->add_option("--limits", options->limits, "judge by these limits (default: the configuration's)")
      ->type_name("LIMITS.toml");
  command
      ->add_option("--sheet", options->sheet, "judge by this requirement sheet (default: that of each check, if it had one)")
      ->type_name("SHEET.toml")
      ->excludes(model);
  CLI::Option* diagnose = command->add_flag("--diagnose", options->diagnose,
                                            "diagnose each check instead: what the base model gets wrong, by name");
  CLI::Option* scores = command->add_flag("--score-effects", options->score_effects,
                                          "ask each check about every effect instead, for `clampctl archive population`");
  scores->excludes(diagnose);
  for (const char* of_verdicts : {"--method", "--model", "--limits", "--sheet"})
    for (CLI::Option* other : {diagnose, scores}) other->excludes(command->get_option(of_verdicts));
  constexpr const char* kGroup = "Which checks";
  reanalysis::Selection& selection = options->selection;
  command->add_option("--serial", selection.serials, "only of these brakes")->group(kGroup);
  command->add_option("--part-number", selection.part_number, "only of this part number")->group(kGroup);
  command->add_option("--batch", selection.batch, "only of this batch")->group(kGroup);
  command->add_option("--station", selection.station, "only of this station")->group(kGroup);
  command->add_option("--since", selection.since, "only started then or later (date, or UTC time)")
      ->check(kTime)
      ->group(kGroup);
  command
      ->add_option("--until", selection.until, "only started then or earlier; a date includes its whole day")
      ->check(kTime)
      ->group(kGroup);
  command->callback([options, &common, &exit_code] { exit_code = submit(*options, common); });
}

}  // namespace

void add_archive_commands(CLI::App& app, const CommonOptions& common, int& exit_code) {
  CLI::App* archive = app.add_subcommand(
      "archive", "the runs in the database of [postgresql] identified anew, by any number of workers");
  archive->require_subcommand(1);
  add_submit(*archive, common, exit_code);

  auto options = std::make_shared<ArchiveOptions>();
  CLI::App* status =
      add_action(*archive, "status", "how far the jobs are, and why tasks failed", options, false);
  status->add_option("job", options->job, "its number, or `last` (default: all)")->type_name("JOB");
  status->callback([options, &common, &exit_code] { exit_code = show_status(*options, common); });

  options = std::make_shared<ArchiveOptions>();
  CLI::App* results = add_action(*archive, "results", "what a job says of each check", options, true);
  results->add_option("--csv", options->csv, "one check a row, with all parameters; - for standard output")
      ->type_name("FILE");
  results->callback([options, &common, &exit_code] { exit_code = show_results(*options, common); });

  options = std::make_shared<ArchiveOptions>();
  CLI::App* comparison = add_action(
      *archive, "compare", "which verdicts change against the recorded ones, and how far parameters move",
      options, true);
  comparison->add_option("--with", options->with, "another job instead of what was recorded")
      ->type_name("JOB");
  comparison->callback([options, &common, &exit_code] { exit_code = show_comparison(*options, common); });

  options = std::make_shared<ArchiveOptions>();
  CLI::App* population = add_action(*archive, "population",
                                    "which effect the line, a station, a fixture or a batch has that no single brake shows; "
                                    "of a job submitted with --score-effects",
                                    options, true);
  population
      ->add_option("--false-alarms", options->false_alarms,
                   "probability that anything is named where there is nothing")
      ->check(CLI::Range(1e-6, 0.5))
      ->capture_default_str();
  population->callback([options, &common, &exit_code] { exit_code = show_population(*options, common); });

  options = std::make_shared<ArchiveOptions>();
  add_action(*archive, "retry", "failed and cancelled tasks wait again", options, true)
      ->callback([options, &common, &exit_code] {
        exit_code = change(*options, common, &Jobs::retry, "wait again");
      });

  options = std::make_shared<ArchiveOptions>();
  add_action(*archive, "cancel", "what is not done is not done any more; results stay", options, true)
      ->callback([options, &common, &exit_code] {
        exit_code = change(*options, common, &Jobs::cancel, "cancelled");
      });
}

}  // namespace clampd::ctl
