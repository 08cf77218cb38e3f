#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/base/json.hpp"
#include "clampd/drive/data_check.hpp"
#include "clampd/drive/prediction.hpp"
#include "clampd/identify/brake_prediction.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"
#include "clampd/views/figure.hpp"
#include "clampd/views/prediction.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

struct PredictCommand {
  std::vector<std::string> files;
  std::string model;
  std::string json;
  std::string out;
  std::string report;
};

Result<void> check_outputs(const PredictCommand& command) {
  std::vector<std::string> read = command.files;
  read.push_back(command.model);
  const std::array outputs{cli::OutputOption{"--json", command.json}, cli::OutputOption{"--out", command.out},
                           cli::OutputOption{"--report", command.report}};
  if (Result<void> checked = cli::check_outputs(outputs, read); !checked) return checked;
  return command.report.empty() ? Result<void>{} : report::can_draw();
}

Result<std::vector<Run>> read_all(const PredictCommand& command, const DriveModel* drive) {
  std::vector<Run> runs;
  std::vector<std::string> said;
  for (const std::string& file : command.files) {
    Result<LoadedRun> loaded = drive != nullptr ? read_drive_run(file, *drive) : read_run(file);
    if (!loaded)
      return failure(fmt::format("{} ({} is a model of a {})", loaded.error().message, command.model,
                                 drive != nullptr ? "drive" : "brake"));
    for (const std::string& notice : loaded->notices) {
      const std::string what =
          notice.substr(std::min(notice.size(), notice.find(" column ")));  // one a kind, not one a file
      if (std::ranges::find(said, what) != said.end()) continue;
      said.push_back(what);
      cli::print_notice(notice);
    }
    runs.push_back(std::move(loaded->run));
  }
  return runs;
}

/// The data first, as a diagnosis does: a wrong sign would pass for a wrong model.
Result<std::vector<PredictedRun>> predict_drives(const PredictCommand& command, const FittedDrive& drive) {
  Result<std::vector<Run>> runs = read_all(command, &drive.model);
  if (!runs) return tl::unexpected(runs.error());
  Result<CheckedData> data = check_data(*runs, drive.model);
  if (!data) return tl::unexpected(data.error());
  if (data->stops()) return failure(stop_message(*data));
  for (const DataFinding& finding : data->findings)
    if (finding.severity == DataSeverity::Mended) cli::print_notice(finding.words);
  if (const std::vector<std::string> names = terms_of_runs(drive); !names.empty())
    cli::print_notice(
        fmt::format("{}: {} differs from run to run of the fit; the first file here is taken for the "
                    "first of those, and so on",
                    command.model, fmt::join(names, ", ")));
  return predict_drive(data->runs.empty() ? *runs : data->runs, drive);
}

Result<std::vector<PredictedRun>> predict(const PredictCommand& command) {
  const Result<std::string> text = read_file(command.model);
  if (!text) return tl::unexpected(text.error());
  if (is_drive_model(*text)) {
    const Result<FittedDrive> drive = parse_fitted_drive(*text, command.model);
    if (!drive) return tl::unexpected(drive.error());
    return predict_drives(command, *drive);
  }
  const Result<ExtendedParameters> brake = parse_extended_parameters(*text, command.model);
  if (!brake) return tl::unexpected(brake.error());
  const Result<std::vector<Run>> runs = read_all(command, nullptr);
  if (!runs) return tl::unexpected(runs.error());
  return predict_brake(*runs, *brake);
}

int predict_files(const PredictCommand& command) {
  if (const Result<void> checked = check_outputs(command); !checked) return cli::refuse(checked.error());
  const Result<std::vector<PredictedRun>> predicted = predict(command);
  if (!predicted) return cli::refuse(predicted.error());
  if (command.json != "-") fmt::print("{}", prediction_text(*predicted));
  if (!command.out.empty())
    if (const Result<void> written = write_file_atomically(command.out, format_residuals(*predicted));
        !written)
      return cli::refuse(written.error());
  if (!command.report.empty()) {
    const Result<std::string> html = prediction_html(*predicted, command.model);
    if (!html) return cli::refuse(html.error());
    if (const Result<void> written = write_file_atomically(command.report, *html); !written)
      return cli::refuse(written.error());
  }
  if (const Result<void> written = cli::write_json(command.json, prediction_json(*predicted, command.model));
      !written)
    return cli::refuse(written.error());
  return cli::kSuccess;
}

}  // namespace

void add_predict_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<PredictCommand>();
  CLI::App* command = app.add_subcommand(
      "predict", "a saved model, simulated from the recorded torque alone, against what was recorded");
  command->add_option("runs", options->files, "run files (CSV), in chronological order")
      ->required()
      ->type_name("RUN.csv");
  command
      ->add_option("--model", options->model,
                   "as `clampctl diagnose --save` writes it, of a brake or a drive")
      ->required()
      ->type_name("SAVED.toml");
  command
      ->add_option("--json", options->json, "write the result as clampd.prediction/1; - for standard output")
      ->type_name("FILE");
  command->add_option("--out", options->out, "measured, predicted and residual of every row")
      ->type_name("RESIDUALS.csv");
  command->add_option("--report", options->report, "the errors with pictures, as one HTML file")
      ->type_name("FILE.html");
  command->callback([options, &exit_code] { exit_code = predict_files(*options); });
}

}  // namespace clampd::ctl
