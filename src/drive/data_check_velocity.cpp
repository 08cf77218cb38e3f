#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <Eigen/Core>

#include "clampd/statistics/symmetric.hpp"
#include "src/drive/data_check.hpp"

namespace clampd::data_check {
namespace {

constexpr std::size_t kVelocityBlocks = 20;

/// Rows of both readings as a regression: the integral of the velocity against the position. An integral has
/// little noise, and a difference much.
struct Pair {
  std::vector<double> time_s, integral, position, velocity;
};

Pair pair_of(const Run& run) {
  constexpr std::size_t kMostRows = 40'000;
  const std::size_t stride = std::max<std::size_t>(1, run.size() / kMostRows);
  Pair pair;
  double integral = 0.0;
  for (std::size_t i = 0; i < run.size(); ++i) {
    if (i > 0)
      integral +=
          0.5 * (run.velocity_rad_s[i] + run.velocity_rad_s[i - 1]) * (run.time_s[i] - run.time_s[i - 1]);
    if (i % stride != 0) continue;
    pair.time_s.push_back(run.time_s[i]);
    pair.integral.push_back(integral);
    pair.position.push_back(run.position_rad[i]);
    pair.velocity.push_back(run.velocity_rad_s[i]);
  }
  return pair;
}

/// Sums of products within a block, less its means: position, velocity, time, and the integral last.
using Products = Eigen::Matrix4d;

std::vector<Products> products_of(const Pair& pair, std::span<const double> position) {
  std::vector<Products> blocks;
  const std::size_t n = pair.time_s.size();
  for (std::size_t b = 0; b < kVelocityBlocks; ++b) {
    const std::size_t begin = b * n / kVelocityBlocks, end = (b + 1) * n / kVelocityBlocks;
    Products products = Products::Zero();
    Eigen::Vector4d sum = Eigen::Vector4d::Zero();
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector4d row(position[i] - position[begin], pair.velocity[i],
                                pair.time_s[i] - pair.time_s[begin], pair.integral[i] - pair.integral[begin]);
      products.noalias() += row * row.transpose();
      sum += row;
    }
    if (end > begin) products -= sum * sum.transpose() / static_cast<double>(end - begin);
    blocks.push_back(products);
  }
  return blocks;
}

/// Integral of the velocity = scale × position − delay × velocity + offset × time + a constant of each block.
struct Fit {
  double scale = 0.0, delay_s = std::numeric_limits<double>::quiet_NaN();
  double left_share = 1.0;  ///< of the integral's variation
};

Fit fit_of(const Products& products) {
  Fit fit;
  const double total = products(3, 3);
  if (!(total > 0.0) || !(products(0, 0) > 0.0)) return fit;
  // A steady speed tells no delay, and no offset from a scale: such a column is left out.
  std::vector<Eigen::Index> used{0};
  for (const Eigen::Index column : {1, 2}) {
    std::vector<Eigen::Index> tried = used;
    tried.push_back(column);
    if (!(products(column, column) > 0.0)) continue;
    const statistics::ScaledFactor factor(products(tried, tried));
    if (factor.smallest_pivot() > 1e-4) used = tried;
  }
  const Eigen::VectorXd coefficients =
      statistics::ScaledFactor(products(used, used)).solve(products(used, 3));
  fit.scale = coefficients[0];
  for (std::size_t k = 1; k < used.size(); ++k)
    if (used[k] == 1) fit.delay_s = -coefficients[static_cast<Eigen::Index>(k)];
  fit.left_share = std::max(0.0, 1.0 - coefficients.dot(products(used, 3)) / total);
  return fit;
}

Products sum_of(const std::vector<Products>& blocks) {
  Products sum = Products::Zero();
  for (const Products& block : blocks) sum += block;
  return sum;
}

std::vector<double> shifted_position(const Pair& pair, double delay_s) {
  std::vector<double> position(pair.time_s.size());
  for (std::size_t i = 0; i < position.size(); ++i)
    position[i] =
        delay_s == 0.0 ? pair.position[i] : interpolate(pair.time_s, pair.position, pair.time_s[i] - delay_s);
  return position;
}

struct Comparison {
  double scale = 0.0, scale_sd = 0.0;
  double delay_s = std::numeric_limits<double>::quiet_NaN(), delay_sd_s = 0.0;
  double left_share = 1.0;
};

/// The delay first on a grid, since it may be many rows, then by linear steps.
double delay_of(const Pair& pair, double step_s) {
  constexpr int kMostRows = 64;
  double best_s = 0.0, least = fit_of(sum_of(products_of(pair, pair.position))).left_share;
  for (int rows = 1; rows <= kMostRows; rows = std::max(rows + 1, rows * 5 / 4))
    for (const double delay_s : {rows * step_s, -rows * step_s}) {
      const double left = fit_of(sum_of(products_of(pair, shifted_position(pair, delay_s)))).left_share;
      if (left < least) {
        least = left;
        best_s = delay_s;
      }
    }
  return best_s;
}

Comparison compare(const Run& run) {
  const Pair pair = pair_of(run);
  Comparison result;
  const double step_s = median_of_steps(run.time_s);
  double delay_s = delay_of(pair, step_s);
  std::vector<Products> blocks = products_of(pair, shifted_position(pair, delay_s));
  for (int i = 0; i < 3; ++i) {
    const double change_s = fit_of(sum_of(blocks)).delay_s;
    if (!std::isfinite(change_s) || std::abs(change_s) > 20.0 * step_s) break;
    delay_s += change_s;
    blocks = products_of(pair, shifted_position(pair, delay_s));
  }
  const Products all = sum_of(blocks);
  const Fit fit = fit_of(all);
  result.scale = fit.scale;
  result.left_share = fit.left_share;
  if (std::isfinite(fit.delay_s)) result.delay_s = delay_s + fit.delay_s;
  double scale_squares = 0.0, delay_squares = 0.0;  // jackknife: each block left out in turn
  for (const Products& block : blocks) {
    const Fit without = fit_of(all - block);
    scale_squares += std::pow(without.scale - fit.scale, 2);
    if (std::isfinite(without.delay_s)) delay_squares += std::pow(without.delay_s - fit.delay_s, 2);
  }
  constexpr double kFactor = static_cast<double>(kVelocityBlocks - 1) / static_cast<double>(kVelocityBlocks);
  result.scale_sd = std::sqrt(kFactor * scale_squares);
  result.delay_sd_s = std::sqrt(kFactor * delay_squares);
  return result;
}

/// Ratios of velocity to the position's rate that units explain, and what then makes them agree.
struct UnitPair {
  double ratio;
  double velocity, position;  ///< multiplied by
  std::string_view words;
  bool rotary, linear;
};
constexpr double kDegrees = 180.0 / M_PI, kTurns = 2.0 * M_PI;
constexpr std::array<UnitPair, 8> kUnitPairs{{
    {60.0 / kTurns, kTurns / 60.0, 1.0, "the velocity is in rpm", true, false},
    {kDegrees, 1.0 / kDegrees, 1.0, "the velocity is in degrees per second", true, false},
    {1.0 / kTurns, kTurns, 1.0, "the velocity is in turns per second", true, false},
    {1.0 / kDegrees, 1.0, 1.0 / kDegrees, "the position is in degrees", true, false},
    {kTurns, 1.0, kTurns, "the position is in turns", true, false},
    {1.0 / 6.0, kTurns / 60.0, 1.0 / kDegrees, "the velocity is in rpm and the position in degrees", true,
     false},
    {60.0, kTurns / 60.0, kTurns, "the velocity is in rpm and the position in turns", true, false},
    {1e-3, 1.0, 1e-3, "the position is in mm", false, true},
}};
constexpr UnitPair kMillimetresPerSecond{1e3, 1e-3, 1.0, "the velocity is in mm/s", false, true};

const UnitPair* explained_by(double ratio, const DriveModel& model) {
  constexpr double kTolerance = 0.015;  // the nearest two, 1/6 and 1/(2 pi), are 4.6 % apart
  for (const UnitPair& pair : kUnitPairs)
    if (std::abs(ratio / pair.ratio - 1.0) < kTolerance && (model.linear ? pair.linear : pair.rotary))
      return &pair;
  if (model.linear && std::abs(ratio / kMillimetresPerSecond.ratio - 1.0) < kTolerance)
    return &kMillimetresPerSecond;
  return nullptr;
}

void scale_by(std::vector<double>& values, double factor) {
  for (double& value : values) value *= factor;
}

/// False: the columns contradict each other.
bool judge_scale(RunCheck& check, const Comparison& found, const std::string& column,
                 const std::string& position) {
  const double ratio = std::abs(found.scale);
  // A calibration is good to a per cent or two, and as much is lost of a filtered velocity.
  constexpr double kCalibration = 0.02, kMisleading = 0.05;
  if (std::abs(ratio - 1.0) < std::max(kCalibration, 5.0 * found.scale_sd)) return true;
  const std::string what = fmt::format("column {} is {:.4g} ± {:.1g} times the rate of change of column {}",
                                       column, ratio, found.scale_sd, position);
  if (const UnitPair* unit = explained_by(ratio, check.model)) {
    scale_by(check.run.velocity_rad_s, unit->velocity);
    scale_by(check.run.position_rad, unit->position);
    check.mended = true;
    check.add("velocity-scale", column, ratio, "1", DataSeverity::Mended,
              fmt::format("{}: {}. It was converted; give the scale in [columns] of the model file", what,
                          unit->words));
  } else if (std::abs(ratio - 1.0) < kMisleading) {
    check.add("velocity-scale", column, ratio, "1", DataSeverity::Note,
              what + ". The motion is taken from the position; check the calibration of both");
  } else {
    check.add("velocity-scale", column, ratio, "1", DataSeverity::Stop,
              what +
                  ", which no unit explains: a gear ratio, counts per turn, or the unit of time. Inertia and "
                  "friction would be off "
                  "by that factor or its square. Give the scale of the wrong one in [columns] of the model "
                  "file, or leave it out "
                  "there");
    return false;
  }
  return true;
}

void judge_delay(RunCheck& check, const Comparison& found, const std::string& column,
                 const std::string& position) {
  const double step_s = median_of_steps(check.run.time_s);
  // Backward differences are half a row late, and a filter of the drive easily one.
  if (!std::isfinite(found.delay_s) ||
      std::abs(found.delay_s) < std::max(1.5 * step_s, 5.0 * found.delay_sd_s))
    return;
  const std::vector<double> raw = check.run.velocity_rad_s;
  for (std::size_t i = 0; i < raw.size(); ++i)
    check.run.velocity_rad_s[i] = interpolate(check.run.time_s, raw, check.run.time_s[i] + found.delay_s);
  check.mended = true;
  check.add("velocity-delay", column, found.delay_s, "s", DataSeverity::Mended,
            fmt::format("column {} is {:.3g} ± {:.1g} ms {} the motion by column {} ({:.1f} rows). It was "
                        "shifted in time; a filter "
                        "or a slower bus makes such a delay",
                        column, 1e3 * std::abs(found.delay_s), 1e3 * found.delay_sd_s,
                        found.delay_s > 0.0 ? "later than" : "ahead of", position,
                        std::abs(found.delay_s) / step_s));
}

/// How much of the position's motion the integral of the torque column would explain: columns that were
/// swapped.
bool is_swapped_with_torque(const RunCheck& check) {
  Run swapped = check.run;
  std::swap(swapped.velocity_rad_s, swapped.torque_Nm);
  const Pair pair = pair_of(swapped);
  return fit_of(sum_of(products_of(pair, pair.position))).left_share < 0.01;
}

}  // namespace

void check_velocity_against_position(RunCheck& check) {
  Run& run = check.run;
  constexpr std::size_t kLeastRows = 100;
  if (run.position_rad.empty() || run.velocity_rad_s.empty() || run.size() < kLeastRows) return;
  // Nothing to compare where nothing moves.
  const double travel = travel_of(run.position_rad);
  if (travel < 20.0 * std::max(noise_of(run.position_rad), step_of(run.position_rad))) return;
  const std::string column =
      check.model.columns.velocity ? check.model.columns.velocity->column : "velocity_rad_s";
  const std::string position =
      check.model.columns.position ? check.model.columns.position->column : "position_rad";
  const Comparison found = compare(run);
  // Of a velocity that belongs to the position next to nothing is left of its integral, whatever its scale
  // and delay.
  constexpr double kOfItsOwn = 0.1;
  if (found.left_share > kOfItsOwn) {
    check.add(
        "velocity-mismatch", column, 100.0 * found.left_share, "%", DataSeverity::Stop,
        fmt::format(
            "column {} is not the velocity of column {}: {:.0f} % of it has nothing to do with that motion. "
            "{}",
            column, position, 100.0 * found.left_share,
            is_swapped_with_torque(check)
                ? fmt::format(
                      "Column {} is, up to a scale: the columns of {} and velocity are swapped in the "
                      "model file",
                      check.model.columns.torque->column, check.model.effort())
                : "Look for swapped columns, another axis, or a reading that stands still; leave it out of "
                  "the model "
                  "file if the position is right"));
    return;
  }
  if (found.scale < 0.0) {
    scale_by(run.velocity_rad_s, -1.0);
    check.mended = true;
    check.add("velocity-sign", column, -1.0, "1", DataSeverity::Mended,
              fmt::format("column {} has the opposite sign of the motion by column {}. The velocity was "
                          "negated; write scale = -1 "
                          "for the wrong one into the model file",
                          column, position));
  }
  if (judge_scale(check, found, column, position)) judge_delay(check, found, column, position);
}

}  // namespace clampd::data_check
