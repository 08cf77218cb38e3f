#include <algorithm>
#include <array>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/diagnose/diagnosis.hpp"
#include "clampd/diagnose/settle.hpp"
#include "clampd/drive/diagnosis.hpp"
#include "clampd/drive/model.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"
#include "clampd/views/diagnosis_json.hpp"
#include "clampd/views/diagnosis_report.hpp"
#include "clampd/views/diagnosis_text.hpp"
#include "clampd/views/figure.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

struct DiagnoseCommand {
  std::vector<std::string> files;
  std::vector<std::string> heldout;
  std::string model;
  std::string parameters;
  std::string json;
  std::string report;
  std::string save;
  std::string next;
  int threads = 0;
};

Result<void> check_outputs(const DiagnoseCommand& command) {
  const std::array outputs{
      cli::OutputOption{"--json", command.json}, cli::OutputOption{"--report", command.report},
      cli::OutputOption{"--save", command.save}, cli::OutputOption{"--next", command.next}};
  std::vector<std::string> read = command.files;
  read.insert(read.end(), command.heldout.begin(), command.heldout.end());
  for (const std::string& file : {command.model, command.parameters})
    if (!file.empty()) read.push_back(file);
  if (Result<void> checked = cli::check_outputs(outputs, read); !checked) return checked;
  for (const std::string& held : command.heldout)
    if (std::find(command.files.begin(), command.files.end(), held) != command.files.end())
      return failure(fmt::format("{} cannot be fitted and held out; name it once", held));
  if (!command.model.empty() && !command.parameters.empty())
    return failure("--parameters is for brakes: a model file describes a bare drive");
  if (!command.report.empty()) return report::can_draw();
  return {};
}

Result<std::vector<Run>> read_runs(const std::vector<std::string>& files,
                                   const std::optional<DriveModel>& drive) {
  std::vector<Run> runs;
  for (const std::string& file : files) {
    Result<LoadedRun> loaded = drive ? read_drive_run(file, *drive) : read_run(file);
    if (!loaded) return tl::unexpected(loaded.error());
    for (const std::string& notice : loaded->notices) cli::print_notice(notice);
    runs.push_back(std::move(loaded->run));
  }
  return runs;
}

DiagnosisSubject subject_of(std::size_t runs, const std::optional<DriveModel>& drive) {
  if (!drive) return {.runs = runs};
  return {.runs = runs,
          .drive = true,
          .position_unit = std::string(drive->position_unit()),
          .torque_unit = drive->torque_unit,
          .torque = std::string(drive->effort())};
}

Result<void> write_outputs(const DiagnoseCommand& command, const Diagnosis& diagnosis,
                           const DiagnosisSubject& subject, const std::string& model) {
  if (!command.report.empty()) {
    const Result<std::string> html = diagnosis_html(diagnosis, subject);
    if (!html) return tl::unexpected(html.error());
    if (Result<void> written = write_file_atomically(command.report, *html); !written) return written;
  }
  if (!command.save.empty())
    if (Result<void> written = write_file_atomically(command.save, model); !written) return written;
  if (!command.next.empty()) {
    if (!diagnosis.next_experiment) {
      cli::print_notice(
          fmt::format("there is no run that would settle anything: {} is not written", command.next));
    } else if (Result<void> written = write_run(command.next, diagnosis.next_experiment->trajectory);
               !written) {
      return written;
    }
  }
  return cli::write_json(command.json, diagnosis_json(diagnosis, subject));
}

int diagnose_files(const DiagnoseCommand& command) {
  if (const Result<void> checked = check_outputs(command); !checked) return cli::refuse(checked.error());
  DiagnoseOptions options;
  std::optional<DriveModel> drive;
  if (!command.model.empty()) {
    Result<DriveModel> model = read_drive_model(command.model);
    if (!model) return cli::refuse(model.error());
    drive = std::move(*model);
  }
  if (!command.parameters.empty()) {
    Result<BrakeParameters> nominal = read_brake_parameters(command.parameters);
    if (!nominal) return cli::refuse(nominal.error());
    options.nominal = *nominal;
  }
  const Result<std::vector<Run>> runs = read_runs(command.files, drive);
  if (!runs) return cli::refuse(runs.error());
  const Result<std::vector<Run>> heldout = read_runs(command.heldout, drive);
  if (!heldout) return cli::refuse(heldout.error());
  options.heldout = *heldout;
  options.views = !command.report.empty();
  options.threads = command.threads;
  cli::ProgressLine progress;
  options.progress = [&progress](double fraction, const std::string& stage) {
    progress.show(fraction, stage);
  };
  std::string model;  // as --save writes it
  Result<Diagnosis> diagnosis;
  if (drive) {
    Result<DriveDiagnosis> of_drive = diagnose_drive(*runs, *drive, options);
    if (of_drive) model = format_fitted_drive(of_drive->fitted);
    diagnosis = std::move(of_drive);
  } else {
    diagnosis = diagnose(*runs, options);
    if (diagnosis) model = format_extended_parameters(diagnosis->model);
  }
  if (!diagnosis) {
    progress.clear();
    return cli::refuse(diagnosis.error());
  }
  if (!drive && diagnosis->verdict == DiagnosisVerdict::Ambiguous) {
    progress.show(1.0, "the run that would settle it");
    NextStep step = next_step_for(*diagnosis, options.nominal, runs->size());
    if (!step.experiment && !step.words.empty()) diagnosis->notices.push_back(step.words);
    diagnosis->next_experiment = std::move(step.experiment);
  }
  progress.clear();
  const DiagnosisSubject subject = subject_of(runs->size(), drive);
  if (command.json != "-") {
    fmt::print("{}", diagnosis_text(*diagnosis, subject, cli::colours_wanted()));
    fmt::print("\n{} run{}, {:.1f} s\n", runs->size(), runs->size() == 1 ? "" : "s", diagnosis->wall_s);
  }
  if (const Result<void> written = write_outputs(command, *diagnosis, subject, model); !written)
    return cli::refuse(written.error());
  return cli::kSuccess;
}

}  // namespace

void add_diagnose_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<DiagnoseCommand>();
  CLI::App* command = app.add_subcommand(
      "diagnose", "what the simulation gets wrong, why, and what the extended model gains");
  command->add_option("runs", options->files, "run files (CSV), in chronological order")
      ->required()
      ->type_name("RUN.csv");
  command
      ->add_option("--holdout", options->heldout,
                   "runs that the models are judged by and never fitted to (default: every third run; of a "
                   "drive, each fifth of the rows in turn)")
      ->type_name("RUN.csv");
  command
      ->add_option("--model", options->model,
                   "the runs are of a bare drive: its columns, units and parts of the model")
      ->type_name("DRIVE.toml");
  command
      ->add_option("--parameters", options->parameters,
                   "start values and fixed J, N (default: the paper's Table I)")
      ->type_name("FILE.toml");
  command
      ->add_option("--json", options->json, "write the result as clampd.diagnosis/1; - for standard output")
      ->type_name("FILE");
  command->add_option("--report", options->report, "the whole story with pictures, as one HTML file")
      ->type_name("FILE.html");
  command->add_option("--save", options->save, "the model with the named effects, for `identify` and checks")
      ->type_name("MODEL.toml");
  command->add_option("--next", options->next, "the trajectory of the run that would settle the rivals")
      ->type_name("TRAJ.csv");
  command->add_option("--threads", options->threads, "0: as many as there are processors")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  command->callback([options, &exit_code] { exit_code = diagnose_files(*options); });
}

}  // namespace clampd::ctl
