#include <array>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "clampd/drive/model.hpp"
#include "clampd/record/file.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {
namespace {

struct NewDriveCommand {
  std::string run, out;
};

int propose(const NewDriveCommand& command) {
  const Result<ProposedDriveModel> model = propose_drive_model(command.run);
  if (!model) return cli::refuse(model.error());
  for (const std::string& notice : model->notices) cli::print_notice(notice);
  if (command.out.empty()) {
    fmt::print("{}", model->text);
    return cli::kSuccess;
  }
  const std::array outputs{cli::OutputOption{"--out", command.out}};
  if (const Result<void> checked = cli::check_outputs(outputs, {command.run}); !checked)
    return cli::refuse(checked.error());
  if (std::filesystem::exists(command.out))
    return cli::refuse(
        Error{fmt::format("{}: is there already; a model file that somebody has written is not "
                          "overwritten. Give another name",
                          command.out)});
  if (const Result<void> written = write_file_atomically(command.out, model->text); !written)
    return cli::refuse(written.error());
  return cli::kSuccess;
}

}  // namespace

void add_drive_command(CLI::App& app, int& exit_code) {
  CLI::App* drive = app.add_subcommand("drive", "model files of bare drives");
  drive->require_subcommand(1);
  auto options = std::make_shared<NewDriveCommand>();
  CLI::App* command = drive->add_subcommand(
      "new", "a model file for `clampctl diagnose --model`, from the columns of a run file");
  command->add_option("run", options->run, "a table of time, torque and motion")
      ->required()
      ->type_name("RUN.csv");
  command->add_option("--out", options->out, "the model file; standard output unless given")
      ->type_name("FILE");
  command->callback([options, &exit_code] { exit_code = propose(*options); });
}

}  // namespace clampd::ctl
