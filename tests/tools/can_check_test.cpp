// `clampctl can check` with the databases of real vehicles, as a user runs it: what it says when a station's
// roles are mapped onto signals that were never meant for a brake, and logs of those vehicles' own messages.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/can/codec.hpp"
#include "drivers/can/log.hpp"
#include "support/command.hpp"
#include "support/shared_data.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::can {
namespace {

using support::Outcome;
using ::testing::AllOf;
using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::Not;

std::filesystem::path vehicle_folder() {
  return support::shared_data("data/dbc");
}

/// Roles of [can.mapping] and their signals; counter and crc may have several, "A, B".
using Roles = std::map<std::string, std::string>;

std::vector<std::string> names_in(const std::string& list) {
  std::vector<std::string> names;
  std::istringstream text(list);
  for (std::string name; std::getline(text >> std::ws, name, ',');) names.push_back(name);
  return names;
}

/// What a mapping leaves out where the frames carry no counter, checksum, clock or flags.
Roles bare(Roles roles) {
  for (const char* role : {"sample_clock", "enabled", "watchdog", "fault", "counter", "crc"})
    roles.emplace(role, "");
  return roles;
}

struct LogShape {
  double cycle_ms = 1.0;
  double spacing_ms = 0.1;  ///< of the frames of one cycle
  std::size_t missing_bytes = 0;
  std::uint32_t id_change = 0;    ///< exclusive or
  std::uint64_t multiplexor = 0;  ///< added to the value that holds the mapped signals
  bool flexible = true;           ///< false: classic frames also where the file says CAN FD
};

/// Frames of the messages that the roles name, each signal a wave within what its own layout holds.
class VehicleLog {
 public:
  VehicleLog(const Database& database, const Roles& roles, const LogShape& shape) : shape_(shape) {
    for (const auto& [role, place] : roles) {
      const std::size_t dot = place.find('.');
      if (dot == std::string::npos) continue;
      const Message* message = database.find_message(std::string_view{place}.substr(0, dot));
      const Signal* signal = message == nullptr ? nullptr : message->find_signal(place.substr(dot + 1));
      if (signal != nullptr) signals_[message].push_back(signal);
    }
    counters_ = names_of(roles, "counter");
    checksums_ = names_of(roles, "crc");
  }

  std::string text(int samples) const {
    std::string text;
    for (int k = 0; k < samples; ++k) {
      int nth = 0;
      for (const auto& [message, signals] : signals_)
        text += line(*message, signals, 1.7e9 + 1e-3 * (k * shape_.cycle_ms + nth++ * shape_.spacing_ms), k);
    }
    return text;
  }

 private:
  static std::vector<std::string> names_of(const Roles& roles, const std::string& role) {
    const auto found = roles.find(role);
    std::vector<std::string> names;
    if (found != roles.end()) names = names_in(found->second);
    for (std::string& name : names) name.erase(0, name.find('.') + 1);
    return names;
  }

  /// A counter of four bits; then the exclusive or of all other bytes.
  void protect(const Message& message, int k, std::vector<std::uint8_t>& data) const {
    for (const std::string& name : counters_)
      if (const Signal* signal = message.find_signal(name)) insert_raw(*signal, k % 16, data);
    for (const std::string& name : checksums_) {
      const Signal* signal = message.find_signal(name);
      if (signal == nullptr) continue;
      std::uint8_t all = 0;
      for (const std::uint8_t byte : data) all ^= byte;
      data[signal->start_bit / 8] = all;
    }
  }

  std::string line(const Message& message, const std::vector<const Signal*>& signals, double time_s,
                   int k) const {
    std::vector<std::uint8_t> data(message.size_bytes);
    for (const Signal* signal : signals) {
      select(message, *signal, data);
      const double half =
          signal->has_range() ? 0.05 * (signal->maximum - signal->minimum) : 5.0 * signal->scale;
      const double centre =
          signal->has_range() ? 0.5 * (signal->maximum + signal->minimum) : 10.0 * signal->scale;
      encode(*signal, signal->bits == 1 ? 1.0 : centre + half * std::sin(0.05 * k), data);
    }
    protect(message, k, data);
    data.resize(data.size() - shape_.missing_bytes);
    const auto format = message.attributes.find("VFrameFormat");
    const bool flexible = shape_.flexible && format != message.attributes.end() &&
                          (format->second == "14" || format->second == "15");
    std::string line = fmt::format("({:.6f}) can0 {}{}", time_s, id_text(message.id ^ shape_.id_change),
                                   flexible ? "##0" : "#");
    for (const std::uint8_t byte : data) line += fmt::format("{:02X}", byte);
    return line + "\n";
  }

  void select(const Message& message, const Signal& signal, std::vector<std::uint8_t>& data) const {
    if (!signal.multiplexor) return;
    const Signal& multiplexor = message.signals[*signal.multiplexor];
    insert_raw(multiplexor, signal.selected_by.front().first + shape_.multiplexor, data);
    select(message, multiplexor, data);
  }

  LogShape shape_;
  std::map<const Message*, std::vector<const Signal*>> signals_;
  std::vector<std::string> counters_, checksums_;
};

class VehicleCanCheck : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(vehicle_folder()))
      GTEST_SKIP() << vehicle_folder()
                   << " is not there; set CLAMPD_SHARED to the folder that holds data/dbc";
  }

  static std::string file(const std::string& name) { return (vehicle_folder() / name).string(); }

  /// The file as a lab would edit it: in the line of each signal, one text for another.
  std::string edited(const std::string& name,
                     const std::map<std::string, std::pair<std::string, std::string>>& edits) const {
    std::ifstream original{file(name), std::ios::binary};
    std::string text;
    for (std::string line; std::getline(original, line); text += line + "\n")
      for (const auto& [signal, change] : edits)
        if (line.starts_with(" SG_ " + signal + " "))
          line.replace(line.find(change.first), change.first.size(), change.second);
    return folder_.write(name, text);
  }

  Outcome check_text(const std::string& dbc, const Roles& roles, const std::string& log,
                     const std::string& checksum = "none") const {
    std::string station = fmt::format("[can]\ndbc = \"{}\"\n", dbc);
    if (!roles.empty())
      station += fmt::format("[can.protection]\nchecksum = \"{}\"\n[can.mapping]\n", checksum);
    for (const auto& [role, place] : roles)
      station += place.find(',') == std::string::npos
                     ? fmt::format("{} = \"{}\"\n", role, place)
                     : fmt::format("{} = [\"{}\"]\n", role, fmt::join(names_in(place), "\", \""));
    folder_.write("station.toml", station);
    folder_.write("brake.log", log);
    return support::run_command(
        fmt::format("cd '{}' && " CLAMPCTL " --config station.toml can check brake.log", folder_.path("")));
  }

  Outcome check(const std::string& dbc, const Roles& roles, const LogShape& shape = {},
                const std::string& checksum = "none") const {
    const auto database = read_dbc(dbc);
    EXPECT_TRUE(database) << database.error().message;
    const VehicleLog log(*database, roles, shape);
    return check_text(dbc, roles, log.text(400), checksum);
  }

  /// Refused before the log is looked at: names the file, and says `message`.
  void expect_refused(const Outcome& outcome, const std::string& dbc, const std::string& message) const {
    EXPECT_EQ(outcome.exit_code, 2) << outcome.output;
    EXPECT_THAT(outcome.output, AllOf(HasSubstr("error: "), HasSubstr(dbc), HasSubstr(message)));
  }

  void expect_problem(const Outcome& outcome, const std::string& dbc, const std::string& message) const {
    EXPECT_EQ(outcome.exit_code, 3) << outcome.output;
    EXPECT_THAT(outcome.output, AllOf(HasSubstr("read by " + dbc), HasSubstr("problem: " + message),
                                      HasSubstr("does not understand this brake yet")));
  }

  void expect_understood(const Outcome& outcome, const std::string& dbc) const {
    EXPECT_EQ(outcome.exit_code, 0) << outcome.output;
    EXPECT_THAT(outcome.output,
                AllOf(HasSubstr("read by " + dbc), Not(HasSubstr("problem:")),
                      ContainsRegex("would have taken 3[0-9][0-9] samples; 0 are missing"),
                      HasSubstr("A station with this configuration understands this brake.")));
  }

  support::TemporaryDirectory folder_;
};

const Roles kTesla = bare({{"torque_command", "DI_torque1.DI_torqueDriver"},
                           {"enable", "DI_torque1.DI_soptState"},
                           {"force", "EPAS_sysStatus.EPAS_steeringRackForce"},
                           {"velocity", "STW_ANGLHP_STAT.StW_AnglHP_Spd"},
                           {"torque", "DI_torque2.DI_torqueEstimate"},
                           {"position", "STW_ANGLHP_STAT.StW_AnglHP"}});
const Roles kModel3 = bare({{"torque_command", "DI_torque.DI_torqueCommand"},
                            {"enable", "DI_torque.DI_torqueCounter"},
                            {"force", "EPAS3S_sysStatus.EPAS3S_steeringRackForce"},
                            {"velocity", "SCCM_steeringAngleSensor.SCCM_steeringAngleSpeed"},
                            {"torque", "EPAS3S_sysStatus.EPAS3S_torsionBarTorque"},
                            {"position", "SCCM_steeringAngleSensor.SCCM_steeringAngle"}});
const Roles kRivian = bare({{"torque_command", "VDM_OutputSignals.VDM_StcTorqueRequest"},
                            {"enable", "VDM_OutputSignals.VDM_StcActiveRequest"},
                            {"force", "ESP_EpbStatus.ESP_EpbClampForce"},
                            {"velocity", "SAS_Status.SAS_Status_AngleSpeedSafe"},
                            {"torque", "VDM_Torque_Front.VDM_OutputTorqueFront"},
                            {"position", "SAS_Status.SAS_Status_AngleSafe"}});
const Roles kToyota = bare({{"torque_command", "ENG1S01.ETQLVSC"},
                            {"enable", "ENG1S01.ETCSF"},
                            {"force", "ENG2F41.FDRV"},
                            {"velocity", "ECT1F03.NT"},
                            {"torque", "VSC2F05.TQER"},
                            {"position", "STR1S01.SSA"}});
const Roles kHyundai = bare({{"torque_command", "VSM1.CR_Esc_StrTqReq"},
                             {"enable", "VSM1.CF_Esc_Act"},
                             {"force", "EMS_H2.R_PAcnC"},
                             {"velocity", "EMS_DCT1.N"},
                             {"torque", "VSM2.CR_Mdps_StrTq"},
                             {"position", "SAS1.SAS_Angle"}});
const Roles kFord =
    bare({{"torque_command", "BrakeSnData_5.DrvSte_Tq_Rq"},
          {"enable", "BrakeSnData_5.BrkCtrFnd_B_Stat"},
          {"force", "PARSEDPushPCMtoGWM_ECG.PARSEDPushPCMtoGWM_ECG"},  // 29 bits of identifier
          {"velocity", "Yaw_Data_FD1.VehYaw_W_Actl"},
          {"torque", "EPAS_INFO.DrvSte_Tq_Actl"},
          {"position", "SteeringPinion_Data.StePinComp_An_Est"}});
const Roles kCommaBody = bare({{"torque_command", "TORQUE_CMD.TORQUE_L"},
                               {"enable", "TORQUE_CMD.COUNTER"},
                               {"force", "MOTORS_CURRENT.LEFT_PHA_AB"},
                               {"velocity", "MOTORS_DATA.SPEED_L"},
                               {"torque", "MOTORS_CURRENT.LEFT_PHA_BC"},
                               {"position", "MOTORS_ANGLE.LEFT_ANGLE_SENSOR"}});

struct Vehicle {
  const char* name;
  const Roles* nearest;
};

constexpr Vehicle kVehicles[]{{"comma_body.dbc", &kCommaBody},     {"ford_lincoln_base_pt.dbc", &kFord},
                              {"hyundai_i30_2014.dbc", &kHyundai}, {"rivian_primary_actuator.dbc", &kRivian},
                              {"tesla_can.dbc", &kTesla},          {"tesla_model3_party.dbc", &kModel3},
                              {"toyota_2017_ref_pt.dbc", &kToyota}};

/// Those whose files have every role in a unit that fits.
constexpr Vehicle kServing[]{{"rivian_primary_actuator.dbc", &kRivian},
                             {"tesla_can.dbc", &kTesla},
                             {"tesla_model3_party.dbc", &kModel3},
                             {"toyota_2017_ref_pt.dbc", &kToyota}};

Roles with(Roles roles, const std::string& role, const std::string& place) {
  roles[role] = place;
  return roles;
}

TEST_F(VehicleCanCheck, TheDefaultNamesAreNotThere) {
  for (const Vehicle& vehicle : kVehicles) {
    const std::string dbc = file(vehicle.name);
    const auto database = read_dbc(dbc);
    ASSERT_TRUE(database) << database.error().message;
    const std::string log = VehicleLog(*database, *vehicle.nearest, {}).text(10);
    const Outcome outcome = check_text(dbc, {}, log);
    expect_refused(outcome, dbc,
                   "torque command: there is no message BrakeCommand in " + dbc +
                       "; correct the name there or in [can.mapping]");
    EXPECT_THAT(outcome.output, HasSubstr(" 10 seen")) << "what the log has, by the file's own names";
  }
}

TEST_F(VehicleCanCheck, FilesThatHaveAllRolesAreUnderstood) {
  for (const Vehicle& vehicle : kServing)
    expect_understood(check(file(vehicle.name), *vehicle.nearest), file(vehicle.name));
}

TEST_F(VehicleCanCheck, NotesWhatTheFilesSignalsCannotDoForACheck) {
  const Outcome outcome = check(file("rivian_primary_actuator.dbc"), kRivian);
  EXPECT_THAT(
      outcome.output,
      AllOf(
          HasSubstr(
              "note: velocity: the DBC file lets it be -50 to 50 rad/s, less than the -350 to 350 rad/s that "
              "the station's limits allow: checks that go further end in an ERROR; correct its range"),
          HasSubstr("note: torque: its steps in the DBC file are 1 N m, but readings that are 0.1 N m apart"),
          Not(HasSubstr("note: torque command")), Not(HasSubstr("note: position"))));
}

TEST_F(VehicleCanCheck, ASpeedCommandIsReadInPlaceOfATorqueCommand) {
  const std::string dbc = file("rivian_primary_actuator.dbc");
  Roles roles = kRivian;
  roles["velocity_command"] = "SAS_Status.SAS_Status_AngleSpeedSafe";
  roles["enable"] = "SAS_Status.SAS_Status_Calibrated";
  roles["velocity"] = "EPAS_AdasStatus.EPAS_SteeringAngleSpeed";
  roles["position"] = "EPAS_AdasStatus.EPAS_InternalSas";
  expect_refused(check(dbc, roles), dbc,
                 "leave the other one empty, torque_command = \"\" where it is told its speed");
  roles["torque_command"] = "";
  const Outcome outcome = check(dbc, roles);
  expect_understood(outcome, dbc);
  EXPECT_THAT(outcome.output, HasSubstr("note: velocity command: the DBC file lets it be -50 to 50 rad/s"));
}

TEST_F(VehicleCanCheck, FilesWithoutAForceOrWithoutUnitsAreRefused) {
  const std::string advice =
      ": write one of them there, with the scale, offset and range that go with it, or name";
  expect_refused(check(file("ford_lincoln_base_pt.dbc"), kFord), file("ford_lincoln_base_pt.dbc"),
                 " has the unit \"unitless\"; expected \"N\", \"kN\"" + advice);
  expect_refused(check(file("hyundai_i30_2014.dbc"), kHyundai), file("hyundai_i30_2014.dbc"),
                 " has the unit \"hPa\"; expected \"N\", \"kN\"" + advice);
  expect_refused(check(file("comma_body.dbc"), kCommaBody), file("comma_body.dbc"),
                 "torque command: TORQUE_CMD.TORQUE_L in " + file("comma_body.dbc") +
                     " has the unit \"\"; expected \"Nm\"");
}

/// The Ford's frames are CAN FD, of 8 and of 64 bytes, with 11 and 29 bits of identifier; none has a force.
TEST_F(VehicleCanCheck, AnEditedFileServesWithLongIdentifiersAndFlexibleDataRate) {
  const std::string dbc =
      edited("ford_lincoln_base_pt.dbc", {{"PARSEDPushPCMtoGWM_ECG", {"\"unitless\"", "\"N\""}},
                                          {"TesterPhysicalResVDM", {"\"unitless\"", "\"kN\""}}});
  Outcome outcome = check(dbc, kFord);
  expect_understood(outcome, dbc);
  EXPECT_THAT(outcome.output,
              HasSubstr("1BB36010 PARSEDPushPCMtoGWM_ECG   from brake        400 seen, 400 good"));
  outcome = check(dbc, with(kFord, "force", "TesterPhysicalResVDM.TesterPhysicalResVDM"));
  expect_understood(outcome, dbc);
  EXPECT_THAT(outcome.output,
              HasSubstr("729      TesterPhysicalResVDM     from brake        400 seen, 400 good"));
  expect_problem(
      check(dbc, kFord, {.flexible = false}), dbc,
      "EPAS_INFO (0x82): 400 of 400 frames are classic frames, the DBC file says otherwise; its attribute "
      "VFrameFormat tells");
  expect_refused(check(dbc, with(kFord, "watchdog", "TesterPhysicalReqVDM_FD1.TesterPhysicalReqVDM")), dbc,
                 "the feedback is spread over more than 4 messages; name signals that come together, or "
                 "leave out a flag");
}

TEST_F(VehicleCanCheck, MultiplexedSignalsAreReadFromTheFramesThatHoldThem) {
  const std::string dbc = file("tesla_model3_party.dbc");
  const Roles roles = with(kModel3, "fault", "VCFRONT_LVPowerState.VCFRONT_tasLVState");
  expect_understood(check(dbc, roles), dbc);
  const std::string none =
      "VCFRONT_LVPowerState (0x221): of 400 frames with its identifier none has 8 bytes and the "
      "multiplexor's value by which "
      "the DBC file puts the mapped signals into it; correct it there, or map signals that the brake sends";
  expect_problem(check(dbc, roles, {.multiplexor = 4}), dbc, none);
  expect_problem(check(dbc, roles, {.missing_bytes = 1}), dbc, none);
  expect_refused(check(dbc, with(roles, "watchdog", "VCFRONT_LVPowerState.VCFRONT_ptcLVRequest")), dbc,
                 "no frame holds all of VCFRONT_ptcLVRequest, VCFRONT_tasLVState, as its multiplexor "
                 "VCFRONT_LVPowerStateIndex has it; name signals that come together");
  expect_refused(check(dbc, with(roles, "watchdog", "VCFRONT_LVPowerState.VCFRONT_LVPowerStateIndex")), dbc,
                 "is a multiplexor: it says what else is in the frame; name a signal that has the value");
}

// As vehicles have it: each message counts by a signal of its own name, and so with the checksum.
TEST_F(VehicleCanCheck, CountersAndChecksumsHaveANameOfTheirOwnInEachMessage) {
  const std::string rivian = file("rivian_primary_actuator.dbc");
  Roles roles = with(kRivian, "counter",
                     "VDM_OutputSigs_Counter, ESP_EpbStatus_Counter, SAS_Status_Counter, "
                     "VDM_Torque_Front.VDM_Torque_Front_Counter");
  roles = with(roles, "crc",
               "VDM_OutputSigs_Checksum, ESP_EpbStatus_Checksum, SAS_Status_Checksum, "
               "VDM_Torque_Front_Checksum");
  expect_understood(check(rivian, roles, {}, "xor"), rivian);
  // One is forgotten, is misspelt, or stands in a message that has two of them.
  expect_refused(check(rivian, with(roles, "crc", "VDM_OutputSigs_Checksum, SAS_Status_Checksum"), {}, "xor"),
                 rivian,
                 "message ESP_EpbStatus of " + rivian +
                     " needs a checksum VDM_OutputSigs_Checksum or SAS_Status_Checksum: 8 bits");
  expect_refused(
      check(rivian, with(roles, "counter", "VDM_OutputSigs_Counter, SAS_Status_Count"), {}, "xor"), rivian,
      "counter: no message of " + rivian + " has a signal SAS_Status_Count; correct the name there");
  expect_refused(
      check(rivian, with(roles, "counter", roles.at("counter") + ", ESP_EpbStatus.ESP_EpbClampForce"), {},
            "xor"),
      rivian,
      "it has 2 of the names in [can.mapping]: ESP_EpbStatus_Counter, ESP_EpbClampForce; write the "
      "one that is meant");
}

// Who maps a brake has to mend them all.
TEST_F(VehicleCanCheck, AllNamesThatTheFileLacksAreToldAtOnce) {
  const std::string rivian = file("rivian_primary_actuator.dbc");
  Roles roles = with(kRivian, "force", "ESP_EpbStatus.ClampForce");
  roles = with(roles, "velocity", "SAS_State.SAS_Status_AngleSpeedSafe");
  const Outcome outcome = check(rivian, with(roles, "position", "Angle"));
  expect_refused(outcome, rivian, "force: message ESP_EpbStatus of " + rivian + " has no signal ClampForce");
  expect_refused(outcome, rivian, "velocity: there is no message SAS_State in " + rivian);
  expect_refused(outcome, rivian, "position: 'Angle' must read Message.Signal");
}

TEST_F(VehicleCanCheck, MappingsThatCannotWorkAreRefusedWithTheSignalAndWhatToDo) {
  const std::string tesla = file("tesla_can.dbc"), model3 = file("tesla_model3_party.dbc");
  const std::string rivian = file("rivian_primary_actuator.dbc"), hyundai = file("hyundai_i30_2014.dbc");
  expect_refused(check(tesla, with(kTesla, "velocity", "DI_torque1.DI_motorRPM")), tesla,
                 "velocity: DI_torque1.DI_motorRPM in " + tesla +
                     " is in the command's own message, which the station sends; "
                     "name a signal of a message that the brake sends");
  expect_refused(
      check(tesla, with(kTesla, "enable", "DI_torque2.DI_brakePedal")), tesla,
      "enable: DI_torque1.DI_torqueDriver and DI_torque2.DI_brakePedal must be signals of one message");
  expect_refused(check(tesla, with(kTesla, "torque", "DI_torque2.DI_torque")), tesla,
                 "torque: message DI_torque2 of " + tesla +
                     " has no signal DI_torque; it has DI_torqueEstimate, DI_gear");
  expect_refused(check(tesla, with(kTesla, "position", "MCU_locationStatus")), tesla,
                 "position: 'MCU_locationStatus' must read Message.Signal");
  // No sign, and no range that says so.
  Roles unsigned_torque = with(kModel3, "torque_command", "ESP_status.ESP_brakeTorqueTarget");
  expect_refused(check(model3, with(unsigned_torque, "enable", "ESP_status.ESP_brakeApply")), model3,
                 "must have a range that includes a torque of either sign, since a brake closes and opens; "
                 "it has 0 to 16382 "
                 "in SI units: correct its sign, scale, offset or range there, or name another signal");
  const std::string with_force =
      edited("ford_lincoln_base_pt.dbc", {{"PARSEDPushPCMtoGWM_ECG", {"\"unitless\"", "\"N\""}}});
  expect_refused(check(with_force, with(kFord, "velocity", "WheelSpeed.WhlRr_W_Meas")), with_force,
                 "velocity: WheelSpeed.WhlRr_W_Meas in " + with_force +
                     " must have a range that includes a velocity of either");
  // Overlapping signals.
  expect_refused(
      check(hyundai, with(with(kHyundai, "torque_command", "EMS2.TQ_STND"), "enable", "EMS2.ACC_ACT")),
      hyundai, "message EMS2 of " + hyundai + " cannot be relied on: mend the file");
  // Each message has a counter of another name there.
  expect_refused(
      check(rivian, with(kRivian, "counter", "VDM_OutputSigs_Counter")), rivian,
      "message ESP_EpbStatus of " + rivian +
          " needs an alive counter VDM_OutputSigs_Counter: 2 to 32 bits, unsigned, "
          "scale 1, offset 0; counter = \"\" in [can.mapping] if the brake's frames carry none; it has no "
          "signal "
          "VDM_OutputSigs_Counter: name its own in [can.mapping], too, as a list of the names in all "
          "messages");
  expect_refused(check(rivian, kRivian, {}, "sae-j1850"), rivian,
                 "\"none\" if the brake's frames carry none; [can.mapping] names none");
  expect_refused(
      check(model3, with(kModel3, "counter", "DI_torqueCounter")), model3,
      "enable: DI_torque.DI_torqueCounter in " + model3 + " is what [can.mapping] names as counter");
}

TEST_F(VehicleCanCheck, LogsThatDoNotFitAreToldFromBrakesThatDoNot) {
  for (const Vehicle& vehicle : kServing) {
    SCOPED_TRACE(vehicle.name);
    const std::string dbc = file(vehicle.name);
    const Roles& roles = *vehicle.nearest;
    const std::string force = roles.at("force").substr(0, roles.at("force").find('.'));
    const Outcome empty = check_text(dbc, roles, "");
    EXPECT_EQ(empty.exit_code, 2);
    EXPECT_THAT(empty.output,
                HasSubstr("error: brake.log is empty; record with 'candump -l can0' while the brake sends"));
    const Outcome strangers = check(dbc, roles, {.id_change = 0x5A4});
    expect_problem(strangers, dbc, force);
    EXPECT_THAT(strangers.output,
                AllOf(HasSubstr("not in the log; without it no sample is complete: record while the brake "
                                "sends it, or correct "
                                "its identifier in the DBC file"),
                      HasSubstr("Frames that the mapping does not name:"), HasSubstr(" 400 seen")));
    const Outcome cut = check(dbc, roles, {.missing_bytes = 1});
    expect_problem(cut, dbc, force);
    EXPECT_THAT(cut.output,
                AllOf(HasSubstr(": 400 of 400 frames have another size than the "),
                      HasSubstr("bytes of the DBC file: "), HasSubstr("; correct its message there")));
    const Outcome slow = check(dbc, roles, {.cycle_ms = 10.0});
    expect_problem(slow, dbc, force);
    EXPECT_THAT(
        slow.output,
        HasSubstr("comes every 10.00 ms; the station needs a sample every 1 ms: have the brake send it so "
                  "often ([can] feedback_cycle_ms takes 5, 2, 1, 0.5, 0.25 and 0.2)"));
  }
  const std::string toyota = file("toyota_2017_ref_pt.dbc");
  expect_problem(check(toyota, kToyota, {.spacing_ms = 0.2}), toyota,
                 "no sample has a time: without a sample clock, 64 samples without a gap, every 1 ms within "
                 "2 %, have to come "
                 "first; without a counter the 4 frames of each have to come within 0.5 ms");
}

}  // namespace
}  // namespace clampd::can
