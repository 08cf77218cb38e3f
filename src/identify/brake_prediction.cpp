#include "clampd/identify/brake_prediction.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "clampd/identify/extended_fit.hpp"

namespace clampd {
namespace {

RowInput input_at(const FitRun& run, std::size_t k) {
  const std::size_t last = run.size() - 1;
  return {.previous_torque_Nm = run.torque_Nm[k > 0 ? k - 1 : 0],
          .torque_Nm = run.torque_Nm[k],
          .next_torque_Nm = run.torque_Nm[std::min(k + 1, last)],
          .later_torque_Nm = run.torque_Nm[std::min(k + 2, last)],
          .time_s = run.time_s[k] - run.time_s.front(),
          .gap_s = k < last ? run.time_s[k + 1] - run.time_s[k] : 0.0,
          .run = run.number};
}

double mean_of_first(const std::vector<double>& values, std::size_t rows) {
  return std::accumulate(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(rows), 0.0) /
         static_cast<double>(rows);
}

/// The position at which the model reads this force: bisection, since the force grows with the position.
double position_of_force(const ExtendedBrake& brake, double force_N, double velocity_rad_s,
                         const RowInput& row) {
  const auto force_at = [&](double position) {
    return brake.read(brake.settled(position, velocity_rad_s, row), row).force_N;
  };
  double low = 0.0, high = 1.0;
  constexpr double kFarthest_rad = 1e3;
  while (high < kFarthest_rad && force_at(high) < force_N) high *= 2.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (force_at(middle) < force_N ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

ExtendedBrake::State initial_state(const ExtendedBrake& brake, const FitRun& run, const Run& recorded) {
  // Few enough that the brake does not move meanwhile, and enough to average the noise.
  const std::size_t rows = std::min<std::size_t>(5, run.size());
  const RowInput first = input_at(run, 0);
  const double velocity = mean_of_first(run.velocity_rad_s, rows), force = mean_of_first(run.force_N, rows);
  const auto [least, most] = std::ranges::minmax(run.force_N);
  constexpr double kTouching = 0.02;  // of the run's forces: less is the reading's noise and offset
  double position = recorded.position_rad.empty() ? 0.0 : recorded.position_rad.front();
  if (force - std::min(least, 0.0) > kTouching * (most - least))
    position = position_of_force(brake, force, velocity, first);
  return brake.settled(position, velocity, first);
}

Result<void> check(const Run& run) {
  constexpr std::size_t kFewestRows = 10;
  if (run.size() < kFewestRows)
    return failure(fmt::format("{}: {} rows are too few to simulate; at least {} are needed", run.name,
                               run.size(), kFewestRows));
  if (run.force_N.size() != run.size() || run.velocity_rad_s.size() != run.size())
    return failure(fmt::format(
        "{}: a brake is judged by force and velocity, and one of them is missing; a bare drive needs a model "
        "with [drive]",
        run.name));
  return {};
}

}  // namespace

Result<std::vector<PredictedRun>> predict_brake(std::span<const Run> runs, const ExtendedParameters& model) {
  if (runs.empty()) return failure("no run to predict");
  for (const Run& run : runs)
    if (Result<void> checked = check(run); !checked) return tl::unexpected(checked.error());
  std::vector<FitRun> moved = fit_runs(runs);
  move_by(delays_of(model), moved);
  const ExtendedBrake brake(model);
  std::vector<PredictedRun> predicted;
  for (std::size_t r = 0; r < runs.size(); ++r) {
    const FitRun& run = moved[r];
    constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
    PredictedQuantity force{"force", "N", run.force_N, std::vector<double>(run.size(), kNone)};
    PredictedQuantity velocity{"velocity", "rad/s", run.velocity_rad_s,
                               std::vector<double>(run.size(), kNone)};
    PredictedRun result;
    result.name = runs[r].name;
    result.time_s = run.time_s;
    ExtendedBrake::State state = initial_state(brake, run, runs[r]);
    for (std::size_t k = 0; k < run.size(); ++k) {
      if (!ExtendedBrake::is_bounded(state)) {
        result.diverged_s = run.time_s[k];
        break;
      }
      const Reading reading = brake.read(state, input_at(run, k));
      if (run.use_force[k] != 0) force.predicted[k] = reading.force_N;
      if (run.use_velocity[k] != 0) velocity.predicted[k] = reading.velocity_rad_s;
      if (k + 1 < run.size()) state = brake.advance(state, input_at(run, k));
    }
    result.quantities = {std::move(force), std::move(velocity)};
    predicted.push_back(std::move(result));
  }
  return predicted;
}

}  // namespace clampd
