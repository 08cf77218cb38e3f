#include "clampd/drive/simulation.hpp"

#include <cmath>

#include <fmt/format.h>

#include "src/drive/data_check.hpp"
#include "src/drive/forward_simulation.hpp"

namespace clampd {
namespace {

using data_check::differences;
using data_check::interpolate;
using drive::Motion;

std::vector<double> integral(const std::vector<double>& time_s, const std::vector<double>& rate) {
  std::vector<double> sum(rate.size(), 0.0);
  for (std::size_t k = 1; k < rate.size(); ++k)
    sum[k] = sum[k - 1] + 0.5 * (rate[k] + rate[k - 1]) * (time_s[k] - time_s[k - 1]);
  return sum;
}

/// What has to be asked for, so that it acts when the motion needs it.
std::vector<double> ahead_of_lag(const std::vector<double>& time_s, const std::vector<double>& acting,
                                 const FittedDrive& drive) {
  std::vector<double> asked = acting;
  if (drive.settling_s > 0.0) {
    const std::vector<double> rate = differences(time_s, acting);
    for (std::size_t k = 0; k < asked.size(); ++k) asked[k] += drive.settling_s * rate[k];
  }
  if (drive.lag_s == 0.0) return asked;
  std::vector<double> early(asked.size());
  for (std::size_t k = 0; k < asked.size(); ++k)
    early[k] = interpolate(time_s, asked, time_s[k] + drive.lag_s);
  return early;
}

/// One column of a foreign file.
struct Written {
  std::string name;
  std::vector<double> readings;
};

void write_column(const Run& run, const ColumnSource& source, const std::vector<double>& values,
                  std::vector<Written>& columns) {
  Written written{source.column, values};
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double value =
        source.late_s == 0.0 ? values[k] : interpolate(run.time_s, values, run.time_s[k] - source.late_s);
    double reading = (value - source.offset) / source.scale;
    if (source.wrap > 0.0) reading -= source.wrap * std::floor(reading / source.wrap);
    written.readings[k] = reading;
  }
  columns.push_back(std::move(written));
  if (!source.minus.empty()) columns.push_back({source.minus, std::vector<double>(values.size(), 0.0)});
}

}  // namespace

Result<Run> simulate_drive_motion(const Run& torque, const FittedDrive& drive, double position) {
  if (Result<void> checked = drive::check_moves(drive); !checked) return tl::unexpected(checked.error());
  if (Result<void> checked = drive::check_run(torque, drive.model); !checked)
    return tl::unexpected(checked.error());
  drive::ForwardSimulation simulation(torque, drive, 0, position);
  Run run = torque;
  Motion motion;
  motion.position = position;
  for (std::size_t row = 0; row < torque.size(); ++row) {
    run.position_rad.push_back(motion.position);
    run.velocity_rad_s.push_back(motion.velocity);
    if (row + 1 < torque.size() && !simulation.advance(row, motion))
      return failure(
          fmt::format("{}: from {:.4g} s on the simulated motion leaves all bounds: by this model nothing "
                      "holds the drive "
                      "against such a {}. Give a smaller or a shorter one",
                      torque.name, torque.time_s[row], drive.model.effort()));
  }
  return run;
}

Result<Run> simulate_drive_torque(const Run& motion, const FittedDrive& drive) {
  if (Result<void> checked = drive::check_run(motion, drive.model); !checked)
    return tl::unexpected(checked.error());
  Run run = motion;
  if (run.velocity_rad_s.empty()) run.velocity_rad_s = differences(run.time_s, run.position_rad);
  if (run.position_rad.empty()) run.position_rad = integral(run.time_s, run.velocity_rad_s);
  const std::vector<double> acceleration = differences(run.time_s, run.velocity_rad_s);
  const std::vector<const std::vector<double>*> columns = drive::columns_for(drive.model, run);
  const double length = drive::length_of_reversals(drive);
  std::vector<double> acting, values(columns.size());
  Motion moves;
  for (std::size_t k = 0; k < run.size(); ++k) {
    moves.velocity = std::abs(run.velocity_rad_s[k]) > drive.slow_speed ? run.velocity_rad_s[k] : 0.0;
    moves.advance(k > 0 ? run.time_s[k] - run.time_s[k - 1] : 0.0, length);
    for (std::size_t c = 0; c < columns.size(); ++c) values[c] = (*columns[c])[k];
    DriveState state;
    state.time_s = run.time_s[k] - run.time_s.front();
    state.position = run.position_rad[k];
    state.velocity = run.velocity_rad_s[k];
    state.acceleration = acceleration[k];
    state.direction = moves.velocity == 0.0 ? 0.0 : moves.sign;
    state.travel = moves.travel;
    state.columns = values;
    acting.push_back(torque_of(drive, state));
  }
  run.torque_Nm = ahead_of_lag(run.time_s, acting, drive);
  return run;
}

std::string format_drive_run(const Run& run, const DriveModel& model) {
  std::vector<Written> columns;
  write_column(run, model.columns.time, run.time_s, columns);
  write_column(run, *model.columns.torque, run.torque_Nm, columns);
  if (model.columns.position) write_column(run, *model.columns.position, run.position_rad, columns);
  if (model.columns.velocity) write_column(run, *model.columns.velocity, run.velocity_rad_s, columns);
  if (model.columns.drive_enabled)
    write_column(run, *model.columns.drive_enabled, std::vector<double>(run.size(), 1.0), columns);
  for (const auto& [name, source] : model.columns.others) {
    if (model.load_position && name == model.columns.others.back().first) {
      write_column(run, source, run.position_rad, columns);
      continue;
    }
    for (const RunColumn& column : run.others)
      if (column.name == name) write_column(run, source, column.values, columns);
  }
  std::string text(static_cast<std::size_t>(model.columns.skip_lines), '\n');
  for (const Written& column : columns) text += (&column == columns.data() ? "" : ",") + column.name;
  text += '\n';
  for (std::size_t k = 0; k < run.size(); ++k) {
    for (const Written& column : columns)
      fmt::format_to(std::back_inserter(text), "{}{}", &column == columns.data() ? "" : ",",
                     column.readings[k]);
    text += '\n';
  }
  return text;
}

}  // namespace clampd
