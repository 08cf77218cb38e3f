#pragma once

#include <optional>
#include <string>

#include "clampd/archive/store.hpp"
#include "clampd/base/result.hpp"
#include "clampd/brake/extended_brake.hpp"
#include "clampd/record/reference.hpp"
#include "clampd/sheet/sheet.hpp"
#include "clampd/station/configuration.hpp"
#include "clampd/station/limits.hpp"
#include "drivers/can/codec.hpp"
#include "drivers/gpio/panel.hpp"
#include "drivers/sim/plant_configuration.hpp"
#include "rt/check_sequence.hpp"
#include "rt/supervisor.hpp"

namespace clampd::bench {

/// A configuration with every file it names read and checked: nothing can be missing once a check starts.
struct PreparedStation {
  StationConfiguration configuration;
  LimitSet limits;
  std::optional<Sheet> sheet;
  std::optional<ExtendedParameters> model;  ///< whose effects a check estimates too
  can::ProtocolCodec codec;
  rt::CheckPlan plan;  ///< with the configured number of repeats
  rt::SupervisorSettings supervisor;
  std::optional<gpio::PanelSettings> panel;
  std::string trajectory_sha256;
};

/// Reads limits, extended model, DBC and trajectory, maps the signals and plans the check. Errors name the
/// file and what is wrong in it.
Result<PreparedStation> prepare_station(const StationConfiguration& configuration);

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
