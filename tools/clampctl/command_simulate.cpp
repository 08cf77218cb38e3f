#include <filesystem>
#include <memory>

#include <fmt/format.h>

#include "clampd/bench/builtin.hpp"
#include "clampd/bench/prepared_station.hpp"
#include "clampd/experiment/manoeuvres.hpp"
#include "clampd/experiment/reference.hpp"
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
  std::vector<std::string> effects;
  std::optional<std::uint64_t> seed;
  std::uint16_t repeats = 1;
  std::string folder;
};

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

/// All or none: what was written before a failure is removed again.
Result<void> write_runs(const std::vector<Run>& runs, const SimulateOptions& options) {
  std::error_code failed;
  const bool existed = fs::exists(options.folder, failed);
  fs::create_directories(options.folder, failed);
  if (failed)
    return failure(fmt::format("cannot create the folder {}: {}; name another with --out", options.folder,
                               failed.message()));
  std::vector<fs::path> written;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const fs::path file = fs::path(options.folder) / fmt::format("{}-{:03}.csv", options.manoeuvre, i + 1);
    if (const Result<void> done = write_run(file.string(), runs[i]); !done) {
      for (const fs::path& earlier : written) fs::remove(earlier, failed);
      if (!existed) fs::remove(options.folder, failed);
      return done;
    }
    written.push_back(file);
  }
  return {};
}

int simulate(const SimulateOptions& options) {
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
  CLI::App* command = app.add_subcommand(
      "simulate", "run files from the simulated brake, driven by the station's own controller");
  command->add_option("--manoeuvre", options->manoeuvre, manoeuvre_help())->required();
  command
      ->add_option("--parameters", options->plant,
                   "the simulated brake, or a model that `clampctl diagnose --save` "
                   "wrote (default: nominal, with noise)")
      ->type_name("PLANT.toml");
  command
      ->add_option("--trajectory", options->trajectory, "what `optimal` drives (default: the one that ships)")
      ->type_name("TRAJ.csv");
  command->add_option("--effect", options->effects, effect_help())->type_name("NAME=VALUE");
  command->add_option("--seed", options->seed, "of the noise (default: of the plant file and the manoeuvre)");
  command->add_option("--repeats", options->repeats, "how many runs")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command->add_option("--out", options->folder, "folder for MANOEUVRE-001.csv and so on")
      ->required()
      ->type_name("DIR");
  command->callback([options, &exit_code] { exit_code = simulate(*options); });
}

}  // namespace clampd::ctl
