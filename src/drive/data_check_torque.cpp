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

constexpr Eigen::Index kBalanceBlocks = 12;
constexpr std::size_t kMostPlaces = 4000;

/// The torque balance as a regression, with what gravity and a spring do beside inertia and friction: a
/// pendulum must not pass for a negative inertia.
struct Balance {
  SmoothMotion motion;
  Eigen::MatrixXd columns;  ///< acceleration, velocity, direction, then the others; only places that move
  Eigen::VectorXd velocity;
  bool both_directions = false;
};

/// No torque acts while the drive is off, whatever its reading.
bool is_off(const Run& run, double at_s) {
  return !run.drive_enabled.empty() && interpolate(run.time_s, run.drive_enabled, at_s) < 1.0;
}

Balance balance_of(const Run& run, bool linear) {
  SmoothMotion all = smooth_motion(run, kMostPlaces);
  std::vector<double> speeds;
  for (const double v : all.velocity) speeds.push_back(std::abs(v));
  const double floor = 0.02 * quantile(speeds, 0.98);
  Balance balance;
  SmoothMotion& kept = balance.motion;
  kept.half_width_s = all.half_width_s;
  for (std::size_t i = 0; i < all.time_s.size(); ++i) {
    if (std::abs(all.velocity[i]) <= floor || is_off(run, all.time_s[i])) continue;
    kept.time_s.push_back(all.time_s[i]);
    kept.position.push_back(all.position[i]);
    kept.velocity.push_back(all.velocity[i]);
    kept.acceleration.push_back(all.acceleration[i]);
    kept.torque.push_back(all.torque[i]);
  }
  const auto n = static_cast<Eigen::Index>(kept.time_s.size());
  const auto as_vector = [n](const std::vector<double>& values) {
    return Eigen::Map<const Eigen::VectorXd>(values.data(), n);
  };
  balance.velocity = as_vector(kept.velocity);
  const auto forward = (balance.velocity.array() > 0.0).count();
  balance.both_directions = forward > n / 20 && forward < n - n / 20;
  std::vector<Eigen::VectorXd> columns{as_vector(kept.acceleration), balance.velocity,
                                       balance.velocity.array().sign(), Eigen::VectorXd::Ones(n)};
  if (!run.position_rad.empty()) {
    columns.emplace_back(as_vector(kept.position));
    if (!linear) columns.emplace_back(as_vector(kept.position).array().sin());
    if (!linear) columns.emplace_back(as_vector(kept.position).array().cos());
  }
  balance.columns.resize(n, static_cast<Eigen::Index>(columns.size()));
  for (std::size_t c = 0; c < columns.size(); ++c)
    balance.columns.col(static_cast<Eigen::Index>(c)) = columns[c];
  return balance;
}

/// Sums of products of the balance's columns and the torque within one block of time.
struct Sums {
  Eigen::MatrixXd products;
  Eigen::VectorXd with_torque;
};

Eigen::VectorXd solve(const Sums& sums) {
  // Columns that are not independent (a constant and the direction of a motion one way) share what they
  // explain.
  return statistics::ScaledFactor(sums.products, 1e-7).solve(sums.with_torque);
}

struct Estimated {
  double value = 0.0, sd = 0.0;
  bool is_negative() const { return value < -5.0 * sd; }
};

/// Inertia, and the power that friction takes, each with a deviation by the jackknife over blocks.
struct Signs {
  Estimated inertia, dissipation;
  bool inertia_is_seen = false;
  double power = 0.0;  ///< mean magnitude of torque times velocity
};

Signs signs_of(const Balance& balance, const Eigen::VectorXd& torque) {
  const Eigen::Index n = balance.columns.rows(), columns = balance.columns.cols();
  std::vector<Sums> blocks;
  Sums all{Eigen::MatrixXd::Zero(columns, columns), Eigen::VectorXd::Zero(columns)};
  for (Eigen::Index b = 0; b < kBalanceBlocks; ++b) {
    const Eigen::Index begin = b * n / kBalanceBlocks, rows = (b + 1) * n / kBalanceBlocks - begin;
    const auto part = balance.columns.middleRows(begin, rows);
    blocks.push_back({part.transpose() * part, part.transpose() * torque.segment(begin, rows)});
    all.products += blocks.back().products;
    all.with_torque += blocks.back().with_torque;
  }
  const double square = balance.velocity.squaredNorm() / static_cast<double>(n);
  const double magnitude = balance.velocity.cwiseAbs().mean();
  const auto dissipation = [&](const Eigen::VectorXd& c) { return c[1] * square + c[2] * magnitude; };
  const Eigen::VectorXd fitted = solve(all);
  Signs signs;
  signs.inertia.value = fitted[0];
  signs.dissipation.value = dissipation(fitted);
  for (const Sums& block : blocks) {
    const Eigen::VectorXd without =
        solve({all.products - block.products, all.with_torque - block.with_torque});
    signs.inertia.sd += std::pow(without[0] - fitted[0], 2);
    signs.dissipation.sd += std::pow(dissipation(without) - signs.dissipation.value, 2);
  }
  constexpr double kFactor = static_cast<double>(kBalanceBlocks - 1) / static_cast<double>(kBalanceBlocks);
  signs.inertia.sd = std::sqrt(kFactor * signs.inertia.sd);
  signs.dissipation.sd = std::sqrt(kFactor * signs.dissipation.sd);
  signs.power = (torque.array() * balance.velocity.array()).abs().mean();
  // What the other columns leave of the acceleration: of a harmonic motion the position takes all of it.
  const Eigen::VectorXd own =
      statistics::left_of(balance.columns.rightCols(columns - 1), balance.columns.col(0));
  const double scatter = std::sqrt((torque.array() - torque.mean()).square().sum());
  constexpr double kOwnShare = 0.2, kMaterialShare = 0.1;
  signs.inertia_is_seen = own.norm() > kOwnShare * balance.columns.col(0).norm() &&
                          std::abs(fitted[0]) * own.norm() > kMaterialShare * scatter;
  return signs;
}

void flip(std::vector<double>& values) {
  for (double& value : values) value = -value;
}

void negate_motion(RunCheck& check) {
  flip(check.run.position_rad);
  flip(check.run.velocity_rad_s);
  check.mended = true;
  for (DataFinding& finding : check.findings) {
    if (finding.name != "velocity-sign") continue;
    finding.column = check.model.columns.position->column;
    finding.words = fmt::format(
        "column {} has the opposite sign of column {}, and of what column {} makes of the motion. The "
        "position was negated; write scale = -1 for it into the model file",
        finding.column,
        check.model.columns.velocity ? check.model.columns.velocity->column : "velocity_rad_s",
        check.model.columns.torque->column);
  }
}

void judge_sign(RunCheck& check, const Signs& signs, bool both_directions) {
  const std::string& column = check.model.columns.torque->column;
  const bool friction_negative = both_directions && signs.dissipation.is_negative();
  const bool friction_positive = both_directions && signs.dissipation.value > 5.0 * signs.dissipation.sd;
  if (signs.inertia_is_seen && signs.inertia.is_negative() && !friction_positive) {
    if (std::ranges::any_of(check.findings,
                            [](const DataFinding& each) { return each.name == "velocity-sign"; }))
      return negate_motion(check);
    flip(check.run.torque_Nm);
    check.mended = true;
    check.add("torque-sign", column, -1.0, "1", DataSeverity::Mended,
              fmt::format("column {} has the opposite sign of the motion: with it, the inertia{} would be "
                          "negative. It was negated; "
                          "write scale = -1 for it into the model file",
                          column, friction_negative ? " and the friction" : ""));
    return;
  }
  // Without an acceleration to tell, a machine that another one drives looks the same as a wrong sign.
  constexpr double kMostOfThePower = 0.5;
  if (signs.inertia_is_seen || !friction_negative || signs.dissipation.value > -kMostOfThePower * signs.power)
    return;
  check.add("torque-sign", column, -1.0, "1", DataSeverity::Stop,
            fmt::format("column {} drives against the motion in both directions, so that the friction would "
                        "be negative: its sign is "
                        "wrong (write scale = -1 for it into the model file), or another machine drives this "
                        "one, and its {} is missing",
                        column, check.model.effort()));
}

/// The shift of the torque in time that leaves least of it, with its deviation by the jackknife over blocks.
struct Delay {
  double value_s = 0.0, sd_s = 0.0;
  double left = 1.0;  ///< of the squares that remain without a shift
  Eigen::Index blocks_better = 0;
  bool at_end = true;
};

double lowest(const Eigen::VectorXd& squares, double step_s, bool& at_end) {
  Eigen::Index least = 0;
  squares.minCoeff(&least);
  const Eigen::Index middle = squares.size() / 2;
  at_end = least == 0 || least == squares.size() - 1;
  double at = static_cast<double>(least - middle);
  if (!at_end) {
    const double curvature = squares[least - 1] - 2.0 * squares[least] + squares[least + 1];
    if (curvature > 0.0) at += 0.5 * (squares[least - 1] - squares[least + 1]) / curvature;
  }
  return at * step_s;
}

Delay delay_of(const Run& run, const Balance& balance) {
  constexpr Eigen::Index kSteps = 40;
  const double row_s = median_of_steps(run.time_s);
  const double step_s = std::max(row_s, 0.25 * balance.motion.half_width_s);
  const Eigen::MatrixXd basis = statistics::orthonormal_basis(balance.columns);
  const Eigen::Index n = basis.rows();
  Eigen::MatrixXd squares(2 * kSteps + 1, kBalanceBlocks);
  for (Eigen::Index k = -kSteps; k <= kSteps; ++k) {
    const std::vector<double> shifted = smooth_torque(run, balance.motion, static_cast<double>(k) * step_s);
    const Eigen::Map<const Eigen::VectorXd> torque(shifted.data(), n);
    const Eigen::VectorXd left = torque - basis * (basis.transpose() * torque);
    for (Eigen::Index b = 0; b < kBalanceBlocks; ++b)
      squares(k + kSteps, b) =
          left.segment(b * n / kBalanceBlocks, (b + 1) * n / kBalanceBlocks - b * n / kBalanceBlocks)
              .squaredNorm();
  }
  const Eigen::VectorXd total = squares.rowwise().sum();
  Delay delay;
  delay.value_s = lowest(total, step_s, delay.at_end);
  Eigen::Index least = 0;
  delay.left = total.minCoeff(&least) / total[kSteps];
  for (Eigen::Index b = 0; b < kBalanceBlocks; ++b) {
    delay.blocks_better += squares(least, b) < squares(kSteps, b) ? 1 : 0;
    bool at_end = false;
    delay.sd_s += std::pow(lowest(total - squares.col(b), step_s, at_end) - delay.value_s, 2);
  }
  delay.sd_s =
      std::sqrt(delay.sd_s * static_cast<double>(kBalanceBlocks - 1) / static_cast<double>(kBalanceBlocks));
  return delay;
}

void judge_delay(RunCheck& check, const Delay& delay) {
  const double row_s = median_of_steps(check.run.time_s);
  // A command that is held acts half a row after its own time. A fifth of what is unexplained, in most parts
  // of the run, is more than a filter of another shape or friction of another law takes by the way.
  constexpr double kLeftOver = 0.8;
  constexpr Eigen::Index kMostBlocks = kBalanceBlocks * 3 / 4;
  if (delay.at_end || delay.left > kLeftOver || delay.blocks_better < kMostBlocks) return;
  if (std::abs(delay.value_s) < std::max(1.5 * row_s, 5.0 * delay.sd_s)) return;
  const std::string& column = check.model.columns.torque->column;
  check.add(
      "torque-delay", column, delay.value_s, "s", DataSeverity::Note,
      fmt::format("column {} is {:.3g} ± {:.1g} ms ({:.1f} rows) {} the motion that it causes; {:.0f} % less "
                  "of it is unexplained "
                  "with that shift. Two loggers, a filter of the {} or a slow bus make such a delay: "
                  "record both at the "
                  "same instant, or look for torque-lag among the effects",
                  column, 1e3 * std::abs(delay.value_s), 1e3 * delay.sd_s, std::abs(delay.value_s) / row_s,
                  delay.value_s > 0.0 ? "later than" : "ahead of", 100.0 * (1.0 - std::sqrt(delay.left)),
                  check.model.effort()));
}

}  // namespace

void check_torque_against_motion(RunCheck& check) {
  constexpr std::size_t kLeastRows = 100;
  constexpr Eigen::Index kLeastPlaces = 5 * kBalanceBlocks;
  if (check.run.size() < kLeastRows) return;
  const std::string& column = check.model.columns.torque->column;
  if (std::ranges::all_of(check.run.torque_Nm,
                          [&](double value) { return value == check.run.torque_Nm.front(); })) {
    check.add("constant", column, check.run.torque_Nm.front(), std::string(torque_unit(check.model)),
              DataSeverity::Stop,
              fmt::format("column {} reads {:.4g} in every row: nothing can be told of the {}", column,
                          check.run.torque_Nm.front(), check.model.effort()));
    return;
  }
  const Balance balance = balance_of(check.run, check.model.linear);
  if (balance.columns.rows() < kLeastPlaces) return;
  const Eigen::VectorXd torque =
      Eigen::Map<const Eigen::VectorXd>(balance.motion.torque.data(), balance.columns.rows());
  const Signs signs = signs_of(balance, torque);
  judge_sign(check, signs, balance.both_directions);
  // Without acceleration the torque does not change with time, and a shift changes nothing.
  if (signs.inertia_is_seen) judge_delay(check, delay_of(check.run, balance));
}

namespace {

/// Rows in which a noisy reading repeats its greatest value, or its least.
struct Limit {
  double level = 0.0;
  std::size_t rows = 0;
};

/// The extremes that many rows share, where the reading hardly ever repeats itself elsewhere.
std::vector<Limit> limits_of(std::span<const double> x) {
  const auto [least, most] = std::ranges::minmax(x);
  std::array<Limit, 2> limits{{{least}, {most}}};
  std::array<std::size_t, 2> repeats{};
  std::size_t elsewhere = 0, repeats_elsewhere = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    std::size_t which = 0;
    while (which < 2 && std::abs(x[i] - limits[which].level) > 1e-9 * std::abs(limits[which].level)) ++which;
    const bool repeated = i > 0 && x[i] == x[i - 1];
    ++(which < 2 ? limits[which].rows : elsewhere);
    if (repeated) ++(which < 2 ? repeats[which] : repeats_elsewhere);
  }
  // A reading that moves in steps, or is at rest, repeats itself elsewhere as well; a lively one at a limit
  // only.
  constexpr std::size_t kFewest = 10, kLeastShare = 500;
  std::vector<Limit> found;
  if (10 * repeats_elsewhere >= elsewhere) return found;
  for (std::size_t which = 0; which < 2; ++which)
    if (limits[which].level != 0.0 && limits[which].rows >= kFewest &&
        kLeastShare * limits[which].rows >= x.size() && 4 * repeats[which] > limits[which].rows)
      found.push_back(limits[which]);
  return found;
}

/// By how much the motion asks for more than the level, in the rows at it, as a share of it: by a balance
/// that is fitted to the other rows. NaN where they do not tell.
double asked_beyond(const Run& run, bool linear, double level) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  const Balance balance = balance_of(run, linear);
  const Eigen::Index columns = balance.columns.cols();
  Sums sums{Eigen::MatrixXd::Zero(columns, columns), Eigen::VectorXd::Zero(columns)};
  std::vector<Eigen::Index> at_level;
  for (Eigen::Index i = 0; i < balance.columns.rows(); ++i) {
    const double torque = balance.motion.torque[static_cast<std::size_t>(i)];
    const double reading =
        interpolate(run.time_s, run.torque_Nm, balance.motion.time_s[static_cast<std::size_t>(i)]);
    if (std::abs(reading - level) < 1e-6 * std::abs(level)) {
      at_level.push_back(i);
    } else if (std::abs(torque) < 0.95 * std::abs(level)) {
      sums.products += balance.columns.row(i).transpose() * balance.columns.row(i);
      sums.with_torque += balance.columns.row(i).transpose() * torque;
    }
  }
  if (at_level.size() < 5 || balance.columns.rows() - std::ssize(at_level) < 5 * columns) return kNone;
  const Eigen::VectorXd fitted = solve(sums);
  std::vector<double> beyond;
  for (const Eigen::Index i : at_level) beyond.push_back(balance.columns.row(i).dot(fitted) / level - 1.0);
  return quantile(std::move(beyond), 0.5);
}

}  // namespace

void check_clipping(RunCheck& check) {
  constexpr std::size_t kLeastRows = 100;
  const std::vector<double>& torque = check.run.torque_Nm;
  if (torque.size() < kLeastRows) return;
  std::size_t rows = 0;
  double level = 0.0, beyond = -1.0;
  for (const Limit& limit : limits_of(torque)) {
    rows += limit.rows;
    if (std::abs(limit.level) > std::abs(level)) level = limit.level;
    beyond = std::max(beyond, asked_beyond(check.run, check.model.linear, limit.level));
  }
  if (rows == 0) return;
  const std::string& column = check.model.columns.torque->column;
  // A tenth more than the reading shows is beyond what friction of another law would make of it.
  constexpr double kContradiction = 0.1;
  const std::string what = fmt::format(
      "column {} reads its extreme, {:.5g} {}, in {} rows ({:.1f} %)", column, level,
      torque_unit(check.model), rows, 100.0 * static_cast<double>(rows) / static_cast<double>(torque.size()));
  // What acts at a command's limit is what it says, unless it was clipped on its way to the file.
  const bool command = check.model.torque_held;
  if (beyond > kContradiction &&
      2 * rows < torque.size())  // else the rest does not tell what the motion needs
    check.add(
        "clipped", column, static_cast<double>(rows), "rows",
        command ? DataSeverity::Note : DataSeverity::Stop,
        fmt::format("{}, and the motion there needs {:.0f} % more: the reading is clipped, and the {} goes "
                    "on. Record with a larger range, or leave those parts out of the file",
                    what, 100.0 * beyond, check.model.effort()));
  else
    check.add(
        "clipped", column, static_cast<double>(rows), "rows", DataSeverity::Note,
        command ? fmt::format("{0}: the controller is at its limit there, or the {1} was clipped on its way "
                              "to the file. If it was, record it with a larger range",
                              what, check.model.effort())
                : fmt::format("{}: the drive limits its {}, or the reading is clipped. If the reading is, "
                              "record with a larger range",
                              what, check.model.effort()));
}

}  // namespace clampd::data_check
