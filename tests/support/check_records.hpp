#pragma once

#include <cmath>
#include <limits>
#include <string>

#include "clampd/record/check_record.hpp"
#include "clampd/record/checksum.hpp"

namespace clampd::support {

/// Lines of all sorts: within and beyond one or two limits, without any, not reached and not known.
inline SheetRecord make_sheet_record() {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  constexpr double kNoLimit = std::numeric_limits<double>::infinity();
  SheetRecord sheet{"configs/sheet.toml", "4", std::string(64, 'c'), true, {}};
  sheet.characteristics = {
      {"apply-time at force_N 20000, share 0.9", "apply-time", "s", 0.1523, 4.7e-5, -kNoLimit, 0.14,
       ParameterVerdict::Fail},
      {"stiffness, 20 kN", "stiffness", "N/rad", 951.25, 0.6, 800.0, 1500.0, ParameterVerdict::Pass},
      {"drag", "drag", "N m", 0.0915, 0.001, -kNoLimit, kNoLimit},
      {"to 27 kN", "apply-time", "s", kNaN, kNaN, -kNoLimit, 0.2, ParameterVerdict::Fail,
       "this brake does not get there"},
      {"holding",
       "holding-margin",
       "N m",
       kNaN,
       kNaN,
       0.0,
       kNoLimit,
       {},
       "it needs mus, which these runs do not determine"}};
  for (CharacteristicRecord& line : sheet.characteristics) line.circumstances = "force_N 20000";
  return sheet;
}

/// A complete record with every field away from its default, for tests of what keeps or shows records.
inline CheckRecord make_check_record(const std::string& id = "20261120T234107123Z-9f3a61c2") {
  CheckRecord r;
  r.id = id;
  r.serial = "EMB-0042";
  r.part_number = "P-17";
  r.batch = "B-3";
  r.station = "line 3";
  r.fixture = "F-1";
  r.operator_name = "Jo Müller";
  r.software_version = "0.1.0";
  r.limits_file = "configs/limits.toml";
  r.limits_revision = "1";
  r.limits_sha256 = std::string(64, 'a');
  r.trajectory_sha256 = std::string(64, 'b');
  r.instruments = R"([{"name":"load cell","serial":"LC-1","calibrated":"2026-05-04"}])";
  r.simulated = true;
  r.started = "2026-11-20T23:41:07.123Z";
  r.stopped = "2026-11-20T23:41:25.000Z";
  r.duration_s = 17.432;
  r.repeats = 2;
  r.verdict = Verdict::Fail;
  r.marginal = false;
  r.reason = "k2 is 24.64 N/rad^2, below its lower limit 29.92 N/rad^2.";
  r.fault = FaultCause::None;
  r.parameters = {
      {"k1", "N/rad^3", -0.3544, 0.0021, -0.4602, -0.2478, ParameterVerdict::Pass},
      {"k2", "N/rad^2", 24.64, 0.105, 29.92, 40.48, ParameterVerdict::Fail},
      {"TC", "N m", 0.0767, 0.00083, 0.03835, 0.1534, ParameterVerdict::Pass},
      {"Ts0", "N m", 0.0468, 0.0011, 0.0234, 0.0702, ParameterVerdict::Pass},
      {"Tv", "N m s/rad", 0.001338, 7.7e-6, 0.0001115, 0.001338, ParameterVerdict::Marginal},
      {"mus", "N m/N", 3.55e-5, 4.1e-8, 2.6625e-5, 4.4375e-5, ParameterVerdict::Pass},
      {"ws", "rad/s", 28.9, 0.74, 7.225, 57.8, ParameterVerdict::Pass},
  };
  for (int i = 0; i < 49; ++i) r.covariance_normalised.push_back(1e-6 * i);
  r.method = "pem";
  r.noise_torque_Nm = 0.0051;
  r.noise_force_N = 75.2;
  r.noise_velocity_rad_s = 1.49;
  r.tracking_rms_N = 212.4;
  r.timing.ticks = 17432;
  r.timing.skipped = 1;
  r.timing.lost_samples = 2;
  r.timing.lateness_min_us = 3.0;
  r.timing.lateness_avg_us = 14.2;
  r.timing.lateness_max_us = 28.5;
  r.timing.lateness_histogram = {0, 0, 7, 0, 9, 0};
  r.timing.bus_load = 0.405;
  for (int i = 0; i < 2; ++i) {
    RunRecord run;
    run.run.name = "repeat " + std::to_string(i + 1);
    for (int k = 0; k < 300; ++k) {
      run.run.time_s.push_back(1e-3 * k);
      run.run.torque_Nm.push_back(std::sin(0.1 * k + i));
      run.run.velocity_rad_s.push_back(100.0 / (k + 1));
      run.run.force_N.push_back(23'000.0 * k / 300.0);
      run.run.position_rad.push_back(0.1 * k);
    }
    run.tracking_rms_N = 210.0 + i;
    run.tracking_max_N = 905.0 + i;
    run.fit_force_rms_N = 75.0 + i;
    run.fit_velocity_rms_rad_s = 1.5 + i;
    run.estimate = {-0.35, 35.0, 0.07, 0.04, 4e-4, 3.5e-5, 29.0 + i};
    run.converged = i == 0;
    run.checksum_sha256 = sha256_hex(format_run(run.run));
    r.runs.push_back(run);
  }
  for (int i = 0; i < 3; ++i) {
    Sample s;
    s.sample_index = 1000 + i;
    s.brake_time_ns = 5'000'000'000 + i;
    s.host_time_ns = 6'000'000'000 + i;
    s.torque_Nm = 1.5;
    s.velocity_rad_s = -2.5;
    s.force_N = 12'345.0 + i;
    s.position_rad = 3.25;
    s.torque_command_Nm = 0.5;
    s.force_reference_N = 12'000.0;
    s.lateness_ns = -7;
    s.trajectory_index = 42 + i;
    s.repeat = 1;
    s.state = StationState::Running;
    s.phase = CheckPhase::Trajectory;
    s.fault = i == 2 ? FaultCause::OverForce : FaultCause::None;
    r.flight_recorder.push_back(s);
  }
  return r;
}

}  // namespace clampd::support
