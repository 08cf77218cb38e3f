#pragma once

#include <optional>
#include <string>
#include <vector>

#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/experiment/next_run.hpp"
#include "clampd/record/reference.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"
#include "clampd/station/recipe.hpp"
#include "clampd/station/session.hpp"
#include "drivers/can/codec.hpp"
#include "drivers/gpio/panel.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "rt/check_sequence.hpp"
#include "rt/supervisor.hpp"

namespace clampd::bench {

/// What a brake is checked by, with every file that is named read and checked: nothing can be missing once a
/// check starts, and what becomes of the files meanwhile changes nothing.
struct PreparedCheck {
  StationConfiguration configuration;
  LimitSet limits;
  std::optional<Sheet> sheet;
  std::optional<ExtendedParameters> model;  ///< whose effects a check estimates too
  rt::CheckPlan plan;                       ///< with the configured number of repeats
  std::string trajectory_sha256;
  TrajectorySet trajectories;                    ///< that of the plan, then its further ones
  std::vector<std::string> trajectories_sha256;  ///< of each of them
};

/// The same for the brakes of one part number.
struct PreparedRecipe : PreparedCheck {
  Recipe recipe;
  std::string refusal;  ///< why this station cannot check them; empty: it can
};

/// The station's own check, its recipes, and what is the same for all checks.
struct PreparedStation : PreparedCheck {
  can::ProtocolCodec codec;
  rt::SupervisorSettings supervisor;
  std::optional<gpio::PanelSettings> panel;
  std::vector<PreparedRecipe> recipes;  ///< by part number
};

/// Reads limits, extended model, DBC and trajectory, maps the signals and plans the check; the same for each
/// recipe. Errors name the file and what is wrong in it.
Result<PreparedStation> prepare_station(const StationConfiguration& configuration);

/// What a check that is asked for is made by.
struct ChosenCheck {
  const PreparedCheck* check = nullptr;      ///< of the station that was asked, never null
  std::optional<RecipeRecord> recipe = {};  ///< nothing: the station's own check
};

/// Chosen by the request's part number, or else by the patterns of serial numbers in the recipes. Errors, each with
/// what to do: no recipe is chosen (then with all part numbers that are known), more than one is, serial and part
/// number contradict each other, the recipe needs another CAN layout; a part number where there are no recipes. The
/// master brake is checked as the station's configuration says unless it is asked for with a part number.
Result<ChosenCheck> choose_check(const PreparedStation& station, const CheckRequest& request);

/// The DBC file of [can] and what in it is what to the station.
struct FrameDescription {
  can::Database database;
  can::ProtocolMapping mapping;
};
Result<FrameDescription> read_frames(const StationConfiguration& configuration);

/// The brake's frames, as [can] and its DBC file describe them. Errors name the file and what is wrong in it.
Result<can::ProtocolCodec> build_codec(const StationConfiguration& configuration);

/// What the bus must carry for these frames.
can::BusFormat bus_format(const StationConfiguration& configuration, const can::ProtocolCodec& codec);

/// The configuration of `path`; empty: /etc/clampd/station.toml if it is there, else the defaults.
Result<StationConfiguration> load_configuration(const std::string& path);

/// What the configuration's [retention] asks of the archive.
RetentionPolicy retention_policy(const StationConfiguration& configuration);

/// The simulated brake of `path`, on top of the one that ships: what the file does not name (noise, quanta,
/// clearance) is as there. Empty: the one that ships.
Result<sim::PlantConfiguration> load_plant(const std::string& path);

}  // namespace clampd::bench
