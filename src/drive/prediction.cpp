#include "clampd/drive/prediction.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>
#include <Eigen/Core>

#include "clampd/statistics/symmetric.hpp"
#include "src/drive/data_check.hpp"
#include "src/drive/forward_simulation.hpp"

namespace clampd {
namespace {

constexpr std::size_t kRowsOfAStart = 5;
using drive::ForwardSimulation;
using drive::Motion;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

/// The recorded motion about each row, by a quadratic through the rows within `half_width_s`, for the starts
/// of simulations.
Motion motion_at(const Run& run, std::size_t row, double half_width_s) {
  const std::span<const double> x(run.position_rad.empty() ? run.velocity_rad_s : run.position_rad);
  std::size_t first = row, last = row + 1;
  while (first > 0 && run.time_s[row] - run.time_s[first - 1] <= half_width_s) --first;
  while (last < run.size() &&
         (last < first + kRowsOfAStart || run.time_s[last] - run.time_s[row] <= half_width_s))
    ++last;
  while (first > 0 && last - first < kRowsOfAStart) --first;
  const auto n = static_cast<Eigen::Index>(last - first);
  Eigen::MatrixXd columns(n, 3);
  Eigen::VectorXd target(n);
  const double scale_s =
      std::max(run.time_s[last - 1] - run.time_s[row], run.time_s[row] - run.time_s[first]);
  for (Eigen::Index k = 0; k < n; ++k) {
    const double u = (run.time_s[first + static_cast<std::size_t>(k)] - run.time_s[row]) / scale_s;
    columns.row(k) << 1.0, u, u * u;
    target[k] = x[first + static_cast<std::size_t>(k)] - x[row];
  }
  const Eigen::VectorXd fitted =
      statistics::SymmetricFactor(columns.transpose() * columns).solve(columns.transpose() * target);
  Motion motion;
  motion.position = run.position_rad.empty() ? 0.0 : x[row] + fitted[0];
  motion.velocity = run.position_rad.empty() ? x[row] + fitted[0] : fitted[1] / scale_s;
  return motion;
}

std::vector<PredictedQuantity> recorded_quantities(const Run& run, const DriveModel& model) {
  std::vector<PredictedQuantity> quantities;
  if (!run.position_rad.empty())
    quantities.push_back({"position", std::string(model.position_unit()), run.position_rad,
                          std::vector<double>(run.size(), kNone)});
  quantities.push_back({"velocity", std::string(model.position_unit()) + "/s",
                        run.velocity_rad_s.empty() ? data_check::differences(run.time_s, run.position_rad)
                                                   : run.velocity_rad_s,
                        std::vector<double>(run.size(), kNone)});
  return quantities;
}

/// From the first row to the end, or anew every `horizon_s`. Returns when it diverged; NaN: never.
double simulate(const Run& run, const FittedDrive& drive, int number, double horizon_s,
                std::vector<PredictedQuantity>& quantities) {
  ForwardSimulation simulation(run, drive, number, run.position_rad.empty() ? 0.0 : run.position_rad.front());
  // The model knows nothing faster than its cut-off, and the start need not either.
  const double half_width_s = std::isfinite(drive.cut_off_Hz) ? 0.2 / drive.cut_off_Hz : 0.0;
  Motion motion;
  double started_s = -std::numeric_limits<double>::infinity();
  for (std::size_t row = 0; row < run.size(); ++row) {
    if (row == 0 || run.time_s[row] - started_s >= horizon_s) {
      motion = motion_at(run, row, half_width_s);
      if (row > 0) motion.sign = motion.velocity > 0.0 ? 1.0 : -1.0;
      started_s = run.time_s[row];
    }
    if (quantities.size() > 1) quantities.front().predicted[row] = motion.position;
    quantities.back().predicted[row] = motion.velocity;
    if (row + 1 < run.size() && !simulation.advance(row, motion)) return run.time_s[row];
  }
  return kNone;
}

}  // namespace

Result<std::vector<PredictedRun>> predict_drive(std::span<const Run> runs, const FittedDrive& drive) {
  if (Result<void> checked = drive::check_moves(drive); !checked) return tl::unexpected(checked.error());
  std::vector<PredictedRun> predicted;
  for (const Run& run : runs) {
    if (Result<void> checked = drive::check_run(run, drive.model); !checked)
      return tl::unexpected(checked.error());
    const auto number = static_cast<int>(predicted.size());
    PredictedRun result;
    result.name = run.name;
    result.time_s = run.time_s;
    result.quantities = recorded_quantities(run, drive.model);
    result.diverged_s =
        simulate(run, drive, number, std::numeric_limits<double>::infinity(), result.quantities);
    for (const double horizon_s : {0.1, 1.0}) {
      if (run.time_s.back() - run.time_s.front() < 2.0 * horizon_s) continue;
      result.limited.push_back({horizon_s, recorded_quantities(run, drive.model)});
      simulate(run, drive, number, horizon_s, result.limited.back().quantities);
    }
    predicted.push_back(std::move(result));
  }
  return predicted;
}

}  // namespace clampd
