#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/identify/method.hpp"
#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {

/// A measuring instrument of the station, as it appears in every record.
struct Instrument {
  std::string name;
  std::string serial;
  std::string calibrated;  ///< date of the last calibration, YYYY-MM-DD
};

/// What a signal or frame of the DBC file can be to the station.
inline constexpr std::array<std::string_view, 13> kMappingRoles{
    "torque_command", "velocity_command", "enable",   "force", "velocity", "torque", "position",
    "sample_clock",   "enabled",          "watchdog", "fault", "counter",  "crc"};

/// What proves that a frame is whole and the one that was meant, as the brake's maker describes it.
struct CanProtection {
  std::string checksum = "sae-j1850";  ///< its name; the drivers know them all
  /// Of checksum = "crc": the parameters of the catalogue of CRC algorithms.
  int width_bits = 8;
  std::uint64_t polynomial = 0x1D, start = 0, final_xor = 0;
  bool reflected = false;
  std::string data_id = "none";  ///< "before" or "after" the frame's bytes, or "none"
};

/// A frame beside the cyclic ones: what wakes a brake, or puts it to sleep.
struct CanSequenceFrame {
  std::string message;                                  ///< of the DBC file
  std::vector<std::pair<std::string, double>> signals;  ///< in the DBC file's units
  double wait_ms = 10.0;                                ///< until the next one
};

struct CanSettings {
  std::string interface;  ///< e.g. "can0"; empty: the embedded simulated brake, in virtual time
  std::string dbc;        ///< path; empty: the DBC file that ships with the station
  std::uint32_t bitrate =
      1'000'000;                   ///< bit/s, for the bus load; the interface itself is set up by the system
  std::uint32_t data_bitrate = 0;  ///< bit/s of the data of CAN FD frames; 0: no bit-rate switch
  double feedback_cycle_ms = 1.0;  ///< 5, 2, 1, 0.5, 0.25 or 0.2
  double command_cycle_ms = 1.0;   ///< likewise; the slower one is a multiple of the other
  CanProtection protection;
  /// Names in this brake's DBC file by role, one of kMappingRoles; roles that are not named keep their
  /// default. Counter and crc may have several, of which each message has one.
  std::vector<std::pair<std::string, std::string>> mapping;
  std::vector<CanSequenceFrame> startup, shutdown;

  /// Of the loop: a millisecond, or as slow as the brake's frames.
  double period_s() const { return 1e-3 * std::max({1.0, feedback_cycle_ms, command_cycle_ms}); }
};

struct RealtimeSettings {
  int priority = 80;  ///< of SCHED_FIFO; 0: an ordinary thread, for development
  int cpu = -1;       ///< -1: any
  bool lock_memory = true;
};

/// When the loop gives up: each governs one cause of the supervisor's table. "Tolerated" counts are within 10
/// ms, unless said otherwise.
struct SupervisorSettings {
  double start_up_ms = 2000.0;     ///< first feedback must come within this
  std::optional<double> stale_after_ms;  ///< without a new sample; left out: two and a half periods
  int corrupt_frames_max = 0;      ///< with a wrong CRC-8, tolerated
  int frozen_frames_max = 1;       ///< with a repeated or jumping alive counter, tolerated
  int implausible_frames_max = 0;  ///< with a value that no brake can have, tolerated
  int send_failures_max = 1;       ///< in a row, tolerated
  double over_force_N = 33'000.0;
  double over_force_ceiling_N = 36'000.0;  ///< above which nothing moves the brake, not even to open it
  double over_speed_rad_s = 350.0;
  double over_torque_Nm = 3.1;
  double over_travel_rad = 120.0;       ///< from where the check began
  double plausible_force_N = 60'000.0;  ///< magnitude beyond which a reading is a defect
  double plausible_velocity_rad_s = 1'000.0;
  double plausible_torque_Nm = 20.0;
  // How far readings may contradict each other in a check.
  double torque_mismatch_Nm = 0.1;
  double velocity_mismatch_rad_s = 25.0;
  double position_mismatch_rad = 0.3;
  double force_mismatch_N = 2'500.0;
  int missed_ticks_max = 2;        ///< periods skipped at once, tolerated
  int missed_ticks_total_max = 5;  ///< periods skipped in one check, tolerated
  bool drive_reports_live = true;  ///< false for a brake whose feedback has no drive-enabled signal
};

struct CheckSettings {
  std::uint32_t repeats = 20;  ///< unless repeats_auto
  bool repeats_auto = true;    ///< as many as the brake needs, repeats_most at most
  /// As a check of so many is decided by its value alone at the end, it errs no more often than one of 20
  /// fixed repeats (docs/repeats.md).
  std::uint32_t repeats_most = 21;
  std::string trajectory;  ///< run file; empty: the trajectory that ships with the station
  /// Run files that runs of a check of as many as its brake needs may follow, once something is in doubt.
  /// Nothing: those that ship with the station if its trajectory does, otherwise none.
  std::optional<std::vector<std::string>> further_trajectories;
  double tare_s = 0.5;
  double approach_velocity_rad_s = 20.0;
  double contact_force_N = 300.0;
  double clearance_rad = 6.0;
  double settle_s = 0.05;
  double phase_timeout_s = 5.0;
  double torque_limit_Nm = 3.0;
  Method method = Method::OutputError;
  std::string model;         ///< extended model whose effects are estimated too; empty: the base model
  bool diagnose = true;      ///< names the cause of runs that the model does not explain
  double deadline_s = 60.0;  ///< for the whole check; then TIMEOUT

  std::uint32_t repeats_planned() const { return repeats_auto ? repeats_most : repeats; }
};

/// What a run must satisfy to say anything about the brake; otherwise the check is an ERROR, never a FAIL.
struct ValiditySettings {
  std::uint64_t skipped_ticks_max = 5;
  std::uint64_t lost_samples_max = 0;
  double tracking_rms_max_N = 1500.0;
  double torque_noise_Nm = 0.0142;  ///< sd per sample of the torque reading, which no fit can follow
  double misfit_max = 4.0;          ///< residual rms over what sensor and torque noise explain
};

/// A line of the operator's panel.
struct GpioLine {
  std::string chip;            ///< name, number, path or label; empty: found by the line's name
  std::string line;            ///< offset or name; empty: the station has no such line
  bool active_low = false;     ///< the contact is closed, the output on, at the low level
  std::string bias = "as-is";  ///< or "disabled", "pull-up", "pull-down"
};

/// The operator's panel. A station without an emergency stop line has none.
struct GpioSettings {
  GpioLine emergency_stop;  ///< normally closed
  GpioLine fixture_closed;
  GpioLine start_button;
  GpioLine enable_relay;  ///< wired normally open
  GpioLine light_red;
  GpioLine light_amber;
  GpioLine light_green;
  double debounce_ms = 20.0;        ///< of start button and fixture
  double release_ms = 50.0;         ///< of the emergency stop's release; its opening counts at once
  double start_stuck_s = 10.0;      ///< a start button held for longer is stuck
  double poll_ms = 1.0;             ///< levels are read at least so often
  double lost_after_ms = 5.0;       ///< the loop gives up on a panel that was silent for longer
  double relay_watchdog_ms = 10.0;  ///< the relay drops when the loop stood still for this long

  bool used() const { return !emergency_stop.line.empty(); }
};

struct ControlSettings {
  std::string address = "127.0.0.1";
  std::uint16_t port = 8371;
  std::string token_file;            ///< empty: none is asked for
  std::vector<std::string> origins;  ///< of proxies, as a browser names them: "https://station7.example"
};

/// How long raw runs stay in the archive. Results and parameters always stay.
struct RetentionSettings {
  std::uint32_t raw_days = 0;            ///< 0: however old
  std::uint64_t raw_megabytes = 20'000;  ///< of all raw runs together, as they are stored; 0: however many
  std::vector<std::string> published;    ///< channels that must have published a check before its runs go
};

/// Publishing of every check to an MQTT broker.
struct MqttConfiguration {
  std::string host;  ///< empty: nothing is published there
  std::uint16_t port = 1883;
  std::string tls_ca_file;              ///< empty: not encrypted
  std::string user;                     ///< empty: none
  std::string password_file;            ///< its first line is the password
  std::string client_id;                ///< empty: "clampd-" and the station's name
  std::string topic_prefix = "clampd";  ///< checks go to PREFIX/STATION/checks
  std::string sparkplug_group;          ///< empty: no Sparkplug B
  std::string sparkplug_node;           ///< empty: the station's name

  bool used() const { return !host.empty(); }
};

/// Publishing of every check to a PostgreSQL database.
struct PostgresqlConfiguration {
  std::string host;  ///< name, address or folder of the socket; empty: nothing is published there
  std::uint16_t port = 5432;
  std::string database = "clampd";
  std::string user;           ///< empty: as the system calls the station's user
  std::string password_file;  ///< its first line is the password
  std::string tls_ca_file;    ///< empty: encrypted if the server can
  bool raw_runs = false;      ///< the runs themselves too, so that they can be identified anew there

  bool used() const { return !host.empty(); }
};

/// A brake whose parameters are certified, checked to see whether the station still measures right.
struct MasterSettings {
  std::string serial;     ///< empty: there is none
  std::string limits;     ///< limits file: its intervals are the certified values with their tolerance
  double due_h = 24.0;    ///< how long a good check of the master brake is good for
  bool required = false;  ///< no other brake is checked while the master brake asks for something
};

/// Everything a station can be told. A default-constructed one works: the embedded simulated brake, nominal
/// model.
struct StationConfiguration {
  std::string file;  ///< where it came from; empty: the defaults
  std::string name = "station";
  std::string fixture;
  std::string part_number;  ///< for records only
  std::string batch;
  std::string operator_name;
  bool simulated_brake = true;  ///< no result of this station says anything about hardware
  std::vector<Instrument> instruments;
  std::string plant_file;  ///< of the embedded simulated brake; empty: a nominal one
  CanSettings can;
  RealtimeSettings realtime;
  SupervisorSettings supervisor;
  CheckSettings check;
  ValiditySettings validity;
  BrakeParameters model;    ///< the nominal brake
  std::string limits_file;  ///< empty: the limits that ship with the station
  std::string sheet_file;   ///< what else is asked of a brake; empty: nothing
  /// A recipe a part number; empty: every brake is checked as this configuration says.
  std::string recipes_directory;
  std::string database;     ///< SQLite file of the results
  ControlSettings control;
  GpioSettings gpio;
  RetentionSettings retention;
  MqttConfiguration mqtt;
  PostgresqlConfiguration postgresql;
  MasterSettings master;

  bool embedded() const { return can.interface.empty(); }
};

/// Reads and checks a TOML file. Unknown keys (with the nearest known one), wrong types and values outside of
/// their bounds are errors with file, line and column. Relative paths count from the file's folder; files
/// named are not opened here, except for the model's parameters.
Result<StationConfiguration> read_station_configuration(const std::string& path);

/// The same from text; `path` stands for the file in messages and decides what relative paths mean.
Result<StationConfiguration> parse_station_configuration(const std::string& text, const std::string& path);

/// Where the results go unless configured: $STATE_DIRECTORY (as systemd sets it), else /var/lib/clampd for
/// root, else $XDG_STATE_HOME/clampd or ~/.local/state/clampd; in there, checks.sqlite, or simulated.sqlite
/// for simulated brakes.
std::string default_database(bool simulated);

/// Puts a simulated brake in the place of the configured one. Where that is a real brake, the results go to
/// simulated.sqlite beside its database, so that the two are never mixed.
void simulate_brake(StationConfiguration& configuration);

}  // namespace clampd
