#include "clampd/station/configuration.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <limits>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"
#include "clampd/base/table_reader.hpp"
#include "clampd/identify/systematic_misfit.hpp"
#include "clampd/record/file.hpp"
#include "clampd/record/text.hpp"
#include "src/station/configuration_tables.hpp"

namespace clampd {
namespace {

constexpr const char* kSimulatedDatabase = "simulated.sqlite";

constexpr double kSafeForce_N = 40'000.0;
constexpr double kSafeCeiling_N = 44'000.0;
constexpr double kSafeSpeed_rad_s = 500.0;
constexpr double kSafeTorque_Nm = 10.0;

/// Calls `read(reader, table)` on a table if it is there, and refuses what is left over.
template <class Read>
void read_section(TableReader& document, std::string_view key, const std::string& file,
                  std::optional<Error>& error, Read read) {
  const toml::table* table = document.table(key);
  if (table == nullptr || error) return;
  TableReader reader(*table, std::string(key), file, error);
  read(reader, *table);
  reader.finish();
}

void read_instruments(TableReader& document, const std::string& file, std::optional<Error>& error,
                      std::vector<Instrument>& instruments) {
  const toml::array* array = document.array_of_tables("instruments");
  if (array == nullptr) return;
  for (const toml::node& node : *array) {
    TableReader reader(*node.as_table(), "instruments", file, error);
    Instrument instrument;
    reader.text("name", instrument.name);
    reader.text("serial", instrument.serial);
    reader.date("calibrated", instrument.calibrated);
    reader.finish();
    if (instrument.name.empty()) reader.refuse(node.source(), "an instrument needs a name");
    instruments.push_back(std::move(instrument));
  }
}

/// Scheme, host and port of an address as browsers send it, in lower case; nothing if it is something else.
std::optional<std::string> canonical_origin(const std::string& text) {
  constexpr std::string_view kHostCharacters = "abcdefghijklmnopqrstuvwxyz0123456789.-:[]";
  std::string origin = text;
  std::transform(origin.begin(), origin.end(), origin.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  for (const std::string_view scheme : {"https://", "http://"})
    if (origin.starts_with(scheme) && origin.size() > scheme.size() &&
        origin.find_first_not_of(kHostCharacters, scheme.size()) == std::string::npos)
      return origin;
  return std::nullopt;
}

/// A whole number up to 64 bits, decimal or, after 0x, hexadecimal; TOML's own numbers have 63.
void read_word(TableReader& reader, const toml::table& table, std::string_view key, std::uint64_t& target) {
  if (!reader.has(key)) return;
  if (table[key].is_integer()) {
    reader.integer(key, target, 0, std::numeric_limits<std::int64_t>::max());
    return;
  }
  std::string text;
  reader.text(key, text);
  const bool hexadecimal = text.starts_with("0x") || text.starts_with("0X");
  const char* begin = text.data() + (hexadecimal ? 2 : 0);
  const char* end = text.data() + text.size();
  std::uint64_t value = 0;
  const auto [stopped, error] = std::from_chars(begin, end, value, hexadecimal ? 16 : 10);
  if (error != std::errc{} || stopped != end)
    reader.refuse(table.get(key)->source(),
                  fmt::format("can.protection.{} must be a number of up to 64 bits, such as \"0x1D\"", key));
  else
    target = value;
}

void read_protection(TableReader& parent, const std::string& file, std::optional<Error>& error,
                     CanProtection& protection) {
  const toml::table* table = parent.table("protection");
  if (table == nullptr) return;
  TableReader reader(*table, "can.protection", file, error);
  reader.text("checksum", protection.checksum);
  const bool described = protection.checksum == "crc";
  for (const std::string_view key : {"width", "polynomial", "start", "final_xor", "reflected", "data_id"})
    if (!described && table->contains(key))
      reader.refuse(table->get(key)->source(),
                    fmt::format("can.protection.{} belongs to checksum = \"crc\", and checksum is \"{}\"",
                                key, protection.checksum));
  reader.integer("width", protection.width_bits, 8, 64);
  if (protection.width_bits != 8 && protection.width_bits != 16 && protection.width_bits != 32 &&
      protection.width_bits != 64)
    reader.refuse(table->get("width")->source(), "can.protection.width must be 8, 16, 32 or 64");
  read_word(reader, *table, "polynomial", protection.polynomial);
  read_word(reader, *table, "start", protection.start);
  read_word(reader, *table, "final_xor", protection.final_xor);
  reader.boolean("reflected", protection.reflected);
  reader.choice("data_id", protection.data_id, {"none", "before", "after"});
  reader.finish();
}

/// [[can.startup]] or [[can.shutdown]].
void read_sequence(TableReader& can, std::string_view key, const std::string& file,
                   std::optional<Error>& error, std::vector<CanSequenceFrame>& sequence) {
  const toml::array* tables = can.array_of_tables(key);
  if (tables == nullptr) return;
  for (const toml::node& node : *tables) {
    TableReader reader(*node.as_table(), fmt::format("can.{}", key), file, error);
    CanSequenceFrame& frame = sequence.emplace_back();
    reader.text("message", frame.message);
    if (frame.message.empty())
      reader.refuse("message", fmt::format("can.{} needs a message of the DBC file", key));
    // Nothing waits once the station ends.
    if (key == "startup") reader.number("wait_ms", frame.wait_ms, 0.0, 2000.0);
    if (const toml::table* signals = reader.table("signals")) {
      TableReader values(*signals, fmt::format("can.{}.signals", key), file, error);
      for (const auto& [name, value] : *signals)
        values.number(name.str(), frame.signals.emplace_back(std::string(name.str()), 0.0).second);
    }
    reader.finish();
  }
}

void read_cycle(TableReader& reader, const toml::table& table, std::string_view key, double& cycle_ms) {
  constexpr std::array kCycles_ms{5.0, 2.0, 1.0, 0.5, 0.25, 0.2};
  reader.number(key, cycle_ms, 1e-3, 1e3);
  if (std::find(kCycles_ms.begin(), kCycles_ms.end(), cycle_ms) != kCycles_ms.end()) return;
  reader.refuse(
      table.get(key)->source(),
      fmt::format(
          "can.{} is {:g} ms; it can be 5, 2, 1, 0.5, 0.25 or 0.2. {}", key, cycle_ms,
          cycle_ms > 5.0
              ? "Slower frames show too little of a clamping of 0.1 s, and too late what goes wrong: such a "
                "brake needs a faster mode for its check"
              : "Choose the cycle that its maker states, or another mode of it"));
}

bool is_slow(const CanSettings& can) {
  return can.period_s() > kPeriod_s;
}

/// The loop's period is the slower of the two, if that is more than a millisecond.
void compare_cycles(TableReader& reader, const toml::table& table, const CanSettings& can) {
  const double slower_ms = std::max(can.feedback_cycle_ms, can.command_cycle_ms);
  const double ratio = slower_ms / std::min(can.feedback_cycle_ms, can.command_cycle_ms);
  if (slower_ms <= 1.0) return;
  const std::string both = fmt::format("can.feedback_cycle_ms is {:g}, and can.command_cycle_ms {:g}",
                                       can.feedback_cycle_ms, can.command_cycle_ms);
  if (std::abs(ratio - std::round(ratio)) > 1e-9)
    reader.refuse(table.source(),
                  both + ": where one of them is above 1 ms, it has to be a multiple of the other");
  // The torque of a row is known when all of its readings are: a command then comes a whole period late.
  else if (can.feedback_cycle_ms < can.command_cycle_ms && can.command_cycle_ms > 2.0)
    reader.refuse(table.source(),
                  both +
                      ": where readings come more often than commands, these have to come every "
                      "2 ms or more often; have the brake send its readings as often as it "
                      "wants commands");
}

void read_can(TableReader& reader, const toml::table& table, const std::string& file,
              const std::string& folder, std::optional<Error>& error, CanSettings& can) {
  constexpr std::size_t kMaxInterface = 15;  // IFNAMSIZ - 1
  reader.text("interface", can.interface, kMaxInterface);
  if (can.interface.find_first_of("/ \t:") != std::string::npos)
    reader.refuse(table.get("interface")->source(), "can.interface is not the name of a network interface");
  reader.path("dbc", can.dbc, folder);
  reader.integer("bitrate", can.bitrate, 10'000, 1'000'000);
  reader.integer("data_bitrate", can.data_bitrate, 0, 8'000'000);
  if (can.data_bitrate != 0 && can.data_bitrate < can.bitrate)
    reader.refuse(
        table.get("data_bitrate")->source(),
        "can.data_bitrate must not be below can.bitrate; leave it out for a bus without bit-rate switch");
  read_cycle(reader, table, "feedback_cycle_ms", can.feedback_cycle_ms);
  read_cycle(reader, table, "command_cycle_ms", can.command_cycle_ms);
  compare_cycles(reader, table, can);
  read_protection(reader, file, error, can.protection);
  read_can_mapping(reader, file, error, can.mapping);
  read_sequence(reader, "startup", file, error, can.startup);
  read_sequence(reader, "shutdown", file, error, can.shutdown);
}

void read_line(TableReader& panel, std::string_view key, const std::string& chip, const std::string& file,
               std::optional<Error>& error, GpioLine& line) {
  const toml::table* table = panel.table(key);
  if (table == nullptr) return;
  TableReader reader(*table, fmt::format("gpio.{}", key), file, error);
  line.chip = chip;
  reader.text("chip", line.chip);
  if (const toml::node* node = table->get("line"); node != nullptr && node->is_integer()) {
    std::int64_t offset = 0;
    reader.integer("line", offset, 0, 1023);
    line.line = std::to_string(offset);
  } else {
    reader.text("line", line.line);
  }
  std::string active = "high";
  reader.choice("active", active, {"high", "low"});
  line.active_low = active == "low";
  reader.choice("bias", line.bias, {"as-is", "disabled", "pull-up", "pull-down"});
  reader.finish();
  if (line.line.empty())
    reader.refuse(table->source(),
                  fmt::format("gpio.{} needs a line: its number on the chip, or its name", key));
}

void read_gpio(TableReader& reader, const toml::table& table, const std::string& file,
               std::optional<Error>& error, GpioSettings& gpio) {
  struct Role {
    std::string_view key;
    GpioLine GpioSettings::*line;
  };
  constexpr std::array kRoles{Role{"emergency_stop", &GpioSettings::emergency_stop},
                              Role{"fixture_closed", &GpioSettings::fixture_closed},
                              Role{"start_button", &GpioSettings::start_button},
                              Role{"enable_relay", &GpioSettings::enable_relay},
                              Role{"light_red", &GpioSettings::light_red},
                              Role{"light_amber", &GpioSettings::light_amber},
                              Role{"light_green", &GpioSettings::light_green}};
  std::string chip;
  reader.text("chip", chip);
  for (const Role& role : kRoles) read_line(reader, role.key, chip, file, error, gpio.*role.line);
  reader.number("debounce_ms", gpio.debounce_ms, 1.0, 200.0);
  reader.number("release_ms", gpio.release_ms, 1.0, 1'000.0);
  reader.number("start_stuck_s", gpio.start_stuck_s, 1.0, 300.0);
  reader.number("poll_ms", gpio.poll_ms, 0.5, 5.0);
  reader.number("lost_after_ms", gpio.lost_after_ms, 2.0, 50.0);
  reader.number("relay_watchdog_ms", gpio.relay_watchdog_ms, 5.0, 100.0);
  if (!gpio.used())
    reader.refuse(table.source(), "[gpio] needs an emergency_stop: a panel without one stops nothing");
  if (gpio.lost_after_ms < 2.0 * gpio.poll_ms)
    reader.refuse(table.source(), "gpio.lost_after_ms must be at least twice gpio.poll_ms");
  for (std::size_t i = 0; i < kRoles.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      const GpioLine& a = gpio.*kRoles[i].line;
      const GpioLine& b = gpio.*kRoles[j].line;
      if (!a.line.empty() && a.line == b.line && a.chip == b.chip)
        reader.refuse(table.source(),
                      fmt::format("gpio.{} and gpio.{} are the same line", kRoles[j].key, kRoles[i].key));
    }
  }
}

void read_station(TableReader& reader, StationConfiguration& configuration, std::optional<bool>& simulated) {
  reader.text("name", configuration.name);
  reader.text("fixture", configuration.fixture);
  reader.text("part_number", configuration.part_number);
  reader.text("batch", configuration.batch);
  reader.text("operator", configuration.operator_name);
  bool value = false;
  reader.boolean("simulated_brake", value);
  if (reader.has("simulated_brake")) simulated = value;
}

void read_realtime(TableReader& reader, RealtimeSettings& realtime) {
  reader.integer("priority", realtime.priority, 0, 98);  // 99 belongs to the kernel's own threads
  reader.integer("cpu", realtime.cpu, -1, 1023);
  reader.boolean("lock_memory", realtime.lock_memory);
}

void read_supervisor(TableReader& reader, double period_ms, SupervisorSettings& s) {
  reader.number("start_up_ms", s.start_up_ms, 10.0, 60'000.0);
  if (reader.has("stale_after_ms")) {
    double stale_after_ms = 0.0;
    // Beyond, torque would outlive its cause by five periods.
    reader.number("stale_after_ms", stale_after_ms, 1.5 * period_ms, 4.5 * period_ms);
    s.stale_after_ms = stale_after_ms;
  }
  reader.integer("corrupt_frames_max", s.corrupt_frames_max, 0, 3);
  reader.integer("frozen_frames_max", s.frozen_frames_max, 0, 3);
  reader.integer("implausible_frames_max", s.implausible_frames_max, 0, 3);
  reader.integer("send_failures_max", s.send_failures_max, 0, 3);
  reader.number("over_force_N", s.over_force_N, 100.0, kSafeForce_N);
  reader.number("over_force_ceiling_N", s.over_force_ceiling_N, 100.0, kSafeCeiling_N);
  reader.number("over_speed_rad_s", s.over_speed_rad_s, 1.0, kSafeSpeed_rad_s);
  reader.number("over_torque_Nm", s.over_torque_Nm, 0.1, kSafeTorque_Nm);
  reader.number("over_travel_rad", s.over_travel_rad, 1.0, 10'000.0);
  reader.number("plausible_force_N", s.plausible_force_N, 1'000.0, 1e6);
  reader.number("plausible_velocity_rad_s", s.plausible_velocity_rad_s, 10.0, 1e4);
  reader.number("plausible_torque_Nm", s.plausible_torque_Nm, 1.0, 1e3);
  reader.number("torque_mismatch_Nm", s.torque_mismatch_Nm, 0.01, 1.0);
  reader.number("velocity_mismatch_rad_s", s.velocity_mismatch_rad_s, 5.0, 100.0);
  reader.number("position_mismatch_rad", s.position_mismatch_rad, 0.05, 2.0);
  reader.number("force_mismatch_N", s.force_mismatch_N, 200.0, 10'000.0);
  reader.integer("missed_ticks_max", s.missed_ticks_max, 0, 3);
  reader.integer("missed_ticks_total_max", s.missed_ticks_total_max, 0, 100'000);
  reader.boolean("drive_reports_live", s.drive_reports_live);
}

/// `repeats`: a number, or the word for as many as the brake needs.
void read_repeats(TableReader& reader, const toml::table& table, CheckSettings& c) {
  reader.integer("repeats_most", c.repeats_most, kFewestRepeats, 200);
  const toml::node* repeats = table.get("repeats");
  if (repeats == nullptr) return;
  c.repeats_auto = false;
  if (!repeats->is_string()) return reader.integer("repeats", c.repeats, 1, 200);
  std::string word;
  reader.text("repeats", word);
  c.repeats_auto = word == "auto";
  if (!c.repeats_auto)
    reader.refuse(
        repeats->source(),
        "check.repeats must be a whole number from 1 to 200, or \"auto\" for as many as the brake needs");
}

/// `is_slow`: rows are too far apart for the output error method.
void read_check(TableReader& reader, const toml::table& table, const std::string& folder, bool is_slow,
                CheckSettings& c) {
  read_repeats(reader, table, c);
  reader.path("trajectory", c.trajectory, folder);
  reader.paths("further_trajectories", c.further_trajectories, folder);
  reader.number("tare_s", c.tare_s, 0.05, 10.0);
  reader.number("approach_velocity_rad_s", c.approach_velocity_rad_s, 1.0, 100.0);
  reader.number("contact_force_N", c.contact_force_N, 10.0, 5'000.0);
  reader.number("clearance_rad", c.clearance_rad, 0.5, 100.0);
  reader.number("settle_s", c.settle_s, 0.0, 10.0);
  reader.number("phase_timeout_s", c.phase_timeout_s, 0.1, 60.0);
  reader.number("torque_limit_Nm", c.torque_limit_Nm, 0.1, kSafeTorque_Nm);
  std::string method(to_string(c.method));
  reader.choice("method", method, {"oem", "pem"});
  c.method = *parse_method(method);
  if (is_slow && reader.has("method") && c.method != Method::PredictionError)
    reader.refuse(
        table.get("method")->source(),
        "check.method = oem cannot be as sure as it says where [can] has cycles above 1 ms; write \"pem\" or "
        "leave the method out");
  reader.path("model", c.model, folder);
  if (!c.model.empty()) {
    if (reader.has("method") && c.method != Method::PredictionError)
      reader.refuse(table.get("method")->source(),
                    "check.method = oem and check.model exclude each other: effects are estimated by the "
                    "prediction error method; write \"pem\" or leave the method out");
    c.method = Method::PredictionError;
  }
  reader.boolean("diagnose", c.diagnose);
  reader.number("deadline_s", c.deadline_s, 1.0, 3'600.0);
}

void read_validity(TableReader& reader, ValiditySettings& v) {
  reader.integer("skipped_ticks_max", v.skipped_ticks_max, 0, 100'000);
  reader.integer("lost_samples_max", v.lost_samples_max, 0, 100'000);
  reader.number("tracking_rms_max_N", v.tracking_rms_max_N, 1.0, kSafeForce_N);
  reader.number("torque_noise_Nm", v.torque_noise_Nm, 0.0, 1.0);
  reader.number("misfit_max", v.misfit_max, 1.0, 1'000.0);
}

void read_control(TableReader& reader, const toml::table& table, const std::string& folder,
                  ControlSettings& control) {
  reader.text("address", control.address);
  reader.integer("port", control.port, 1, 65'535);
  reader.path("token_file", control.token_file, folder);
  reader.texts("origins", control.origins);
  for (std::string& origin : control.origins)
    if (std::optional<std::string> canonical = canonical_origin(origin))
      origin = std::move(*canonical);
    else
      reader.refuse(table.get("origins")->source(),
                    fmt::format("control.origins: \"{}\" must be what a browser shows before the first path, "
                                "https://HOST or https://HOST:PORT",
                                origin));
}

void read_mqtt(TableReader& reader, const toml::table& table, const std::string& folder,
               MqttConfiguration& m) {
  reader.text("host", m.host);
  reader.integer("port", m.port, 1, 65'535);
  reader.path("tls_ca_file", m.tls_ca_file, folder);
  reader.text("user", m.user);
  reader.path("password_file", m.password_file, folder);
  reader.text("client_id", m.client_id);
  reader.text("topic_prefix", m.topic_prefix);
  reader.text("sparkplug_group", m.sparkplug_group);
  reader.text("sparkplug_node", m.sparkplug_node);
  const toml::source_region& where = table.source();
  if (m.topic_prefix.empty() || m.topic_prefix.find_first_of("+#") != std::string::npos ||
      m.topic_prefix.front() == '$')
    reader.refuse(where, "mqtt.topic_prefix must not be empty, begin with $ or contain + or #");
  for (const auto& [key, name] :
       {std::pair("sparkplug_group", &m.sparkplug_group), std::pair("sparkplug_node", &m.sparkplug_node)})
    if (name->find_first_of("+#/") != std::string::npos)
      reader.refuse(where, fmt::format("mqtt.{} must not contain +, # or /", key));
  if (m.user.empty() && !m.password_file.empty()) reader.refuse(where, "mqtt.password_file needs mqtt.user");
}

void read_postgresql(TableReader& reader, const std::string& folder, PostgresqlConfiguration& p) {
  reader.text("host", p.host);
  reader.integer("port", p.port, 1, 65'535);
  reader.text("database", p.database);
  reader.text("user", p.user);
  reader.path("password_file", p.password_file, folder);
  reader.path("tls_ca_file", p.tls_ca_file, folder);
  reader.boolean("raw_runs", p.raw_runs);
}

/// After [mqtt] and [postgresql]: a channel that is not there never publishes, and the disk would fill.
void read_retention(TableReader& reader, const toml::table& table, const StationConfiguration& configuration,
                    RetentionSettings& retention) {
  reader.integer("raw_days", retention.raw_days, 0, 36'500);
  reader.integer("raw_megabytes", retention.raw_megabytes, 0, 100'000'000);
  reader.texts("published", retention.published);
  std::vector<std::string_view> channels;
  if (configuration.mqtt.used()) channels.emplace_back("mqtt");
  if (configuration.postgresql.used()) channels.emplace_back("postgresql");
  for (const std::string& channel : retention.published)
    if (std::find(channels.begin(), channels.end(), channel) == channels.end())
      reader.refuse(
          table.get("published")->source(),
          fmt::format("retention.published names \"{}\", to which nothing is published; {}", channel,
                      channels.empty() ? "configure [mqtt] or [postgresql], or leave it out"
                                       : fmt::format("there are: {}", fmt::join(channels, ", "))));
}

void read_master(TableReader& reader, const toml::table& table, const std::string& folder,
                 MasterSettings& master) {
  reader.text("serial", master.serial, 80);
  master.serial = trimmed(master.serial);
  reader.path("limits", master.limits, folder);
  reader.number("due_h", master.due_h, 0.1, 10'000.0);
  reader.boolean("required", master.required);
  if (master.serial.empty() != master.limits.empty())
    reader.refuse(table.source(),
                  "master needs both serial and limits: the brake, and the file with its certified values");
}

/// After [station].
void read_recipes_section(TableReader& reader, const toml::table& table, const std::string& folder,
                          StationConfiguration& configuration) {
  reader.path("directory", configuration.recipes_directory, folder);
  if (!configuration.recipes_directory.empty() && !configuration.part_number.empty())
    reader.refuse(
        table.source(),
        "recipes.directory and station.part_number exclude each other: where there are recipes, each "
        "check's part number is chosen when it is started; leave out one of the two");
}

/// What a file leaves open: of the parts that were read, and of what they say together.
Result<void> complete(StationConfiguration& configuration, std::optional<bool> simulated) {
  const std::string& path = configuration.file;
  const std::string& interface = configuration.can.interface;
  const bool no_hardware = interface.empty() || interface.rfind("vcan", 0) == 0 || interface == "simulated";
  if (simulated == false && interface.empty())
    return failure(
        fmt::format("{}: station.simulated_brake is false, but without can.interface the brake is the "
                    "embedded simulated one",
                    path));
  configuration.simulated_brake = simulated.value_or(no_hardware);
  if (configuration.database.empty())
    configuration.database = default_database(configuration.simulated_brake);
  if (configuration.check.torque_limit_Nm >= configuration.supervisor.over_torque_Nm)
    return failure(fmt::format("{}: check.torque_limit_Nm = {} must be below supervisor.over_torque_Nm = {}",
                               path, configuration.check.torque_limit_Nm,
                               configuration.supervisor.over_torque_Nm));
  if (configuration.supervisor.over_force_ceiling_N < configuration.supervisor.over_force_N)
    return failure(fmt::format(
        "{}: supervisor.over_force_ceiling_N = {} must not be below supervisor.over_force_N = {}", path,
        configuration.supervisor.over_force_ceiling_N, configuration.supervisor.over_force_N));
  if (configuration.check.contact_force_N >= configuration.supervisor.over_force_N)
    return failure(fmt::format("{}: check.contact_force_N = {} must be below supervisor.over_force_N = {}",
                               path, configuration.check.contact_force_N,
                               configuration.supervisor.over_force_N));
  return {};
}

}  // namespace

void read_can_mapping(TableReader& can, const std::string& file, std::optional<Error>& error,
                      std::vector<std::pair<std::string, std::string>>& mapping) {
  const toml::table* table = can.table("mapping");
  if (table == nullptr) return;
  TableReader roles(*table, "can.mapping", file, error);
  for (const std::string_view role : kMappingRoles) {
    const toml::node* node = roles.at(role);
    if (node == nullptr) continue;
    std::vector<std::string> names(1);
    const bool may_be_several = role == "counter" || role == "crc";
    if (may_be_several && node->is_array()) {
      roles.texts(role, names);
      if (names.empty() || std::find(names.begin(), names.end(), "") != names.end())
        roles.refuse(role, fmt::format("{} must name signals; {} = \"\" says that the frames carry none",
                                       roles.name(role), role));
    } else {
      roles.text(role, names.front());
    }
    for (std::string& name : names) mapping.emplace_back(std::string(role), std::move(name));
  }
  roles.finish();
}

std::string default_database(bool simulated) {
  namespace fs = std::filesystem;
  const auto variable = [](const char* name) -> std::string {
    const char* value = std::getenv(name);
    return value == nullptr ? "" : value;
  };
  fs::path folder;
  if (const std::string state = variable("STATE_DIRECTORY"); !state.empty()) {
    folder = state.substr(0, state.find(':'));  // systemd may list several
  } else if (::geteuid() == 0) {
    folder = "/var/lib/clampd";
  } else if (const std::string xdg = variable("XDG_STATE_HOME"); !xdg.empty()) {
    folder = fs::path(xdg) / "clampd";
  } else if (const std::string home = variable("HOME"); !home.empty()) {
    folder = fs::path(home) / ".local/state/clampd";
  }
  return (folder / (simulated ? kSimulatedDatabase : "checks.sqlite")).string();
}

void simulate_brake(StationConfiguration& configuration) {
  if (!configuration.simulated_brake)
    configuration.database =
        (std::filesystem::path(configuration.database).parent_path() / kSimulatedDatabase).string();
  configuration.simulated_brake = true;
}

Result<StationConfiguration> parse_station_configuration(const std::string& text, const std::string& path) {
  const Result<toml::table> parsed = parse_toml(text, path);
  if (!parsed) return tl::unexpected(parsed.error());

  StationConfiguration configuration;
  configuration.file = path;
  configuration.database.clear();
  std::string folder = std::filesystem::path(path).parent_path().string();
  if (folder.empty()) folder.push_back('.');
  std::optional<Error> error;
  std::optional<bool> simulated;
  std::string model_file;
  TableReader document(*parsed, "", path, error);
  const auto section = [&](std::string_view key, auto read) {
    read_section(document, key, path, error, read);
  };

  section("station",
          [&](TableReader& reader, const toml::table&) { read_station(reader, configuration, simulated); });
  read_instruments(document, path, error, configuration.instruments);
  section("simulation", [&](TableReader& reader, const toml::table&) {
    reader.path("brake", configuration.plant_file, folder);
  });
  section("can", [&](TableReader& reader, const toml::table& table) {
    read_can(reader, table, path, folder, error, configuration.can);
  });
  section("realtime",
          [&](TableReader& reader, const toml::table&) { read_realtime(reader, configuration.realtime); });
  section("supervisor", [&](TableReader& reader, const toml::table&) {
    read_supervisor(reader, 1e3 * configuration.can.period_s(), configuration.supervisor);
  });
  section("check", [&](TableReader& reader, const toml::table& table) {
    read_check(reader, table, folder, is_slow(configuration.can), configuration.check);
  });
  if (is_slow(configuration.can)) configuration.check.method = Method::PredictionError;
  section("validity",
          [&](TableReader& reader, const toml::table&) { read_validity(reader, configuration.validity); });
  section("model",
          [&](TableReader& reader, const toml::table&) { reader.path("brake", model_file, folder); });
  section("limits", [&](TableReader& reader, const toml::table&) {
    reader.path("file", configuration.limits_file, folder);
  });
  section("sheet", [&](TableReader& reader, const toml::table&) {
    reader.path("file", configuration.sheet_file, folder);
  });
  section("recipes", [&](TableReader& reader, const toml::table& table) {
    read_recipes_section(reader, table, folder, configuration);
  });
  section("archive", [&](TableReader& reader, const toml::table&) {
    reader.path("database", configuration.database, folder);
  });
  section("control", [&](TableReader& reader, const toml::table& table) {
    read_control(reader, table, folder, configuration.control);
  });
  section("mqtt", [&](TableReader& reader, const toml::table& table) {
    read_mqtt(reader, table, folder, configuration.mqtt);
  });
  section("postgresql", [&](TableReader& reader, const toml::table&) {
    read_postgresql(reader, folder, configuration.postgresql);
  });
  section("retention", [&](TableReader& reader, const toml::table& table) {
    read_retention(reader, table, configuration, configuration.retention);
  });
  section("master", [&](TableReader& reader, const toml::table& table) {
    read_master(reader, table, folder, configuration.master);
  });
  section("gpio", [&](TableReader& reader, const toml::table& table) {
    read_gpio(reader, table, path, error, configuration.gpio);
  });
  document.finish();
  if (error) return tl::unexpected(*error);

  if (const Result<void> completed = complete(configuration, simulated); !completed)
    return tl::unexpected(completed.error());
  if (!model_file.empty()) {
    const Result<BrakeParameters> model = read_brake_parameters(model_file);
    if (!model) return tl::unexpected(model.error());
    configuration.model = *model;
  }
  return configuration;
}

Result<StationConfiguration> read_station_configuration(const std::string& path) {
  return read_file(path).and_then(
      [&](const std::string& text) { return parse_station_configuration(text, path); });
}

}  // namespace clampd
