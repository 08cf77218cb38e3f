#include "clampd/station/configuration.hpp"

#include <cstdlib>
#include <sstream>
#include <string>

#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/record/file.hpp"
#include "support/temporary_directory.hpp"

namespace clampd {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pair;
using ::testing::StartsWith;
using ::testing::UnorderedElementsAre;

Result<StationConfiguration> parse(const std::string& text) {
  return parse_station_configuration(text, "/etc/clampd/station.toml");
}

TEST(StationConfiguration, AnEmptyFileIsTheDefault) {
  const auto configuration = parse("");
  ASSERT_TRUE(configuration) << configuration.error().message;
  EXPECT_TRUE(configuration->embedded());
  EXPECT_TRUE(configuration->simulated_brake);
  EXPECT_EQ(configuration->check.repeats, 20u);
  EXPECT_EQ(configuration->model.theta, nominal_parameters());
  EXPECT_EQ(configuration->database, default_database(true));
}

TEST(StationConfiguration, TheSheetsPathCountsFromTheFilesFolder) {
  EXPECT_EQ(parse("")->sheet_file, "");
  EXPECT_EQ(parse("[sheet]\nfile = \"sheet.toml\"\n")->sheet_file, "/etc/clampd/sheet.toml");
  EXPECT_FALSE(parse("[sheet]\nfiles = \"sheet.toml\"\n"));
}

TEST(StationConfiguration, RetentionAndMasterBrake) {
  const auto read = parse(
      "[retention]\nraw_days = 90\nraw_megabytes = 500\npublished = [\"mqtt\", \"postgresql\"]\n"
      "[mqtt]\nhost = \"broker\"\n[postgresql]\nhost = \"line\"\n"
      "[master]\nserial = \"M-1\"\nlimits = \"master.toml\"\ndue_h = 8\n");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->retention.raw_days, 90u);
  EXPECT_EQ(read->retention.raw_megabytes, 500u);
  EXPECT_THAT(read->retention.published, ElementsAre("mqtt", "postgresql"));
  EXPECT_EQ(read->master.serial, "M-1");
  EXPECT_EQ(read->master.limits, "/etc/clampd/master.toml");
  EXPECT_EQ(read->master.due_h, 8.0);
  const auto no_list = parse("[retention]\npublished = \"mqtt\"\n");
  ASSERT_FALSE(no_list);
  EXPECT_THAT(no_list.error().message, HasSubstr("station.toml:2:13: "));
  EXPECT_THAT(no_list.error().message, HasSubstr("list of texts"));
  EXPECT_FALSE(parse("[retention]\npublished = [\"mqtt\", 1]\n"));
  const auto nowhere = parse("[retention]\npublished = [\"mqtt\"]\n");
  ASSERT_FALSE(nowhere);
  EXPECT_THAT(nowhere.error().message, HasSubstr("station.toml:2:13: "));
  EXPECT_THAT(nowhere.error().message, HasSubstr("nothing is published; configure [mqtt] or [postgresql]"));
  const auto misspelt = parse("[retention]\npublished = [\"mqqt\"]\n[mqtt]\nhost = \"broker\"\n");
  ASSERT_FALSE(misspelt);
  EXPECT_THAT(misspelt.error().message,
              HasSubstr("\"mqqt\", to which nothing is published; there are: mqtt"));
  const auto half = parse("[master]\nserial = \"M-1\"\n");
  ASSERT_FALSE(half);
  EXPECT_THAT(half.error().message, HasSubstr("both serial and limits"));
}

TEST(StationConfiguration, PublishesNowhereUnlessToldWhere) {
  EXPECT_FALSE(parse("")->mqtt.used());
  EXPECT_FALSE(parse("")->postgresql.used());
  const auto read = parse(
      "[mqtt]\nhost = \"broker\"\nport = 8883\ntls_ca_file = \"ca.pem\"\nuser = \"a\"\npassword_file = "
      "\"secret\"\n"
      "sparkplug_group = \"plant\"\n[postgresql]\nhost = \"/run/postgresql\"\ndatabase = \"line\"\n");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_TRUE(read->mqtt.used());
  EXPECT_EQ(read->mqtt.port, 8883);
  EXPECT_EQ(read->mqtt.tls_ca_file, "/etc/clampd/ca.pem");
  EXPECT_EQ(read->mqtt.password_file, "/etc/clampd/secret");
  EXPECT_EQ(read->mqtt.topic_prefix, "clampd");
  EXPECT_EQ(read->mqtt.sparkplug_group, "plant");
  EXPECT_TRUE(read->postgresql.used());
  EXPECT_EQ(read->postgresql.port, 5432);
  EXPECT_EQ(read->postgresql.database, "line");
  for (const char* wrong :
       {"[mqtt]\nport = 0\n", "[mqtt]\npassword = \"secret\"\n", "[mqtt]\ntopic_prefix = \"a/#\"\n",
        "[mqtt]\nsparkplug_group = \"a/b\"\n", "[mqtt]\npassword_file = \"a\"\n",
        "[postgresql]\npassword = \"secret\"\n", "[postgresql]\nport = 70000\n"}) {
    const auto refused = parse(wrong);
    ASSERT_FALSE(refused) << wrong;
    EXPECT_THAT(refused.error().message, StartsWith("/etc/clampd/station.toml:")) << wrong;
  }
  EXPECT_THAT(parse("[mqtt]\npassword = \"secret\"\n").error().message,
              HasSubstr("unknown key password in [mqtt]; known are host"));
}

TEST(StationConfiguration, OriginsAreAsBrowsersSendThem) {
  const auto read = parse("[control]\norigins = [\"https://Station7.example\", \"http://[::1]:8443\"]\n");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->control.origins,
            (std::vector<std::string>{"https://station7.example", "http://[::1]:8443"}));
}

TEST(StationConfiguration, AnExtendedModelIsForThePredictionErrorMethod) {
  const auto extended = parse("[check]\nmodel = \"extended.toml\"\ndiagnose = false\n");
  ASSERT_TRUE(extended) << extended.error().message;
  EXPECT_EQ(extended->check.model, "/etc/clampd/extended.toml");
  EXPECT_EQ(extended->check.method, Method::PredictionError);
  EXPECT_FALSE(extended->check.diagnose);
  EXPECT_TRUE(parse("[check]\nmodel = \"extended.toml\"\nmethod = \"pem\"\n"));
  const auto both = parse("[check]\nmethod = \"oem\"\nmodel = \"extended.toml\"\n");
  ASSERT_FALSE(both);
  EXPECT_THAT(both.error().message, StartsWith("/etc/clampd/station.toml:2:10: "));
  EXPECT_THAT(both.error().message, HasSubstr("exclude each other"));
}

TEST(StationConfiguration, TheShippedFileSaysTheDefaults) {
  const auto shipped = read_station_configuration(CLAMPD_SOURCE_DIR "/configs/station.toml");
  ASSERT_TRUE(shipped) << shipped.error().message;
  const StationConfiguration defaults;
  EXPECT_EQ(shipped->name, defaults.name);
  EXPECT_EQ(shipped->simulated_brake, defaults.simulated_brake);
  EXPECT_EQ(shipped->can.bitrate, defaults.can.bitrate);
  EXPECT_EQ(shipped->realtime.priority, defaults.realtime.priority);
  EXPECT_EQ(shipped->realtime.cpu, defaults.realtime.cpu);
  EXPECT_EQ(shipped->realtime.lock_memory, defaults.realtime.lock_memory);
  const SupervisorSettings& a = shipped->supervisor;
  const SupervisorSettings& b = defaults.supervisor;
  EXPECT_EQ(a.start_up_ms, b.start_up_ms);
  EXPECT_EQ(a.stale_after_ms, b.stale_after_ms);
  EXPECT_EQ(a.corrupt_frames_max, b.corrupt_frames_max);
  EXPECT_EQ(a.frozen_frames_max, b.frozen_frames_max);
  EXPECT_EQ(a.implausible_frames_max, b.implausible_frames_max);
  EXPECT_EQ(a.send_failures_max, b.send_failures_max);
  EXPECT_EQ(a.over_force_N, b.over_force_N);
  EXPECT_EQ(a.over_force_ceiling_N, b.over_force_ceiling_N);
  EXPECT_EQ(a.over_speed_rad_s, b.over_speed_rad_s);
  EXPECT_EQ(a.over_torque_Nm, b.over_torque_Nm);
  EXPECT_EQ(a.over_travel_rad, b.over_travel_rad);
  EXPECT_EQ(a.plausible_force_N, b.plausible_force_N);
  EXPECT_EQ(a.plausible_velocity_rad_s, b.plausible_velocity_rad_s);
  EXPECT_EQ(a.plausible_torque_Nm, b.plausible_torque_Nm);
  EXPECT_EQ(a.torque_mismatch_Nm, b.torque_mismatch_Nm);
  EXPECT_EQ(a.velocity_mismatch_rad_s, b.velocity_mismatch_rad_s);
  EXPECT_EQ(a.position_mismatch_rad, b.position_mismatch_rad);
  EXPECT_EQ(a.force_mismatch_N, b.force_mismatch_N);
  EXPECT_EQ(a.missed_ticks_max, b.missed_ticks_max);
  EXPECT_EQ(a.missed_ticks_total_max, b.missed_ticks_total_max);
  EXPECT_EQ(a.drive_reports_live, b.drive_reports_live);
  EXPECT_EQ(shipped->retention.raw_days, defaults.retention.raw_days);
  EXPECT_EQ(shipped->retention.raw_megabytes, defaults.retention.raw_megabytes);
  EXPECT_EQ(shipped->retention.published, defaults.retention.published);
  EXPECT_EQ(shipped->master.serial, defaults.master.serial);
  EXPECT_EQ(shipped->check.repeats_auto, defaults.check.repeats_auto);
  EXPECT_EQ(shipped->check.repeats_planned(), defaults.check.repeats_planned());
  EXPECT_EQ(shipped->check.tare_s, defaults.check.tare_s);
  EXPECT_EQ(shipped->check.approach_velocity_rad_s, defaults.check.approach_velocity_rad_s);
  EXPECT_EQ(shipped->check.contact_force_N, defaults.check.contact_force_N);
  EXPECT_EQ(shipped->check.clearance_rad, defaults.check.clearance_rad);
  EXPECT_EQ(shipped->check.settle_s, defaults.check.settle_s);
  EXPECT_EQ(shipped->check.phase_timeout_s, defaults.check.phase_timeout_s);
  EXPECT_EQ(shipped->check.torque_limit_Nm, defaults.check.torque_limit_Nm);
  EXPECT_EQ(shipped->check.deadline_s, defaults.check.deadline_s);
  EXPECT_EQ(shipped->check.method, defaults.check.method);
  EXPECT_EQ(shipped->check.model, defaults.check.model);
  EXPECT_EQ(shipped->check.diagnose, defaults.check.diagnose);
  EXPECT_EQ(shipped->validity.skipped_ticks_max, defaults.validity.skipped_ticks_max);
  EXPECT_EQ(shipped->validity.lost_samples_max, defaults.validity.lost_samples_max);
  EXPECT_EQ(shipped->validity.tracking_rms_max_N, defaults.validity.tracking_rms_max_N);
  EXPECT_EQ(shipped->validity.torque_noise_Nm, defaults.validity.torque_noise_Nm);
  EXPECT_EQ(shipped->validity.misfit_max, defaults.validity.misfit_max);
  EXPECT_EQ(shipped->control.port, defaults.control.port);
  EXPECT_EQ(shipped->control.address, defaults.control.address);
  EXPECT_EQ(shipped->can.dbc, CLAMPD_SOURCE_DIR "/configs/brake.dbc");
  EXPECT_EQ(shipped->check.trajectory, CLAMPD_SOURCE_DIR "/configs/trajectory.csv");
  EXPECT_EQ(shipped->limits_file, CLAMPD_SOURCE_DIR "/configs/limits.toml");
  EXPECT_EQ(shipped->plant_file, CLAMPD_SOURCE_DIR "/configs/plant.toml");
}

TEST(StationConfiguration, ReadsThePanel) {
  EXPECT_FALSE(parse("")->gpio.used());
  const auto configuration = parse(R"(
[gpio]
chip = "gpiochip0"
emergency_stop = { line = 4, active = "low", bias = "pull-up" }
fixture_closed = { chip = "gpiochip1", line = "FIXTURE" }
enable_relay.line = 17
release_ms = 80
)");
  ASSERT_TRUE(configuration) << configuration.error().message;
  const GpioSettings& gpio = configuration->gpio;
  EXPECT_TRUE(gpio.used());
  EXPECT_EQ(gpio.emergency_stop.chip, "gpiochip0");
  EXPECT_EQ(gpio.emergency_stop.line, "4");
  EXPECT_TRUE(gpio.emergency_stop.active_low);
  EXPECT_EQ(gpio.emergency_stop.bias, "pull-up");
  EXPECT_EQ(gpio.fixture_closed.chip, "gpiochip1");
  EXPECT_EQ(gpio.fixture_closed.line, "FIXTURE");
  EXPECT_FALSE(gpio.fixture_closed.active_low);
  EXPECT_EQ(gpio.enable_relay.line, "17");
  EXPECT_TRUE(gpio.start_button.line.empty());
  EXPECT_EQ(gpio.release_ms, 80.0);
}

TEST(StationConfiguration, RefusesAPanelThatCannotWork) {
  const auto refusal = [](const std::string& text) {
    const auto configuration = parse("[gpio]\n" + text);
    return configuration ? std::string("accepted") : configuration.error().message;
  };
  EXPECT_THAT(refusal("start_button = { line = 1 }"), HasSubstr("needs an emergency_stop"));
  EXPECT_THAT(refusal("emergency_stop = { chip = \"gpiochip0\" }"),
              HasSubstr("gpio.emergency_stop needs a line"));
  EXPECT_THAT(refusal("emergency_stop = { line = 4, actve = \"low\" }"), HasSubstr("actve"));
  EXPECT_THAT(refusal("emergency_stop = { line = 4, active = \"down\" }"), HasSubstr("active"));
  EXPECT_THAT(refusal("emergency_stop = { line = 4 }\nlight_red = { line = 4 }"),
              HasSubstr("gpio.emergency_stop and gpio.light_red are the same line"));
  EXPECT_THAT(refusal("emergency_stop = { line = 4 }\npoll_ms = 2\nlost_after_ms = 3"),
              HasSubstr("lost_after_ms"));
  EXPECT_THAT(refusal("emergency_stop = { line = -1 }"), HasSubstr("line"));
}

// What a technician uncomments has to work, and to be the defaults.
TEST(StationConfiguration, ThePanelInTheShippedFileIsValidOnceUncommented) {
  std::string text;
  bool panel = false;
  std::istringstream shipped(*read_file(CLAMPD_SOURCE_DIR "/configs/station.toml"));
  for (std::string line; std::getline(shipped, line);) {
    if (line == "# [gpio]") panel = true;
    if (panel && line.rfind("# ", 0) == 0) text += line.substr(2) + "\n";
    if (panel && line.rfind("# ", 0) != 0) break;
  }
  const auto configuration = parse(text);
  ASSERT_TRUE(configuration) << configuration.error().message;
  const GpioSettings& gpio = configuration->gpio;
  for (const GpioLine* line : {&gpio.emergency_stop, &gpio.fixture_closed, &gpio.start_button,
                               &gpio.enable_relay, &gpio.light_red, &gpio.light_amber, &gpio.light_green})
    EXPECT_FALSE(line->line.empty());
  const GpioSettings defaults;
  EXPECT_EQ(gpio.debounce_ms, defaults.debounce_ms);
  EXPECT_EQ(gpio.release_ms, defaults.release_ms);
  EXPECT_EQ(gpio.start_stuck_s, defaults.start_stuck_s);
  EXPECT_EQ(gpio.poll_ms, defaults.poll_ms);
  EXPECT_EQ(gpio.lost_after_ms, defaults.lost_after_ms);
  EXPECT_EQ(gpio.relay_watchdog_ms, defaults.relay_watchdog_ms);
}

TEST(StationConfiguration, ReadsEveryKindOfKey) {
  const auto configuration = parse(R"(
[station]
name = "line 3"
operator = "Jo"
[[instruments]]
name = "load cell"
serial = "LC-1"
calibrated = 2026-05-04
[[instruments]]
name = "amplifier"
calibrated = "2026-06-01"
[can]
interface = "can0"
dbc = "other/brake.dbc"
bitrate = 500000
[can.mapping]
force = "Caliper.ClampForce"
position = ""
counter = ["CommandCount", "Caliper.Count"]
crc = "Checksum"
[supervisor]
over_force_N = 31000
[check]
repeats = 3
trajectory = "/data/t.csv"
[archive]
database = "../results.sqlite"
[control]
port = 9000
)");
  ASSERT_TRUE(configuration) << configuration.error().message;
  EXPECT_EQ(configuration->name, "line 3");
  EXPECT_EQ(configuration->operator_name, "Jo");
  ASSERT_EQ(configuration->instruments.size(), 2u);
  EXPECT_EQ(configuration->instruments[0].calibrated, "2026-05-04");
  EXPECT_EQ(configuration->instruments[1].calibrated, "2026-06-01");
  EXPECT_FALSE(configuration->embedded());
  EXPECT_FALSE(configuration->simulated_brake);
  EXPECT_EQ(configuration->can.dbc, "/etc/clampd/other/brake.dbc");
  EXPECT_THAT(
      configuration->can.mapping,
      ElementsAre(Pair("force", "Caliper.ClampForce"), Pair("position", ""), Pair("counter", "CommandCount"),
                  Pair("counter", "Caliper.Count"), Pair("crc", "Checksum")));
  EXPECT_EQ(configuration->supervisor.over_force_N, 31000.0);
  EXPECT_EQ(configuration->check.repeats, 3u);
  EXPECT_EQ(configuration->check.trajectory, "/data/t.csv");
  EXPECT_EQ(configuration->database, "/etc/results.sqlite");
  EXPECT_EQ(configuration->control.port, 9000);
}

TEST(StationConfiguration, AFrameSequenceIsATable) {
  const auto configuration = parse(
      "[[can.startup]]\nmessage = \"Network\"\nsignals = {Order = 1, Node = 5.0}\nwait_ms = 50\n"
      "[[can.startup]]\nmessage = \"Mode\"\n[[can.shutdown]]\nmessage = \"Mode\"\nsignals = {Mode = 0}\n");
  ASSERT_TRUE(configuration) << configuration.error().message;
  const CanSettings& can = configuration->can;
  ASSERT_EQ(can.startup.size(), 2U);
  ASSERT_EQ(can.shutdown.size(), 1U);
  EXPECT_EQ(can.startup[0].message, "Network");
  EXPECT_THAT(can.startup[0].signals, UnorderedElementsAre(Pair("Order", 1.0), Pair("Node", 5.0)));
  EXPECT_EQ(can.startup[0].wait_ms, 50.0);
  EXPECT_TRUE(can.startup[1].signals.empty());
  EXPECT_THAT(can.shutdown[0].signals, ElementsAre(Pair("Mode", 0.0)));
}

TEST(StationConfiguration, RepeatsMayBeAsManyAsTheBrakeNeeds) {
  const auto check = [](const char* text) {
    return parse_station_configuration(text, "a.toml").value().check;
  };
  EXPECT_TRUE(check("").repeats_auto);
  EXPECT_EQ(check("").repeats_planned(), 21u);
  EXPECT_FALSE(check("[check]\nrepeats = 20\n").repeats_auto);
  EXPECT_TRUE(check("[check]\nrepeats = \"auto\"\n").repeats_auto);
  EXPECT_EQ(check("[check]\nrepeats = \"auto\"\n").repeats_planned(), 21u);
  EXPECT_EQ(check("[check]\nrepeats = \"auto\"\nrepeats_most = 30\n").repeats_planned(), 30u);
  EXPECT_EQ(check("[check]\nrepeats = 5\nrepeats_most = 30\n").repeats_planned(), 5u);
}

TEST(StationConfiguration, AVirtualBusMeansASimulatedBrakeUnlessTold) {
  EXPECT_TRUE(parse("[can]\ninterface = \"vcan0\"")->simulated_brake);
  EXPECT_FALSE(parse("[can]\ninterface = \"vcan0\"\n[station]\nsimulated_brake = false")->simulated_brake);
  EXPECT_TRUE(parse("[can]\ninterface = \"can0\"\n[station]\nsimulated_brake = true")->simulated_brake);
}

TEST(StationConfiguration, ReadsTheModelFile) {
  const support::TemporaryDirectory directory;
  directory.write("softer.toml", "[parameters_normalised]\nk2 = 0.9\n");
  const auto configuration =
      read_station_configuration(directory.write("station.toml", "[model]\nbrake = \"softer.toml\"\n"));
  ASSERT_TRUE(configuration) << configuration.error().message;
  EXPECT_NEAR(configuration->model.theta[k2], 0.9 * kParameterTable[k2].nominal, 1e-12);
  EXPECT_FALSE(parse("[model]\nbrake = \"missing.toml\"\n"));
}

struct Refused {
  std::string label;
  std::string text;
  std::string place;
  std::string says;
};
void PrintTo(const Refused& refused, std::ostream* out) {
  *out << refused.label;
}

class StationConfigurationRefuses : public ::testing::TestWithParam<Refused> {};

TEST_P(StationConfigurationRefuses, WithFileLineAndColumn) {
  const auto configuration = parse(GetParam().text);
  ASSERT_FALSE(configuration);
  EXPECT_THAT(configuration.error().message, StartsWith("/etc/clampd/station.toml:" + GetParam().place));
  EXPECT_THAT(configuration.error().message, HasSubstr(GetParam().says));
}

INSTANTIATE_TEST_SUITE_P(
    Inputs, StationConfigurationRefuses,
    ::testing::Values(
        Refused{"not_toml", "[station\n", "1:", "not valid TOML"},
        Refused{"unknown_key", "[supervisor]\n\nover_forse_N = 1\n", "3:1: ", "did you mean over_force_N?"},
        Refused{"unknown_far", "[realtime]\nzzzzzz = 1\n", "2:1: ", "known are priority, cpu, lock_memory"},
        Refused{"unknown_section", "[supervisors]\nx = 1\n", "1:", "did you mean supervisor?"},
        Refused{"slow_feedback", "[can]\nfeedback_cycle_ms = 10\n",
                "2:", "such a brake needs a faster mode for its check"},
        Refused{"odd_command_cycle", "[can]\ncommand_cycle_ms = 0.3\n",
                "2:", "it can be 5, 2, 1, 0.5, 0.25 or 0.2"},
        Refused{"unequal_cycles", "[can]\nfeedback_cycle_ms = 5\ncommand_cycle_ms = 2\n",
                "1:", "has to be a multiple of the other"},
        Refused{"slow_by_output_errors", "[can]\nfeedback_cycle_ms = 2\n[check]\nmethod = \"oem\"\n",
                "4:", "write \"pem\" or leave the method out"},
        Refused{"late_commands", "[can]\ncommand_cycle_ms = 5\n", "1:", "as often as it wants commands"},
        Refused{"patient_for_its_period",
                "[can]\nfeedback_cycle_ms = 5\n[supervisor]\nstale_after_ms = 2.5\n",
                "4:", "outside of 7.5 to 22.5"},
        Refused{"sequence_without_message", "[[can.startup]]\nwait_ms = 5\n", "1:", "needs a message"},
        Refused{"sequence_word", "[[can.startup]]\nmessage = \"M\"\nsignals = {Mode = \"on\"}\n",
                "3:", "Mode"},
        Refused{"sequence_is_a_table", "[can.startup]\nmessage = \"M\"\n",
                "1:", "must be written as [[can.startup]]"},
        Refused{"shutdown_waits", "[[can.shutdown]]\nmessage = \"M\"\nwait_ms = 5\n",
                "3:1: ", "unknown key wait_ms"},
        Refused{"no_counter_in_a_list", "[can]\ninterface = \"can0\"\n[can.mapping]\ncounter = []\n",
                "4:11: ",
                "can.mapping.counter must name signals; counter = \"\" says that the frames carry none"},
        Refused{"forces_in_a_list",
                "[can]\ninterface = \"can0\"\n[can.mapping]\nforce = [\"a.b\", \"a.c\"]\n",
                "4:9: ", "can.mapping.force must be"},
        Refused{"unknown_role", "[can]\ninterface = \"can0\"\n[can.mapping]\nforces = \"a.b\"\n",
                "4:1: ", "did you mean force?"},
        Refused{"wrong_type", "[check]\nrepeats = \"20\"\n",
                "2:11: ", "check.repeats must be a whole number"},
        Refused{"repeats_word", "[check]\nrepeats = \"few\"\n",
                "2:11: ", "or \"auto\" for as many as the brake needs"},
        Refused{"too_few_at_most", "[check]\nrepeats_most = 3\n", "2:16: ", "outside of 4 to 200"},
        Refused{"float_count", "[check]\nrepeats = 2.5\n", "2:11: ", "whole number"},
        Refused{"no_repeats", "[check]\nrepeats = 0\n", "2:11: ", "outside of 1 to 200"},
        Refused{"nan", "[check]\ntare_s = nan\n", "2:10: ", "check.tare_s = nan is outside of"},
        Refused{"too_big", "[supervisor]\nover_force_N = 1e9\n", "2:16: ", "outside of"},
        Refused{"priority_99", "[realtime]\npriority = 99\n", "2:12: ", "outside of 0 to 98"},
        Refused{"text_for_bool", "[realtime]\nlock_memory = \"yes\"\n", "2:15: ", "true or false"},
        Refused{"number_for_text", "[station]\nname = 3\n", "2:8: ", "text in quotes"},
        Refused{"control_character", "[station]\nname = \"a\\nb\"\n", "2:8: ", "control characters"},
        Refused{"interface_path", "[can]\ninterface = \"a/b\"\n",
                "2:13: ", "not the name of a network interface"},
        Refused{"interface_long", "[can]\ninterface = \"abcdefghijklmnop\"\n", "2:13: ", "longer than 15"},
        Refused{"bad_date", "[[instruments]]\nname=\"x\"\ncalibrated = \"2026-02-30\"\n",
                "3:14: ", "YYYY-MM-DD"},
        Refused{"no_name", "[[instruments]]\nserial=\"x\"\n", "1:", "needs a name"},
        Refused{"one_instrument", "[instruments]\nname=\"x\"\n", "1:", "[[instruments]]"},
        Refused{"section_is_number", "check = 3\n", "1:9: ", "must be a table"},
        Refused{"origin_path", "[control]\norigins = [\"https://a.example/\"]\n",
                "2:11: ", "https://HOST or https://HOST:PORT"},
        Refused{"origin_scheme", "[control]\norigins = [\"a.example\"]\n", "2:11: ", "control.origins"},
        Refused{"torque_limits", "[check]\ntorque_limit_Nm = 3.1\n", " ",
                "must be below supervisor.over_torque_Nm"},
        Refused{"ceiling", "[supervisor]\nover_force_ceiling_N = 32000\n", " ",
                "must not be below supervisor.over_force_N"},
        Refused{"contact_force", "[supervisor]\nover_force_N = 250\n", " ",
                "must be below supervisor.over_force_N"},
        Refused{"embedded_hardware", "[station]\nsimulated_brake = false\n", " ", "embedded simulated one"}),
    [](const auto& input) { return input.param.label; });

TEST(DefaultDatabase, FollowsTheSystemsStateFolder) {
  ::setenv("STATE_DIRECTORY", "/var/lib/one:/var/lib/two", 1);
  EXPECT_EQ(default_database(false), "/var/lib/one/checks.sqlite");
  EXPECT_EQ(default_database(true), "/var/lib/one/simulated.sqlite");
  ::unsetenv("STATE_DIRECTORY");
  EXPECT_THAT(default_database(false), ::testing::EndsWith("/checks.sqlite"));
}

TEST(DefaultDatabase, IsAnotherForSimulatedBrakes) {
  const auto database_of = [](const std::string& text) {
    return std::filesystem::path(parse_station_configuration(text, "station.toml")->database)
        .filename()
        .string();
  };
  EXPECT_EQ(database_of(""), "simulated.sqlite");
  EXPECT_EQ(database_of("[can]\ninterface = \"vcan0\"\n"), "simulated.sqlite");
  EXPECT_EQ(database_of("[can]\ninterface = \"can0\"\n"), "checks.sqlite");
}

TEST(SimulatedBrake, InTheRealOnesPlaceKeepsOutOfItsDatabase) {
  StationConfiguration real;
  real.simulated_brake = false;
  real.database = "/var/lib/clampd/line3.sqlite";
  simulate_brake(real);
  EXPECT_TRUE(real.simulated_brake);
  EXPECT_EQ(real.database, "/var/lib/clampd/simulated.sqlite");
  StationConfiguration simulated;
  simulated.database = "/tmp/tried.sqlite";
  simulate_brake(simulated);
  EXPECT_EQ(simulated.database, "/tmp/tried.sqlite") << "which is for simulated ones already";
}

}  // namespace
}  // namespace clampd
