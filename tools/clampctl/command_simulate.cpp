#include <algorithm>
#include <filesystem>
#include <memory>

#include <fmt/format.h>

#include "clampd/bench/builtin.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/drive/simulation.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"
#include "clampd/simulation/saved_model.hpp"
#include "clampd/simulation/simulate.hpp"
#include "drivers/sim/effects.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "tools/clampctl/command.hpp"
#include "tools/cli/output.hpp"
#include "tools/cli/terminal.hpp"

namespace clampd::ctl {

namespace {

namespace fs = std::filesystem;

struct SimulateOptions {
  std::string manoeuvre;
  std::string plant;
  std::string trajectory;
  std::vector<std::string> torques, motions;  ///< of a drive: run files to begin with
  double position = 0.0;                      ///< at which it begins
  std::vector<std::string> effects;
  std::optional<std::uint64_t> seed;
  std::uint16_t repeats = 1;
  std::string folder;
};

/// Whether these are options of a simulated brake or of a drive; the words say what is missing.
Result<void> check_kind(const SimulateOptions& options) {
  const bool input = !options.torques.empty() || !options.motions.empty();
  if (!input && options.manoeuvre.empty())
    return failure(
        "say what is to be simulated: a brake with --manoeuvre, or a drive with --parameters DRIVE.toml and "
        "--torque or --motion");
  if (input && !options.manoeuvre.empty())
    return failure("--manoeuvre is driven by a brake, --torque and --motion by a drive: give one of them");
  if (input && options.plant.empty())
    return failure(
        "--torque and --motion need the drive: --parameters MODEL.toml, as `clampctl diagnose --save` wrote "
        "it");
  if (input &&
      (!options.effects.empty() || options.seed || options.repeats != 1 || !options.trajectory.empty()))
    return failure(
        "--effect, --seed, --repeats and --trajectory are for a simulated brake: a drive is simulated by its "
        "saved model, without noise");
  return {};
}

/// Of a manoeuvre's own: two manoeuvres with the same noise, row by row, would look like one brake that errs
/// in the same places. FNV-1a.
std::uint64_t seed_for(std::uint64_t seed, std::string_view manoeuvre) {
  std::uint64_t hash = 0xcbf29ce484222325u ^ seed;
  for (const char c : manoeuvre) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  return hash;
}

/// A plant file, or a model as `clampctl diagnose --save` writes it.
Result<sim::PlantConfiguration> load_simulated_brake(const std::string& path) {
  const Result<ExtendedParameters> model =
      path.empty() ? Result<ExtendedParameters>(ExtendedParameters{}) : read_extended_parameters(path);
  if (!model || model->effects.empty()) return bench::load_plant(path);
  Result<sim::PlantConfiguration> plant = bench::load_plant({});
  if (!plant) return plant;
  plant->brake = model->base;
  const Result<sim::Effects> effects = simulated_effects(*model);
  if (!effects) return failure(fmt::format("{}: {}", path, effects.error().message));
  plant->effects = *effects;
  return plant;
}

Result<sim::PlantConfiguration> plant_configuration(const SimulateOptions& options) {
  Result<sim::PlantConfiguration> plant = load_simulated_brake(options.plant);
  if (!plant) return plant;
  plant->seed = options.seed ? *options.seed : seed_for(plant->seed, options.manoeuvre);
  for (const std::string& effect : options.effects)
    if (const Result<void> set = sim::set_effect(plant->effects, effect); !set)
      return tl::unexpected(set.error());
  if (const Result<void> valid = plant->validate(); !valid) return tl::unexpected(valid.error());
  return plant;
}

struct SimulatedFile {
  std::string path, text;
};

Result<void> create_folder(const std::string& folder) {
  std::error_code failed;
  fs::create_directories(folder, failed);
  if (failed)
    return failure(
        fmt::format("cannot create the folder {}: {}; name another with --out", folder, failed.message()));
  return {};
}

/// All or none: what was written before a failure is removed again.
Result<void> write_files(const std::vector<SimulatedFile>& files) {
  for (std::size_t i = 0; i < files.size(); ++i)
    if (const Result<void> done = write_file_atomically(files[i].path, files[i].text); !done) {
      std::error_code failed;
      for (std::size_t k = 0; k < i; ++k) fs::remove(files[k].path, failed);
      return done;
    }
  return {};
}

/// A folder that this made goes again where a file cannot be written. None of the files may be one of those
/// that were `read`.
Result<void> write_into_folder(const std::string& folder, const std::vector<SimulatedFile>& files,
                               const std::vector<std::string>& read) {
  std::error_code failed;
  const bool existed = fs::exists(folder, failed);
  if (Result<void> created = create_folder(folder); !created) return created;
  std::vector<cli::OutputOption> outputs;
  for (const SimulatedFile& file : files) outputs.push_back({"--out", file.path});
  const Result<void> written = cli::check_outputs(outputs, read).and_then([&] { return write_files(files); });
  if (!written && !existed) fs::remove(folder, failed);
  return written;
}

Result<void> write_runs(const std::vector<Run>& runs, const SimulateOptions& options) {
  std::vector<SimulatedFile> files;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const fs::path file = fs::path(options.folder) / fmt::format("{}-{:03}.csv", options.manoeuvre, i + 1);
    files.push_back({file.string(), format_run(runs[i])});
  }
  return write_into_folder(options.folder, files, {});
}

Result<SimulatedFile> simulate_drive_file(const std::string& file, bool motion, const FittedDrive& drive,
                                          const SimulateOptions& options) {
  const Result<LoadedRun> loaded =
      motion ? read_drive_motion(file, drive.model) : read_drive_torque(file, drive.model);
  if (!loaded) return tl::unexpected(loaded.error());
  for (const std::string& notice : loaded->notices) cli::print_notice(notice);
  const Result<Run> run = motion ? simulate_drive_torque(loaded->run, drive)
                                 : simulate_drive_motion(loaded->run, drive, options.position);
  if (!run) return tl::unexpected(run.error());
  const fs::path path = fs::path(options.folder) / fs::path(file).filename().replace_extension(".csv");
  return SimulatedFile{path.string(), format_drive_run(*run, drive.model)};
}

/// All files are simulated before the first is written.
int simulate_drive(const SimulateOptions& options) {
  const Result<FittedDrive> drive = read_fitted_drive(options.plant);
  if (!drive) return cli::refuse(drive.error());
  if (const std::vector<std::string> terms = terms_of_runs(*drive); !terms.empty())
    cli::print_notice(fmt::format("{}: {} {} a value for each run that was fitted; the first one's is taken",
                                  options.plant, fmt::join(terms, ", "), terms.size() == 1 ? "has" : "have"));
  std::vector<SimulatedFile> files;
  for (const bool motion : {false, true})
    for (const std::string& file : motion ? options.motions : options.torques) {
      Result<SimulatedFile> simulated = simulate_drive_file(file, motion, *drive, options);
      if (!simulated) return cli::refuse(simulated.error());
      files.push_back(std::move(*simulated));
    }
  std::vector<std::string> read{options.plant};
  for (const auto& names : {options.torques, options.motions})
    read.insert(read.end(), names.begin(), names.end());
  for (auto file = files.begin(); file != files.end(); ++file)
    if (std::find_if(files.begin(), file,
                     [&](const SimulatedFile& other) { return other.path == file->path; }) != file)
      return cli::refuse(
          {fmt::format("two of the runs would become {}; simulate them into different folders", file->path)});
  if (const Result<void> written = write_into_folder(options.folder, files, read); !written)
    return cli::refuse(written.error());
  fmt::print("{} run{} in {}\n", files.size(), files.size() == 1 ? "" : "s", options.folder);
  return cli::kSuccess;
}

int simulate(const SimulateOptions& options) {
  if (const Result<void> checked = check_kind(options); !checked) return cli::refuse(checked.error());
  if (options.manoeuvre.empty()) return simulate_drive(options);
  const Result<sim::PlantConfiguration> plant = plant_configuration(options);
  if (!plant) return cli::refuse(plant.error());
  const Result<LoadedRun> optimal =
      options.trajectory.empty()
          ? parse_run(std::string(bench::kBuiltinTrajectory), "built-in trajectory.csv")
          : read_run(options.trajectory);
  if (!optimal) return cli::refuse(optimal.error());
  // What a station knows of the brake is the nominal one, whatever the simulated brake really is.
  const BrakeParameters nominal;
  const Result<Run> trajectory = make_manoeuvre(options.manoeuvre, nominal, optimal->run);
  if (!trajectory) return cli::refuse(trajectory.error());
  Result<std::vector<Run>> runs = std::vector<Run>();
  if (!is_driven(*trajectory)) {
    for (std::uint64_t repeat = 0; repeat < options.repeats; ++repeat) {
      sim::PlantConfiguration other = *plant;
      other.seed += repeat;
      runs->push_back(simulate_drive_off(other, trajectory->size()));
    }
  } else {
    const Result<Reference> reference = build_reference(*trajectory, nominal);
    if (!reference) return cli::refuse(reference.error());
    runs = simulate_manoeuvre(*plant, *reference, nominal, options.repeats);
  }
  if (!runs) {
    cli::print_error(runs.error().message);
    return cli::kStation;
  }
  if (const Result<void> written = write_runs(*runs, options); !written) return cli::refuse(written.error());
  fmt::print("{} run{} of {} rows in {}\n", runs->size(), runs->size() == 1 ? "" : "s", trajectory->size(),
             options.folder);
  return cli::kSuccess;
}

std::string manoeuvre_help() {
  std::string text = "what to drive: ";
  for (const ManoeuvreInfo& manoeuvre : manoeuvres())
    text += fmt::format("\n  {}: {}", manoeuvre.name, manoeuvre.description);
  return text;
}

std::string effect_help() {
  std::string text = "physics beyond the base model, as often as wanted; VALUE in the effect's unit:";
  for (const sim::EffectInfo& effect : sim::kEffectTable)
    text += fmt::format("\n  {} ({}): {}", effect.name, effect.unit, effect.meaning);
  return text;
}

}  // namespace

void add_simulate_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<SimulateOptions>();
  CLI::App* command = app.add_subcommand("simulate",
                                         "run files from the simulated brake, driven by the station's own "
                                         "controller, or from the saved model of "
                                         "a drive");
  command->add_option("--manoeuvre", options->manoeuvre, manoeuvre_help());
  command
      ->add_option("--parameters", options->plant,
                   "the simulated brake, or a model that `clampctl diagnose --save` "
                   "wrote of a brake or of a drive (default: a nominal brake, with noise)")
      ->type_name("PLANT.toml");
  CLI::Option* torque =
      command
          ->add_option("--torque", options->torques,
                       "of a drive: run files whose torque drives it, from rest; its motion is simulated")
          ->type_name("RUN.csv");
  command
      ->add_option("--position", options->position, "of a drive: where it begins under --torque (default: 0)")
      ->needs(torque);
  command
      ->add_option("--motion", options->motions,
                   "of a drive: run files whose motion it makes; the torque for it is computed")
      ->type_name("RUN.csv");
  command
      ->add_option("--trajectory", options->trajectory, "what `optimal` drives (default: the one that ships)")
      ->type_name("TRAJ.csv");
  command->add_option("--effect", options->effects, effect_help())->type_name("NAME=VALUE");
  command->add_option("--seed", options->seed, "of the noise (default: of the plant file and the manoeuvre)");
  command->add_option("--repeats", options->repeats, "how many runs")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command
      ->add_option("--out", options->folder,
                   "folder for MANOEUVRE-001.csv and so on, or for a drive's runs by their own names")
      ->required()
      ->type_name("DIR");
  command->callback([options, &exit_code] { exit_code = simulate(*options); });
}

}  // namespace clampd::ctl
