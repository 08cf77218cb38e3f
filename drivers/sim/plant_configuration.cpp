#include "drivers/sim/plant_configuration.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include "clampd/record/file.hpp"

namespace clampd::sim {
namespace {

template <class Settings>
struct Key {
  std::string_view name;
  double Settings::*member;
  double lower;
  double upper;
};

constexpr std::array kSensorKeys = {
    Key<SensorSettings>{"force_noise_N", &SensorSettings::force_noise_N, 0.0, 5000.0},
    Key<SensorSettings>{"velocity_noise_rad_s", &SensorSettings::velocity_noise_rad_s, 0.0, 100.0},
    Key<SensorSettings>{"torque_noise_Nm", &SensorSettings::torque_noise_Nm, 0.0, 1.0},
    Key<SensorSettings>{"position_noise_rad", &SensorSettings::position_noise_rad, 0.0, 1.0},
    Key<SensorSettings>{"force_quantum_N", &SensorSettings::force_quantum_N, 0.0, 1000.0},
    Key<SensorSettings>{"velocity_quantum_rad_s", &SensorSettings::velocity_quantum_rad_s, 0.0, 10.0},
    Key<SensorSettings>{"torque_quantum_Nm", &SensorSettings::torque_quantum_Nm, 0.0, 0.1},
    Key<SensorSettings>{"position_quantum_rad", &SensorSettings::position_quantum_rad, 0.0, 1.0},
    Key<SensorSettings>{"force_offset_N", &SensorSettings::force_offset_N, -2000.0, 2000.0},
    Key<SensorSettings>{"velocity_offset_rad_s", &SensorSettings::velocity_offset_rad_s, -20.0, 20.0},
};

constexpr std::array kPlantKeys = {
    Key<PlantConfiguration>{"clearance_rad", &PlantConfiguration::clearance_rad, -90.0, 1000.0},
    Key<PlantConfiguration>{"encoder_zero_rad", &PlantConfiguration::encoder_zero_rad, -1e5, 1e5},
    Key<PlantConfiguration>{"open_stop_rad", &PlantConfiguration::open_stop_rad, 0.0, 1000.0},
    Key<PlantConfiguration>{"closed_stop_rad", &PlantConfiguration::closed_stop_rad, 0.0, 1000.0},
    Key<PlantConfiguration>{"torque_limit_Nm", &PlantConfiguration::torque_limit_Nm, 0.0, 10.0},
    Key<PlantConfiguration>{"watchdog_s", &PlantConfiguration::watchdog_s, 0.002, 1.0},
    Key<PlantConfiguration>{"speed_bandwidth_rad_s", &PlantConfiguration::speed_bandwidth_rad_s, 0.0, 1000.0},
    Key<PlantConfiguration>{"speed_period_s", &PlantConfiguration::speed_period_s, 1e-6, 1e-3},
    Key<PlantConfiguration>{"step_s", &PlantConfiguration::step_s, 1e-6, 20e-6},
    Key<PlantConfiguration>{"sampling_jitter_s", &PlantConfiguration::sampling_jitter_s, 0.0, 100e-6},
};

constexpr std::array kFaultKinds = {FaultKind::CorruptCrc, FaultKind::FrozenCounter,
                                    FaultKind::ImpossibleValues, FaultKind::Silent};

std::string where(const std::string& path, const toml::node& node) {
  return fmt::format("{}:{}", path, node.source().begin.line);
}

Result<void> read_number(const std::string& path, std::string_view table, std::string_view name,
                         const toml::node& node, double& number) {
  const std::optional<double> value = node.value<double>();
  if (!value || !node.is_number())  // nothing: a whole number beyond 2^53
    return failure(fmt::format("{}: {}.{} must be a number", where(path, node), table, name));
  number = *value;
  return {};
}

template <class Settings, std::size_t n>
Result<void> read_key(const std::string& path, std::string_view table, std::string_view name,
                      const toml::node& node, const std::array<Key<Settings>, n>& keys, Settings& settings) {
  for (const Key<Settings>& key : keys) {
    if (key.name != name) continue;
    return read_number(path, table, name, node, settings.*key.member);
  }
  std::vector<std::string_view> names;
  for (const Key<Settings>& key : keys) names.push_back(key.name);
  return failure(fmt::format("{}: unknown key {}.{}; known are: {}", where(path, node), table, name,
                             fmt::join(names, ", ")));
}

/// The member of an episode that has this name in the file, or null.
double* find_time(Episode& episode, std::string_view name) {
  if (name == "at_s") return &episode.at_s;
  if (name == "duration_s") return &episode.duration_s;
  return name == "from_force_N" ? &episode.from_force_N : nullptr;
}

Result<ScriptedFault> read_fault(const std::string& path, const toml::table& table) {
  ScriptedFault fault;
  bool has_kind = false, has_end = false;
  for (const auto& [key, node] : table) {
    const std::string_view name = key.str();
    if (name == "kind") {
      const std::string text = node.value_or(std::string());
      for (const FaultKind kind : kFaultKinds)
        if (to_string(kind) == text) {
          fault.kind = kind;
          has_kind = true;
        }
      if (!has_kind)
        return failure(
            fmt::format("{}: unknown fault kind '{}'; known are: corrupt-crc, frozen-counter, "
                        "impossible-values, silent",
                        where(path, node), text));
    } else if (double* const number = find_time(fault.when, name)) {
      if (auto read = read_number(path, "fault", name, node, *number); !read)
        return tl::unexpected(read.error());
      has_end = has_end || name == "duration_s";
    } else {
      return failure(
          fmt::format("{}: unknown key fault.{}; known are: kind, at_s, duration_s, from_force_N",
                      where(path, node), name));
    }
  }
  if (!has_kind) return failure(fmt::format("{}: a [[fault]] needs a kind", where(path, table)));
  if (!has_end || !fault.when.valid())
    return failure(fmt::format("{}: a [[fault]] needs duration_s > 0, and at_s and from_force_N not below 0",
                               where(path, table)));
  return fault;
}

/// The enumerator with this name, or nothing; `known` gets the names of all.
template <class Enum>
std::optional<Enum> find_name(const toml::node& node, std::size_t count, std::string& known) {
  std::optional<Enum> found;
  for (std::size_t i = 0; i < count; ++i) {
    const std::string_view name = to_string(static_cast<Enum>(i));
    known += (i > 0 ? ", " : "") + std::string(name);
    if (node.value_or(std::string()) == name) found = static_cast<Enum>(i);
  }
  return found;
}

Result<SpoiledReading> read_spoil(const std::string& path, const toml::table& table) {
  SpoiledReading spoiled;
  std::optional<Reading> reading;
  std::optional<Spoil> kind;
  for (const auto& [key, node] : table) {
    const std::string_view name = key.str();
    std::string known;
    if (name == "reading") {
      reading = find_name<Reading>(node, kReadingCount, known);
      if (!reading)
        return failure(fmt::format("{}: spoil.reading must be one of: {}", where(path, node), known));
    } else if (name == "kind") {
      kind = find_name<Spoil>(node, kSpoilCount, known);
      if (!kind) return failure(fmt::format("{}: spoil.kind must be one of: {}", where(path, node), known));
    } else if (double* const number = name == "amount" ? &spoiled.amount : find_time(spoiled.when, name)) {
      if (auto read = read_number(path, "spoil", name, node, *number); !read)
        return tl::unexpected(read.error());
    } else {
      return failure(fmt::format(
          "{}: unknown key spoil.{}; known are: reading, kind, amount, at_s, duration_s, from_force_N",
          where(path, node), name));
    }
  }
  if (!reading || !kind)
    return failure(fmt::format("{}: a [[spoil]] needs a reading and a kind", where(path, table)));
  spoiled.reading = *reading;
  spoiled.spoil = *kind;
  if (!spoiled.valid())
    return failure(
        fmt::format("{}: a [[spoil]] needs at_s >= 0, duration_s > 0, from_force_N >= 0, and an amount "
                    "that its kind can have (late: 1 to {} samples; noisy: not negative)",
                    where(path, table), kLatest));
  return spoiled;
}

Result<void> read_tables(const std::string& path, const toml::table& root,
                         PlantConfiguration& configuration) {
  for (const auto& [table_key, node] : root) {
    const std::string_view table_name = table_key.str();
    if (table_name == "parameters" || table_name == "parameters_normalised" || table_name == "fixed")
      continue;
    if (table_name == "fault") {
      const toml::array* list = node.as_array();
      if (!list || !list->is_array_of_tables())
        return failure(fmt::format("{}: faults are written as [[fault]]", where(path, node)));
      for (const toml::node& element : *list) {
        const Result<ScriptedFault> fault = read_fault(path, *element.as_table());
        if (!fault) return tl::unexpected(fault.error());
        configuration.faults.push_back(*fault);
      }
      continue;
    }
    if (table_name == "spoil") {
      const toml::array* list = node.as_array();
      if (!list || !list->is_array_of_tables())
        return failure(fmt::format("{}: spoiled readings are written as [[spoil]]", where(path, node)));
      for (const toml::node& element : *list) {
        const Result<SpoiledReading> spoiled = read_spoil(path, *element.as_table());
        if (!spoiled) return tl::unexpected(spoiled.error());
        configuration.spoiled.push_back(*spoiled);
      }
      continue;
    }
    const toml::table* table = node.as_table();
    if (!table || (table_name != "plant" && table_name != "sensors" && table_name != "effects"))
      return failure(
          fmt::format("{}: unknown entry '{}'; known are [parameters] or [parameters_normalised], [fixed], "
                      "[plant], [sensors], [effects], [[fault]] and [[spoil]]",
                      where(path, node), table_name));
    for (const auto& [key, value] : *table) {
      Result<void> read;
      if (table_name == "sensors") {
        read = read_key(path, table_name, key.str(), value, kSensorKeys, configuration.sensors);
      } else if (table_name == "effects") {
        if (!value.is_number() || !value.value<double>())
          return failure(fmt::format("{}: effects.{} must be a number", where(path, value), key.str()));
        read = set_effect(configuration.effects, key.str(), *value.value<double>());
        if (!read) return failure(fmt::format("{}: {}", where(path, value), read.error().message));
      } else if (key.str() == "seed") {
        const std::optional<std::int64_t> seed = value.value_exact<std::int64_t>();
        if (!seed || *seed < 0)
          return failure(
              fmt::format("{}: plant.seed must be an integer that is not negative", where(path, value)));
        configuration.seed = static_cast<std::uint64_t>(*seed);
      } else {
        read = read_key(path, table_name, key.str(), value, kPlantKeys, configuration);
      }
      if (!read) return read;
    }
  }
  return {};
}

}  // namespace

std::string_view to_string(FaultKind kind) noexcept {
  switch (kind) {
    case FaultKind::CorruptCrc:
      return "corrupt-crc";
    case FaultKind::FrozenCounter:
      return "frozen-counter";
    case FaultKind::ImpossibleValues:
      return "impossible-values";
    case FaultKind::Silent:
      return "silent";
  }
  return "?";
}

bool PlantConfiguration::fault_active(FaultKind kind, double time_s) const noexcept {
  return std::any_of(faults.begin(), faults.end(),
                     [&](const ScriptedFault& fault) { return fault.kind == kind && fault.when.active(time_s); });
}

Result<void> PlantConfiguration::validate() const {
  const auto check = [](std::string_view name, double value, double lower, double upper) -> Result<void> {
    if (std::isfinite(value) && value >= lower && value <= upper) return {};
    return failure(fmt::format("{} = {} must lie within [{}, {}]", name, value, lower, upper));
  };
  for (const auto& key : kSensorKeys)
    if (auto result = check(key.name, sensors.*key.member, key.lower, key.upper); !result) return result;
  for (const auto& key : kPlantKeys)
    if (auto result = check(key.name, this->*key.member, key.lower, key.upper); !result) return result;
  for (const SpoiledReading& reading : spoiled)
    if (!reading.valid()) return failure("a spoiled reading has a time or an amount that it cannot have");
  if (clearance_rad > open_stop_rad || -clearance_rad > closed_stop_rad)
    return failure(
        fmt::format("clearance_rad = {} starts the brake beyond its end stops (open_stop_rad = {}, "
                    "closed_stop_rad = {})",
                    clearance_rad, open_stop_rad, closed_stop_rad));
  for (std::size_t i = 0; i < kParameterCount; ++i)
    if (!std::isfinite(brake.theta[static_cast<Eigen::Index>(i)]))
      return failure(fmt::format("parameter {} is not finite", kParameterTable[i].name));
  if (!(brake.fixed.inertia_kg_m2 > 0.0) || !(brake.fixed.ratio_m_rad > 0.0))
    return failure("inertia_kg_m2 and ratio_m_rad must be positive");
  return {};
}

Result<PlantConfiguration> read_plant_configuration(const std::string& path, const PlantConfiguration& base) {
  const Result<std::string> text = read_file(path);
  if (!text) return tl::unexpected(text.error());
  return parse_plant_configuration(*text, path, base);
}

Result<PlantConfiguration> parse_plant_configuration(std::string_view text, const std::string& path,
                                                     const PlantConfiguration& base) {
  PlantConfiguration configuration = base;
  const Result<BrakeParameters> brake = parse_brake_parameters(text, path);
  if (!brake) return tl::unexpected(brake.error());
  configuration.brake = *brake;
  try {
    const toml::table root = toml::parse(text, path);
    if (auto read = read_tables(path, root, configuration); !read) return tl::unexpected(read.error());
  } catch (const toml::parse_error& parse_error) {
    return failure(
        fmt::format("{}:{}: {}", path, parse_error.source().begin.line, parse_error.description()));
  }
  if (auto valid = configuration.validate(); !valid)
    return failure(fmt::format("{}: {}", path, valid.error().message));
  return configuration;
}

}  // namespace clampd::sim
