#include "src/drive/next_motion.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include <fmt/format.h>

namespace clampd::drive {
namespace {

constexpr double kStep_s = 0.01;

void append(Run& run, const FittedDrive& drive, double position, double velocity, double acceleration) {
  DriveState state;
  state.time_s = static_cast<double>(run.size()) * kStep_s;
  state.position = position;
  state.velocity = velocity;
  state.acceleration = acceleration;
  state.direction = velocity > 0.0 ? 1.0 : velocity < 0.0 ? -1.0 : 0.0;
  const std::vector<double> no_columns(drive.model.regressors.size(), 0.0);
  state.columns = no_columns;
  run.time_s.push_back(state.time_s);
  run.torque_Nm.push_back(torque_of(drive, state));
  run.velocity_rad_s.push_back(velocity);
  run.position_rad.push_back(position);
}

/// To and fro over the middle of the range, faster each time; each speed long enough to be steady.
Run speeds_in_both_directions(const FittedDrive& drive, const DriveRange& range) {
  Run run;
  run.name = "speeds in both directions";
  const double acceleration = std::max(range.acceleration, range.fast / 0.5);
  double position = range.centre() - 0.4 * range.half();
  for (const double share : {0.03, 0.06, 0.12, 0.25, 0.5, 1.0})
    for (const double side : {1.0, -1.0}) {
      const double speed = share * range.fast;
      const double travel = std::min(0.8 * range.half(), 4.0 * speed);
      const double ramp_s = std::min(speed / acceleration, std::sqrt(std::max(travel, 1e-12) / acceleration));
      const double steady_s = std::max(0.0, travel / speed - ramp_s);
      double velocity = 0.0;
      for (double t = 0.0; t < 2.0 * ramp_s + steady_s; t += kStep_s) {
        const double a = t < ramp_s ? acceleration : t < ramp_s + steady_s ? 0.0 : -acceleration;
        velocity = std::max(0.0, std::min(speed, velocity + a * kStep_s));
        position += side * velocity * kStep_s;
        append(run, drive, position, side * velocity, velocity > 0.0 ? side * a : 0.0);
      }
    }
  return run;
}

Run standstill_with_the_drive_off() {
  Run run;
  run.name = "drive off";
  for (int k = 0; k < 300; ++k) {
    run.time_s.push_back(k * kStep_s);
    run.torque_Nm.push_back(0.0);
    run.velocity_rad_s.push_back(0.0);
    run.position_rad.push_back(0.0);
    run.drive_enabled.push_back(0.0);
  }
  return run;
}

bool holds(const std::vector<std::string>& group, const char* name) {
  return std::ranges::find(group, name) != group.end();
}

}  // namespace

std::optional<NextExperiment> next_motion(const FittedDrive& drive,
                                          const std::vector<std::vector<std::string>>& rivals,
                                          const std::map<std::string, Unidentifiable>& unseen,
                                          const DriveRange& range) {
  NextExperiment next;
  for (const std::vector<std::string>& group : rivals)
    if (holds(group, "torque-offset") && holds(group, "friction-asymmetry")) {
      next.manoeuvre = "standstill with the drive off";
      next.why = fmt::format(
          "while the drive slides, a constant {0} and friction that differs by direction are the same; with "
          "the "
          "drive off, an offset of the {0} reading is still there, and a load that pulls moves the drive",
          drive.model.effort());
      next.trajectory = standstill_with_the_drive_off();
      return next;
    }
  std::set<std::string> motions;
  for (const auto& [name, reason] : unseen)
    if (!reason.motion.empty()) motions.insert(fmt::format("{} (for {})", reason.motion, name));
  if (rivals.empty() && motions.empty()) return std::nullopt;
  next.manoeuvre = "speeds in both directions";
  if (!rivals.empty()) {
    next.why = fmt::format(
        "{} do best at other speeds and places: each of six speeds up to {:.3g} {}/s, forward and backward "
        "over most of "
        "the range",
        fmt::join(rivals.front(), " and "), range.fast, drive.model.position_unit());
  } else {
    next.why = fmt::format("it would show what these runs could not: {}", fmt::join(motions, "; "));
  }
  next.trajectory = speeds_in_both_directions(drive, range);
  return next;
}

}  // namespace clampd::drive
