#include "tools/clampctl/identify_drive.hpp"

#include <array>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/base/json.hpp"
#include "clampd/drive/diagnosis.hpp"
#include "clampd/record/file.hpp"
#include "clampd/views/diagnosis_json.hpp"
#include "clampd/views/diagnosis_words.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {
namespace {

using nlohmann::ordered_json;

ordered_json to_json(const DriveIdentification& identified, const IdentifyDriveCommand& command) {
  ordered_json document{{"schema", "clampd.identify-drive/1"},
                        {"model", command.model},
                        {"runs", command.files},
                        {"unit", identified.fitted.model.torque_unit},
                        {"share_left", number_or_null(identified.share_left)},
                        {"share_explainable", number_or_null(identified.share_explainable)},
                        {"good_enough", identified.fitted.model.good_enough},
                        {"enough", identified.is_enough}};
  document["parameters"] = parameters_json(identified.parameters);
  document["data"] = findings_json(identified.data);
  document["notices"] = identified.notices;
  return document;
}

void print(const DriveIdentification& identified, const IdentifyDriveCommand& command) {
  const DriveModel& model = identified.fitted.model;
  fmt::print("{}, the model of {}, fitted to {} run{}\n\n", model.name, command.model, command.files.size(),
             command.files.size() == 1 ? "" : "s");
  for (const EstimatedParameter& each : identified.parameters)
    fmt::print("  {:<34} {:>25}  {}\n", each.name, words::estimate(each), each.unit);
  fmt::print("\n  {:.3g} % of the {}'s variation is left{}\n", 100.0 * identified.share_left, model.effort(),
             identified.is_enough
                 ? ""
                 : ": this model does not explain these runs; `clampctl diagnose` looks for the cause");
  for (const DataFinding& each : identified.data) fmt::print("  {}: {}\n", each.name, each.words);
  for (const std::string& each : identified.notices) fmt::print("  {}\n", each);
}

}  // namespace

int identify_drive_files(const IdentifyDriveCommand& command) {
  std::vector<std::string> read = command.files;
  read.push_back(command.model);
  const std::array outputs{cli::OutputOption{"--json", command.json},
                           cli::OutputOption{"--save", command.save}};
  if (const Result<void> checked = cli::check_outputs(outputs, read); !checked)
    return cli::refuse(checked.error());
  const Result<FittedDrive> saved = parse_fitted_drive(command.text, command.model);
  if (!saved) return cli::refuse(saved.error());
  std::vector<Run> runs;
  for (const std::string& file : command.files) {
    Result<LoadedRun> loaded = read_drive_run(file, saved->model);
    if (!loaded) return cli::refuse(loaded.error());
    for (const std::string& notice : loaded->notices) cli::print_notice(notice);
    runs.push_back(std::move(loaded->run));
  }
  const Result<DriveIdentification> identified = identify_drive(runs, *saved);
  if (!identified) return cli::refuse(identified.error());
  if (!command.save.empty())
    if (const Result<void> written =
            write_file_atomically(command.save, format_fitted_drive(identified->fitted));
        !written)
      return cli::refuse(written.error());
  if (const Result<void> written = cli::write_json(command.json, to_json(*identified, command)); !written)
    return cli::refuse(written.error());
  if (command.json != "-") print(*identified, command);
  return cli::kSuccess;
}

}  // namespace clampd::ctl
