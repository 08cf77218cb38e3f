#include "clampd/bench/prepared_station.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <set>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "clampd/base/clock.hpp"
#include "clampd/bench/builtin.hpp"
#include "clampd/experiment/reference.hpp"
#include "clampd/record/checksum.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/run.hpp"

namespace clampd::bench {

namespace {

constexpr const char* kInstalledConfiguration = "/etc/clampd/station.toml";

struct MappingRole {
  std::string_view role;
  std::string can::ProtocolMapping::*signal = nullptr;
  bool needed = true;  ///< false: a brake may do without, and an empty name says so
  /// In the place of `signal`: of each message one of several names.
  std::vector<std::string> can::ProtocolMapping::*names = nullptr;
};

constexpr std::array kMappingRoles{
    MappingRole{"torque_command", &can::ProtocolMapping::torque_command, false},
    MappingRole{"velocity_command", &can::ProtocolMapping::velocity_command, false},
    MappingRole{"enable", &can::ProtocolMapping::enable},
    MappingRole{"force", &can::ProtocolMapping::force},
    MappingRole{"velocity", &can::ProtocolMapping::velocity},
    MappingRole{"torque", &can::ProtocolMapping::torque},
    MappingRole{"position", &can::ProtocolMapping::position},
    MappingRole{"sample_clock", &can::ProtocolMapping::sample_clock, false},
    MappingRole{"enabled", &can::ProtocolMapping::enabled, false},
    MappingRole{"watchdog", &can::ProtocolMapping::watchdog, false},
    MappingRole{"fault", &can::ProtocolMapping::fault, false},
    MappingRole{"counter", nullptr, false, &can::ProtocolMapping::counter},
    MappingRole{"crc", nullptr, false, &can::ProtocolMapping::crc},
};

Result<can::ProtectionDescription> protection(const StationConfiguration& configuration) {
  const CanProtection& configured = configuration.can.protection;
  const auto found = std::find(can::kChecksumNames.begin(), can::kChecksumNames.end(), configured.checksum);
  if (found == can::kChecksumNames.end())
    return failure(fmt::format("{}: [can.protection] checksum is \"{}\"; there are {}", configuration.file,
                               configured.checksum, fmt::join(can::kChecksumNames, ", ")));
  can::ProtectionDescription description;
  description.checksum = static_cast<can::Checksum>(found - can::kChecksumNames.begin());
  description.crc = {configured.width_bits,
                     configured.polynomial,
                     configured.start,
                     configured.final_xor,
                     configured.reflected,
                     configured.data_id == "before"  ? can::DataIdPlace::Before
                     : configured.data_id == "after" ? can::DataIdPlace::After
                                                     : can::DataIdPlace::None};
  return description;
}

Result<can::ProtocolMapping> protocol_mapping(const StationConfiguration& configuration) {
  can::ProtocolMapping mapping;
  const Result<can::ProtectionDescription> described = protection(configuration);
  if (!described) return tl::unexpected(described.error());
  mapping.protection = *described;
  mapping.fast_data = configuration.can.data_bitrate > 0;
  const double period_s = configuration.can.period_s();
  mapping.period_ns = std::llround(1e9 * period_s);
  mapping.samples_per_period =
      static_cast<int>(std::lround(1e3 * period_s / configuration.can.feedback_cycle_ms));
  mapping.commands_per_period =
      static_cast<int>(std::lround(1e3 * period_s / configuration.can.command_cycle_ms));
  for (const CanSequenceFrame& frame : configuration.can.startup)
    mapping.startup.push_back({frame.message, frame.signals, frame.wait_ms});
  for (const CanSequenceFrame& frame : configuration.can.shutdown)
    mapping.shutdown.push_back({frame.message, frame.signals, frame.wait_ms});
  std::set<std::string_view> listed;
  for (const auto& [role, signal] : configuration.can.mapping) {
    bool known = false;
    for (const MappingRole& candidate : kMappingRoles) {
      if (candidate.role != role) continue;
      if (candidate.needed && signal.empty())
        return failure(
            fmt::format("{}: [can.mapping] {} is empty, but a check cannot do without: name the signal of "
                        "the DBC file that "
                        "has it, or leave the line out for the default, \"{}\"",
                        configuration.file, role, mapping.*candidate.signal));
      if (candidate.names == nullptr) {
        mapping.*candidate.signal = signal;
      } else {
        if (listed.insert(role).second) (mapping.*candidate.names).clear();
        if (!signal.empty()) (mapping.*candidate.names).push_back(signal);
      }
      known = true;
    }
    if (!known) {
      std::string roles;
      for (const MappingRole& candidate : kMappingRoles) roles += fmt::format(" {}", candidate.role);
      return failure(fmt::format("{}: [can.mapping] has no role '{}'; the roles are:{}", configuration.file,
                                 role, roles));
    }
  }
  if (mapping.torque_command.empty() && mapping.velocity_command.empty())
    return failure(
        fmt::format("{}: [can.mapping] torque_command is empty, and there is no velocity_command, but a "
                    "brake has to be told one of the two: name the signal of the DBC file that has it",
                    configuration.file));
  if (!mapping.velocity_command.empty() && mapping.period_ns > kPeriod_ns)
    return failure(fmt::format(
        "{}: [can.mapping] velocity_command and cycles above 1 ms exclude each other: what the brake's own "
        "loop does "
        "between two readings would remain unseen; have it send them each millisecond, or tell it its torque",
        configuration.file));
  return mapping;
}

}  // namespace

Result<FrameDescription> read_frames(const StationConfiguration& configuration) {
  const Result<can::ProtocolMapping> mapping = protocol_mapping(configuration);
  if (!mapping) return tl::unexpected(mapping.error());
  Result<can::Database> database = configuration.can.dbc.empty()
                                       ? can::parse_dbc(kBuiltinDbc, "built-in brake.dbc")
                                       : can::read_dbc(configuration.can.dbc);
  if (!database) return tl::unexpected(database.error());
  return FrameDescription{std::move(*database), *mapping};
}

Result<can::ProtocolCodec> build_codec(const StationConfiguration& configuration) {
  return read_frames(configuration).and_then([](const FrameDescription& frames) {
    return can::ProtocolCodec::build(frames.database, frames.mapping);
  });
}

can::BusFormat bus_format(const StationConfiguration& configuration, const can::ProtocolCodec& codec) {
  const CanSettings& bus = configuration.can;
  return {codec.needs_flexible_data_rate(),
          bus.data_bitrate > 0 ? static_cast<double>(bus.data_bitrate) / bus.bitrate : 1.0};
}

namespace {

Result<ExtendedParameters> read_check_model(const StationConfiguration& configuration) {
  const std::string& file = configuration.check.model;
  Result<ExtendedParameters> model = read_extended_parameters(file);
  if (!model) return model;
  if (model->effects.empty())
    return failure(
        fmt::format("{}: has no [[effect]]; leave [check] model out to check by the base model", file));
  const FixedParameters& found = model->base.fixed;
  const FixedParameters& known = configuration.model.fixed;
  const auto differs = [](double a, double b) { return std::abs(a - b) > 1e-9 * std::abs(b); };
  if (differs(found.inertia_kg_m2, known.inertia_kg_m2) || differs(found.ratio_m_rad, known.ratio_m_rad))
    return failure(fmt::format(
        "{}: was found with J = {} kg m^2 and N = {} m/rad, but the station's brake has {} and {}; "
        "diagnose with `--parameters` of the station's [model] brake",
        file, found.inertia_kg_m2, found.ratio_m_rad, known.inertia_kg_m2, known.ratio_m_rad));
  return model;
}

rt::SupervisorSettings supervisor_settings(const StationConfiguration& configuration) {
  const clampd::SupervisorSettings& configured = configuration.supervisor;
  const auto nanoseconds = [](double milliseconds) {
    return static_cast<std::int64_t>(milliseconds * static_cast<double>(kNanosecondsPerMillisecond));
  };
  auto settings =
      rt::SupervisorSettings::of(nominal_drive(configuration.model, configuration.can.period_s()));
  settings.startup_timeout_ns = nanoseconds(configured.start_up_ms);
  if (configured.stale_after_ms) settings.stale_ns = nanoseconds(*configured.stale_after_ms);
  settings.corrupt_tolerated = static_cast<std::uint64_t>(configured.corrupt_frames_max);
  settings.frozen_tolerated = static_cast<std::uint64_t>(configured.frozen_frames_max);
  settings.implausible_tolerated = static_cast<std::uint64_t>(configured.implausible_frames_max);
  settings.send_failures_tolerated = static_cast<std::uint64_t>(configured.send_failures_max);
  settings.force_limit_N = configured.over_force_N;
  settings.force_ceiling_N = configured.over_force_ceiling_N;
  settings.speed_limit_rad_s = configured.over_speed_rad_s;
  settings.torque_limit_Nm = configured.over_torque_Nm;
  settings.travel_limit_rad = configured.over_travel_rad;
  settings.plausible_force_N = configured.plausible_force_N;
  settings.plausible_velocity_rad_s = configured.plausible_velocity_rad_s;
  settings.plausible_torque_Nm = configured.plausible_torque_Nm;
  settings.readings = {configured.torque_mismatch_Nm, configured.velocity_mismatch_rad_s,
                       configured.position_mismatch_rad, configured.force_mismatch_N};
  settings.drive_reports_live = configured.drive_reports_live;
  settings.skipped_in_a_row_tolerated = static_cast<std::uint64_t>(configured.missed_ticks_max);
  settings.skipped_per_check_tolerated = static_cast<std::uint64_t>(configured.missed_ticks_total_max);
  return settings;
}

gpio::LineSettings panel_line(const GpioLine& configured) {
  gpio::LineSettings line{configured.chip, configured.line, configured.active_low, gpio::Bias::AsIs};
  if (configured.bias == "disabled") line.bias = gpio::Bias::Disabled;
  if (configured.bias == "pull-up") line.bias = gpio::Bias::PullUp;
  if (configured.bias == "pull-down") line.bias = gpio::Bias::PullDown;
  return line;
}

gpio::PanelSettings panel_settings(const StationConfiguration& configuration) {
  const GpioSettings& configured = configuration.gpio;
  const auto nanoseconds = [](double milliseconds) {
    return static_cast<std::int64_t>(milliseconds * static_cast<double>(kNanosecondsPerMillisecond));
  };
  gpio::PanelSettings panel;
  const auto set = [&panel](gpio::LineRole role, const GpioLine& line) {
    panel.lines[static_cast<std::size_t>(role)] = panel_line(line);
  };
  set(gpio::LineRole::EmergencyStop, configured.emergency_stop);
  set(gpio::LineRole::FixtureClosed, configured.fixture_closed);
  set(gpio::LineRole::StartButton, configured.start_button);
  set(gpio::LineRole::EnableRelay, configured.enable_relay);
  set(gpio::LineRole::LightRed, configured.light_red);
  set(gpio::LineRole::LightAmber, configured.light_amber);
  set(gpio::LineRole::LightGreen, configured.light_green);
  panel.debounce_ns = nanoseconds(configured.debounce_ms);
  panel.release_ns = nanoseconds(configured.release_ms);
  panel.stuck_after_ns = nanoseconds(1e3 * configured.start_stuck_s);
  panel.poll_ns = nanoseconds(configured.poll_ms);
  panel.lost_after_ns = nanoseconds(configured.lost_after_ms);
  panel.relay_watchdog_ns = nanoseconds(configured.relay_watchdog_ms);
  panel.loop_priority = configuration.realtime.priority;
  return panel;
}

/// `references`: the check's own first.
rt::CheckPlan check_plan(const StationConfiguration& configuration, const std::vector<Reference>& references) {
  const CheckSettings& check = configuration.check;
  rt::CheckPlan plan;
  plan.reference = references.front();
  plan.further.assign(references.begin() + 1, references.end());
  plan.drive = nominal_drive(configuration.model, configuration.can.period_s());
  plan.repeats = static_cast<std::uint16_t>(check.repeats_planned());
  plan.tare_s = check.tare_s;
  plan.approach_velocity_rad_s = check.approach_velocity_rad_s;
  plan.contact_force_N = check.contact_force_N;
  plan.clearance_rad = check.clearance_rad;
  plan.settle_s = check.settle_s;
  plan.phase_timeout_s = check.phase_timeout_s;
  plan.torque_limit_Nm = check.torque_limit_Nm;
  return plan;
}

}  // namespace

namespace {

/// What the runs alone take, without the ways between them.
Result<void> check_deadline(const StationConfiguration& configuration, const rt::CheckPlan& plan) {
  const CheckSettings& check = configuration.check;
  const double least_s =
      check.tare_s +
      check.repeats_planned() *
          (static_cast<double>(plan.reference.rows.size()) * plan.drive.period_s + check.settle_s);
  if (least_s < check.deadline_s) return {};
  return failure(
      fmt::format("{}check.deadline_s = {:g} is too short for {} repeats, which take {:.0f} s and the "
                  "ways between them: allow more time or ask for fewer",
                  configuration.file.empty() ? "" : configuration.file + ": ", check.deadline_s,
                  check.repeats_planned(), least_s));
}

/// What no bus of this bit rate carries.
Result<void> check_bus(const StationConfiguration& configuration, const can::ProtocolCodec& codec) {
  const CanSettings& can = configuration.can;
  const double load = can::bus_load(codec, can.bitrate, bus_format(configuration, codec).data_speedup);
  if (load < 1.0) return {};
  return failure(
      fmt::format("{}the frames of [can] may take {:.0f} % of a bus at {} bit/s, with readings every {:g} ms "
                  "and commands every "
                  "{:g} ms: raise bitrate or data_bitrate, or have fewer, shorter or less frequent frames",
                  configuration.file.empty() ? "" : configuration.file + ": ", 100.0 * load, can.bitrate,
                  can.feedback_cycle_ms, can.command_cycle_ms));
}

}  // namespace

Result<StationConfiguration> load_configuration(const std::string& path) {
  if (!path.empty()) return read_station_configuration(path);
  std::error_code ignored;
  if (std::filesystem::exists(kInstalledConfiguration, ignored))
    return read_station_configuration(kInstalledConfiguration);
  StationConfiguration defaults;
  defaults.database = default_database(defaults.simulated_brake);
  return defaults;
}

namespace {

Result<LimitSet> limits_of(const StationConfiguration& configuration, const Recipe* recipe) {
  if (recipe != nullptr && recipe->limits) return *recipe->limits;
  return configuration.limits_file.empty() ? parse_limits(std::string(kBuiltinLimits), "built-in limits.toml")
                                           : read_limits(configuration.limits_file);
}

struct LoadedReference {
  Reference reference;
  std::string sha256;
};

Result<LoadedReference> reference_of(const Result<LoadedRun>& trajectory,
                                     const StationConfiguration& configuration) {
  if (!trajectory) return tl::unexpected(trajectory.error());
  return build_reference(trajectory->run, configuration.model, {.period_s = configuration.can.period_s()})
      .map([&](Reference reference) {
        return LoadedReference{std::move(reference), sha256_hex(format_run(trajectory->run))};
      });
}

/// The check's trajectory first, then the further ones.
std::vector<Result<LoadedRun>> read_trajectories(const CheckSettings& check) {
  std::vector<Result<LoadedRun>> runs;
  const bool is_builtin = check.trajectory.empty();
  runs.push_back(is_builtin ? parse_run(std::string(kBuiltinTrajectory), "built-in trajectory.csv")
                            : read_run(check.trajectory));
  if (check.further_trajectories) {
    for (const std::string& file : *check.further_trajectories) runs.push_back(read_run(file));
  } else if (is_builtin) {
    runs.push_back(parse_run(std::string(kBuiltinSliding), "built-in trajectory-sliding.csv"));
    runs.push_back(parse_run(std::string(kBuiltinBreakaway), "built-in trajectory-breakaway.csv"));
  }
  return runs;
}

constexpr std::size_t kMostTrajectories = 16;

Result<void> prepare_trajectories(PreparedCheck& check) {
  std::vector<Reference> references;
  for (const Result<LoadedRun>& run : read_trajectories(check.configuration.check)) {
    Result<LoadedReference> loaded = reference_of(run, check.configuration);
    if (!loaded) return tl::unexpected(loaded.error());
    if (!references.empty() && loaded->reference.rows.size() != references[0].rows.size())
      return failure(fmt::format(
          "{}: a further trajectory must have as many rows as the check's own, {}, not {}",
          run->run.name, references[0].rows.size(), loaded->reference.rows.size()));
    references.push_back(std::move(loaded->reference));
    check.trajectories_sha256.push_back(std::move(loaded->sha256));
  }
  if (references.size() > kMostTrajectories)
    return failure(fmt::format("{}check.further_trajectories names {} files; at most {}",
                               check.configuration.file.empty() ? "" : check.configuration.file + ": ",
                               references.size() - 1, kMostTrajectories - 1));
  check.trajectory_sha256 = check.trajectories_sha256.front();
  check.plan = check_plan(check.configuration, references);
  check.trajectories =
      TrajectorySet(std::move(references), check.plan.drive, check.configuration.check.torque_limit_Nm);
  return check_deadline(check.configuration, check.plan);
}

/// What `configuration` names, and the limits that are written into `recipe`, if there is one.
Result<PreparedCheck> prepare_check(const StationConfiguration& configuration, const Recipe* recipe) {
  PreparedCheck check;
  check.configuration = configuration;

  Result<LimitSet> limits = limits_of(configuration, recipe);
  if (!limits) return tl::unexpected(limits.error());
  check.limits = std::move(*limits);

  if (!configuration.check.model.empty()) {
    Result<ExtendedParameters> model = read_check_model(configuration);
    if (!model) return tl::unexpected(model.error());
    check.model = std::move(*model);
    check.configuration.check.method = Method::PredictionError;
  }
  if (const Result<void> usable = check_limits(check.limits, check.model.value_or(ExtendedParameters{}));
      !usable)
    return tl::unexpected(usable.error());

  if (!configuration.sheet_file.empty()) {
    Result<Sheet> sheet = read_sheet(configuration.sheet_file);
    if (!sheet) return tl::unexpected(sheet.error());
    if (check.model)
      if (const Result<void> countable = check_countable(check.model->effects); !countable)
        return failure(fmt::format("{}: {}: leave the sheet out, or the effect out of [check] model = \"{}\"",
                                   sheet->file, countable.error().message, configuration.check.model));
    check.sheet = std::move(*sheet);
  }
  return prepare_trajectories(check).map([&] { return std::move(check); });
}

/// Codec and socket belong to a loop that never stands still, since it feeds the brake's watchdog in IDLE
/// too: they stay what they are, and a recipe that needs others is refused.
Result<std::string> refusal_of(const Recipe& recipe, StationConfiguration configuration,
                               const can::ProtocolCodec& of_station) {
  if (!recipe.states_can_layout()) return std::string();
  const std::string own = configuration.can.dbc.empty() ? "the built-in brake.dbc" : configuration.can.dbc;
  if (!recipe.dbc.empty()) configuration.can.dbc = recipe.dbc;
  if (!recipe.mapping.empty()) configuration.can.mapping = recipe.mapping;
  configuration.file = recipe.file;  // whose [can] it is, in messages
  return build_codec(configuration).map([&](const can::ProtocolCodec& needed) {
    return needed == of_station
               ? std::string()
               : fmt::format(
                     "its recipe {} needs the CAN layout of {}, and this station runs that of {}: check "
                     "these "
                     "brakes on a station that is configured for them ([can] dbc and [can.mapping])",
                     recipe.file, configuration.can.dbc.empty() ? own : configuration.can.dbc, own);
  });
}

Result<PreparedRecipe> prepare_recipe(const PreparedStation& station, Recipe recipe) {
  const auto named_by = [&recipe](const Error& error) {
    const bool own = error.message.starts_with(recipe.file + ":");
    return failure(
        own ? error.message
            : fmt::format("{}: part number {}: {}", recipe.file, recipe.part_number, error.message));
  };
  Result<PreparedCheck> check = prepare_check(with_recipe(station.configuration, recipe), &recipe);
  if (!check) return named_by(check.error());
  Result<std::string> refusal = refusal_of(recipe, station.configuration, station.codec);
  if (!refusal) return named_by(refusal.error());
  return PreparedRecipe{std::move(*check), std::move(recipe), std::move(*refusal)};
}

}  // namespace

Result<PreparedStation> prepare_station(const StationConfiguration& configuration) {
  Result<PreparedCheck> own = prepare_check(configuration, nullptr);
  if (!own) return tl::unexpected(own.error());
  PreparedStation station;
  static_cast<PreparedCheck&>(station) = std::move(*own);

  Result<can::ProtocolCodec> codec = build_codec(configuration);
  if (!codec) return tl::unexpected(codec.error());
  station.codec = std::move(*codec);
  station.plan.commanded = station.codec.commanded;
  if (const Result<void> carried = check_bus(configuration, station.codec); !carried)
    return tl::unexpected(carried.error());
  station.supervisor = supervisor_settings(configuration);
  if (const Result<void> valid = station.supervisor.validate(); !valid) return tl::unexpected(valid.error());
  if (configuration.gpio.used()) station.panel = panel_settings(configuration);
  if (configuration.recipes_directory.empty()) return station;

  Result<std::vector<Recipe>> recipes = read_recipes(configuration.recipes_directory);
  if (!recipes) return tl::unexpected(recipes.error());
  for (Recipe& recipe : *recipes) {
    Result<PreparedRecipe> prepared = prepare_recipe(station, std::move(recipe));
    if (!prepared) return tl::unexpected(prepared.error());
    prepared->plan.commanded = station.codec.commanded;
    station.recipes.push_back(std::move(*prepared));
  }
  return station;
}

RetentionPolicy retention_policy(const StationConfiguration& configuration) {
  constexpr std::uint64_t kBytesPerMegabyte = 1'000'000;
  const RetentionSettings& settings = configuration.retention;
  return {settings.raw_days, settings.raw_megabytes * kBytesPerMegabyte, settings.published};
}

Result<sim::PlantConfiguration> load_plant(const std::string& path) {
  Result<sim::PlantConfiguration> shipped =
      sim::parse_plant_configuration(kBuiltinPlant, "built-in plant.toml");
  if (!shipped || path.empty()) return shipped;
  return sim::read_plant_configuration(path, *shipped);
}

}  // namespace clampd::bench
