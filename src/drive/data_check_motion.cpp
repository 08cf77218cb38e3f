#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

constexpr std::size_t kFewestRows = 20;
/// Of the rows that move, at most in the other direction if the motion is called one way.
constexpr double kOneWay = 0.03;

std::vector<double> magnitudes(std::span<const double> values) {
  std::vector<double> result;
  for (const double value : values) result.push_back(std::abs(value));
  return result;
}

/// From row to row, without the smoothing of central differences.
std::vector<double> row_velocity(const Run& run) {
  if (run.position_rad.empty()) return run.velocity_rad_s;
  std::vector<double> velocity;
  for (std::size_t i = 1; i < run.size(); ++i)
    velocity.push_back((run.position_rad[i] - run.position_rad[i - 1]) / (run.time_s[i] - run.time_s[i - 1]));
  return velocity;
}

/// The share of all change of speed that happens in steps, from one row to the next, of more than this share
/// of the range. Steps in fewer than one row of a hundred are those of a defect, not of the motion.
double share_in_steps(std::span<const double> velocity, double range, double noise, double step) {
  double large = 0.0, all = 0.0;
  std::size_t count = 0;
  for (std::size_t i = 1; i < velocity.size(); ++i) {
    const double change = std::abs(velocity[i] - velocity[i - 1]);
    if (change < 4.0 * noise) continue;  // noise changes, too, and forth and back
    all += change;
    if (change <= step * range) continue;
    large += change;
    ++count;
  }
  return 100 * count > velocity.size() ? large / all : 0.0;
}

/// What one step of the reading is as a velocity from row to row.
double step_of_velocity(const Run& run) {
  return run.position_rad.empty() ? step_of(run.velocity_rad_s)
                                  : step_of(run.position_rad) / median_of_steps(run.time_s);
}

/// Places about which the run moves: local means, so that noise does not count as motion.
std::vector<double> mean_velocity(const Run& run, std::size_t rows) {
  const std::vector<double> velocity = velocity_of(run);
  std::vector<double> means;
  for (std::size_t begin = 0; begin < velocity.size(); begin += rows) {
    const std::size_t end = std::min(velocity.size(), begin + rows);
    means.push_back(quantile({velocity.begin() + static_cast<std::ptrdiff_t>(begin),
                              velocity.begin() + static_cast<std::ptrdiff_t>(end)},
                             0.5));
  }
  return means;
}

bool moves(const Run& run) {
  if (!run.position_rad.empty()) {
    // Six deviations, or five steps of an encoder that toggles: a reading at rest goes no farther.
    const double travel = travel_of(run.position_rad);
    return travel > std::max(6.0 * noise_of(run.position_rad), 5.0 * step_of(run.position_rad));
  }
  // The median of a reading at rest is no farther from zero than its noise, and its sign changes.
  if (quantile(magnitudes(mean_velocity(run, 5)), 0.9) > 2.0 * noise_of(run.velocity_rad_s)) return true;
  const auto forward = std::ranges::count_if(run.velocity_rad_s, [](double v) { return v > 0.0; });
  const auto backward = std::ranges::count_if(run.velocity_rad_s, [](double v) { return v < 0.0; });
  return 10 * std::max(forward, backward) > 9 * std::ssize(run.velocity_rad_s);
}

/// Of the motion as a whole: no column of its own. `run` is empty where it is true of all together.
void add_of_motion(std::vector<DataFinding>& findings, std::string name, const std::string& run, double size,
                   std::string unit, DataSeverity severity, std::string words) {
  findings.push_back({std::move(name), "", run, size, std::move(unit), severity, std::move(words)});
}

/// A position that changes in most rows by much of its whole travel, forth and back: neither noise nor motion
/// can be told then. Of a harmonic motion of N rows a period the second differences make as noise 2 % of the
/// travel with N = 20, 8 % with 10.
bool check_position_rows(RunCheck& check) {
  const Run& run = check.run;
  if (run.position_rad.empty()) return false;
  const double travel = travel_of(run.position_rad);
  const double scatter = noise_of(run.position_rad);
  constexpr double kNotable = 0.03, kMost = 0.08;
  if (scatter < kNotable * travel || scatter < 2.0 * step_of(run.position_rad)) return false;
  const bool stops =
      check.model.part(DriveTerm::Inertia).use == PartUse::Estimate && scatter > kMost * travel;
  const double rate_Hz = 1.0 / median_of_steps(run.time_s);
  check.add(
      "sampling-too-slow", check.model.columns.time.column, rate_Hz, "Hz",
      stops ? DataSeverity::Stop : DataSeverity::Note,
      fmt::format("{:.3g} rows a second are too few for this motion: from row to row the position leaves a "
                  "straight line by {:.0f} % of its travel, so that it has no acceleration that could be "
                  "told from noise. Record at {:.2g} Hz or more, or move more slowly",
                  rate_Hz, 100.0 * scatter / travel, rate_Hz * (stops ? 10.0 : 5.0)));
  return true;
}

}  // namespace

void check_sampling(RunCheck& check) {
  const Run& run = check.run;
  constexpr std::size_t kEnoughRows = 40;
  if (run.size() < kEnoughRows || !moves(run)) return;
  if (check_position_rows(check)) return;
  const std::vector<double> velocity = row_velocity(run);
  const double range = quantile(velocity, 0.99) - quantile(velocity, 0.01), noise = noise_of(velocity);
  if (range < 20.0 * std::max(noise, step_of_velocity(run)))
    return;  // a steady speed, or an encoder too coarse to tell
  // A harmonic motion with 20 rows a period changes by at most 0.16 of its range in a row, one with 10 by
  // 0.31. Below 20 an acceleration can hardly be had from differences, below 10 not at all.
  const double coarse = share_in_steps(velocity, range, noise, 0.15),
               hopeless = share_in_steps(velocity, range, noise, 0.3);
  constexpr double kNotable = 0.3, kMost = 0.5;
  if (coarse < kNotable) return;
  const bool inertia = check.model.part(DriveTerm::Inertia).use == PartUse::Estimate;
  const bool stops = inertia && hopeless > kMost;
  const double rate_Hz = 1.0 / median_of_steps(run.time_s);
  check.add("sampling-too-slow", check.model.columns.time.column, rate_Hz, "Hz",
            stops ? DataSeverity::Stop : DataSeverity::Note,
            fmt::format("{:.3g} rows a second are too few for this motion: {:.0f} % of all change of speed "
                        "happens from one row to the "
                        "next in steps of more than {:.0f} % of its range. {} Record at {:.2g} Hz or more, "
                        "or move more slowly",
                        rate_Hz, 100.0 * (stops ? hopeless : coarse), stops ? 30.0 : 15.0,
                        stops ? "No acceleration can be had from that; inertia = \"off\" in [model] leaves "
                                "it out, and then only steady "
                                "parts count."
                              : "What needs the acceleration (inertia, delays) is uncertain.",
                        rate_Hz * (stops ? 10.0 : 5.0)));
}

void check_resolution(RunCheck& check) {
  const Run& run = check.run;
  if (run.size() < kFewestRows || !moves(run)) return;
  const bool by_position = !run.position_rad.empty();
  const double step = step_of(by_position ? run.position_rad : run.velocity_rad_s);
  const SmoothMotion motion = smooth_motion(run, 4000);
  const double speed = quantile(magnitudes(motion.velocity), 0.9),
               acceleration = quantile(magnitudes(motion.acceleration), 0.9);
  if (!(speed > 0.0)) return;
  const Channel channel = by_position ? channels_of(check).back() : channels_of(check)[1];
  // A speed is known to one step over the time in which it changes; a tenth of it is poor, a third of no use.
  constexpr double kPoor = 0.1, kUseless = 0.33;
  const double change_s = std::min(acceleration > 0.0 ? speed / acceleration : run.time_s.back(),
                                   run.time_s.back() - run.time_s.front());
  const double error = by_position ? step / change_s / speed : 0.5 * step / speed;
  if (error < kPoor) return;
  const std::string difference =
      by_position ? fmt::format(" (from row to row even by {:.3g} {})", step / median_of_steps(run.time_s),
                                velocity_unit(check.model))
                  : "";
  check.add("resolution", channel.column, step, std::string(channel.unit),
            error > kUseless ? DataSeverity::Stop : DataSeverity::Note,
            fmt::format("column {} goes in steps of {:.3g} {}, which are coarse for this motion: a speed of "
                        "{:.3g} {} is uncertain by {:.0f} % "
                        "over the time in which it changes{}. Move faster or farther, or use a finer reading",
                        channel.column, step, channel.unit, speed, velocity_unit(check.model), 100.0 * error,
                        difference));
}

bool MotionSummary::one_way() const {
  return static_cast<double>(std::min(forward, backward)) < kOneWay * static_cast<double>(forward + backward);
}

MotionSummary summarise_motion(const RunCheck& check) {
  MotionSummary summary;
  const Run& run = check.run;
  if (run.size() < kFewestRows || !moves(run)) return summary;
  summary.moves = true;
  const std::vector<double> velocity = smooth_motion(run, 2000).velocity;
  const double fast = quantile(magnitudes(velocity), 0.98);
  std::vector<double> speeds;
  for (const double v : velocity) {
    if (std::abs(v) <= 0.02 * fast) continue;
    speeds.push_back(std::abs(v));
    ++(v > 0.0 ? summary.forward : summary.backward);
  }
  summary.rows = velocity.size();
  summary.standing_share = 1.0 - static_cast<double>(speeds.size()) / static_cast<double>(velocity.size());
  if (speeds.empty()) return summary;
  summary.least_speed = quantile(speeds, 0.1);
  summary.greatest_speed = quantile(std::move(speeds), 0.9);
  summary.acceleration_share = (quantile(velocity, 0.95) - quantile(velocity, 0.05)) / summary.greatest_speed;
  return summary;
}

void check_excitation(std::span<const MotionSummary> motions, std::span<const RunCheck> checks,
                      std::vector<DataFinding>& findings) {
  const DriveModel& model = checks.front().model;
  MotionSummary all;
  double standing = 0.0, least = std::numeric_limits<double>::infinity(), greatest = 0.0, acceleration = 0.0;
  for (std::size_t r = 0; r < motions.size(); ++r) {
    const MotionSummary& motion = motions[r];
    if (!motion.moves) {
      add_of_motion(
          findings, "standstill", checks[r].run.name, 100.0, "%", DataSeverity::Note,
          fmt::format(
              "the drive stands still throughout; nothing can be told of it there but the {} reading's "
              "zero and noise",
              model.effort()));
      continue;
    }
    all.rows += motion.rows;
    all.forward += motion.forward;
    all.backward += motion.backward;
    standing += motion.standing_share * static_cast<double>(motion.rows);
    least = std::min(least, motion.least_speed);
    greatest = std::max(greatest, motion.greatest_speed);
    acceleration = std::max(acceleration, motion.acceleration_share);
  }
  const std::string together;
  if (all.rows == 0) {
    findings.clear();
    return add_of_motion(
        findings, "standstill", together, 100.0, "%", DataSeverity::Stop,
        "the drive stands still in every run: its readings go no farther than their noise or "
        "their steps. Record a motion");
  }
  const double standing_share = standing / static_cast<double>(all.rows);
  constexpr double kMostlyStanding = 0.6, kSteady = 0.1;
  if (standing_share > kMostlyStanding)
    add_of_motion(
        findings, "standstill", together, 100.0 * standing_share, "%", DataSeverity::Note,
        fmt::format(
            "the drive stands still in {:.0f} % of the rows, which tell nothing of friction or inertia",
            100.0 * standing_share));
  if (all.one_way())
    add_of_motion(
        findings, "one-direction", together,
        100.0 * static_cast<double>(std::max(all.forward, all.backward)) /
            static_cast<double>(all.forward + all.backward),
        "%", DataSeverity::Note,
        fmt::format("the drive moves {} only. Dry friction, a constant {} and friction that differs by "
                    "direction are then the same; record the other direction, too",
                    all.forward > all.backward ? "forward" : "backward", model.effort()));
  else if (!model.steady && std::ranges::all_of(motions, [](const MotionSummary& each) {
             return !each.moves || each.one_way();
           }))
    add_of_motion(
        findings, "one-direction", together, 100.0, "%", DataSeverity::Note,
        fmt::format("no run reverses: each goes one way only. What happens at a reversal is not seen, and a "
                    "constant {} that changes from run to run would be the same as friction; record "
                    "motion there and back within a run, too",
                    model.effort()));
  if (model.part(DriveTerm::Viscous).use == PartUse::Estimate && least > (1.0 - kSteady) * greatest)
    add_of_motion(
        findings, "one-speed", together, greatest, std::string(velocity_unit(model)), DataSeverity::Note,
        fmt::format("the drive moves at {:.3g} {} only. Viscous and dry friction are then the same; "
                    "record other speeds, too",
                    greatest, velocity_unit(model)));
  if (!model.steady && model.part(DriveTerm::Inertia).use == PartUse::Estimate && acceleration < kSteady)
    add_of_motion(
        findings, "no-acceleration", together, 100.0 * acceleration, "%", DataSeverity::Note,
        "the drive hardly accelerates within a run, which tells nothing of its inertia; record changes "
        "of speed, or write "
        "inertia = \"off\" into [model]");
}

}  // namespace clampd::data_check
